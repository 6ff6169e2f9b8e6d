"""What ``daq.port`` names for ``driver: serial``: an emulated device, or a port and its USB adapter."""

from __future__ import annotations

from rig.backends.emulated.words import in_virtual_time
from rig.backends.links.usb_adapters import Adapter, adapter_by_name
from rig.config.schema import Experiment

PICO_PORTS = ("emulated-pico", "emulated-pico-realtime")
CHIP_PORTS = ("emulated-chip", "emulated-chip-realtime", *PICO_PORTS)
EMULATED_PORTS = ("emulated", "emulated-realtime", *CHIP_PORTS)
CHIP_BAUDS = (115200, 1_000_000)  # that the boards' firmware is built for


def is_emulated(e: Experiment) -> bool:
    """Whether the port is that of an emulated device."""
    return e.daq.port in EMULATED_PORTS


def is_virtual(e: Experiment) -> bool:
    """Whether that device lives in virtual time."""
    return is_emulated(e) and in_virtual_time(e.daq.port)


def adapter_of(e: Experiment) -> Adapter:
    """The USB adapter that delays the replies: from the config, else from the port's name."""
    if e.daq.adapter is not None:
        return e.daq.adapter
    return "none" if e.daq.port is None or is_emulated(e) else adapter_by_name(e.daq.port)
