"""What estimators read: times, positions and drives of one stretch of recording, cut loose from run folders."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.errors import RigError
from rig.recording.reader import Recording

Array = NDArray[np.float64]

FEWEST_ROWS = 20  # that anything can be read from
LATENCY_PERIODS, LATENCY_S = 10.0, 0.1  # between a sample and its row's drive, at most the longer of both

LEAST_DELAY_S = (
    0.01  # a serial link and a driver take as much, however fast the samples (of a record 100 times as long)
)
TIMES_ERROR_S = 1e-4  # by which times may be wrong where nobody says: a converter's step, a PWM period, an interrupt
ALIKE = 0.8  # correlation of a drive with itself, later, that makes it periodic
# No bench shows more or less in any unit, and squares and cubes of what lies between are numbers.
LARGEST, SMALLEST = 1e12, 1e-12


class IdentifyError(RigError):
    """A recording that cannot be identified: one line of cause, one of cure."""

    def __init__(self, cause: str, cure: str) -> None:
        self.cause = cause
        self.cure = cure
        super().__init__(f"{cause}\n{cure}")


@dataclass(frozen=True)
class Record:
    """Rows of a recording. Row k: y sampled at t_s; u acts from t_u_s until the next row's t_u_s.

    t_s        n times, s, increasing
    y_rad      n positions, rad
    t_u_s      n times at which each row's drive took effect, s; None if unknown (then u acts from t_s plus a constant
               delay, at most `longest_delay_s`)
    u_V        n drives, V, after saturation and quantisation
    first_row  index of row 0 in the file it comes from
    name       what to call it in a message
    times_error_s  by how much t_u_s may be wrong against t_s, s, at least 0: by so little beside it the drive may act
    Raises IdentifyError on columns of unequal length, fewer than 2 rows, values that are not finite or that no bench
    shows (beyond 1e12, or a whole column within 1e-12 of zero that is not zero), times that do not increase, or drives
    that act far before or after their samples.
    """

    t_s: Array
    y_rad: Array
    t_u_s: Array | None
    u_V: Array
    first_row: int = 0
    name: str = "recording"
    times_error_s: float = TIMES_ERROR_S

    def __post_init__(self) -> None:
        columns = {"t_s": self.t_s, "y_rad": self.y_rad, "u_V": self.u_V}
        if self.t_u_s is not None:
            columns["t_u_s"] = self.t_u_s
        for key, column in columns.items():
            if column.ndim != 1 or column.size != self.t_s.size:
                raise IdentifyError(
                    f"{self.name}: column {key} has {column.size} values where t_s has {self.t_s.size}",
                    "every column needs one value a row",
                )
            bad = np.flatnonzero(~np.isfinite(column))
            if bad.size:
                raise IdentifyError(
                    f"{self.name}: {key} is not a number in row {self.first_row + int(bad[0])}"
                    + (f" and {bad.size - 1} more" if bad.size > 1 else ""),
                    "leave these rows out, by --rows FIRST:LAST, or record again: `rig relay CONFIG`",
                )
            largest = float(np.abs(column).max(initial=0.0))
            if largest > LARGEST or 0.0 < largest < SMALLEST:
                raise IdentifyError(
                    f"{self.name}: {key} reaches {largest:.3g}, which no bench shows",
                    "give t_s in seconds, u_V in volts and y_rad in radians, and see that each is in its own column",
                )
        if self.t_s.size < 2:
            raise IdentifyError(
                f"{self.name}: {self.t_s.size} rows are too few", "record at least ten cycles: relay.cycles"
            )
        back = np.flatnonzero(np.diff(self.t_s) <= 0.0)
        if back.size:
            raise IdentifyError(
                f"{self.name}: t_s does not increase at row {self.first_row + int(back[0]) + 1}",
                "t_s must be the time of each sample in seconds; sort the rows and drop doubled ones",
            )
        if self.t_u_s is not None:
            back = np.flatnonzero(np.diff(self.t_u_s) < 0.0)
            if back.size:
                raise IdentifyError(
                    f"{self.name}: t_u_s decreases at row {self.first_row + int(back[0]) + 1}",
                    "t_u_s must be the time at which each row's drive took effect; leave the column out if unknown",
                )
            latency = float(np.median(self.t_u_s - self.t_s))
            if abs(latency) > max(LATENCY_PERIODS * self.period_s, LATENCY_S):
                raise IdentifyError(
                    f"{self.name}: t_u_s is {latency:.3g} s beyond t_s, where samples are {self.period_s:.3g} s apart",
                    "give both in seconds on one clock, or leave t_u_s out",
                )

    def __len__(self) -> int:
        return int(self.t_s.size)

    @property
    def period_s(self) -> float:
        """Sampling period: the median step of t_s, s."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def longest_delay_s(self) -> float:
        """Longest constant delay looked for where t_u_s is unknown, s: two periods, or 10 ms if that is more."""
        return max(2.0 * self.period_s, min(LEAST_DELAY_S, 0.01 * float(self.t_s[-1] - self.t_s[0])))

    @property
    def edge_s(self) -> Array:
        """Times from which each row's drive acts, as far as they are known: t_u_s, else t_s."""
        return self.t_s if self.t_u_s is None else self.t_u_s

    def drive_period_s(self) -> float | None:
        """Period with which the drive repeats itself, s: the first lag at which it is like itself again; else None."""
        count = min(8192, 4 * self.t_s.size)
        even = np.linspace(self.t_s[0], self.t_s[-1], count)
        u = self.u_V[np.searchsorted(self.t_s, even, side="right") - 1]
        u = u - u.mean()
        power = np.abs(np.fft.rfft(u, 2 * count)) ** 2
        alike = np.fft.irfft(power)[:count] * (count / np.arange(count, 0, -1))
        if alike[0] <= 0.0:
            return None
        alike = alike[: count // 2] / alike[0]
        apart = np.flatnonzero(alike < 0.0)
        if apart.size == 0:
            return None
        again = np.flatnonzero(alike[apart[0] :] > ALIKE) + apart[0]
        if again.size == 0:
            return None
        first_run = again[: int(np.argmax(np.append(np.diff(again), 2) > 1)) + 1]
        lag = int(first_run[np.argmax(alike[first_run])])
        return float(even[lag] - even[0])

    def part(self, first: int, stop: int) -> Record:
        """Rows ``first`` to ``stop`` (exclusive)."""
        cut = slice(first, stop)
        times = None if self.t_u_s is None else self.t_u_s[cut]
        return Record(
            self.t_s[cut],
            self.y_rad[cut],
            times,
            self.u_V[cut],
            self.first_row + first,
            self.name,
            self.times_error_s,
        )

    def resolution_rad(self) -> float:
        """Step between neighbouring distinct positions, rad; 0 if they do not look quantised.

        Positions are taken for quantised if most differences between sorted distinct values are near multiples of
        the smallest common one.
        """
        steps = np.diff(np.unique(np.round(self.y_rad, 12)))
        steps = steps[steps > 1e-9]
        if steps.size < 3:
            return float(steps.min()) if steps.size else 0.0
        lsb = float(np.median(steps[steps < 1.5 * steps.min()]))
        ratio = steps / lsb
        return lsb if float(np.mean(np.abs(ratio - np.round(ratio)) < 0.1)) > 0.9 else 0.0

    def noise_rad(self) -> float:
        """Standard deviation of white noise on the position, rad, at least that of its quantisation.

        From fourth divided differences, in which motion all but vanishes however the samples are spaced; their median,
        so that jumps of acceleration do not count.
        """
        return self._noise_rad

    @cached_property
    def _noise_rad(self) -> float:
        scatter = 0.0
        if len(self) >= 5:
            t = np.lib.stride_tricks.sliding_window_view(self.t_s, 5)
            y = np.lib.stride_tricks.sliding_window_view(self.y_rad, 5)
            apart = (t[:, :, None] - t[:, None, :]) / self.period_s
            apart[:, range(5), range(5)] = 1.0
            weights = 1.0 / apart.prod(axis=2)
            differences = np.sum(weights * y, axis=1) / np.linalg.norm(weights, axis=1)
            scatter = 1.4826 * float(np.median(np.abs(differences)))
        return float(max(scatter, self.resolution_rad() / np.sqrt(12.0)))


@dataclass(frozen=True)
class ClockRatio:
    """Ratio of a recording's times to the host's, and its standard error."""

    ratio: float
    error: float

    @property
    def significant(self) -> bool:
        """Whether it differs from 1 beyond four standard errors and 20 ppm."""
        return abs(self.ratio - 1.0) > max(4.0 * self.error, 20e-6)


def clock_ratio(recording: Recording) -> ClockRatio | None:
    """Regress t_s on the host's time of each tick (tick * period + lateness); None where that is not recorded."""
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


def from_recording(recording: Recording, rows: slice, name: str) -> tuple[Record, list[str]]:
    """Rows of a recording as a ``Record``, and notes on what was done to the times.

    Times are divided by the clock ratio over the whole run where that is significant. Rows before the first known t_u_s
    are dropped; a t_u_s missing between others is filled in with the median latency. Raises IdentifyError,
    also for fewer than twenty rows.
    """
    first, stop, _ = rows.indices(len(recording))
    if stop - first < FEWEST_ROWS:
        raise IdentifyError(
            f"{name}: {max(0, stop - first)} rows are too few to fit",
            "record at least three cycles, better ten: relay.cycles",
        )
    notes: list[str] = []
    scale = 1.0
    clock = clock_ratio(recording)
    if clock is not None and clock.significant:
        if abs(clock.ratio - 1.0) > 0.03:
            raise IdentifyError(
                f"{name}: t_s runs {100.0 * (clock.ratio - 1.0):+.1f} % against the ticks and period_s of meta.json",
                "correct the times; a clock is a few per cent off at most",
            )
        scale = clock.ratio
        notes.append(f"{name}: times divided by the clock ratio over the run, {scale:.6f} +- {clock.error:.6f}")
    first += recording.first_row
    t_s = recording.t_s[rows] / scale
    t_u_s = recording.t_u_s[rows] / scale
    y_rad, u_V = recording.y_rad[rows], recording.u_V[rows]
    known = np.isfinite(t_u_s)
    if not known.any():
        return Record(t_s, y_rad, None, u_V, first, name), notes
    start = int(np.flatnonzero(known)[0])
    missing = int((~known[start:]).sum())
    if missing > 0.2 * t_s.size:
        notes.append(f"{name}: t_u_s is missing in {missing} rows and was not used")
        return Record(t_s, y_rad, None, u_V, first, name), notes
    latency = float(np.median((t_u_s - t_s)[known]))
    filled = np.where(known, t_u_s, t_s + latency)[start:]
    if missing:
        notes.append(
            f"{name}: t_u_s missing in {missing} rows, filled in with the median latency of {1e3 * latency:.2f} ms"
        )
        filled = np.maximum.accumulate(filled)
    error_s = _times_error_s(recording)
    return Record(t_s[start:], y_rad[start:], filled, u_V[start:], first + start, name, error_s), notes


def _times_error_s(recording: Recording) -> float:
    """What meta.json says that the times may be wrong by; a CSV file and a run of an older version say nothing."""
    said = recording.meta.times_error_s
    return TIMES_ERROR_S if said is None or said < 0.0 else said
