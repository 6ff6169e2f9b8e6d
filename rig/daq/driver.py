"""The old name of ``rig.backends.driver``."""

from rig.backends.driver import (
    Clock,
    DeviceInfo,
    DeviceWatchdog,
    Driver,
    DriverSettings,
    RelayDriver,
    Transport,
)

__all__ = [
    "Clock",
    "DeviceInfo",
    "DeviceWatchdog",
    "Driver",
    "DriverSettings",
    "RelayDriver",
    "Transport",
]
