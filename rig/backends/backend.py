"""What is behind the driver that a config names: an emulated device, a plug-in's, or a real motor."""

from __future__ import annotations

from rig.backends.modbus.section import EMULATED_PORTS as MODBUS_EMULATED_PORTS
from rig.backends.modbus.section import is_tcp
from rig.backends.serial.usb_adapters import Adapter, adapter_by_name
from rig.config.schema import BUILT_IN_DRIVERS, Experiment

CHIP_PORTS = ("emulated-chip", "emulated-chip-realtime")
EMULATED_PORTS = ("emulated", *CHIP_PORTS)
CHIP_BAUDS = (115200, 1_000_000)  # that the Uno's firmware is built for


def is_plug_in(experiment: Experiment) -> bool:
    """Whether the driver comes from another package: offline nothing is known of its link and its failsafe."""
    return experiment.daq.driver not in BUILT_IN_DRIVERS


def is_emulated(e: Experiment) -> bool:
    """Whether the bench is the one of section `emulated`, so that nothing moves."""
    ports = MODBUS_EMULATED_PORTS if e.daq.driver == "modbus" else EMULATED_PORTS
    return e.daq.driver == "simulated" or e.daq.port in ports


def writes_first(experiment: Experiment) -> bool:
    """Whether what a tick decides goes out with the next one: a Modbus device asked by FC23; a plug-in's may."""
    modbus = experiment.daq.modbus
    asked_by_fc23 = experiment.daq.driver == "modbus" and modbus is not None and modbus.requests == "read-write"
    return asked_by_fc23 or is_plug_in(experiment)


def adapter_of(e: Experiment) -> Adapter:
    """What delays the replies of a serial device: what the config says; else what its port's name gives away."""
    d = e.daq
    if d.driver != "serial":
        return "none"
    if d.adapter is not None:
        return d.adapter
    return "none" if d.port is None or is_emulated(e) else adapter_by_name(d.port)


def backend_words(e: Experiment) -> str:
    """What is there, and whether a real motor may turn, for people."""
    if e.daq.driver == "simulated":
        return "a simulation in virtual time, no device, nothing moves"
    if e.daq.driver == "modbus":
        return _modbus_words(e)
    if e.daq.port == "emulated-chip":
        return f"the Uno's emulated chip with its firmware, {e.daq.baud} baud, virtual time, nothing moves"
    if e.daq.port == "emulated-chip-realtime":
        return f"the Uno's emulated chip with its firmware, {e.daq.baud} baud, real time, nothing moves"
    if e.daq.port == "emulated":
        return f"an emulated device behind a pseudo-terminal, {e.daq.baud} baud, real time, nothing moves"
    if is_plug_in(e):
        return f"plug-in driver {e.daq.driver}: take it for a REAL MOTOR"
    return f"a REAL MOTOR behind the serial port {e.daq.port}, {e.daq.baud} baud"


def _modbus_words(e: Experiment) -> str:
    unit = 1 if e.daq.modbus is None else e.daq.modbus.unit
    if e.daq.port == "emulated-tcp":
        return f"an emulated I/O block, Modbus TCP on this machine, unit {unit}, real time, nothing moves"
    rtu = f"Modbus RTU, unit {unit}, {e.daq.baud} baud"
    if e.daq.port == "emulated-virtual":
        return f"an emulated I/O block, {rtu}, virtual time, nothing moves"
    if e.daq.port == "emulated":
        return f"an emulated I/O block behind a pseudo-terminal, {rtu}, real time, nothing moves"
    link = f"Modbus TCP, unit {unit}" if is_tcp(e.daq.port) else rtu
    return f"a REAL MOTOR behind {e.daq.port}, {link}"
