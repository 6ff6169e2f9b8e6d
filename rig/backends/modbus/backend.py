"""``driver: modbus``: a Modbus device, as a config describes it."""

from __future__ import annotations

from collections.abc import Iterator

from typing_extensions import override

from rig.backends.backend import Opening, Watchdog
from rig.backends.link_budget import LinkBudget
from rig.backends.modbus import link_budget
from rig.backends.modbus.rules import modbus_notes, modbus_rules
from rig.backends.modbus.section import EMULATED_PORTS, ModbusKeys, is_tcp
from rig.backends.registers.backend import RegisterBackend
from rig.config.problems import Problem
from rig.config.schema import DeviceSetup
from rig.core.strict_json import JsonObject

_STAMPS_S = 1e-4  # of a device's own: a conversion, the refresh of its output


class ModbusBackend(RegisterBackend):
    """A Modbus device on RTU or TCP; or an emulated I/O block on either."""

    name = "modbus"
    own_keys = ModbusKeys
    emulated_ports = EMULATED_PORTS
    port_example = "/dev/ttyUSB0, tcp://192.168.0.5:502, or port: emulated"
    adapter_hint = "add its delay to daq.modbus.turnaround_s"

    @override
    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        yield from super().rules(d)
        yield from modbus_rules(d)

    @override
    def owns_port(self, port: str) -> bool:
        return is_tcp(port)

    @override
    def watchdog(self, d: DeviceSetup) -> Watchdog:
        """The watchdog of its register; or the one that was set on the device itself."""
        modbus = d.daq.modbus
        if modbus is None:
            return Watchdog(d.daq.watchdog_s)
        if modbus.registers.watchdog is not None:
            return Watchdog(d.daq.watchdog_s, modbus.registers.watchdog.unit_s)
        return Watchdog(modbus.device_watchdog_s, None)

    @override
    def writes_first(self, d: DeviceSetup) -> bool:
        """With FC23 it does."""
        return d.daq.modbus is not None and d.daq.modbus.requests == "read-write"

    @override
    def budget(self, d: DeviceSetup) -> LinkBudget:
        return LinkBudget() if d.daq.modbus is None else link_budget.tick_budget(d.daq, d.daq.modbus)

    @override
    def reading_budget(self, d: DeviceSetup) -> LinkBudget:
        return LinkBudget() if d.daq.modbus is None else link_budget.reading_budget(d.daq, d.daq.modbus)

    @override
    def lost_reply_s(self, d: DeviceSetup) -> float:
        """Where no watchdog acts meanwhile the stop comes later, too: the line must be silent before it."""
        modbus, late_s = d.daq.modbus, super().lost_reply_s(d)
        if modbus is None or self.watchdog(d).time_s is not None:
            return late_s
        return late_s + link_budget.longest_transaction_s(d.daq, modbus)

    @override
    def times_error_s(self, d: DeviceSetup) -> float:
        """The device reports no times: rig computes them.

        When within its turnaround the device samples and drives is not known.
        """
        return _STAMPS_S + (0.5 * d.daq.modbus.turnaround_s if d.daq.modbus is not None else 0.0)

    @override
    def words(self, d: DeviceSetup) -> str:
        unit = 1 if d.daq.modbus is None else d.daq.modbus.unit
        tcp = is_tcp(d.daq.port)
        link = f"Modbus TCP, unit {unit}" if tcp else f"Modbus RTU, unit {unit}, {d.daq.baud} baud"
        if not self.is_emulated(d):
            return f"a REAL MOTOR behind {d.daq.port}, {link}"
        if self.in_virtual_time(d):
            return f"an emulated I/O block, {link}, virtual time, nothing moves"
        place = "on a port of this machine" if tcp else "behind a pseudo-terminal"
        return f"an emulated I/O block {place}, {link}, real time, nothing moves"

    @override
    def failsafe_words(self, d: DeviceSetup) -> str:
        modbus = d.daq.modbus
        if modbus is None or modbus.registers.watchdog is not None:
            return super().failsafe_words(d)
        if modbus.device_watchdog_s is None:
            return "failsafe: none; daq.accept_no_watchdog accepts that: keep the motor's supply switch in reach"
        return (
            f"failsafe: the device sets 0 V after {modbus.device_watchdog_s * 1e3:g} ms of silence, as set on it "
            "(daq.modbus.device_watchdog_s): test that, pull the plug at 0.3 V"
        )

    @override
    def notes(self, d: DeviceSetup) -> Iterator[str]:
        yield from super().notes(d)
        yield from modbus_notes(d)

    @override
    def opening(self) -> Opening:
        from rig.backends.modbus import opening

        return opening

    @override
    def rehearsed(self, d: DeviceSetup) -> dict[str, JsonObject]:
        """An I/O block with the config's register map, on the same kind of line."""
        found = super().rehearsed(d)
        return found | {"daq": found["daq"] | {"port": "emulated-tcp"}} if is_tcp(d.daq.port) else found

    @override
    def emulated_hint(self, d: DeviceSetup, port: str) -> str:
        if d.daq.modbus is None:
            return ""
        from rig.backends.modbus.emulated.modbus_board import mbpoll_line

        return f"try: {mbpoll_line(d.daq.modbus, port, d.daq.baud)}"


MODBUS = ModbusBackend()
