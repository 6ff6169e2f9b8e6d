"""Cards with one defect each, and the tests of the conformance suite that must find it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from plug_in_cards import VirtualCard

from rig.backends.driver import DeviceInfo, DeviceWatchdog, DriverSettings
from rig.core.faults import Fault
from rig.core.signals import Limits, Sample

CAUGHT_BY: dict[type[VirtualCard], set[str]] = {}


def caught_by(*names: str) -> Callable[[type[VirtualCard]], type[VirtualCard]]:
    def note(card: type[VirtualCard]) -> type[VirtualCard]:
        CAUGHT_BY[card] = {f"test_{name}" for name in names}
        return card

    return note


@caught_by("times_are_in_its_clock_and_rise")
class WallClock(VirtualCard):
    """Samples are stamped with another clock than the declared one."""

    def read(self) -> Sample:
        sample = super().read()
        return sample._replace(t_s=sample.t_s + 1.7e9)


@caught_by("times_are_in_its_clock_and_rise")
class FrozenTime(VirtualCard):
    """The time of the sample is that of the last tick but one, every other time."""

    def read(self) -> Sample:
        sample = super().read()
        return sample._replace(t_s=sample.t_s - 0.010 * (sample.seq % 2))


@caught_by("the_drive_takes_effect_after_its_write_and_in_its_order")
class EffectWhenRead(VirtualCard):
    """The drive is said to act since the tick before it was written."""

    def read(self) -> Sample:
        sample = super().read()
        return sample._replace(t_u_s=sample.t_u_s - 0.010)


@caught_by("the_drive_takes_effect_after_its_write_and_in_its_order")
class ActsAtOnce(VirtualCard):
    """Says that a drive goes out with the next reading, but it goes out at once."""

    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings)
        self.order = "write_first"

    def write(self, u_V: float) -> None:
        self.order = "sample_first"
        super().write(u_V)
        self.order = "write_first"


@caught_by("the_drive_takes_effect_after_its_write_and_in_its_order")
class ActsATickLate(VirtualCard):
    """Says that a drive goes out at once, but it goes out with the next reading."""

    def write(self, u_V: float) -> None:
        self.order = "write_first"
        super().write(u_V)
        self.order = "sample_first"


@caught_by("the_drive_is_reported_as_quantised")
class EchoesWhatWasAsked(VirtualCard):
    """Reports the host's drive instead of the device's."""

    asked_V = acting_V = 0.0

    def read(self) -> Sample:
        sample = super().read()
        if sample.u_V == 0.0:
            return sample
        return sample._replace(u_V=self.asked_V)

    def write(self, u_V: float) -> None:
        super().write(u_V)
        self.asked_V = u_V


@caught_by("the_drive_is_reported_as_quantised")
class OtherUnits(VirtualCard):
    """Its converter has other steps than it says."""

    def open(self) -> DeviceInfo:
        return replace(super().open(), drive_units=1000)


@caught_by("the_drive_that_acts_is_reported", "safe_stop_disarms", "constructing_touches_no_device")
class ReportsTheOtherSign(VirtualCard):
    """The drive comes back with its sign turned."""

    def read(self) -> Sample:
        sample = super().read()
        return sample._replace(u_V=-sample.u_V)


@caught_by("it_refuses_drives_beyond_its_range")
class Clips(VirtualCard):
    """Drives what it can instead of refusing."""

    def write(self, u_V: float) -> None:
        super().write(max(-12.0, min(12.0, u_V)))


@caught_by("it_refuses_drives_beyond_its_range")
class TakesNan(VirtualCard):
    """Takes what is no number for 0 V."""

    def write(self, u_V: float) -> None:
        super().write(0.0 if math.isnan(u_V) else u_V)


@caught_by("it_drives_no_more_than_it_was_armed_for")
class ForgetsItsLimit(VirtualCard):
    """Drives up to its supply, whatever it was armed for."""

    def arm(self, limits: Limits) -> None:
        super().arm(replace(limits, max_u_V=max(limits.max_u_V, 12.0) if limits.max_u_V < 3.0 else limits.max_u_V))


@caught_by(
    "safe_stop_sets_zero",
    "safe_stop_disarms",
    "a_dead_link_is_a_fault_and_safe_stop_does_not_raise",
)
class StopsLater(VirtualCard):
    """Confirms the stop and goes on driving."""

    def safe_stop(self) -> bool:
        return True


@caught_by("it_drives_nothing_unless_it_is_armed", "safe_stop_disarms", "it_refuses_limits_that_it_cannot_hold")
class ArmsItself(VirtualCard):
    """A write arms it."""

    def write(self, u_V: float) -> None:
        if self._limits is None and abs(u_V) <= 3.0:
            super().arm(Limits((-1.0, 1.0), (-1.9, 1.9), 3.0, 0.1))
        super().write(u_V)


@caught_by("it_refuses_limits_that_it_cannot_hold")
class TakesAnyLimits(VirtualCard):
    """Takes limits that its sensor could never see."""

    def arm(self, limits: Limits) -> None:
        super().arm(replace(limits, hard_rad=(-1.9, 1.9)))


@caught_by("safe_stop_after_close_does_not_raise")
class RaisesWhenClosed(VirtualCard):
    """A stop on a closed link raises."""

    closed = False

    def safe_stop(self) -> bool:
        if self.closed:
            raise OSError("bad file descriptor")
        return super().safe_stop()

    def close(self) -> None:
        super().close()
        self.closed = True


@caught_by("close_may_be_called_twice")
class ClosesOnce(VirtualCard):
    """Closing again raises."""

    closed = False

    def close(self) -> None:
        if self.closed:
            raise ValueError("not open")
        self.closed = True
        super().close()


@caught_by("safe_stop_and_close_before_open")
class NeedsOpen(VirtualCard):
    """A stop before it was opened raises."""

    opened = False

    def open(self) -> Any:
        self.opened = True
        return super().open()

    def safe_stop(self) -> bool:
        if not self.opened:
            raise AttributeError("no task")
        return super().safe_stop()


@caught_by("its_failsafe_is_declared")
class LongWatchdog(VirtualCard):
    """Its watchdog takes ten times as long as it was armed for."""

    def arm(self, limits: Limits) -> None:
        super().arm(replace(limits, watchdog_s=10.0 * limits.watchdog_s))


@caught_by("silence_sets_zero_and_latches")
class ClaimsAWatchdog(VirtualCard):
    """Says that it has a watchdog, and holds its last drive."""

    def arm(self, limits: Limits) -> None:
        super().arm(replace(limits, watchdog_s=1e6))
        self.failsafe = DeviceWatchdog(limits.watchdog_s)


@caught_by("silence_sets_zero_and_latches")
class WatchdogForgets(VirtualCard):
    """Its watchdog stops the drive, and lets the next write through."""

    def read(self) -> Sample:
        try:
            return super().read()
        except Fault as fault:
            if fault.code != "DEVICE_WATCHDOG":
                raise
            self._fault = None
            return super().read()


@caught_by("it_holds_the_period")
class Slow(VirtualCard):
    """A reading takes a period and a half."""

    def read(self) -> Sample:
        self.clock.sleep_until(self.clock.now_s() + 1.5 * self.period_s)
        return super().read()


@caught_by("a_reading_is_complete_before_anything_was_armed")
class OtherCalibration(VirtualCard):
    """Position and raw reading do not belong together; times of drives before there was one."""

    def read(self) -> Sample:
        sample = super().read()
        return sample._replace(y_rad=sample.y_rad + 0.05)


@caught_by("its_link_statistics_only_rise")
class CountsDown(VirtualCard):
    """Counts since the last reading instead of since it was made."""

    def read(self) -> Sample:
        sample = super().read()
        self.link_statistics = {"exchanges": -sample.seq}
        return sample


@caught_by("it_says_what_it_is")
class Nameless(VirtualCard):
    """Does not say what is behind it."""

    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings)
        self.backend = ""


@caught_by("constructing_touches_no_device")
class ResetsTheDevice(VirtualCard):
    """Constructing another one resets the device that both share."""

    last: VirtualCard | None = None

    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings)
        if ResetsTheDevice.last is not None:
            ResetsTheDevice.last.safe_stop()
        ResetsTheDevice.last = self


@caught_by("a_dead_link_is_a_fault_and_safe_stop_does_not_raise")
class RepeatsTheLastReading(VirtualCard):
    """On a dead link it returns what it read last."""

    seen: Sample | None = None

    def read(self) -> Sample:
        if self.dead and self.seen is not None:
            return self.seen
        self.seen = super().read()
        return self.seen


@caught_by("a_dead_link_is_a_fault_and_safe_stop_does_not_raise")
class ConfirmsOnADeadLink(VirtualCard):
    """Says that the device has stopped although nobody could tell it."""

    def safe_stop(self) -> bool:
        super().safe_stop()
        return True
