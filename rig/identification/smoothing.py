"""A column that was smoothed, or came late, before it was logged: a velocity that a driver smooths, a mean of rows, a
drive that was measured behind a filter, a direction that was read rows after its size.

Two shapes are told. A low pass works row by row, y_k = a y_{k-1} + (1 - a) x_k: that is undone to the last bit; behind
a resistor and a capacitor it leaves a delay of half a row. Some smooth twice. Any other shape, such as a mean over
rows or a ramp, is to a slower motor no more than its middle and its variance s^2: x = y - s^2 y'' / 2. There y'' is the
difference over half of these rows, so that their noise hardly grows.

The change is looked for with which the plain motor explains pieces of the tests best. It counts where the plain motor
leaves more than noise, and most of that goes. Not where a dead band and a sag explain more, or a bridge that is free
between its pulses: they lag, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.identification.departures.departure import NOTHING
from rig.identification.departures.fit import Fit, solve
from rig.identification.estimate import Estimate
from rig.identification.in_pieces import (
    DEAD_BAND,
    FORCE,
    PIECE_ITERATIONS,
    PIECE_S,
    ROUGHLY,
    SAG,
    free_between,
    plain_in_pieces,
)
from rig.identification.lowest import lowest
from rig.identification.plausibility import divides_a_turn
from rig.identification.preprocessing import unfiltered
from rig.model.compiled.row_filter import filtered
from rig.model.real_motor import RealMotor
from rig.run_folder.recording.series import TimeSeries

Array = NDArray[np.float64]
Column = Literal["reading", "drive", "row"]

LEAVES, SHOWS = 1.1, 1.03  # residual over the sensor's noise from which on a smoothing is looked for; over pieces
# Residual beyond noise with the smoothing over that without it, at most; the same where the record looks wrong: a lag
# makes a shaft turn against its drive; and of the best that is tried first. Rise of the log likelihood, at least
CUTS, NEARLY_ALL, PROMISING, SURE = 0.5, 0.1, 0.8, 20.0
NOISY, TWICE = 3.0, 0.7  # residual over noise from which on two low passes are tried; residual over that with one
LONGEST_S, TRIED, COARSE, FINER = 0.5, 8, 5, 16
# Iterations, and residual then over the least that a change left, beyond which one is given up; or not tried at bridges
FIRST, FAR = 3, 1.5
TO_ITS_END = 20  # iterations of a motion that may be told without a filter
EXPLAINS, NEAR = 0.01, 0.95  # residual over the spread of positions, at most; of the longest mean, or low pass
MEAN_OF_ROW = 0.75  # of a period: so short a filter is no filter, but how velocities are summed
SMOOTHED = {"reading": "a smoothed velocity", "drive": "one that was measured", "row": "all that one card reads"}
MEAN, WAY, RAMP = 0, -1, -2  # orders that are no low pass
OF_STEP, SMALL = 0.5, 0.05  # way from row to row, of a step of the sensor; a drive, of the largest one
AT_ONCE = 0.2  # of a drive's way, in steps between rows that are alike: a smoothed drive has none
EVENLY, OFTEN = 0.01, 0.2  # how steps of a ramp differ; share of the steps of a drive that are those of its ramp
OVER, RARE = 1.1, 0.01  # drives over the largest that the bench gives; share of them that rounding alone explains
COVERAGE, MOST_LEFT = 2.0, 0.99  # of what such a low pass leaves, over what is left without it
ROWS, MOST_ROWS = (4.0, 8.0, 16.0), 24.0  # of means that are tried first; of the longest one
WAY_ROWS = range(1, 13)
# By what is left with a filter this share larger or smaller its size is known: to KNOWN times the share that would make
# the squares of what is left twice as large. In 11 made logs it was off by 0.95 of that share at most, in 10 by 0.42.
BESIDE, KNOWN = 0.15, 0.6
RUNS_FREE, NO_BRAKE, LOAD = {"runs_free": 1.0}, {"no_brake": 1.0}, dict.fromkeys(FORCE, 0.0)
COAST_S = 0.1  # bridges are looked at beyond a share of the way in it


class Smoothing(NamedTuple):
    """How a column was smoothed.

    column   which; "row": both
    size_s   time constant of a low pass; how long a mean is, or how late the sign of a drive, s
    order    so many low passes, one after the other; ``MEAN``; ``WAY``: the sign of the drive is late; ``RAMP``: the
             drive goes at one pace where the motor's stepped
    is_late  of a mean, whether it is of the rows up to its own; False: of those around it
    left     share of it that may be missing, or be too much; above 1 where a motor could stand in its place. A drive's
             low pass that leaves more than noise is another shape. Just 1: it does not explain the tests, though it
             takes most of what a plain motor leaves
    moves    what this share moves K by, of itself, and f_c, V
    """

    column: Column
    size_s: float
    order: int
    is_late: bool = False
    left: float = 0.0
    moves: tuple[float, float] = (0.0, 0.0)

    @property
    def late_s(self) -> float:
        """By how much it makes a column late, or would if it were of the rows before."""
        return {MEAN: 0.5, WAY: 0.0, RAMP: 0.0}.get(self.order, self.order) * self.size_s

    def undone(self, test: TimeSeries) -> TimeSeries:
        """The test with its column as it was."""
        if self.order == MEAN:
            return self._without_mean(test)
        if self.order == WAY:
            rows = round(self.size_s / test.period_s)
            way = _signs(test.u_V)[rows:]
            return replace(test.part(0, way.size), u_V=np.abs(test.u_V[: way.size]) * way)
        if self.order == RAMP:
            return replace(test, u_V=_without_ramps(test.u_V))
        # undone, a reading has no steps, by which its unit would be known
        test = replace(test, units_stated=test.units_stated or divides_a_turn(test.resolution_rad()))
        for _ in range(self.order):
            test = test if self.column == "drive" else unfiltered(test, self.size_s)
            test = test if self.column == "reading" else unfiltered(test, self.size_s, of_drive=True)
        return test

    def left_rad(self, fit: Fit) -> float:
        """RMS residual of a reading as it was logged, rad: undone, its noise is many times as large as it was.

        Of a row a low pass changes friction alone, and so next to nothing: there its large noise speaks against it.
        """
        if self.column != "reading" or self.order < 1:
            return fit.rms_rad
        squares, at = 0.0, 0
        for window in fit.problem.cut.windows:
            left, at = fit.residual_rad[at : at + window.t_s.size, None], at + window.t_s.size
            keep = math.exp(-window.period_s / self.size_s)
            for _ in range(self.order):
                left = filtered([1.0 - keep], [-keep], left)
            squares += float(np.sum(left**2))
        return math.sqrt(squares / at)

    def _without_mean(self, test: TimeSeries) -> TimeSeries:
        rows = self.size_s / test.period_s
        half = max(1, round(0.5 * rows))
        kept = len(test) - (round(0.5 * (rows - 1.0)) if self.is_late else 0)

        def sharp(values: Array, is_smooth: bool) -> Array:
            if not is_smooth:
                return values[:kept]
            wide = np.pad(values, half, mode="edge")
            bends = wide[2 * half :] - 2.0 * values + wide[: -2 * half]
            return np.asarray(values - (rows**2 - 1.0) / (24.0 * half**2) * bends)[-kept:]

        y_rad, u_V = sharp(test.y_rad, self.column != "drive"), sharp(test.u_V, self.column != "reading")
        return replace(test.part(0, kept), y_rad=y_rad, u_V=u_V).part(half, kept - half)

    def in_words(self, period_s: float) -> str:
        """What was undone, such as ``the reading is low-passed by 45 ms, as a smoothed velocity is: ...``."""
        rows = f"{self.size_s / period_s:.2g} rows"
        if self.order == WAY:
            return f"the direction of the drive stands {rows} late, and its size does not: undone before the fit"
        if self.order == RAMP:
            return "the drive goes up and down at one pace, and the motor's stepped: undone before the fit"
        if self.order == MEAN:
            which = "up to its own" if self.is_late else "around it"
            return f"each {self.column} is like a mean of {rows} {which}: undone before the fit"
        if self.late_s < MEAN_OF_ROW * period_s and self.column == "reading":
            return "the readings lag by half a row, as velocities that are summed do: undone before the fit"
        by = f"{1e3 * self.size_s:.3g} ms{' twice' if self.order > 1 else ''}"
        return f"the {self.column} is low-passed by {by}, as {SMOOTHED[self.column]} is: undone before the fit"


def smoothings(tests: Sequence[TimeSeries], plain: Estimate, otherwise_rad: float = math.inf) -> list[Smoothing | None]:
    """How a column of each test was smoothed: of all alike, else of each by itself, where that is told.

    otherwise_rad   what the plain motor leaves of pieces where something else is mended instead
    """
    of_all = smoothing(tests, plain, otherwise_rad)
    if len(tests) > 1 and (of_all is None or of_all.left == 1.0):
        each = [smoothing([test], plain, otherwise_rad) for test in tests]
        told = [one if one is not None and one.left != 1.0 else None for one in each]
        if any(told):
            return told
    return [of_all] * len(tests)


def smoothing(tests: Sequence[TimeSeries], plain: Estimate, otherwise_rad: float = math.inf) -> Smoothing | None:
    """How a column of the tests was smoothed; None where that does not show.

    Where its drive ends, a motor behind a bridge that does not brake goes on as a smoothed column does. So it is looked
    for behind other bridges, too, where one that brakes leaves some of the motion. A hanging load bends the motion as a
    long mean does: so it is looked for beside a load, too.
    """
    over = [test.noise_over_rad(math.ceil(PIECE_S / test.period_s)) for test in tests]
    noise_rad = math.sqrt(sum(one**2 for one in over) / len(over))
    if not plain.is_motor or plain.rms_rad < LEAVES * noise_rad or any(test.t_u_s is not None for test in tests):
        return None
    tried: dict[Smoothing, float] = {}
    rad, found = _behind(NOTHING, tests, plain, noise_rad, tried)
    ways_rad = [float(np.std(np.diff(test.y_rad))) * COAST_S / test.period_s for test in tests]
    bridges = _bridges(tests, plain) if rad > EXPLAINS * max(ways_rad) else ()
    loads = [LOAD] if rad > NOISY * noise_rad and _explains_more(LOAD, tests, plain) else []
    for bridge in (*loads, *bridges):
        if rad > NOISY * noise_rad:
            # without the load that a shaft carries, what was tried says nothing
            other_rad, other = _behind(bridge, tests, plain, noise_rad, {} if bridge is LOAD else tried)
            is_told = other is None or other.left != 1.0
            rad, found = (other_rad, other) if is_told and other_rad < CUTS * rad else (rad, found)
    return found if rad < otherwise_rad else None


def _bridges(tests: Sequence[TimeSeries], plain: Estimate) -> Iterator[Mapping[str, float]]:
    """Bridges that do not brake; one that lets the motor run free between its pulses only where it explains more."""
    if any(np.any(test.steps.u_V == 0.0) for test in tests):
        yield RUNS_FREE
    yield NO_BRAKE
    free = free_between(tests)
    if _explains_more(free, tests, plain):
        yield free


def _explains_more(laws: Mapping[str, float], tests: Sequence[TimeSeries], plain: Estimate) -> bool:
    """Whether a motor with these laws leaves clearly less of pieces than the plain one does."""
    return plain_in_pieces(tests, plain, laws).rms_rad < PROMISING * plain_in_pieces(tests, plain).rms_rad


def _behind(
    bridge: Mapping[str, float],
    tests: Sequence[TimeSeries],
    plain: Estimate,
    noise_rad: float,
    tried: dict[Smoothing, float],
) -> tuple[float, Smoothing | None]:
    """What the plain motor behind a bridge leaves, rad, and how a column was smoothed, as ``smoothing``.

    tried   what each change that was tried first left behind a bridge that brakes, rad; empty: this is that one
    """
    period_s = max(test.period_s for test in tests)
    motors: dict[Smoothing, RealMotor] = {}

    @cache
    def left(one: Smoothing, most_rad: float = math.inf) -> float:
        undone = [one.undone(test) for test in tests]
        if any(float(np.mean(np.abs(test.u_V) > OVER * test.most_V)) > RARE for test in undone):
            return math.inf  # no bridge gave that
        fit = plain_in_pieces(undone, plain, bridge, iterations=FIRST if math.isfinite(most_rad) else PIECE_ITERATIONS)
        if math.isfinite(most_rad) and not fit.arrived and one.left_rad(fit) < most_rad:
            fit = solve(fit, PIECE_ITERATIONS - FIRST, ROUGHLY)
        motors[one] = fit.motor
        return one.left_rad(fit)

    def beyond(rad: float) -> float:
        return max(rad**2 - noise_rad**2, 0.0)

    # several rows as one leave what their mean drive is off, which a low pass of the drive would take: no more counts
    # than the plain motor leaves row by row
    without = min(plain_in_pieces(tests, plain, bridge).rms_rad, plain.rms_rad)
    if without < SHOWS * noise_rad:
        return without, None  # over pieces the plain motor leaves no more than noise
    least_rad = min(tried.values(), default=math.inf)
    near_rad = FAR * least_rad if without > PROMISING * least_rad else math.inf  # such a bridge was missing there
    every = [one for one in _first(tests, period_s) if tried.get(one, 0.0) < near_rad]
    each: dict[Smoothing, float] = {}
    for one in every:
        each[one] = left(one, FAR * min(each.values(), default=math.inf))
    tried.update({} if tried else each)
    best = first = min(each, key=lambda one: each[one], default=None)
    if first is None or best is None or beyond(each[first]) > PROMISING**2 * beyond(without):
        return without, None
    found = {first: each[first]}

    def refine(one: Smoothing, wide: float, longest_s: float, steps: int) -> None:
        low_s, high_s = one.size_s / wide, min(one.size_s * wide, longest_s)
        size_s, rad = lowest(lambda s: left(one._replace(size_s=s)), low_s, high_s, steps)
        found[one._replace(size_s=size_s)] = rad

    for steps in (COARSE, FINER):
        for order, wide, longest_s in ((1, _apart(period_s), LONGEST_S), (MEAN, 2.0, MOST_ROWS * period_s)):
            ours = [one for one in each if (one.column, one.order) == (first.column, order) and each[one] < without]
            if ours:
                refine(min(ours, key=lambda one: each[one]), wide, longest_s, steps)
        once = min((one for one in found if one.order == 1), key=lambda one: found[one], default=first)
        if once.order == 1 and found[once] > NOISY * noise_rad:
            twice = Smoothing(once.column, 0.5 * once.size_s, 2)  # late by as much as one, and they round off more
            refine(twice, 2.0, LONGEST_S, steps)
        by_order = sorted(found, key=lambda one: (one.order, found[one]))
        best = min((one for one in by_order if one.order < 2), key=lambda one: found[one])
        best = next((one for one in by_order if one.order == 2 and found[one] < TWICE * found[best]), best)
        cuts = NEARLY_ALL if plain.spoiled else CUTS
        if beyond(found[best]) >= cuts**2 * beyond(without):
            return without, None
    largest_V = max(float(np.abs(test.u_V).max()) for test in tests)
    band = {**bridge, DEAD_BAND: SMALL * largest_V, SAG: SMALL / largest_V}
    # at each reversal it lags as a filter does; and where the drive is small, a bridge that is free between its pulses;
    # and a hanging load bends the motion between reversals, which a long mean would do, too
    others = (bridge, band, {**band, **free_between(tests)}, {**bridge, **LOAD})
    motions = (plain_in_pieces(tests, plain, one) for one in others)
    told = next((rad for rad in (solve(one, TO_ITS_END).rms_rad for one in motions) if rad < found[best]), None)
    if told is not None or not sum(map(len, tests)) * math.log(without / found[best]) > SURE:
        return without if told is None else told, None
    # where a motor leaves so much of the motion, or asks for the longest change, it is no plain one behind one
    most_rad = max(NOISY * noise_rad, EXPLAINS * max(float(np.std(test.y_rad)) for test in tests))
    longest_s = NEAR * (MOST_ROWS * period_s if best.order == MEAN else LONGEST_S)
    is_told = found[best] < most_rad and best.size_s < longest_s
    # a low pass of a drive, which has no noise, is undone to the last bit; behind a velocity's noise nothing is known
    is_other = best.order > 0 and best.column == "drive" and found[best] > NOISY * noise_rad
    share = COVERAGE * math.sqrt(beyond(found[best]) / beyond(without)) if is_other else 0.0
    moves = (0.0, 0.0)
    if best.order > 0 and best.column != "drive":
        beside = [best._replace(size_s=best.size_s * of) for of in (1.0 - BESIDE, 1.0 + BESIDE)]
        rise = (sum(map(left, beside)) / 2.0 / found[best]) ** 2 - 1.0
        share = KNOWN * BESIDE / math.sqrt(max(rise, 1e-6))
        other_s = motors[best].tau_s  # a motor and a filter could stand in each other's place, but for friction
        if period_s < other_s and left(best._replace(size_s=other_s)) < math.hypot(1.0, KNOWN) * found[best]:
            share = max(share, abs(other_s / best.size_s - 1.0))
        small, large = (motors[one] for one in beside)
        by = share / (2.0 * BESIDE)
        moves = by * abs(large.K_rad_s_V / small.K_rad_s_V - 1.0), by * abs(large.fc_V - small.fc_V)
    share = share if share > 1.0 else min(share, MOST_LEFT)
    return found[best], best._replace(left=share if is_told else 1.0, moves=moves)


def _apart(period_s: float) -> float:
    """Ratio of the low passes that are tried first."""
    return float((LONGEST_S / (0.5 * period_s)) ** (1.0 / (TRIED - 1)))


def _first(tests: Sequence[TimeSeries], period_s: float) -> Iterator[Smoothing]:
    """What is tried first. Of a drive that was written at its changes nothing is: its edges are known.

    Nor is one smoothed behind a coarse sensor: a low pass takes of its steps, which look like anything.
    """
    in_rows = all(test.edges is None for test in tests) and not all(map(_is_within_steps, tests))
    may_be_smooth = in_rows and not any(map(_steps_at_once, tests))
    columns: tuple[Column, ...] = ("reading", "drive", "row") if may_be_smooth else ("reading",)
    if any(test.reads == "counter" for test in tests):  # a count is no mean
        columns = columns[1:2]
    for column in columns:
        yield from (Smoothing(column, LONGEST_S / _apart(period_s) ** k, 1) for k in range(TRIED))
        yield from (
            Smoothing(column, rows * period_s, MEAN, late)
            for rows in ROWS
            for late in (False, True)[: 2 - (column == "row")]
        )
    if may_be_smooth and all(map(_goes_at_one_pace, tests)):
        yield Smoothing("drive", period_s, RAMP)
    if in_rows and all(map(_turns_at_a_drive, tests)):
        yield from (Smoothing("drive", rows * period_s, WAY) for rows in WAY_ROWS)


def _signs(u_V: Array) -> Array:
    """The sign of each drive; at 0 V that of the drive before."""
    driven = np.maximum.accumulate(np.where(u_V != 0.0, np.arange(u_V.size), 0))
    return np.asarray(np.where(u_V[driven] < 0.0, -1.0, 1.0))


def _is_within_steps(test: TimeSeries) -> bool:
    """Whether rows lie within the steps of the sensor."""
    return bool(np.mean(np.abs(np.diff(test.y_rad))) <= OF_STEP * test.resolution_rad())


def _turns_at_a_drive(test: TimeSeries) -> bool:
    """Whether the sign changes, and mostly between two drives: one that passes 0 V changes it where it must."""
    turns = np.flatnonzero(np.diff(_signs(test.u_V)))
    size_V = np.abs(test.u_V)
    return bool(turns.size) and float(np.median(np.minimum(size_V[turns], size_V[turns + 1]))) > SMALL * size_V.max()


def _steps_at_once(test: TimeSeries) -> bool:
    """Whether much of the drive's way is in steps between rows that are alike, as of a relay: none is smoothed."""
    steps_V = np.abs(np.diff(test.u_V))
    at_once = steps_V[1:-1][(steps_V[:-2] == 0.0) & (steps_V[2:] == 0.0)]
    return bool(at_once.sum() > AT_ONCE * steps_V.sum())


def _goes_at_one_pace(test: TimeSeries) -> bool:
    """Whether many steps of the drive are alike, and none is larger."""
    steps_V = np.abs(np.diff(test.u_V))
    alike = np.count_nonzero(steps_V > (1.0 - EVENLY) * steps_V.max())
    return bool(alike > OFTEN * np.count_nonzero(steps_V))


def _without_ramps(u_V: Array) -> Array:
    """The drive at once where each of its ramps ends."""
    steps_V = np.diff(u_V, append=u_V[-1])
    is_ramp = np.abs(steps_V) > (1.0 - EVENLY) * np.abs(steps_V).max()
    found = u_V.copy()
    for k in range(u_V.size - 2, 0, -1):
        if is_ramp[k - 1] and steps_V[k - 1] * steps_V[k] > 0.0:
            found[k] = found[k + 1]
    return found
