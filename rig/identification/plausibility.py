"""Signs that the columns of a recording are not what their names say. A fit alone cannot notice this.

A motor in milliseconds and millivolts fits just as well. So each column is compared with what a bench with a small
motor, its sensor and its logger can show. A column outside this range is refused, with a question. The estimate is
doubtful if both the column and a thousand times or a thousandth of it are possible.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.estimate import Estimate, Verdict
from rig.run_folder.recording.series import FEWEST_ROWS, LATENCY_S, TimeSeries

LONGEST_PERIOD_S = 0.5  # between samples: longer than any motor's time constant
SHORTEST_PERIOD_S = 20e-6  # between samples: shorter than that of any logger of positions
SHORTEST_RECORD_S = 0.1
LARGEST_SPAN_RAD = 40.0  # six turns
SMALL_SPAN_RAD, SMALLEST_SPAN_RAD = 0.04, 0.01
FINE_RAD = 0.05  # 126 steps a turn; in degrees it would be 7,200
FEWEST_COUNTS, WHOLE = 8, 0.01  # counts a turn of the coarsest encoder whose step tells radians, and how whole they are
COARSE_STEP_RAD, COARSEST_STEP_RAD = 0.1, 0.5  # 63 and 13 steps a turn
LARGEST_DRIVE_V = 100.0
SMALL_DRIVE_V, SMALLEST_DRIVE_V = 0.1, 0.02
LONG_TAU_S, LONGEST_TAU_S = 2.0, 20.0
SHORT_TAU_S, SHORTEST_TAU_S = 2e-3, 0.5e-3
FAST_RAD_S = 1000.0  # 9,500 turns a minute; in degrees it would be 170
GAP_PERIODS = 5.0
# Of rows that come evenly: how far from a period a step may be, periods; share of such steps; a step of the drive, of
# the largest one
ON_TIME, EVEN_ROWS, STEPPED = 0.1, 0.85, 0.2
KEPT = 0.5  # of the rows, in parts between gaps that are long enough: with fewer, the gaps are what the record has
MOST_PARTS = 40  # the longest ones tell enough
# Positions that are set anew, at most; how far over all other steps, and how much larger; a spike goes back in the next
# row, by this share or more
MOST_JUMPS, FAR_JUMP, LARGER, GOES_BACK = 5, 4.0, 1.5, 0.75
TIMED_GAP_S = 0.05  # with recorded times of the drive: the drive stayed constant until the next one
JUMP = 0.25  # of the whole travel, in one sampling period: no motor moves that fast
# Of a motor that explains a test: its residual, of the spread of positions; its delay: half a period of a relay may
# stand for a sign; and what its rows may differ by
EXPLAINED, LATE_ROWS, STRIDE = 0.05, 2.5, 1.1
COVERAGE = 2.0  # of noise that adds up
SPIKE = 0.02  # of the whole travel: a spike differs from its neighbours by at least this,
SPIKE_NOISES = 10.0  # and by so many standard deviations of the noise
MOVED_NOISES = 8.0  # standard deviations of the noise: a larger change of position is motion,
TURNED_BACK = 0.01  # of the longer way: a shorter one is drift where the drive never asks for it
MOVED_STEPS = 3.0  # if it is also more than this many steps of the sensor
FEWEST_STEPS = 40.0  # of the sensor over the whole travel: an amplitude of 20 (docs/theory.md 4.3)
RAIL_ROWS = 10  # successive rows at exactly one end of the travel, in spite of noise
STANDS = 1.0 / 3.0  # of the time at an end, for which a shaft that is at no end stands as hard driven
RESTS = 0.5  # of the largest drive: under less a shaft may rest where a record begins
TURN_STEPS = 16.0  # of the sensor: a shaft that turns within one step goes no farther in as many rows ahead or behind
FAR_STEPS = 10.0  # from an end of the travel: no reading there is one of that end
LARGE_SPAN_RAD = 12.6  # two turns: a potentiometer of one turn cannot show more
FEW_LEVELS = 8
# A sensor that fails stands for so many rows, so much longer than the shaft else, and a share of them under drives that
# turn it, each way.
DEAD_ROWS, DEAD_TIMES, DEAD_SHARE = 100, 10, 0.1
# Of a drive without its sign: the share of rows, and of the largest speed, that are motion backwards; the fewest of
# them; rows over which a speed is taken; how speed and drive are correlated there.
TURNS_BACK, FEWEST_BACK, SMOOTH_ROWS, FASTER_BACK = 0.1, 20, 4, 0.2
IS_CURRENT = "is u_V a current? That is a torque, under which the speed only grows: log the motor's voltage"
DID_IT_TURN = "did the shaft turn? check the motor's supply and its wires, and those of its sensor"
SAY_UNIT = "For degrees type --position y_rad:deg; if they are radians, --position y_rad:rad"


class Objection(NamedTuple):
    """A reason not to trust a recording or a motor, with what to do, and the verdict that it gives."""

    verdict: Verdict
    reason: str
    spoils: bool = True  # whether no better fit mends it


def judge_records(tests: Sequence[TimeSeries], motor: Estimate | None = None) -> list[Objection]:
    """Objections to the recordings: units, columns that do not belong together, gaps, too little motion.

    motor   as it was fitted; None: not known. A quick one turns within a row or two, and that is no spike
    Of many tests of a run, or parts of a file, that are alike in one of them, the first one is named.
    """
    found: dict[tuple[object, ...], list[Objection]] = {}
    # a test of a run may end in the middle of a swing, where another took its place: what it lacks, others tell
    named = Counter(test.name for test in tests)
    of_many = [test.stage is not None or named[test.name] > 1 for test in tests]
    some = [test for test, is_one in zip(tests, of_many, strict=True) if is_one]
    is_told = any(not _lacks(test) for test in some)
    run_rad = max((float(np.ptp(test.y_rad)) for test in some), default=0.0)
    fine_rad: dict[str, float] = {}  # of a file: a short part may look coarser than its sensor is
    for test in tests:
        fine_rad[test.name] = min(fine_rad.get(test.name, math.inf), max(test.resolution_rad(), test.noise_rad()))
    for k, (test, is_one) in enumerate(zip(tests, of_many, strict=True)):
        told = is_told and is_one
        span_rad = run_rad if told and _lacks(test) else float(np.ptp(test.y_rad))
        columns = _columns(test, span_rad, motor)
        units = partial(_units, fine_rad=fine_rad[test.name])
        looks = (units, _holes, partial(_spikes, motor=motor), _rails, *(() if told else (_little, _information)))
        for place, look in enumerate((_columns,) if columns else looks):
            for number, one in enumerate(columns or look(test)):
                alike = is_one or not one.spoils  # of one way only
                of = (place, number, one.verdict) if alike else (place, number, one.verdict, k)
                found.setdefault(of, []).append(one)
    if not one_way(tests):
        found = {of: each for of, each in found.items() if each[0].spoils}
    return [first if not others else _as_in_others(first, len(others)) for first, *others in found.values()]


def _as_in_others(first: Objection, others: int) -> Objection:
    tests = "another test" if others == 1 else f"{others} other tests"
    return first._replace(reason=f"{first.reason} (and {tests} alike)")


def _lacks(test: TimeSeries) -> list[Objection]:
    """What a test lacks that others of the run can tell."""
    return [*_little(test), *_information(test)]


def is_cut_off(test: TimeSeries) -> bool:
    """Whether the position stays at one end of its travel, as beyond the end of a sensor's range."""
    return bool(_rails(test))


def judge_motor(estimate: Estimate, tests: Sequence[TimeSeries]) -> list[Objection]:
    """Objections to a fitted motor: a time constant that points to another unit of time, a speed to degrees."""
    return [*_judge_tau(estimate, tests), *_judge_speed(estimate, tests)]


def _judge_tau(estimate: Estimate, tests: Sequence[TimeSeries]) -> list[Objection]:
    tau = estimate.tau_s
    period = max(test.period_s for test in tests)
    if tau > LONGEST_TAU_S:
        reason = f"tau = {tau:.3g} s is no small motor's: is t_s in milliseconds, or {IS_CURRENT}"
        return [Objection("refused", reason, spoils=_shortest_tau_s(estimate) > LONGEST_TAU_S)]
    if tau < SHORTEST_TAU_S:
        return [Objection("refused", f"tau = {tau:.3g} s is no motor's: is t_s in seconds, not in ks or minutes?")]
    if tau > LONG_TAU_S and period >= 1e3 * SHORTEST_PERIOD_S:
        return [Objection("doubtful", f"tau = {tau:.3g} s with samples {period:.3g} s apart: is t_s in milliseconds?")]
    if tau < SHORT_TAU_S:
        return [Objection("doubtful", f"tau = {tau:.3g} s is very short: is t_s in seconds, not in ks or minutes?")]
    return []


def _judge_speed(estimate: Estimate, tests: Sequence[TimeSeries]) -> list[Objection]:
    """A speed of few motors in steps that are no part of a turn. Where somebody has stated the unit it is a remark."""
    fast = [test for test in tests if test.stage is None and not divides_a_turn(test.resolution_rad())]
    fastest_V = max((float(np.abs(test.u_V).max()) for test in fast), default=0.0)
    fastest_rad_s = abs(estimate.K_rad_s_V) * (fastest_V - estimate.fc_V)
    if not fastest_rad_s > FAST_RAD_S:
        return []
    turns = f"the motor turns at {fastest_rad_s:.4g} rad/s, {9.55 * fastest_rad_s:,.0f} turns a minute"
    if any(test.units_stated for test in fast):
        return [Objection("ok", f"{turns}: if that is too fast, are its columns in degrees?", spoils=False)]
    return [Objection("doubtful", f"{turns}: is y_rad in degrees? {SAY_UNIT}")]


def _shortest_tau_s(estimate: Estimate) -> float:
    """The shortest tau that a motor of this estimate may have, at 95 %: what a record shows of a long one is 1 / tau.

    Where even a small motor's is as likely, it is tau that the record does not say, and the columns may be right.
    """
    low_s, high_s = estimate.ci95.get("tau_s", (estimate.tau_s, estimate.tau_s))
    return estimate.tau_s / (1.0 + 0.5 * (high_s - low_s) / estimate.tau_s)


def _columns(test: TimeSeries, span_rad: float, motor: Estimate | None) -> list[Objection]:
    """Signs that u and y are not the drive and the position of one motor, which moves over ``span_rad``."""
    y, u = test.y_rad, test.u_V
    name = test.name
    y_levels, u_levels = np.unique(y).size, np.unique(u).size
    if 1 < y_levels <= FEW_LEVELS and u_levels > 4 * y_levels:
        cause = f"{name}: the position has {y_levels} different values and the drive {u_levels}"
        swapped = "" if test.units_stated else "are the two columns swapped? Or "
        return [Objection("refused", f"{cause}: {swapped}{DID_IT_TURN}")]
    if float(np.ptp(y)) == 0.0:
        return []  # the fit reports that
    steps = np.abs(np.diff(y))
    k = int(np.argmax(np.where(np.diff(test.t_s) < 2.0 * test.period_s, steps, 0.0)))
    if steps[k] > max(JUMP * span_rad, _motion(test), _stride_rad(test, motor)):
        row = test.first_row + k
        return [
            Objection(
                "refused",
                f"{name}: the position jumps by {steps[k]:.3g} rad between rows {row} and {row + 1}: unwrap the angle, "
                f"leave the spike out (--rows {row + 1}: or --rows :{row}), or are u_V and y_rad swapped?",
            )
        ]
    if (stands := _stands_dead(test)) is not None and not _explains(test, motor):
        first, last = (test.first_row + row for row in stands)
        rest = f"--rows :{first - 1}" if stands[0] > len(test) - 1 - stands[1] else f"--rows {last + 1}:"
        reason = f"{name}: the position stands still from row {first} to row {last}, under drives that turn it else"
        return [Objection("refused", f"{reason}: {DID_IT_TURN}; or leave these rows out ({rest})")]
    if _lacks_sign(test):
        turns = "both ways" if _ways_rad(test)[0] >= _motion(test) else "backwards"
        cure = "log it with the sign of the direction, or say which column tells it: --direction COLUMN"
        if turns == "backwards":
            cure += "; or, if positions fall under a positive drive: --reversed"
        return [
            Objection(
                "refused",
                f"{name}: the drive is never negative, and the shaft turns {turns}, the faster the larger the drive: "
                f"the drive's sign is missing; {cure}",
            )
        ]
    if _turns_against_drive(test) and not _explains(test, motor):
        return [
            Objection(
                "refused",
                f"{name}: the motor turns against its drive: type --reversed (leave it out if you did), or reverse the "
                "sign of u_V or y_rad; or are they swapped?",
            )
        ]
    return []


def _stands_dead(test: TimeSeries) -> tuple[int, int] | None:
    """The first and last row of the longest time in which no drive, either way, turns the shaft; else None.

    At a stop it turns the other way; under friction it stands elsewhere, too, or under smaller drives.
    """
    edges = np.flatnonzero(np.diff(test.y_rad) != 0.0)
    first, stop = np.append(0, edges + 1), np.append(edges + 1, len(test))
    k = int(np.argmax(stop - first))
    rows = slice(int(first[k]), int(stop[k]))
    u, moving = test.u_V[rows], np.abs(test.u_V[edges])
    others = int(np.delete(stop - first, k).max(initial=0))
    if u.size < max(DEAD_ROWS, DEAD_TIMES * others) or not moving.any():
        return None
    turns_V = np.median(moving[moving > 0.0])
    if min(np.mean(u >= turns_V), np.mean(u <= -turns_V)) < DEAD_SHARE:
        return None
    return rows.start, rows.stop - 1


def _lacks_sign(test: TimeSeries) -> bool:
    """Whether the drive is a mere size: never negative, and the shaft turns backwards the faster the larger it is.

    A load that turns the shaft back does so the slower, the more the drive holds against it.
    """
    u, y = test.u_V, test.y_rad
    if u.min() < 0.0 or u.max() <= 0.0 or y.size < FEWEST_BACK:
        return False
    rows = min(y.size // 4, SMOOTH_ROWS)
    v = (y[rows:] - y[:-rows]) / (test.t_s[rows:] - test.t_s[:-rows])
    at = u[rows // 2 : rows // 2 + v.size]
    back = v < -TURNS_BACK * float(np.abs(v).max())
    if int(back.sum()) < max(FEWEST_BACK, TURNS_BACK * v.size) or np.ptp(y) <= 2.0 * _motion(test):
        return False
    if np.ptp(at[back]) == 0.0:
        return bool(at[back][0] == u.max())
    return float(np.corrcoef(-v[back], at[back])[0, 1]) > FASTER_BACK


def _turns_against_drive(test: TimeSeries) -> bool:
    """Whether the drive takes work out of the motor, sum of u dy < 0, by more than noise could explain."""
    u, y = test.u_V, test.y_rad
    work = float(u[:-1] @ np.diff(y))
    scatter = test.noise_rad() * float(np.sqrt(np.sum(np.diff(u) ** 2) + u[0] ** 2 + u[-1] ** 2))
    return work < -5.0 * scatter


def divides_a_turn(step_rad: float) -> bool:
    """Whether a turn is a whole number of such steps: those of degrees are not, 0.9 degrees as 0.9 rad included."""
    counts = 2.0 * np.pi / max(step_rad, 1e-9)
    return bool(counts > FEWEST_COUNTS - 0.5 and abs(counts - round(counts)) < WHOLE)


def _units(test: TimeSeries, fine_rad: float) -> list[Objection]:
    """Numbers that point to another unit; ``fine_rad``: the step, or noise, of its sensor."""
    name, period = test.name, test.period_s
    y, span, largest = test.y_rad, float(np.ptp(test.y_rad)), float(np.abs(test.u_V).max())
    duration = float(test.t_s[-1] - test.t_s[0])
    found: list[Objection] = []

    def object_to(verdict: Verdict, reason: str) -> None:
        found.append(Objection(verdict, f"{name}: {reason}"))

    if period > LONGEST_PERIOD_S:
        object_to("refused", f"samples are {period:.3g} s apart: is t_s in milliseconds?")
    elif period < SHORTEST_PERIOD_S:
        cure = "is t_s in seconds? If it is, keep every tenth row"
        object_to("refused", f"samples are {period:.3g} s apart: {cure}")
    elif duration < SHORTEST_RECORD_S:
        object_to("doubtful", f"the whole recording lasts {duration:.3g} s: is t_s in seconds?")

    step = test.resolution_rad()
    said = _say_unit(test)
    if test.units_stated:
        pass  # any number of turns, in steps of any size: ``_information`` asks for enough steps
    elif span > 2.0 and bool(np.all(y == np.round(y))):
        object_to("refused", f"positions are whole numbers over {span:g}: is y_rad in raw counts or degrees? {said}")
    elif fine_rad < FINE_RAD or divides_a_turn(step):
        pass  # an encoder's radians, fine or of few counts: no sign of degrees, and the column's name says rad
    elif span > LARGEST_SPAN_RAD:
        object_to("refused", f"positions span {span:.3g} rad, {span / 6.283:.1f} turns: is y_rad in degrees? {said}")
    elif span > LARGE_SPAN_RAD:
        object_to("doubtful", f"positions span {span:.3g} rad, {span / 6.283:.1f} turns: is y_rad in degrees? {said}")
    elif step > COARSEST_STEP_RAD:
        object_to("refused", f"positions move in steps of {step:.3g} rad: is y_rad in degrees? {said}")
    elif step >= COARSE_STEP_RAD or test.noise_rad() > COARSE_STEP_RAD:
        coarse = max(step, test.noise_rad())
        object_to("doubtful", f"positions are only good to {coarse:.2g} rad: is y_rad in degrees? {said}")

    if largest > LARGEST_DRIVE_V:
        object_to("refused", f"the drive reaches {largest:.3g} V: is u_V in mV or in duty counts?")
    elif 0.0 < largest < SMALLEST_DRIVE_V:
        object_to("refused", f"the drive never exceeds {1e3 * largest:.2g} mV: is u_V in V?")
    elif 0.0 < largest < SMALL_DRIVE_V:
        object_to("doubtful", f"the drive never exceeds {1e3 * largest:.2g} mV: is u_V in V?")
    return found


def hole_rows(test: TimeSeries) -> NDArray[np.intp]:
    """Indices of the rows before holes in the samples."""
    allowed_s = GAP_PERIODS * test.period_s
    if test.t_u_s is not None:
        allowed_s = max(allowed_s, TIMED_GAP_S)
    return np.flatnonzero(np.diff(test.t_s) > allowed_s)


def _set_anew(test: TimeSeries) -> NDArray[np.intp]:
    """Indices of the few rows behind which the position is set anew: one step far from the steps before and after it.

    It is larger than any other step, and farther from those beside it: of a motor that turns round they differ, too.
    Nor is it where the drive is larger than anywhere else: a kick moves the shaft so.
    """
    steps_rad = np.diff(test.y_rad) * np.minimum(1.0, test.period_s / np.diff(test.t_s))  # over lost rows it goes on
    beside_rad = np.pad(steps_rad, 1, mode="edge")
    off_rad = np.pad(np.abs(steps_rad - 0.5 * (beside_rad[:-2] + beside_rad[2:])), 1)
    peaks = np.flatnonzero((off_rad[1:-1] >= off_rad[:-2]) & (off_rad[1:-1] >= off_rad[2:]))
    peaks = peaks[np.argsort(-off_rad[peaks + 1])][: MOST_JUMPS + 1]
    far = np.flatnonzero(off_rad[peaks + 1][:-1] > FAR_JUMP * off_rad[peaks + 1][1:])
    jumps = np.sort(peaks[: far[-1] + 1]) if far.size else peaks[:0]
    goes_back = np.maximum(off_rad[jumps], off_rad[jumps + 2]) > GOES_BACK * off_rad[jumps + 1]
    least_rad = max(LARGER * float(np.abs(np.delete(steps_rad, jumps)).max(initial=0.0)), _motion(test))
    at = np.clip(jumps + np.array([[-1], [0], [1]]), 0, None)
    is_kick = np.abs(test.u_V)[at].max(axis=0) > LARGER * np.abs(np.delete(test.u_V, at)).max(initial=0.0)
    none = goes_back.any() or is_kick.any() or np.any(np.abs(steps_rad[jumps]) < least_rad)
    return jumps[:0] if none else jumps


def _lost_rows(test: TimeSeries) -> NDArray[np.intp]:
    """Indices of the rows before lost ones in which the drive stepped, nobody knows when. Else the rows come evenly."""
    periods, steps_V = np.diff(test.t_s) / test.period_s, np.abs(np.diff(test.u_V))
    if test.t_u_s is not None or float(np.mean(np.abs(periods - 1.0) < ON_TIME)) < EVEN_ROWS:
        return np.array([], dtype=np.intp)
    return np.flatnonzero((periods > 2.0 - ON_TIME) & (steps_V > STEPPED * np.abs(test.u_V).max()))


def since_it_moves(test: TimeSeries) -> TimeSeries:
    """Of a drive that never changes the rows from the first motion on: how late it began to act, no row tells."""
    first = int(np.argmax(np.abs(test.y_rad - test.y_rad[0]) >= _motion(test)))
    if np.ptp(test.u_V) > 0.0 or len(test) - first < FEWEST_ROWS:
        return test
    return replace(test, t_u_s=test.t_s).part(first, len(test))


def without_holes(test: TimeSeries) -> tuple[list[TimeSeries], list[str]]:
    """The parts between holes, each with the name of the whole, and a sentence; the whole where too little is left.

    A lost row is a hole where the drive stepped meanwhile. Where the position is set anew, another part begins, too. A
    part is as long as the longest delay of a drive, and twenty rows: after that its drives are known.
    """
    holes = np.union1d(hole_rows(test), _lost_rows(test))
    jumps = np.setdiff1d(_set_anew(test), holes)  # over a hole a shaft turns far
    least = FEWEST_ROWS + math.ceil(LATENCY_S / test.period_s) + 1
    edges = [0, *(np.union1d(holes, jumps) + 1).tolist(), len(test)]
    parts = [test.part(first, stop) for first, stop in pairwise(edges) if stop - first >= least]
    parts = [part for part in parts if np.ptp(part.u_V) and np.ptp(part.y_rad)]  # others no fit can use
    kept = sum(map(len, parts))
    if len(edges) == 2 or kept < KEPT * len(test):
        return [test], []
    parts = sorted(sorted(parts, key=len)[-MOST_PARTS:], key=lambda part: part.first_row)
    said = [f"{_in_words(test, holes)}, in which the drive is unknown"] if holes.size else []
    if jumps.size:
        said.append(f"a position that is set anew after row {', '.join(str(test.first_row + k) for k in jumps)}")
    rest = len(test) - sum(map(len, parts))
    left_out = f"; {rest} rows in short or steady parts were left out" if rest else ""
    each = f"each of {len(parts)} parts is fitted with a start of its own"
    return parts, [f"{test.name}: {' and '.join(said)}: {each}{left_out}"]


def _in_words(test: TimeSeries, holes: NDArray[np.intp]) -> str:
    """Holes, at least one, such as ``2 gaps, the largest a gap of 0.21 s after row 109``."""
    steps_s = np.diff(test.t_s)[holes]
    k = int(np.argmax(steps_s))
    gap = f"gap of {steps_s[k]:.3g} s after row {test.first_row + int(holes[k])}"
    return f"a {gap}" if holes.size == 1 else f"{holes.size} gaps, the largest a {gap}"


def _holes(test: TimeSeries) -> list[Objection]:
    """Holes in the samples."""
    holes = hole_rows(test)
    if not holes.size:
        return []
    starts, ends = np.append(0, holes + 1), np.append(holes, len(test) - 1)
    part = int(np.argmax(test.t_s[ends] - test.t_s[starts]))
    first, last = test.first_row + int(starts[part]), test.first_row + int(ends[part])
    cure = f"identify the longest part without a gap (--rows {first}:{last})"
    if last - first < FEWEST_ROWS:
        cure = "no part without one is long enough; log every tick"
    reason = f"{test.name}: {_in_words(test, holes)}: the drive there is unknown; {cure}"
    return [Objection("doubtful", reason)]


def one_way(tests: Sequence[TimeSeries]) -> bool:
    """Whether all tests together turn the shaft one way only, but for what noise and the sensor's steps explain."""
    ways = [_ways_rad(test) for test in tests]
    return not any(forth >= _motion(test) for (forth, _), test in zip(ways, tests, strict=True)) or not any(
        back >= _motion(test) for (_, back), test in zip(ways, tests, strict=True)
    )


def _ways_rad(test: TimeSeries) -> tuple[float, float]:
    """Longest way towards +y and towards -y, rad. A small one that no drive asks for is none: summed noise drifts."""
    y, u = test.y_rad, test.u_V
    ways = float(np.max(y - np.minimum.accumulate(y))), float(np.max(np.maximum.accumulate(y) - y))
    least_rad = TURNED_BACK * max(ways) if np.all(u >= 0.0) or np.all(u <= 0.0) else 0.0
    return ways[0] if ways[0] > least_rad else 0.0, ways[1] if ways[1] > least_rad else 0.0


def _explains(test: TimeSeries, motor: Estimate | None) -> bool:
    """Whether the motor explains the test, as it does one whose reading lags: then the shaft seems to turn too late."""
    return (
        motor is not None
        and motor.is_motor
        and motor.rms_rad <= math.hypot(EXPLAINED * float(np.std(test.y_rad)), COVERAGE * test.strays_rad(len(test)))
        and not motor.delay_s > LATE_ROWS * test.period_s
    )


def _stride_rad(test: TimeSeries, motor: Estimate | None) -> float:
    """How far a motor that explains the test turns from row to row at its largest speed, rad; 0.0 if it does not."""
    if motor is None or not _explains(test, motor):
        return 0.0
    return STRIDE * abs(motor.K_rad_s_V) * float(np.abs(test.u_V).max()) * test.period_s


def _turn_rad(test: TimeSeries, motor: Estimate | None, steps_s: Array) -> Array:
    """How far a reversal takes a position from its neighbours at most, rad: by an acceleration of 2 K u / tau.

    steps_s   the largest step of time beside each
    """
    if motor is None or not motor.is_motor or not motor.tau_s > 0.0:
        return np.zeros_like(steps_s)
    fastest = 2.0 * abs(motor.K_rad_s_V) * float(np.abs(test.u_V).max())
    return np.asarray(fastest * steps_s * np.minimum(1.0, steps_s / motor.tau_s))


def _spikes(test: TimeSeries, motor: Estimate | None) -> list[Objection]:
    """Single positions that differ from the median of their neighbours by more than a reversal explains."""
    y = test.y_rad
    if y.size < 5:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(y, 5)
    steps_s = np.lib.stride_tricks.sliding_window_view(np.diff(test.t_s), 4).max(axis=1)
    off = np.abs(y[2:-2] - np.median(windows, axis=1))
    least = max(SPIKE * float(np.ptp(y)), SPIKE_NOISES * test.noise_rad())
    beyond = off - np.maximum(least, _turn_rad(test, motor, steps_s))
    k = int(np.argmax(beyond))
    if beyond[k] > 0.0:
        return [
            Objection(
                "doubtful",
                f"{test.name}: the position in row {test.first_row + k + 2} differs by {off[k]:.2g} rad from "
                "the rows around it: correct or delete this row",
            )
        ]
    return []


def _rails(test: TimeSeries) -> list[Objection]:
    """Positions that stay exactly at one end of the travel in spite of noise: the end of the sensor's range.

    A reading that stays there at 0 V is a shaft at rest: only rows under a drive count.
    """
    if test.reads in ("speed", "samples"):
        return []
    y, step = test.y_rad, test.resolution_rad()
    driven = np.concatenate(([0], np.cumsum(test.u_V != 0.0)))
    if test.noise_rad() <= max(0.5 * step, 1e-6 * float(np.ptp(y))):
        return []  # without visible noise the reading of a turning shaft can stay at one step, too
    found = []
    for end in (float(y.min()), float(y.max())):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], y == end, [False]))))
        begins, lengths = edges[::2], edges[1::2] - edges[::2]
        under_drive = driven[edges[1::2]] - driven[begins]
        k = int(np.argmax(under_drive))
        row = int(begins[k])
        stop = row + int(lengths[k])
        rests = row == 0 and np.abs(test.u_V[:stop]).max() < RESTS * np.abs(test.u_V).max()
        if under_drive[k] >= RAIL_ROWS and not (rests or _turns(test, row, stop) or _sticks(test, row, stop)):
            first = test.first_row + row
            found.append(
                Objection(
                    "doubtful",
                    f"{test.name}: the position stays at exactly {end:.4g} rad from row {first} to row "
                    f"{first + int(lengths[k]) - 1}: is it the end of the sensor's range or travel? Keep off it",
                )
            )
    return found


def _turns(test: TimeSeries, first: int, stop: int) -> bool:
    """Whether the shaft may just turn in these rows, within one step of a sensor that shows no more noise than that."""
    y, step, rows = test.y_rad, test.resolution_rad(), stop - first
    ahead, behind = y[max(first - rows, 0) : first + 1], y[stop - 1 : stop + rows]
    return test.noise_rad() <= step and max(float(np.ptp(ahead)), float(np.ptp(behind))) <= TURN_STEPS * step


def _sticks(test: TimeSeries, first: int, stop: int) -> bool:
    """Whether friction may hold the shaft in these rows: inside the travel it stands as long, as hard driven.

    Where the reading does not move at all, a part of the time is enough.
    """
    y, step, rows = test.y_rad, test.resolution_rad(), stop - first
    hard_V = np.abs(test.u_V[first:stop]).mean()
    for long, moves, far in ((rows, MOVED_STEPS, FAR_STEPS), (max(RAIL_ROWS, round(STANDS * rows)), 0.0, 0.0)):
        windows = np.lib.stride_tricks.sliding_window_view(y, long)
        low, high = windows.min(axis=1), windows.max(axis=1)
        inside = (low > y.min() + far * step) & (high < y.max() - far * step)
        stands = np.flatnonzero(inside & (high - low <= moves * step))
        drives = np.lib.stride_tricks.sliding_window_view(np.abs(test.u_V), long)[stands]
        if np.any(drives.mean(axis=1) >= hard_V):
            return True
    return False


def _say_unit(test: TimeSeries) -> str:
    """How to say what the unit is: of a run of rig its config does."""
    return SAY_UNIT if test.stage is None else "See calibration in its config"


def _little(test: TimeSeries) -> list[Objection]:
    """So little motion that it may be in another unit."""
    span = float(np.ptp(test.y_rad))
    if 0.0 < span < SMALLEST_SPAN_RAD:
        cause = f"positions span {1e3 * span:.2g} mrad in all: is y_rad in rad? If it is, move further"
        return [Objection("refused", f"{test.name}: {cause}")]
    if 0.0 < span < SMALL_SPAN_RAD and not test.units_stated:
        cause = f"positions span only {1e3 * span:.2g} mrad: is y_rad in rad? {_say_unit(test)}"
        return [Objection("doubtful", f"{test.name}: {cause}")]
    return []


def _information(test: TimeSeries) -> list[Objection]:
    """Motion that cannot separate the parameters, in any fit."""
    y = test.y_rad
    motion = _motion(test)
    forth, back = _ways_rad(test)
    if 0.0 < max(forth, back) < 2.0 * motion:
        return [
            Objection(
                "refused",
                f"{test.name}: the position moves by {1e3 * max(forth, back):.2g} mrad, no more than its noise: "
                "record with a drive above friction",
            )
        ]
    step = test.resolution_rad()
    coarse = []
    if float(np.ptp(y)) < FEWEST_STEPS * step:
        coarse = [
            Objection(
                "doubtful",
                f"{test.name}: the position moves over {float(np.ptp(y)) / step:.0f} sensor steps only: record "
                f"at least {FEWEST_STEPS:.0f}, with larger cycles or a finer sensor",
            )
        ]
    if 0.0 < min(forth, back) < motion or min(forth, back) == 0.0 < max(forth, back):
        return [
            *coarse,
            Objection(
                "refused",
                f"{test.name}: the shaft turned one way only: friction and asymmetry (a) show only as f_c - a, or as "
                "f_c + a backwards. For f_c, drive it both ways",
                spoils=False,
            ),
        ]
    return coarse


def _motion(test: TimeSeries) -> float:
    """Smallest change of position that noise and the sensor's steps cannot explain, rad."""
    return max(MOVED_NOISES * test.noise_rad(), MOVED_STEPS * test.resolution_rad())
