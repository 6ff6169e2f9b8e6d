"""The one class above every error that rig raises on purpose. Any room may import this module; it imports none."""


class RigError(Exception):
    """Something that rig has to say to a person: what happened, where, and what to do.

    Below it stand ``Fault``, ``ConfigError``, ``RecordingError``, ``IdentifyError``, ``PlugInError`` and the others.
    A value that no function can mean, such as a negative time constant, stays a ValueError.
    """
