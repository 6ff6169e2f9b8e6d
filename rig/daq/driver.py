"""The old name of ``rig.backends.driver``."""

from rig.backends.driver import (
    Clock,
    DeviceInfo,
    DeviceWatchdog,
    Driver,
    DriverSettings,
    RelayCommand,
    RelayDriver,
    RelayRow,
    Transport,
)

__all__ = [
    "Clock",
    "DeviceInfo",
    "DeviceWatchdog",
    "Driver",
    "DriverSettings",
    "RelayCommand",
    "RelayDriver",
    "RelayRow",
    "Transport",
]
