"""``driver: servo``: a smart servo on a bus, as a config describes it."""

from __future__ import annotations

from collections.abc import Iterator

from typing_extensions import override

from rig.backends.backend import Opening, Watchdog
from rig.backends.link_budget import LinkBudget
from rig.backends.links.usb_adapters import Adapter, adapter_delay_s
from rig.backends.registers.backend import RegisterBackend
from rig.backends.servo import link_budget
from rig.backends.servo.rules import has_watchdog, servo_rules, switch_to_try
from rig.backends.servo.section import EMULATED_PORTS, ServoKeys
from rig.config.problems import Problem
from rig.config.schema import DeviceSetup

_STEP_S = 1e-3  # of a servo's own loop: when within it a duty acts, and a position is sampled, no manual says


class ServoBackend(RegisterBackend):
    """A servo on a bus; or an emulated bus."""

    name = "servo"
    own_keys = ServoKeys
    emulated_ports = EMULATED_PORTS
    port_example = "/dev/ttyUSB0, or port: emulated"
    bench_example = "config/servo.yaml"
    adapter_hint = "daq.servo.adapter"

    @override
    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        yield from super().rules(d)
        yield from servo_rules(d)

    @override
    def watchdog(self, d: DeviceSetup) -> Watchdog:
        """Of a servo that has one in its registers; whether it works the opening tries."""
        servo = d.daq.servo
        if servo is None:
            return Watchdog(d.daq.watchdog_s)
        if not has_watchdog(servo):
            return Watchdog(None)
        return Watchdog(d.daq.watchdog_s, servo.table.role("watchdog").scale, certain=not d.daq.accept_no_watchdog)

    @override
    def writes_first(self, d: DeviceSetup) -> bool:
        return False

    @override
    def budget(self, d: DeviceSetup) -> LinkBudget:
        return LinkBudget() if d.daq.servo is None else link_budget.tick_budget(d.daq, d.daq.servo)

    @override
    def reading_budget(self, d: DeviceSetup) -> LinkBudget:
        return LinkBudget() if d.daq.servo is None else link_budget.reading_budget(d.daq, d.daq.servo)

    @override
    def reply_delay_s(self, d: DeviceSetup) -> float:
        adapter = self.adapter_behind(d)
        return 0.0 if adapter is None else adapter_delay_s(adapter)

    @override
    def times_error_s(self, d: DeviceSetup) -> float:
        """Both times are known to a half of the servo's step each."""
        return _STEP_S

    @override
    def adapter_behind(self, d: DeviceSetup) -> Adapter | None:
        return None if d.daq.servo is None or self.is_emulated(d) else link_budget.adapter_of(d.daq, d.daq.servo)

    @override
    def hand(self, d: DeviceSetup) -> str:
        return "" if d.daq.servo is None else switch_to_try(d, d.daq.servo)

    @override
    def words(self, d: DeviceSetup) -> str:
        servo = d.daq.servo
        who = f"servo {servo.id}, {servo.model}, {d.daq.baud} baud" if servo is not None else "a servo"
        if not self.is_emulated(d):
            return f"a REAL SERVO behind {d.daq.port}, {who}"
        if self.in_virtual_time(d):
            return f"an emulated bus, {who}, virtual time, nothing moves"
        return f"an emulated bus behind a pseudo-terminal, {who}, real time, nothing moves"

    @override
    def failsafe_words(self, d: DeviceSetup) -> str:
        servo = d.daq.servo
        silent_ms = 1e3 * d.daq.watchdog_s
        keeper = (
            f"a keeper, a process on this machine, stops the servo if rig dies or is silent for {silent_ms:g} ms; it "
            "does not cover cable, adapter or machine, nor what ends both at once, as the end of a container"
        )
        if servo is None or not has_watchdog(servo):
            return f"failsafe: none in the servo; {keeper}: keep the switch of its supply in reach"
        watchdog = f"the servo's watchdog, {silent_ms:g} ms, which rig tries at each opening without motion"
        return f"failsafe: {watchdog}; {keeper}"

    @override
    def notes(self, d: DeviceSetup) -> Iterator[str]:
        yield from super().notes(d)
        yield (
            "a servo's travel limits are in this host alone: no firmware of rig's holds them. No manual says when "
            "within its step of 1 ms a servo samples and drives"
        )
        servo = d.daq.servo
        if servo is None:
            return
        if switch := self.hand(d):
            yield f"before it drives rig asks you, at a terminal, to open the supply's switch and close it: {switch}"
        if servo.attached != "nothing" and d.load is None:
            yield (
                "without section `load` rig cannot tell whether what is on the horn falls when the torque goes off: "
                "try it by hand"
            )
        if "tick" not in servo.table.roles:
            yield (
                f"{servo.model} tells no clock: rig asks at another place within its step of 1 ms in each tick, "
                "and takes the mean for true; what its exchanges wait is in the interval of tau"
            )

    @override
    def opening(self) -> Opening:
        from rig.backends.servo import line

        return line


SERVO = ServoBackend()
