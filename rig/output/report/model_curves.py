"""What the figures draw of a model, no figure: its cycles, and what it predicts under the recorded drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rig.core.arrays import Array
from rig.core.estimators import LEADING
from rig.identification.cycles import find_cycle
from rig.identification.descent import Point, descend
from rig.identification.identification import Identification, identify
from rig.identification.known_model import model_of, plain_motor
from rig.identification.preprocessing import from_recording
from rig.model.real_motor import FramedMotor, readings_of, windows_of
from rig.output.report.source import ReportedRun, Span, words_of
from rig.output.report.style import AbsentError
from rig.run_folder.recording.curves import Curves, read_curves
from rig.run_folder.recording.errors import IdentifyError, RecordingError
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.results import EstimateResult, known

DIFFERENCE = 1e-6  # rad/s and rad, by which a start is moved to see its effect
GAINS, STEPS = 1e-8, 10  # of a start: share of the squares that a step must gain, and steps at most


@dataclass(frozen=True)
class Cycles:
    """Whole settled cycles of one relay test.

    series  the test as the estimators read it, with its clock corrected
    rows    (first, last) of each cycle, both included, counted in the file
    """

    series: TimeSeries
    rows: list[tuple[int, int]]

    def __len__(self) -> int:
        return len(self.rows)

    def last(self) -> Cycles:
        """The last cycle alone."""
        return Cycles(self.series, self.rows[-1:])


@dataclass(frozen=True)
class Predicted:
    """One recorded cycle or test, and its prediction from a fitted start. All arrays have one length.

    phase        time since the cycle's start over its length, 0 to 1
    measured_rad, y_rad   position as recorded and as predicted
    v_rad_per_s  predicted velocity
    """

    phase: Array
    measured_rad: Array
    y_rad: Array
    v_rad_per_s: Array

    @property
    def residual_rad(self) -> Array:
        """Recorded less predicted position, rad."""
        return self.measured_rad - self.y_rad


def central_difference(t: Array, y: Array, rows: int = 1) -> Array:
    """Velocity, rad/s, by central differences; one-sided at the ends; nan where times repeat.

    t     times, s
    y     positions, rad
    rows  so many before and after
    """
    if t.size < 3:
        return np.full(t.size, np.nan)
    first, last = np.maximum(np.arange(t.size) - rows, 0), np.minimum(np.arange(t.size) + rows, t.size - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        v = (y[last] - y[first]) / (t[last] - t[first])
    return np.where(np.isfinite(v), v, np.nan)


def cycles_of(run: ReportedRun, span: Span) -> Cycles | None:
    """Whole settled cycles of a relay test, as identification finds them; None if it finds none.

    A cycle starts where the integral crosses zero downwards: the drive steps up to h1 + h2 (docs/theory.md 3.1). The
    relay can chatter around that edge, so a crossing sooner than half a period after the last one does not count.
    """
    try:
        series, _ = from_recording(run.rows, slice(span.first, span.last + 1), span.stage)
        settled = find_cycle(series)
    except IdentifyError:
        return None
    first, last = settled.rows
    z = run.rows.z_rad_s
    row = np.arange(max(first, 1), min(last + 1, span.last) + 1)
    starts = row[(z[row] < 0.0) & (z[row - 1] >= 0.0)].tolist()
    kept: list[int] = []
    for start in starts:
        if not kept or start - kept[-1] > 0.5 * settled.period_s / settled.period_sampling_s:
            kept.append(start)
    rows = list(pairwise(kept))
    return Cycles(series, rows) if len(rows) >= 2 else None


def answer_motor(run: ReportedRun) -> FramedMotor | None:
    """The motor of the run's answer; None without one, if it was refused, or is damaged."""
    try:
        return model_of(run.result.answer, in_its_time=True)
    except ValueError:
        return None


def motor_of(estimate: EstimateResult) -> FramedMotor | None:
    """The estimated model; None if the estimate has no usable parameters."""
    try:
        return plain_motor(estimate)
    except ValueError:
        return None


def models(run: ReportedRun) -> dict[str, tuple[EstimateResult, FramedMotor]]:
    """The estimates that are models, by method: the answer, and those of the other methods beside it.

    A refused answer is a model, too: its residual shows what is wrong.
    """
    found = run.estimates
    answer = run.result.answer
    if answer is not None:
        found = {answer.method: answer} | {m: e for m, e in found.items() if m != answer.method}
    real = answer_motor(run)
    motors = {method: motor_of(estimate) for method, estimate in found.items()}
    if answer is not None and real is not None:
        motors[answer.method] = real
    return {m: (found[m], motor) for m, motor in motors.items() if motor is not None}


def predict_cycles(run: ReportedRun, estimate: EstimateResult, motor: FramedMotor, cycles: Cycles) -> list[Predicted]:
    """Predict each cycle under its recorded drive by one of ``models``, from the start (v0, y0) that fits best."""
    series = cycles.series
    delays_s = [known(e.delay_s) for e in (estimate, run.estimates.get(LEADING)) if e is not None]
    return [
        predicted(motor, series, slice(first - series.first_row, last + 1 - series.first_row), delays_s)
        for first, last in cycles.rows
    ]


def predicted(motor: FramedMotor, series: TimeSeries, part: slice, delays_s: Sequence[float] = ()) -> Predicted:
    """Predict a part of a test under its recorded drive, from the start (v0, y0) that fits best.

    part      of the rows of ``series``
    delays_s  of the drive, where the test does not know it: the first that is finite counts, s
    Raises AbsentError for a motor that cannot be followed.
    """
    edges, u = (series.edge_s, series.u_V) if series.edges is None else series.edges
    t, y = series.t_s[part], series.y_rad[part]
    if series.t_u_s is None:
        edges = edges + next((d for d in delays_s if math.isfinite(d)), 0.0)
    first = max(int(np.searchsorted(edges, t[0], side="right")) - 1, 0)
    stop = int(np.searchsorted(edges, t[-1], side="right"))
    edge, drive = edges[first:stop].copy(), u[first:stop]
    edge[0] = min(edge[0], t[0])
    guess = float(np.polyfit(t[:6] - t[0], y[:6], 1)[0])
    one_piece = np.zeros(1, dtype=np.int64)

    def path(start: Array) -> tuple[Array, Array]:
        windows = windows_of([(motor.frame, (edge, drive), t, one_piece)])
        way = np.sign(start[0])
        shown = readings_of(motor.motor, windows, np.array([[*start, way, way]])).y_rad  # play, bristles: as in motion
        return shown, central_difference(t, shown)

    def rows(start: Array) -> tuple[Array, Array]:
        left = path(start)[0] - y
        moved = [(path(start + step)[0] - y - left) / DIFFERENCE for step in DIFFERENCE * np.eye(2)]
        return left, np.column_stack(moved)

    guessed = Point.of(np.array([guess, y[0]]), rows)
    if not math.isfinite(guessed.cost):
        raise AbsentError("The answer holds a motor that runs away, or is too stiff to be followed.")
    best, _ = descend(
        guessed,
        lambda at: lambda damping: Point.of(at.x + at.step(np.array([True, True]), damping), rows),
        lambda before, after: before.cost - after.cost <= GAINS * after.cost,
        STEPS,
    )
    return Predicted((t - t[0]) / (t[-1] - t[0]), y, *path(best.x))


def average(phase: Array, values: Array, bins: int) -> tuple[Array, Array, Array]:
    """Mean over cycles in ``bins`` equal steps of phase. Returns centres, means, counts, without empty bins.

    phase   0 to 1
    values  one per phase; the means have their unit
    """
    place = np.minimum((phase * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins)
    total = np.bincount(place, weights=values, minlength=bins)
    centre = np.bincount(place, weights=phase, minlength=bins)
    full = count > 0
    return centre[full] / count[full], total[full] / count[full], count[full].astype(float)


def curves_of(run: ReportedRun, identification: Identification | None = None) -> tuple[Curves | None, str]:
    """The curves behind the run's answer; or None, and a sentence that says why, empty where no test would have any.

    identification  of this recording; None: as kept with the run, else fitted anew, which a note of the run says
    """
    if run.recording is None:
        return None, "There are no samples, so there is no residual to show."
    if not (run.spans("relay") or run.spans("hysteretic")):
        return None, ""
    if identification is not None:
        return identification.curves, ""
    try:
        found, why = kept_or_fitted(run)
    except IdentifyError as error:
        return None, f"No estimator can use this recording: {error.cause}. What to do: {error.cure}."
    except RecordingError as error:
        return None, f"The estimators cannot read this recording: {error}."
    run.notes.extend([f"{why}: the recording was identified anew for the residual."] if why else [])
    return found, ""


def kept_or_fitted(run: ReportedRun) -> tuple[Curves | None, str]:
    """The curves that are kept with a run, and ""; or those of a new fit, and what is wrong with the kept ones.

    Raises AbsentError without rows; IdentifyError and RecordingError as ``identify``.
    """
    try:
        return read_curves(run.folder, run.rows, run.result.answer), ""
    except RecordingError as error:
        why = words_of(error)
    answer = run.result.answer
    return identify([run.rows], choose_law=answer is not None and answer.law is not None).curves, why
