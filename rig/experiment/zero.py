"""The zero of an encoder: set by hand, or by an end switch that the shaft is driven to."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from rig.backends.driver import EncoderDriver
from rig.backends.registry import Bench, connect
from rig.config.schema import Experiment, HomeSwitch
from rig.control.guard import Guard
from rig.control.law import Rest
from rig.faults import Fault
from rig.loop.runner import Loop
from rig.loop.stop_request import StopRequest, stop_on_signals
from rig.preflight.loop_settings import guard_settings_of
from rig.recording.sink import NullSink
from rig.signals import Limits, Sample

_ROOM = 1.2  # of the travel between the hard limits: where no switch opens within it, there is none
_STANDS_S = 1.0  # a drive that moves nothing for so long is too weak
_LONGEST_S = 120.0
_AT_REST_S = 1.0


class Zero(NamedTuple):
    """Where the shaft stands now, and what the encoder read there before its zero was set."""

    y_rad: float
    y_counts: int
    from_counts: int


def by_hand(e: Experiment, at_rad: float) -> Zero:
    """Set the zero of a shaft that stands at ``at_rad``. Raises Fault LINK_*, CONFIG_MISMATCH."""
    with connect(e) as bench:
        driver = _encoder_driver(bench)
        before = driver.read()
        driver.set_zero(at_rad)
        now = driver.read()
    return Zero(now.y_rad, now.y_counts, before.y_counts)


def by_switch(e: Experiment) -> Zero:
    """As ``find_by_switch``, on the bench of the config. Raises Fault LINK_*, CONFIG_MISMATCH, too."""
    with connect(e) as bench:
        return find_by_switch(e, bench)


def find_by_switch(e: Experiment, bench: Bench) -> Zero:
    """Drive the shaft to the end switch of ``sensor.encoder.home``, set the zero, and drive it back inside.

    Nothing is recorded. Raises Fault NO_MOTION, POLARITY, NOT_HOME, INTERRUPTED, and those of guard, link and device;
    ValueError without such a switch.
    """
    switch = None if e.sensor.encoder is None else e.sensor.encoder.home
    if switch is None:
        raise ValueError("no end switch is given")
    with stop_on_signals() as stop:
        driver = _encoder_driver(bench)
        before = driver.read()
        at_switch_rad = _drive_to_switch(e, bench, switch, stop)
        driver.leave_switch()
        driver.set_zero(switch.at_rad + driver.read().y_rad - at_switch_rad)
        loop = _loop(e, bench, e.device_limits, stop)
        loop.guard.recovering = True
        with loop.armed(e.device_limits):
            loop.run(_Inside(-_way(switch) * switch.u_V), "inside")
            loop.run(Rest(_AT_REST_S), "rest")
        loop.close()
        now = driver.read()
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


def _drive_to_switch(e: Experiment, bench: Bench, switch: HomeSwitch, stop: StopRequest) -> float:
    """Position at which the switch opened, counted as before its zero, rad. The shaft rests behind it."""
    driver = _encoder_driver(bench)
    here_rad = driver.read().y_rad
    low_rad, high_rad = e.limits.hard_rad
    room_rad = _ROOM * (high_rad - low_rad)
    # a device counts its limits from where it was switched on
    around = min(here_rad, 0.0) - room_rad, max(here_rad, 0.0) + room_rad
    limits = replace(e.device_limits, soft_rad=around, hard_rad=around)
    law = _ToSwitch(_way(switch) * switch.u_V, room_rad, e.breakaway.motion_rad)
    loop = _loop(e, bench, limits, stop)
    driver.homing = True
    try:
        with loop.armed(limits):
            loop.run(law, "to-switch")
    except Fault as fault:
        if fault.code == "DEVICE_TRAVEL" and law.gone_rad < e.breakaway.motion_rad:
            raise Fault("NOT_HOME", "the shaft stands at the end switch: turn it inward by hand") from fault
        if fault.code != "DEVICE_END_SWITCH":
            raise
    finally:
        driver.homing = False
        loop.close()
    bench.clock.sleep_until(bench.clock.now_s() + _AT_REST_S)
    opened = driver.stopped
    if opened is None:
        raise ValueError("the law ended by itself")
    sample = opened.sample._replace(t_s=loop.since_start_s(opened.sample.t_s))
    return law.position_at(loop.since_start_s(opened.t_s), sample)


class _ToSwitch:
    """A constant drive until the device stops it. Raises Fault NO_MOTION, POLARITY, NOT_HOME."""

    z_rad_s = math.nan
    yd_rad = math.nan
    finished = False

    def __init__(self, u_V: float, room_rad: float, motion_rad: float) -> None:
        self._u_V = u_V
        self._room_rad = room_rad
        self._motion_rad = motion_rad
        self._first: Sample | None = None
        self._last: Sample | None = None
        self._moved: Sample | None = None  # where it was when it had last moved
        self.gone_rad = 0.0  # towards the switch

    def step(self, sample: Sample) -> float:
        """The drive, V."""
        first = self._first = self._first or sample
        moved = self._moved = self._moved or sample
        self._last = sample
        way = 1.0 if self._u_V > 0.0 else -1.0
        self.gone_rad = gone_rad = way * (sample.y_rad - first.y_rad)
        if gone_rad < -self._motion_rad:
            raise Fault(
                "POLARITY", f"{self._u_V:+.2f} V moved the shaft by {-way * gone_rad:+.3f} rad, away from the switch"
            )
        if gone_rad > self._room_rad or sample.t_s - first.t_s > _LONGEST_S:
            raise Fault("NOT_HOME", f"no end switch opened within {gone_rad:.2f} rad, {sample.t_s - first.t_s:.0f} s")
        if abs(sample.y_rad - moved.y_rad) >= self._motion_rad:
            self._moved = sample
        elif sample.t_s - moved.t_s > _STANDS_S:
            raise Fault("NO_MOTION", f"{self._u_V:+.2f} V did not move the shaft for {_STANDS_S:g} s")
        return self._u_V

    def position_at(self, t_s: float, after: Sample) -> float:
        """Between the last sample of this law and the one ``after`` it, rad."""
        before = self._last
        if before is None or not before.t_s < after.t_s:
            return after.y_rad
        share = min(max((t_s - before.t_s) / (after.t_s - before.t_s), 0.0), 1.0)
        return before.y_rad + share * (after.y_rad - before.y_rad)


class _Inside:
    """A constant drive until the shaft has passed zero, or half a minute."""

    z_rad_s = math.nan
    yd_rad = math.nan

    def __init__(self, u_V: float) -> None:
        self._u_V = u_V
        self._begin_s = math.nan
        self.finished = False

    def step(self, sample: Sample) -> float:
        """The drive, V; 0 V at the end."""
        if math.isnan(self._begin_s):
            self._begin_s = sample.t_s
        self.finished = sample.y_rad * self._u_V >= 0.0
        if sample.t_s - self._begin_s > _LONGEST_S:
            raise Fault("NOT_HOME", f"at {sample.y_rad:.3f} rad after {_LONGEST_S:.0f} s")
        return 0.0 if self.finished else self._u_V
