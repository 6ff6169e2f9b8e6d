"""Signs that a recording is not what its columns' names say: what no fit can notice by itself.

A motor in milliseconds and millivolts is a motor too, and fits as well. So every column is held to what a bench with a
small motor, its sensor and its logger can show. A reading outside of it is refused with a question. Where both the
reading and a thousandth or a thousand times it are conceivable, the estimate is doubtful.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.identify.estimate import Estimate, Verdict
from rig.recording.series import TimeSeries

Array = NDArray[np.float64]

LONGEST_PERIOD_S = 0.5  # between samples: slower than any motor's time constant
SHORTEST_PERIOD_S = 20e-6  # faster than any logger of positions
SHORTEST_RECORD_S = 0.1
LARGEST_SPAN_RAD = 40.0  # six turns
SMALL_SPAN_RAD, SMALLEST_SPAN_RAD = 0.04, 0.01
COARSE_STEP_RAD, COARSEST_STEP_RAD = 0.1, 0.5  # 63 and 13 steps a turn
LARGEST_DRIVE_V = 100.0
SMALL_DRIVE_V, SMALLEST_DRIVE_V = 0.1, 0.02
LONG_TAU_S, LONGEST_TAU_S = 2.0, 20.0
SHORT_TAU_S, SHORTEST_TAU_S = 2e-3, 0.5e-3
GAP_PERIODS = 5.0
LARGE_SPAN_RAD = 12.6  # two turns: more than a potentiometer of one turn shows

TIMED_GAP_S = 0.05  # where the times of the drive were recorded, it was held until the next one
JUMP = 0.25  # of all the travel, in one sampling period: no motor does that
SPIKE = 0.02  # of all the travel, by which one position stands out from its neighbours,
SPIKE_NOISES = 10.0  # and in standard deviations of the noise
MOVED_NOISES = 8.0  # standard deviations of the noise beyond which a change of position is motion,
MOVED_STEPS = 3.0  # and steps of the sensor
FEWEST_STEPS = 40.0  # of the sensor over all the travel: an amplitude of 20 (docs/theory.md 4.3)
RAIL_ROWS = 10  # in a row at exactly one end of the travel, in spite of noise
FEW_LEVELS = 8


class Objection(NamedTuple):
    """What speaks against a record or a motor, as a sentence that says what to do, and how bad that is."""

    verdict: Verdict
    reason: str


def judge_records(tests: Sequence[TimeSeries]) -> list[Objection]:
    """Objections to the records: units, columns that do not belong together, holes, a drive that shows too little."""
    said: list[Objection] = []
    for test in tests:
        said += _columns(test) or [
            objection for look in (_units, _holes, _spikes, _rails, _information) for objection in look(test)
        ]
    return said


def judge_motor(estimate: Estimate, tests: Sequence[TimeSeries]) -> list[Objection]:
    """Objections to a fitted motor: a time constant that points to another unit of time."""
    tau = estimate.tau_s
    period = max(test.period_s for test in tests)
    if tau > LONGEST_TAU_S:
        return [Objection("refused", f"tau = {tau:.3g} s is no small motor's: is t_s in milliseconds?")]
    if tau < SHORTEST_TAU_S:
        return [Objection("refused", f"tau = {tau:.3g} s is no motor's: is t_s in seconds, not in ks or minutes?")]
    if tau > LONG_TAU_S and period >= 1e3 * SHORTEST_PERIOD_S:
        return [Objection("doubtful", f"tau = {tau:.3g} s with samples {period:.3g} s apart: is t_s in milliseconds?")]
    if tau < SHORT_TAU_S:
        return [Objection("doubtful", f"tau = {tau:.3g} s is very short: is t_s in seconds, not in ks or minutes?")]
    return []


def _columns(test: TimeSeries) -> list[Objection]:
    """Signs that u and y are not drive and position of one motor."""
    y, u = test.y_rad, test.u_V
    name, span = test.name, float(np.ptp(y))
    y_levels, u_levels = np.unique(y).size, np.unique(u).size
    if 1 < y_levels <= FEW_LEVELS and u_levels > 4 * y_levels:
        return [
            Objection(
                "refused",
                f"{name}: y_rad takes {y_levels} values and u_V {u_levels}: are the two columns swapped?",
            )
        ]
    if span == 0.0:
        return []  # the fit says so
    steps = np.abs(np.diff(y))
    k = int(np.argmax(np.where(np.diff(test.t_s) < 2.0 * test.period_s, steps, 0.0)))
    if steps[k] > JUMP * span and steps[k] > _motion(test):
        row = test.first_row + k
        return [
            Objection(
                "refused",
                f"{name}: the position jumps by {steps[k]:.3g} rad between rows {row} and {row + 1}: unwrap the angle, "
                f"leave the spike out (--rows {row + 1}: or --rows :{row}), or are u_V and y_rad swapped?",
            )
        ]
    if _turns_against_drive(test):
        return [
            Objection(
                "refused",
                f"{name}: the motor turns against its drive: reverse the sign of u_V or of y_rad, or are they swapped?",
            )
        ]
    return []


def _turns_against_drive(test: TimeSeries) -> bool:
    """Whether the drive takes work out of the motor, beyond what noise could make of it: sum of u dy < 0."""
    u, y = test.u_V, test.y_rad
    work = float(u[:-1] @ np.diff(y))
    scatter = test.noise_rad() * float(np.sqrt(np.sum(np.diff(u) ** 2) + u[0] ** 2 + u[-1] ** 2))
    return work < -5.0 * scatter


def _units(test: TimeSeries) -> list[Objection]:
    name, period = test.name, test.period_s
    y, span, largest = test.y_rad, float(np.ptp(test.y_rad)), float(np.abs(test.u_V).max())
    duration = float(test.t_s[-1] - test.t_s[0])
    said: list[Objection] = []

    def object_to(verdict: Verdict, reason: str) -> None:
        said.append(Objection(verdict, f"{name}: {reason}"))

    if period > LONGEST_PERIOD_S:
        object_to("refused", f"samples are {period:.3g} s apart: is t_s in milliseconds?")
    elif period < SHORTEST_PERIOD_S:
        cure = "is t_s in seconds? If it is, keep each tenth row"
        object_to("refused", f"samples are {period:.3g} s apart: {cure}")
    elif duration < SHORTEST_RECORD_S:
        object_to("doubtful", f"the whole record lasts {duration:.3g} s: is t_s in seconds?")

    step = test.resolution_rad()
    if span > 2.0 and bool(np.all(y == np.round(y))):
        object_to("refused", f"all positions are whole numbers over {span:g}: is y_rad in raw counts or degrees?")
    elif span > LARGEST_SPAN_RAD:
        object_to("refused", f"positions span {span:.3g} rad: is y_rad in degrees or milliradians?")
    elif span > LARGE_SPAN_RAD:
        object_to("doubtful", f"positions span {span:.3g} rad, {span / 6.283:.1f} turns: is y_rad in degrees?")
    elif step > COARSEST_STEP_RAD:
        object_to("refused", f"positions move in steps of {step:.3g} rad: is y_rad in degrees or milliradians?")
    elif step >= COARSE_STEP_RAD or test.noise_rad() > COARSE_STEP_RAD:
        coarse = max(step, test.noise_rad())
        object_to("doubtful", f"positions are only good to {coarse:.2g} rad: is y_rad in degrees?")
    elif 0.0 < span < SMALLEST_SPAN_RAD:
        object_to("refused", f"positions span {1e3 * span:.2g} mrad in all: is y_rad in rad? If it is, move further")
    elif 0.0 < span < SMALL_SPAN_RAD:
        object_to("doubtful", f"positions span only {1e3 * span:.2g} mrad: is y_rad in rad?")

    if largest > LARGEST_DRIVE_V:
        object_to("refused", f"the drive reaches {largest:.3g} V: is u_V in mV or in duty counts?")
    elif 0.0 < largest < SMALLEST_DRIVE_V:
        object_to("refused", f"the drive never exceeds {1e3 * largest:.2g} mV: is u_V in V?")
    elif 0.0 < largest < SMALL_DRIVE_V:
        object_to("doubtful", f"the drive never exceeds {1e3 * largest:.2g} mV: is u_V in V?")
    return said


def _holes(test: TimeSeries) -> list[Objection]:
    """Holes in the samples."""
    said: list[Objection] = []
    steps = np.diff(test.t_s)
    k = int(np.argmax(steps))
    allowed_s = GAP_PERIODS * test.period_s
    if test.t_u_s is not None:
        allowed_s = max(allowed_s, TIMED_GAP_S)
    if steps[k] > allowed_s:
        said.append(
            Objection(
                "doubtful",
                f"{test.name}: gap of {steps[k]:.3g} s after row {test.first_row + k}: what the drive did in it is "
                "unknown; identify the part before or after it",
            )
        )
    return said


def _spikes(test: TimeSeries) -> list[Objection]:
    """Single positions that stand out from the median of their neighbours."""
    y = test.y_rad
    if y.size < 5:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(y, 5)
    off = np.abs(y[2:-2] - np.median(windows, axis=1))
    k = int(np.argmax(off))
    if off[k] > max(SPIKE * float(np.ptp(y)), SPIKE_NOISES * test.noise_rad()):
        return [
            Objection(
                "doubtful",
                f"{test.name}: the position in row {test.first_row + k + 2} stands out by {off[k]:.2g} rad from "
                "those around it: correct or delete this row",
            )
        ]
    return []


def _rails(test: TimeSeries) -> list[Objection]:
    """Positions that stay exactly at one end of the travel although there is noise: the sensor's rail."""
    y, step = test.y_rad, test.resolution_rad()
    if test.noise_rad() <= max(0.5 * step, 1e-6 * float(np.ptp(y))):
        return []  # without noise that moves the reading, a turning shaft stays at one step too
    said = []
    for end in (float(y.min()), float(y.max())):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], y == end, [False]))))
        begins, lengths = edges[::2], edges[1::2] - edges[::2]
        k = int(np.argmax(lengths))
        if lengths[k] >= RAIL_ROWS:
            first = test.first_row + int(begins[k])
            said.append(
                Objection(
                    "doubtful",
                    f"{test.name}: the position stays at exactly {end:.4g} rad from row {first} to row "
                    f"{first + int(lengths[k]) - 1}: the end of the sensor's range or of the travel? Keep off it",
                )
            )
    return said


def _information(test: TimeSeries) -> list[Objection]:
    """Motion that cannot tell the parameters apart, whatever is fitted to it."""
    y = test.y_rad
    motion = _motion(test)
    forth = float(np.max(y - np.minimum.accumulate(y)))
    back = float(np.max(np.maximum.accumulate(y) - y))
    if 0.0 < max(forth, back) < 2.0 * motion:
        return [
            Objection(
                "refused",
                f"{test.name}: the position moves by {1e3 * max(forth, back):.2g} mrad, no more than its noise: "
                "record with a larger drive, beyond friction",
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
                f"{test.name}: the motor moves one way only, which cannot tell K, fc and asymmetry apart: record a "
                "drive that moves it both ways",
            ),
        ]
    return coarse


def _motion(test: TimeSeries) -> float:
    """Change of position that noise and the sensor's steps do not make, rad."""
    return max(MOVED_NOISES * test.noise_rad(), MOVED_STEPS * test.resolution_rad())
