"""A device on a register bus, as a config describes it: what Modbus devices and servos have in common."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

from typing_extensions import override

from rig.backends.backend import PortBackend
from rig.backends.tick_waits import unwatched_s
from rig.config.problems import Problem
from rig.config.schema import DeviceSetup
from rig.core.strict_json import JsonObject


class RegisterBackend(PortBackend):
    """A device on a register bus.

    adapter_hint    where the delay of a USB adapter stands, which is no key of ``daq`` itself
    """

    has_chip = False
    adapter_hint: ClassVar[str]

    @override
    def foreign_key(self, d: DeviceSetup, key: str, owner: str = "") -> Problem:
        problem = super().foreign_key(d, key, owner)
        return replace(problem, hint=self.adapter_hint) if key == "adapter" else problem

    @override
    def lost_reply_s(self, d: DeviceSetup) -> float:
        """Where no watchdog ends a drive late answers may take as much together."""
        if self.watchdog(d).time_s is None:
            return unwatched_s(d.daq.timeout_s, d.daq.watchdog_s)
        return d.daq.timeout_s

    @override
    def plan(self, d: DeviceSetup) -> Iterator[str]:
        budget = self.budget(d)
        if budget.terms:
            yield f"link: {budget.beside(d.period_s)}"
            yield self.late_words(d)

    @override
    def rehearsed(self, d: DeviceSetup) -> dict[str, JsonObject]:
        """The same device, emulated on the same kind of line."""
        return {"daq": {"port": self.emulated_ports[0], "usb_serial": None}, "emulated": {}}
