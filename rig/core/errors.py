"""The class above every error that rig raises on purpose, and the error of the physics; it imports nothing of rig."""


class RigError(Exception):
    """An error with a message for people: what happened, where, and what to do.

    Its subclasses are ``Fault``, ``ConfigError``, ``RecordingError``, ``IdentifyError``, ``PlugInError`` and others.
    A call that makes no sense, such as one with a negative time constant, raises ValueError instead.
    """


class LibraryError(RigError):
    """The C library of the motor's physics cannot be compiled or loaded (``rig.model.library``)."""
