"""``driver: modbus``: a Modbus device, as a config describes it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from typing_extensions import override

from rig.backends.backend import Line, LineBackend, Watchdog, usb_notes, usb_rules
from rig.backends.driver import Driver
from rig.backends.emulated.words import in_virtual_time
from rig.backends.link_budget import LinkBudget
from rig.backends.modbus import link_budget
from rig.backends.modbus.rules import modbus_notes, modbus_rules
from rig.backends.modbus.section import EMULATED_PORTS, ModbusKeys, is_tcp
from rig.config.problems import Problem
from rig.config.schema import Experiment

if TYPE_CHECKING:  # it loads slowly
    from rig.backends.emulated.board_process import BoardProcess
    from rig.results import JsonObject

_STAMPS_S = 1e-4  # of a device's own: a conversion, the refresh of its output


class ModbusBackend(LineBackend):
    """A Modbus device on RTU or TCP; or an emulated I/O block on either."""

    name = "modbus"
    own_keys = ModbusKeys
    shared_keys = frozenset({"port", "usb_serial"})
    has_chip = False

    @override
    def rules(self, e: Experiment) -> Iterator[Problem]:
        yield from usb_rules(e)
        yield from modbus_rules(e)

    @override
    def foreign_key(self, e: Experiment, key: str, owner: str = "") -> Problem:
        """The delay of a USB adapter has another key here."""
        problem = super().foreign_key(e, key, owner)
        return replace(problem, hint="add its delay to daq.modbus.turnaround_s") if key == "adapter" else problem

    @override
    def owns_port(self, port: str) -> bool:
        return is_tcp(port)

    @override
    def watchdog(self, e: Experiment) -> Watchdog:
        """The watchdog of its register; or the one that was set on the device itself."""
        modbus = e.daq.modbus
        if modbus is None:
            return Watchdog(e.daq.watchdog_s)
        if modbus.registers.watchdog is not None:
            return Watchdog(e.daq.watchdog_s, modbus.registers.watchdog.unit_s)
        return Watchdog(modbus.device_watchdog_s, None)

    @override
    def writes_first(self, e: Experiment) -> bool:
        """With FC23 it does."""
        return e.daq.modbus is not None and e.daq.modbus.requests == "read-write"

    @override
    def budget(self, e: Experiment) -> LinkBudget:
        return LinkBudget() if e.daq.modbus is None else link_budget.tick_budget(e.daq, e.daq.modbus)

    @override
    def reading_budget(self, e: Experiment) -> LinkBudget:
        return LinkBudget() if e.daq.modbus is None else link_budget.reading_budget(e.daq, e.daq.modbus)

    @override
    def times_error_s(self, e: Experiment) -> float:
        """The device reports no times: rig computes them.

        When within its turnaround the device samples and drives is not known.
        """
        return _STAMPS_S + (0.5 * e.daq.modbus.turnaround_s if e.daq.modbus is not None else 0.0)

    @override
    def words(self, e: Experiment) -> str:
        unit = 1 if e.daq.modbus is None else e.daq.modbus.unit
        tcp = is_tcp(e.daq.port)
        link = f"Modbus TCP, unit {unit}" if tcp else f"Modbus RTU, unit {unit}, {e.daq.baud} baud"
        if not self.is_emulated(e):
            return f"a REAL MOTOR behind {e.daq.port}, {link}"
        if self.in_virtual_time(e):
            return f"an emulated I/O block, {link}, virtual time, nothing moves"
        place = "on a port of this machine" if tcp else "behind a pseudo-terminal"
        return f"an emulated I/O block {place}, {link}, real time, nothing moves"

    @override
    def is_emulated(self, e: Experiment) -> bool:
        return e.daq.port in EMULATED_PORTS

    @override
    def in_virtual_time(self, e: Experiment) -> bool:
        return self.is_emulated(e) and in_virtual_time(e.daq.port)

    @override
    def plan(self, e: Experiment) -> Iterator[str]:
        budget = self.budget(e)
        if budget.terms:
            yield f"link: {budget.beside(e.period_s)}"

    @override
    def failsafe_words(self, e: Experiment) -> str:
        modbus = e.daq.modbus
        if modbus is None or modbus.registers.watchdog is not None:
            return super().failsafe_words(e)
        if modbus.device_watchdog_s is None:
            return "failsafe: none; daq.accept_no_watchdog accepts that: keep the motor's supply switch in reach"
        return (
            f"failsafe: the device sets 0 V after {modbus.device_watchdog_s * 1e3:g} ms of silence, as set on it "
            "(daq.modbus.device_watchdog_s): test that, pull the plug at 0.3 V"
        )

    @override
    def notes(self, e: Experiment) -> Iterator[str]:
        yield from usb_notes(e)
        yield from modbus_notes(e)

    @override
    def not_emulated_words(self, e: Experiment) -> str:
        return f"section `emulated` is not used with port {e.daq.port}"

    @override
    def line(self, e: Experiment) -> AbstractContextManager[Line]:
        from rig.backends.modbus.opening import modbus_line

        return modbus_line(e)

    @override
    def driver(self, e: Experiment, line: Line) -> Driver:
        from rig.backends.modbus.opening import modbus_driver

        return modbus_driver(e, line.transport, line.name, emulated=line.emulated, answered=line.answered)

    @override
    def emulated(
        self, e: Experiment, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
    ) -> AbstractContextManager[BoardProcess]:
        """There is no ``chip``."""
        from rig.backends.modbus.opening import emulated_board

        return emulated_board(e, link, trace)

    @override
    def rehearsed(self, e: Experiment) -> dict[str, JsonObject]:
        """An I/O block with the config's register map, on the same kind of line."""
        port = "emulated-tcp" if is_tcp(e.daq.port) else "emulated"
        return {"daq": {"port": port, "usb_serial": None}, "emulated": {}}

    @override
    def emulated_hint(self, e: Experiment, port: str) -> str:
        if e.daq.modbus is None:
            return ""
        from rig.backends.modbus.emulated.modbus_board import mbpoll_line

        return f"try: {mbpoll_line(e.daq.modbus, port, e.daq.baud)}"


MODBUS = ModbusBackend()
