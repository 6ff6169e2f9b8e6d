"""The one class above every error that rig raises on purpose. Any room may import it; it imports nothing of rig."""


class RigError(Exception):
    """An error with a message for people: what happened, where, and what to do.

    Its subclasses are ``Fault``, ``ConfigError``, ``RecordingError``, ``IdentifyError``, ``PlugInError`` and others.
    A call that makes no sense, such as one with a negative time constant, raises ValueError instead.
    """
