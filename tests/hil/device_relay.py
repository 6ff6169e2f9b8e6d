"""The relay of the firmware, called directly in the shared library."""

from __future__ import annotations

import ctypes

from rig.backends.serial.emulated import firmware_build

COUNT = 16  # y of one count
COUNT_TICK = 32  # z of one count for one tick
Z_MAX = 2**30


class _Setup(ctypes.Structure):
    _fields_ = (
        ("centre", ctypes.c_int32),
        ("z_bound", ctypes.c_int32),
        ("drive", ctypes.c_int16 * 4),
        ("direction", ctypes.c_int8),
    )


class _Relay(ctypes.Structure):
    _fields_ = (
        ("setup", _Setup),
        ("y", ctypes.c_int32),
        ("z", ctypes.c_int32),
        ("sign_y", ctypes.c_int8),
        ("sign_z", ctypes.c_int8),
        ("bound_reached", ctypes.c_bool),
    )


class DeviceRelay:
    """One relay; centre in 1/16 count, z_bound in 1/32 count tick, the drive of each state in units."""

    def __init__(self, centre: int, z_bound: int, drive: tuple[int, int, int, int], direction: int) -> None:
        self._library = ctypes.CDLL(str(firmware_build.build()))
        self._library.relay_is_valid.restype = ctypes.c_bool
        self._library.relay_step.restype = ctypes.c_int16
        self._library.relay_step.argtypes = [ctypes.POINTER(_Relay), ctypes.c_int32]
        setup = _Setup(centre, z_bound, (ctypes.c_int16 * 4)(*drive), direction)
        assert self._library.relay_is_valid(ctypes.byref(setup))
        self._relay = _Relay()
        self._library.relay_init(ctypes.byref(self._relay), ctypes.byref(setup))

    def step(self, counts: int) -> int:
        drive: int = self._library.relay_step(ctypes.byref(self._relay), counts)
        return drive

    @property
    def z(self) -> int:
        z: int = self._relay.z
        return z

    @property
    def bound_reached(self) -> bool:
        reached: bool = self._relay.bound_reached
        return reached
