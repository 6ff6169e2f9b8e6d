"""What a run of rig drives before its relay tests: the breakaway check and the gain search, in closed loop.

The laws are rig's own, as its stages make them. The motor is that of ``departing_motor``, which shares no code with
``rig.model``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from campaign_real.departing_motor import Bench, Departures, MovingShaft, PlainMotor
from rig.campaign.random_motors import Draw
from rig.config import Experiment
from rig.config.load import load
from rig.config.schema import BreakawaySection
from rig.control.excitation import CycleTarget, GainSearch, SearchRange
from rig.control.law import Law, Rest
from rig.control.relay import DualChannelRelay
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.cycle_detector import CycleDetector
from rig.running.experiment.stages import breakaway_check
from rig.running.preflight.breakaway_strokes import breakaway_strokes

Array = NDArray[np.float64]

CONFIG = Path(__file__).resolve().parents[2] / "config" / "quick.yaml"
REST_S = 0.5  # between the two
REACH_RAD = 1.4
AMPLITUDE_RAD = 0.8  # that the search aims at: the campaign's first test
FAST = 1.05  # the config's no-load speed over the motor's
SPARE_S = 5.0  # friction that drifts makes the search a little longer or shorter
LONGEST_S = 120.0  # of a stage
BREAKAWAY_V = (1.2, 1.0, 0.8, 0.6, 0.5, 0.45, 0.4, 0.35)  # levels that are tried


@dataclass(frozen=True)
class Stretch:
    """Rows of one stage: its name, times, s, positions as read, rad, and drives, V."""

    stage: str
    t_s: Array
    y_rad: Array
    u_V: Array


class _ClosedLoop:
    """A motor under one law after the other."""

    def __init__(self, shaft: MovingShaft, bench: Bench, random_V: Array, noise_rad: Array) -> None:
        self._shaft, self._bench = shaft, bench
        self._random_V, self._noise_rad = random_V, noise_rad
        self._tick = 0
        self._u_V = 0.0

    def run(self, law: Law, stage: str) -> Stretch:
        """Run a law until it is finished, or finds a fault. Rows are kept up to there."""
        bench, period = self._bench, self._bench.period_s
        rows: list[tuple[float, float, float]] = []
        while not law.finished and len(rows) * period < LONGEST_S:
            t_s, noise = self._tick * period, self._noise_rad[self._tick % self._noise_rad.size]
            y_rad = self._shaft.reading_rad + bench.offset_rad + noise
            counts = round(y_rad / bench.lsb_rad) if bench.lsb_rad > 0.0 else 0
            y_rad = counts * bench.lsb_rad if bench.lsb_rad > 0.0 else y_rad
            last_s = t_s - period + bench.delay_s if rows else math.nan
            try:
                asked_V = law.step(Sample(t_s, y_rad, counts, t_u_s=last_s, u_V=self._u_V))
            except Fault:
                break
            rows.append((t_s, y_rad, asked_V))
            force_V = self._random_V[self._tick % self._random_V.size]
            self._shaft.advance(self._u_V, force_V, t_s, bench.delay_s)
            self._u_V = asked_V
            self._shaft.advance(self._u_V, force_V, t_s + bench.delay_s, period - bench.delay_s)
            self._tick += 1
        return Stretch(stage, *np.array(rows).reshape(-1, 3).T)


def before_the_tests(
    motor: PlainMotor,
    departures: Departures,
    bench: Bench,
    one: Draw,
    whole_s: float,
    seed: np.random.SeedSequence,
) -> tuple[Stretch, ...]:
    """Breakaway check and gain search, in times up to 0, when the tests begin. A stage that a fault ends is the last.

    one       the draw, for the cycle that the search aims at
    whole_s   how long the tests are: friction drifts in that time from one end to the other, and as fast before
    seed      of noise and random force
    """
    ticks = math.ceil(2.0 * LONGEST_S / bench.period_s)
    noise, force = _disturbances(departures, bench, ticks, np.random.default_rng(seed))
    begin_s = 0.0
    while True:
        loop = _ClosedLoop(MovingShaft(motor, departures, (-begin_s, whole_s)), bench, force, noise)
        stretches = _driven(loop, _config(one, bench), bench, one)
        takes_s = float(stretches[-1].t_s[-1]) + bench.period_s
        if takes_s <= begin_s or departures.drift == 0.0:
            break
        begin_s = takes_s + SPARE_S  # with drift: again, early enough, and then a rest until the tests
    early_s = max(begin_s, takes_s)
    return tuple(replace(stretch, t_s=stretch.t_s - early_s) for stretch in stretches)


def _driven(loop: _ClosedLoop, e: Experiment, bench: Bench, one: Draw) -> list[Stretch]:
    check = breakaway_check(e)
    stretches = [loop.run(check, "breakaway")]
    if not check.finished:
        return stretches
    loop.run(Rest(REST_S), "rest")
    s = e.relay.search
    search = GainSearch(
        DualChannelRelay(0.0, 0.0, 10.0 * one.period_s),
        CycleDetector(min_period_s=30.0 * bench.period_s, min_amplitude_rad=20.0 * bench.lsb_rad),
        CycleTarget(AMPLITUDE_RAD, one.period_s, 0.15),
        SearchRange(s.h1_start_V, s.h2_start_V, s.h2_step_V, s.step_s, s.h_max_V, e.drive.max_V, s.timeout_s),
        friction_V=0.45 * (check.plus_V + check.minus_V),
        reach_rad=REACH_RAD,
    )
    return [*stretches, loop.run(search, "search")]


def _disturbances(departures: Departures, bench: Bench, ticks: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Noise on the position, rad, and the random force, V, of each tick."""
    noise: Array = bench.noise_rad * rng.standard_normal(ticks)
    force = np.zeros(ticks)
    if departures.random_V > 0.0:
        keep = math.exp(-bench.period_s / 0.1)
        white = rng.standard_normal(ticks)
        for k in range(1, ticks):
            force[k] = keep * force[k - 1] + math.sqrt(1.0 - keep * keep) * white[k]
    return noise, departures.random_V * force


def _config(one: Draw, bench: Bench) -> Experiment:
    """The simulated bench's config with this motor's data sheet, and the highest strokes that `rig check` allows."""
    e = load(CONFIG)
    assert e.motor is not None
    no_load = FAST * one.K_rad_s_V * e.drive.supply_V
    given = {"period_s": bench.period_s, "motor": e.motor.model_copy(update={"no_load_speed_rad_s": no_load})}
    levels = (e.model_copy(update={**given, "breakaway": _up_to(e, max_V)}) for max_V in BREAKAWAY_V)
    return next((trial for trial in levels if breakaway_strokes(trial) is not None), e.model_copy(update=given))


def _up_to(e: Experiment, max_V: float) -> BreakawaySection:
    return e.breakaway.model_copy(update={"max_V": max_V})
