"""A device on a register bus, as a config describes it: what Modbus devices and servos have in common."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from typing_extensions import override

from rig.backends.backend import LineBackend, usb_notes, usb_rules
from rig.backends.emulated.words import in_virtual_time
from rig.config.problems import Problem
from rig.config.schema import DeviceSetup

if TYPE_CHECKING:
    from rig.core.strict_json import JsonObject


class RegisterBackend(LineBackend):
    """A device on a real port, or the emulated one of section ``emulated`` in its place.

    emulated_ports  words of ``daq.port`` for that
    adapter_hint    where the delay of a USB adapter stands, which is no key of ``daq`` itself
    """

    shared_keys = frozenset({"port", "usb_serial"})
    has_chip = False
    emulated_ports: ClassVar[tuple[str, ...]]
    adapter_hint: ClassVar[str]

    @override
    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        yield from usb_rules(d)

    @override
    def foreign_key(self, d: DeviceSetup, key: str, owner: str = "") -> Problem:
        problem = super().foreign_key(d, key, owner)
        return replace(problem, hint=self.adapter_hint) if key == "adapter" else problem

    @override
    def is_emulated(self, d: DeviceSetup) -> bool:
        return d.daq.port in self.emulated_ports

    @override
    def in_virtual_time(self, d: DeviceSetup) -> bool:
        return self.is_emulated(d) and in_virtual_time(d.daq.port)

    @override
    def plan(self, d: DeviceSetup) -> Iterator[str]:
        budget = self.budget(d)
        if budget.terms:
            yield f"link: {budget.beside(d.period_s)}"

    @override
    def notes(self, d: DeviceSetup) -> Iterator[str]:
        yield from usb_notes(d)

    @override
    def not_emulated_words(self, d: DeviceSetup) -> str:
        return f"section `emulated` is not used with port {d.daq.port}"

    @override
    def rehearsed(self, d: DeviceSetup) -> dict[str, JsonObject]:
        """The same device, emulated on the same kind of line."""
        return {"daq": {"port": self.emulated_ports[0], "usb_serial": None}, "emulated": {}}
