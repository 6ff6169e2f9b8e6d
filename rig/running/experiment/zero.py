"""The zero of an encoder: set by hand, or by an end switch that the shaft is driven to."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from rig.backends.driver import EncoderDriver
from rig.backends.registry import Bench, connect
from rig.config.schema import Experiment, HomeSwitch
from rig.control.guard import Guard
from rig.control.law import BareLaw, Rest
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest, stop_on_signals
from rig.core.faults import Fault
from rig.core.signals import Limits, Sample
from rig.run_folder.live.running import told
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.recording.sink import NullSink
from rig.running.preflight.room_to_stop import guard_settings_of

_BACK_RAD = 0.2  # from the switch, before it is driven to once more
_ROOM = 1.2  # of the travel between the hard limits: where no switch opens within it, there is none
_STANDS_S = 1.0  # a drive that moves nothing for so long is too weak
_LONGEST_S = 120.0
_AT_REST_S = 1.0


class Zero(NamedTuple):
    """Where the shaft stands now, and what the encoder read there before its zero was set."""

    y_rad: float
    y_counts: int
    from_counts: int


def forget(e: Experiment) -> None:
    """Forget the zero before a hand turns the shaft. Raises Fault LINK_*, CONFIG_MISMATCH."""
    with connect(e.device) as bench:
        _encoder_driver(bench).forget_zero()


def by_hand(e: Experiment, at_rad: float) -> Zero:
    """Forget the zero, then set that of a shaft that stands at ``at_rad``.

    Raises Fault LINK_*, CONFIG_MISMATCH, DEVICE_ENCODER_*: then there is none.
    """
    with connect(e.device) as bench:
        driver = _encoder_driver(bench)
        driver.forget_zero()
        before = driver.read()
        driver.set_zero(at_rad)
        now = driver.read()
    return Zero(now.y_rad, now.y_counts, before.y_counts)


def by_switch(e: Experiment, runs: Path) -> Zero:
    """As ``find_by_switch``, on the bench of the config. Raises Fault LINK_*, CONFIG_MISMATCH, BusyError, too.

    runs  folder of the run folders, whose panels can stop it
    """
    with told(runs, "home") as flag, connect(e.device) as bench:
        return find_by_switch(e, bench, flag)


def find_by_switch(e: Experiment, bench: Bench, flag: StopFlag) -> Zero:
    """Drive the shaft to the end switch of ``sensor.encoder.home`` twice, then inside, and set the zero last.

    The zero of before is forgotten first. So whatever goes wrong, there is none: a switch that opens for a moment, or
    the other end's, would give a wrong one. Nothing is recorded.
    Raises Fault NO_MOTION, POLARITY, NOT_HOME, INTERRUPTED, and those of guard, link and device; ValueError without
    such a switch.
    """
    switch = None if e.sensor.encoder is None else e.sensor.encoder.home
    if switch is None:
        raise ValueError("no end switch is given")
    with stop_on_signals(flag) as stop:
        driver = _encoder_driver(bench)
        driver.forget_zero()
        before = driver.read()
        driver.homing = True
        try:
            first_rad = _drive_to_switch(e, bench, switch, stop)
            _drive_inside(e, bench, switch, first_rad - _way(switch) * _BACK_RAD, _around(e, bench), stop)
            at_switch_rad = _drive_to_switch(e, bench, switch, stop)
            if abs(at_switch_rad - first_rad) > e.breakaway.motion_rad:
                apart_rad = abs(at_switch_rad - first_rad)
                raise Fault(
                    "NOT_HOME",
                    f"the end switch opened at two places, {apart_rad:.3f} rad apart: a loose contact, or lost counts",
                )
            shift_rad = switch.at_rad - at_switch_rad
            limits = _shifted(e.device.arming, -shift_rad)
            _drive_inside(e, bench, switch, -shift_rad, limits, stop)
        finally:
            driver.homing = False
        try:
            driver.set_zero(driver.read().y_rad + shift_rad)
            now = driver.read()
        except Fault:
            with suppress(Fault):  # a link that is dead: then the zero that the device may hold is the right one
                driver.forget_zero()
            raise
        if reason := stop.look():  # in the last moments: whatever ends a homing, there is no zero
            driver.forget_zero()
            raise Fault("INTERRUPTED", reason)
    return Zero(now.y_rad, now.y_counts, before.y_counts)


def _encoder_driver(bench: Bench) -> EncoderDriver:
    if not isinstance(bench.driver, EncoderDriver):
        raise Fault("CONFIG_MISMATCH", "this driver sets no zero of an encoder: daq.driver: serial does")
    return bench.driver


def _way(switch: HomeSwitch) -> int:
    return 1 if switch.end == "high" else -1


def _loop(e: Experiment, bench: Bench, limits: Limits, stop: StopRequest) -> Loop:
    guard = Guard(replace(guard_settings_of(e), limits=limits))
    return Loop(bench.driver, bench.clock, guard, NullSink(), e.period_s, stop)


def _around(e: Experiment, bench: Bench) -> Limits:
    """Limits of a shaft of which nobody knows where it stands: the device counts from where it was switched on."""
    here_rad = bench.driver.read().y_rad
    room_rad = _room_rad(e)
    around = min(here_rad, 0.0) - room_rad, max(here_rad, 0.0) + room_rad
    return replace(e.device.arming, soft_rad=around, hard_rad=around)


def _room_rad(e: Experiment) -> float:
    low_rad, high_rad = e.limits.hard_rad
    return _ROOM * (high_rad - low_rad)


def _shifted(limits: Limits, by_rad: float) -> Limits:
    (soft_low, soft_high), (hard_low, hard_high) = limits.soft_rad, limits.hard_rad
    return replace(
        limits, soft_rad=(soft_low + by_rad, soft_high + by_rad), hard_rad=(hard_low + by_rad, hard_high + by_rad)
    )


def _drive_to_switch(e: Experiment, bench: Bench, switch: HomeSwitch, stop: StopRequest) -> float:
    """Position at which the switch opened, counted as before its zero, rad. The shaft rests behind it."""
    driver = _encoder_driver(bench)
    limits = _around(e, bench)
    law = _ToSwitch(_way(switch) * switch.u_V, _room_rad(e), e.breakaway.motion_rad)
    loop = _loop(e, bench, limits, stop)
    try:
        with loop.armed(limits):
            loop.run(law, "to-switch")
    except Fault as fault:
        if fault.code == "DEVICE_TRAVEL" and law.gone_rad < e.breakaway.motion_rad:
            raise Fault("NOT_HOME", "the shaft stands at the end switch: turn it inward by hand") from fault
        if fault.code != "DEVICE_END_SWITCH":
            raise
    finally:
        loop.close()
    bench.clock.sleep_until(bench.clock.now_s() + _AT_REST_S)
    opened = driver.stopped
    if opened is None:
        raise ValueError("the law ended by itself")
    sample = opened.sample._replace(t_s=loop.since_start_s(opened.sample.t_s))
    driver.leave_switch()
    return law.position_at(loop.since_start_s(opened.t_s), sample)


def _drive_inside(
    e: Experiment, bench: Bench, switch: HomeSwitch, until_rad: float, limits: Limits, stop: StopRequest
) -> None:
    """Away from the switch until ``until_rad``, counted as before the zero; the shaft rests then.

    A device whose end switch is open passes only drive away from that end.
    """
    law = _Inside(-_way(switch) * switch.u_V, until_rad, e.breakaway.motion_rad)
    loop = _loop(e, bench, limits, stop)
    loop.guard.recovering = True
    try:
        with loop.armed(limits):
            loop.run(law, "inside")
            loop.run(Rest(_AT_REST_S), "rest")
    except Fault as fault:
        if fault.code == "DEVICE_TRAVEL" and law.gone_rad < e.breakaway.motion_rad:
            other = "low" if switch.end == "high" else "high"
            raise Fault(
                "NOT_HOME",
                f"the switch that opened is that of the {other} end: its wire is broken, or the two are swapped",
            ) from fault
        raise
    finally:
        loop.close()


class _Pushed(BareLaw):
    """A constant drive, and how far the shaft has gone with it. Raises Fault NO_MOTION, NOT_HOME, POLARITY."""

    def __init__(self, u_V: float, motion_rad: float) -> None:
        self._u_V = u_V
        self._motion_rad = motion_rad
        self._first: Sample | None = None
        self._moved: Sample | None = None  # where it was when it had last moved
        self.gone_rad = 0.0  # the way that the drive pushes

    def _look(self, sample: Sample) -> None:
        first = self._first = self._first or sample
        moved = self._moved = self._moved or sample
        way = 1.0 if self._u_V > 0.0 else -1.0
        self.gone_rad = gone_rad = way * (sample.y_rad - first.y_rad)
        if gone_rad < -self._motion_rad:
            raise Fault("POLARITY", f"{self._u_V:+.2f} V moved the shaft by {way * gone_rad:+.3f} rad")
        if sample.t_s - first.t_s > _LONGEST_S:
            raise Fault("NOT_HOME", f"{self._u_V:+.2f} V moved the shaft by {gone_rad:.3f} rad in {_LONGEST_S:.0f} s")
        if abs(sample.y_rad - moved.y_rad) >= self._motion_rad:
            self._moved = sample
        elif sample.t_s - moved.t_s > _STANDS_S:
            raise Fault("NO_MOTION", f"{self._u_V:+.2f} V did not move the shaft for {_STANDS_S:g} s")


class _ToSwitch(_Pushed):
    """A constant drive until the device stops it."""

    def __init__(self, u_V: float, room_rad: float, motion_rad: float) -> None:
        super().__init__(u_V, motion_rad)
        self._room_rad = room_rad
        self._last: Sample | None = None

    def step(self, sample: Sample) -> float:
        """The drive, V."""
        self._last = sample
        self._look(sample)
        if self.gone_rad > self._room_rad:
            raise Fault("NOT_HOME", f"no end switch opened within {self.gone_rad:.2f} rad")
        return self._u_V

    def position_at(self, t_s: float, after: Sample) -> float:
        """Between the last sample of this law and the one ``after`` it, rad."""
        before = self._last
        if before is None or not before.t_s < after.t_s:
            return after.y_rad
        share = min(max((t_s - before.t_s) / (after.t_s - before.t_s), 0.0), 1.0)
        return before.y_rad + share * (after.y_rad - before.y_rad)


class _Inside(_Pushed):
    """A constant drive until the shaft has passed ``until_rad``; then 0 V."""

    def __init__(self, u_V: float, until_rad: float, motion_rad: float) -> None:
        super().__init__(u_V, motion_rad)
        self._until_rad = until_rad

    def step(self, sample: Sample) -> float:
        """The drive, V; 0 V at the end."""
        self.finished = (sample.y_rad - self._until_rad) * self._u_V >= 0.0
        if self.finished:
            return 0.0
        self._look(sample)
        return self._u_V
