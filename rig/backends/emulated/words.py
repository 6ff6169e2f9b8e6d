"""The words of ``daq.port`` for emulated devices: one for virtual time; with ``-realtime`` behind it, for real time."""

from __future__ import annotations

_EMULATED = "emulated"
_REAL_TIME = "-realtime"


def in_virtual_time(port: str | None) -> bool:
    """Whether the port is that of an emulated device in virtual time."""
    return port is not None and port.startswith(_EMULATED) and not port.endswith(_REAL_TIME)


def without_real_time(port: str) -> str:
    """The word for the same emulated device in virtual time."""
    return port.removesuffix(_REAL_TIME)


def in_real_time(port: str) -> str:
    """The word for the same emulated device in real time."""
    return port if port.endswith(_REAL_TIME) else port + _REAL_TIME
