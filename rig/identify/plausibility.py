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
from rig.recording.series import Record

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


def judge_records(records: Sequence[Record]) -> list[Objection]:
    """Objections to the records: units, columns that do not belong together, holes, a drive that shows too little."""
    said: list[Objection] = []
    for record in records:
        said += _columns(record) or [
            objection for look in (_units, _holes, _spikes, _rails, _information) for objection in look(record)
        ]
    return said


def judge_motor(estimate: Estimate, records: Sequence[Record]) -> list[Objection]:
    """Objections to a fitted motor: a time constant that points to another unit of time."""
    tau = estimate.tau_s
    period = max(record.period_s for record in records)
    if tau > LONGEST_TAU_S:
        return [Objection("refused", f"tau = {tau:.3g} s is no small motor's: is t_s in milliseconds?")]
    if tau < SHORTEST_TAU_S:
        return [Objection("refused", f"tau = {tau:.3g} s is no motor's: is t_s in seconds, not in ks or minutes?")]
    if tau > LONG_TAU_S and period >= 1e3 * SHORTEST_PERIOD_S:
        return [Objection("doubtful", f"tau = {tau:.3g} s with samples {period:.3g} s apart: is t_s in milliseconds?")]
    if tau < SHORT_TAU_S:
        return [Objection("doubtful", f"tau = {tau:.3g} s is very short: is t_s in seconds, not in ks or minutes?")]
    return []


def _columns(record: Record) -> list[Objection]:
    """Signs that u and y are not drive and position of one motor."""
    y, u = record.y_rad, record.u_V
    name, span = record.name, float(np.ptp(y))
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
    k = int(np.argmax(np.where(np.diff(record.t_s) < 2.0 * record.period_s, steps, 0.0)))
    if steps[k] > JUMP * span and steps[k] > _motion(record):
        row = record.first_row + k
        return [
            Objection(
                "refused",
                f"{name}: the position jumps by {steps[k]:.3g} rad between rows {row} and {row + 1}: unwrap the angle, "
                f"leave the spike out (--rows {row + 1}: or --rows :{row}), or are u_V and y_rad swapped?",
            )
        ]
    if _turns_against_drive(record):
        return [
            Objection(
                "refused",
                f"{name}: the motor turns against its drive: reverse the sign of u_V or of y_rad, or are they swapped?",
            )
        ]
    return []


def _turns_against_drive(record: Record) -> bool:
    """Whether the drive takes work out of the motor, beyond what noise could make of it: sum of u dy < 0."""
    u, y = record.u_V, record.y_rad
    work = float(u[:-1] @ np.diff(y))
    scatter = record.noise_rad() * float(np.sqrt(np.sum(np.diff(u) ** 2) + u[0] ** 2 + u[-1] ** 2))
    return work < -5.0 * scatter


def _units(record: Record) -> list[Objection]:
    name, period = record.name, record.period_s
    y, span, largest = record.y_rad, float(np.ptp(record.y_rad)), float(np.abs(record.u_V).max())
    duration = float(record.t_s[-1] - record.t_s[0])
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

    step = record.resolution_rad()
    if span > 2.0 and bool(np.all(y == np.round(y))):
        object_to("refused", f"all positions are whole numbers over {span:g}: is y_rad in raw counts or degrees?")
    elif span > LARGEST_SPAN_RAD:
        object_to("refused", f"positions span {span:.3g} rad: is y_rad in degrees or milliradians?")
    elif span > LARGE_SPAN_RAD:
        object_to("doubtful", f"positions span {span:.3g} rad, {span / 6.283:.1f} turns: is y_rad in degrees?")
    elif step > COARSEST_STEP_RAD:
        object_to("refused", f"positions move in steps of {step:.3g} rad: is y_rad in degrees or milliradians?")
    elif step >= COARSE_STEP_RAD or record.noise_rad() > COARSE_STEP_RAD:
        coarse = max(step, record.noise_rad())
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


def _holes(record: Record) -> list[Objection]:
    """Holes in the samples."""
    said: list[Objection] = []
    steps = np.diff(record.t_s)
    k = int(np.argmax(steps))
    allowed_s = GAP_PERIODS * record.period_s
    if record.t_u_s is not None:
        allowed_s = max(allowed_s, TIMED_GAP_S)
    if steps[k] > allowed_s:
        said.append(
            Objection(
                "doubtful",
                f"{record.name}: gap of {steps[k]:.3g} s after row {record.first_row + k}: what the drive did in it is "
                "unknown; identify the part before or after it",
            )
        )
    return said


def _spikes(record: Record) -> list[Objection]:
    """Single positions that stand out from the median of their neighbours."""
    y = record.y_rad
    if y.size < 5:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(y, 5)
    off = np.abs(y[2:-2] - np.median(windows, axis=1))
    k = int(np.argmax(off))
    if off[k] > max(SPIKE * float(np.ptp(y)), SPIKE_NOISES * record.noise_rad()):
        return [
            Objection(
                "doubtful",
                f"{record.name}: the position in row {record.first_row + k + 2} stands out by {off[k]:.2g} rad from "
                "those around it: correct or delete this row",
            )
        ]
    return []


def _rails(record: Record) -> list[Objection]:
    """Positions that stay exactly at one end of the travel although there is noise: the sensor's rail."""
    y, step = record.y_rad, record.resolution_rad()
    if record.noise_rad() <= max(0.5 * step, 1e-6 * float(np.ptp(y))):
        return []  # without noise that moves the reading, a turning shaft stays at one step too
    said = []
    for end in (float(y.min()), float(y.max())):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], y == end, [False]))))
        begins, lengths = edges[::2], edges[1::2] - edges[::2]
        k = int(np.argmax(lengths))
        if lengths[k] >= RAIL_ROWS:
            first = record.first_row + int(begins[k])
            said.append(
                Objection(
                    "doubtful",
                    f"{record.name}: the position stays at exactly {end:.4g} rad from row {first} to row "
                    f"{first + int(lengths[k]) - 1}: the end of the sensor's range or of the travel? Keep off it",
                )
            )
    return said


def _information(record: Record) -> list[Objection]:
    """Motion that cannot tell the parameters apart, whatever is fitted to it."""
    y = record.y_rad
    motion = _motion(record)
    forth = float(np.max(y - np.minimum.accumulate(y)))
    back = float(np.max(np.maximum.accumulate(y) - y))
    if 0.0 < max(forth, back) < 2.0 * motion:
        return [
            Objection(
                "refused",
                f"{record.name}: the position moves by {1e3 * max(forth, back):.2g} mrad, no more than its noise: "
                "record with a larger drive, beyond friction",
            )
        ]
    step = record.resolution_rad()
    coarse = []
    if float(np.ptp(y)) < FEWEST_STEPS * step:
        coarse = [
            Objection(
                "doubtful",
                f"{record.name}: the position moves over {float(np.ptp(y)) / step:.0f} sensor steps only: record "
                f"at least {FEWEST_STEPS:.0f}, with larger cycles or a finer sensor",
            )
        ]
    if 0.0 < min(forth, back) < motion or min(forth, back) == 0.0 < max(forth, back):
        return [
            *coarse,
            Objection(
                "refused",
                f"{record.name}: the motor moves one way only, which cannot tell K, fc and asymmetry apart: record a "
                "drive that moves it both ways",
            ),
        ]
    return coarse


def _motion(record: Record) -> float:
    """Change of position that noise and the sensor's steps do not make, rad."""
    return max(MOVED_NOISES * record.noise_rad(), MOVED_STEPS * record.resolution_rad())
