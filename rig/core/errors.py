"""The classes above the errors that rig raises on purpose, and the error of the physics; it imports nothing of rig."""

from __future__ import annotations

from typing import Any


class RigError(Exception):
    """An error with a message for people: what happened, where, and what to do.

    Its subclasses are ``Fault``, ``ConfigError``, ``RecordingError``, ``IdentifyError``, ``PlugInError`` and others.
    A call that makes no sense, such as one with a negative time constant, raises ValueError instead.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """As it is, whatever its class is made of: the pool of a worker that could not hand it over would break."""
        return _again, (type(self), self.args), self.__dict__


def _again(kind: type[RigError], args: tuple[object, ...]) -> RigError:
    return kind.__new__(kind, *args)


class CauseError(RigError):
    """An error in two lines: ``cause``, what is wrong, and ``cure``, one thing to do about it.

    status  exit status of a command that ends with it: 1, it failed, or 2, bad input
    """

    status = 2

    def __init__(self, cause: str, cure: str) -> None:
        self.cause, self.cure = cause, cure
        super().__init__(f"{cause}\n{cure}")


class LibraryError(RigError):
    """The C library of the motor's physics cannot be compiled or loaded (``rig.model.library``)."""
