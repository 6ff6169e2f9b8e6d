"""What ``daq.port`` names for ``driver: serial``: an emulated device, or a port and its USB adapter."""

from __future__ import annotations

from rig.backends.links.usb_adapters import Adapter, adapter_by_name
from rig.config.schema import DeviceSetup

PICO_PORTS = ("emulated-pico", "emulated-pico-realtime")
CHIP_PORTS = ("emulated-chip", "emulated-chip-realtime", *PICO_PORTS)
EMULATED_PORTS = ("emulated", "emulated-realtime", *CHIP_PORTS)
CHIP_BAUDS = (115200, 1_000_000)  # that the boards' firmware is built for


def is_emulated(d: DeviceSetup) -> bool:
    """Whether the port is that of an emulated device."""
    return d.daq.port in EMULATED_PORTS


def adapter_of(d: DeviceSetup) -> Adapter:
    """The USB adapter that delays the replies: from the config, else from the port's name."""
    if d.daq.adapter is not None:
        return d.daq.adapter
    return "none" if d.daq.port is None or is_emulated(d) else adapter_by_name(d.daq.port)
