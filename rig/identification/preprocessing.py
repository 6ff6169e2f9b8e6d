"""Corrections before a fit: the device's clock, missing times of drives, stamps that scatter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rig.core.signals import BenchDelay
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.recording import Floats, Recording, even_times_s
from rig.run_folder.recording.series import FEWEST_ROWS, RECORD_MORE, TIMES_ERROR_S, TimeSeries, steps_of
from rig.run_folder.recording.stage import Stage

SMOOTHER = 0.5  # noise of the sensor, or roughness, at even times over that at the own ones, at most


@dataclass(frozen=True)
class ClockRatio:
    """Ratio of a recording's clock to the host's clock, and its standard error."""

    ratio: float
    error: float

    @property
    def significant(self) -> bool:
        """Whether it differs from 1 beyond four standard errors and 20 ppm."""
        return abs(self.ratio - 1.0) > max(4.0 * self.error, 20e-6)


def clock_ratio(recording: Recording) -> ClockRatio | None:
    """Regress t_s on the host's time of each tick (tick * period + lateness); None if that is not recorded."""
    period_s = recording.meta.period_s
    usable = np.isfinite(recording.late_us)
    if period_s is None or not period_s > 0.0 or int(usable.sum()) < 100:
        return None
    host = recording.tick[usable] * period_s + 1e-6 * recording.late_us[usable]
    x = host - host.mean()
    power = float(x @ x)
    if power == 0.0:
        return None
    t = recording.t_s[usable]
    slope = float(x @ t) / power
    residual = t - t.mean() - slope * x
    return ClockRatio(slope, float(np.sqrt(residual @ residual / (x.size - 2) / power)))


def from_recording(recording: Recording, rows: slice, name: str) -> tuple[TimeSeries, list[str]]:
    """Rows of a recording as a ``TimeSeries``, and notes on corrected times.

    A drive that the device ramps is taken as it was, in fine stairs. If the clock ratio over the whole run is
    significant, times are divided by it. Rows before the first known t_u_s are left out. A missing t_u_s between others
    gets the median latency. Raises IdentifyError for fewer than twenty rows, for times that do not fit the ticks, and
    as ``TimeSeries`` does.
    """
    series, notes = _as_commanded(recording, rows, name)
    if recording.slew_V_s is not None:
        series = replace(series, edges=series.steps.ramped(recording.slew_V_s))
    return series, notes


def _as_commanded(recording: Recording, rows: slice, name: str) -> tuple[TimeSeries, list[str]]:
    """The same with each drive at once."""
    first, stop, _ = rows.indices(len(recording))
    if stop - first < FEWEST_ROWS:
        raise IdentifyError(
            f"{name}: {max(0, stop - first)} rows are too few to fit",
            RECORD_MORE,
        )
    notes: list[str] = []
    scale = 1.0
    clock = clock_ratio(recording)
    if clock is not None and clock.significant:
        if abs(clock.ratio - 1.0) > 0.03:
            raise IdentifyError(
                f"{name}: t_s runs {100.0 * (clock.ratio - 1.0):+.1f} % against the ticks and period_s of meta.json",
                "correct the times: a clock is wrong by a few per cent at most",
            )
        scale = clock.ratio
        notes.append(f"{name}: times divided by the clock ratio over the run, {scale:.6f} +- {clock.error:.6f}")
    first += recording.first_row
    named = str(recording.stage[rows][0])
    stage = Stage.parse(named) if named else None
    t_s = recording.t_s[rows] / scale
    t_u_s = recording.t_u_s[rows] / scale
    y_rad, u_V = recording.y_rad[rows], recording.u_V[rows]
    if recording.delay is not None:
        waiting = _waiting(recording.delay, t_s, t_u_s)
        if waiting:
            t_s, y_rad, t_u_s, u_V = t_s[:-waiting], y_rad[:-waiting], t_u_s[waiting:], u_V[waiting:]
    known = np.isfinite(t_u_s)
    if not known.any():
        stated = recording.units_stated
        edges = None if recording.drive_steps is None else steps_of(*recording.drive_steps)
        return TimeSeries(
            t_s, y_rad, None, u_V, first, name, stage=stage, units_stated=stated, edges=edges,
            reads=recording.reads, most_V=recording.most_V,
        ), notes  # fmt: skip
    start = int(np.flatnonzero(known)[0])
    missing = int((~known[start:]).sum())
    if missing > 0.2 * t_s.size:
        notes.append(f"{name}: t_u_s is missing in {missing} rows and was not used")
        return TimeSeries(t_s, y_rad, None, u_V, first, name, stage=stage, most_V=recording.most_V), notes
    latency = float(np.median((t_u_s - t_s)[known]))
    filled = np.where(known, t_u_s, t_s + latency)[start:]
    if missing:
        notes.append(
            f"{name}: t_u_s missing in {missing} rows, filled in with the median latency of {1e3 * latency:.2f} ms"
        )
        filled = np.maximum.accumulate(filled)
    error_s = _times_error_s(recording)
    shift_s = max(recording.meta.times_shift_s or 0.0, 0.0)
    series = TimeSeries(
        t_s[start:], y_rad[start:], filled, u_V[start:], first + start, name, error_s, shift_s, stage,
        most_V=recording.most_V,
    )  # fmt: skip
    return _with_delay(series, recording.delay, notes), notes


def _with_delay(series: TimeSeries, delay: BenchDelay | None, notes: list[str]) -> TimeSeries:
    """With an unknown delay, if the breakaway check has shown more delay than the device reports."""
    if delay is None or delay.further_s is None or not delay.is_shown:
        return series
    reported_s = float(np.mean(series.edge_s - series.t_s))
    low_s, high_s = (reported_s + end for end in (delay.further_s[0], delay.further_s[2]))
    notes.append(
        f"the reading moves {1e3 * low_s:.0f} to {1e3 * high_s:.0f} ms after a sample, by the strokes of the breakaway "
        f"check, but the device reports {1e3 * reported_s:.1f} ms: the delay is fitted"
    )
    return series.with_unknown_delay((low_s, high_s))


def _waiting(delay: BenchDelay, t_s: Floats, t_u_s: Floats) -> int:
    """Rows by which a drive was decided before the row in which it acts: it waited in the device.

    Then each row gets the drive that was decided on its sample, and the time at which that drive acted.
    """
    latency_s = t_u_s - t_s
    if t_s.size < FEWEST_ROWS or not np.isfinite(latency_s).any():
        return 0
    return min(delay.whole_periods(float(np.nanmedian(latency_s)), float(np.median(np.diff(t_s)))), t_s.size - 2)


def _times_error_s(recording: Recording) -> float:
    """Largest error of the times by meta.json, s; the default for a CSV file and for a run of an older version."""
    error_s = recording.meta.times_error_s
    return TIMES_ERROR_S if error_s is None or error_s < 0.0 else error_s


def evened(test: TimeSeries) -> tuple[TimeSeries, list[str]]:
    """The test at even times, and a sentence, if its motion is far smoother there; else as it is.

    Rows may come evenly and their stamps scatter about that, as those of a computer that receives them.
    """
    even_s = even_times_s(test.t_s)
    if test.t_u_s is not None or test.edges is not None or even_s is None:
        return test, []
    off_s, period_s, even = test.t_s - even_s, float(even_s[1] - even_s[0]), replace(test, t_s=even_s)
    if even.noise_rad() > SMOOTHER * test.noise_rad() and _roughness(even) > SMOOTHER * _roughness(test):
        return test, []
    if min(with_stamps_of(test, rows).noise_rad() for rows in (-1, 1)) < SMOOTHER * even.noise_rad():
        return test, []  # rows are uneven, and have the stamps of other rows
    said = (
        f"{test.name}: the time stamps scatter by {1e3 * float(np.std(off_s)):.2g} ms about even times, "
        f"{1e3 * period_s:.4g} ms apart, and the motion does not: it is taken at even times"
    )
    return even, [said]


def with_stamps_of(test: TimeSeries, rows: int) -> TimeSeries:
    """The test with each stamp moved up by a row (-1) or down (1). The row that has none then is left out."""
    kept, stamps = (slice(0, -1), slice(1, None)) if rows < 0 else (slice(1, None), slice(0, -1))
    return replace(test, t_s=test.t_s[stamps], y_rad=test.y_rad[kept], u_V=test.u_V[kept], even_s=None)


def _roughness(test: TimeSeries) -> float:
    """By how much the speed changes from row to row, on average, rad/s: within a bunch of stamps a shaft would race."""
    return float(np.mean(np.abs(np.diff(np.diff(test.y_rad) / np.diff(test.t_s)))))


def unfiltered(test: TimeSeries, lag_s: float, *, of_drive: bool = False) -> TimeSeries:
    """The series as its shaft moved, or as it was driven, behind a low pass of this time constant, s, >= 0.

    The first row is as it was.
    """
    if not lag_s > 0.0:
        return test
    column, left = test.u_V if of_drive else test.y_rad, np.exp(-np.diff(test.t_s) / lag_s)
    sharp = np.append(column[0], column[1:] + np.diff(column) * left / (1.0 - left))
    return replace(test, u_V=sharp) if of_drive else replace(test, y_rad=sharp)
