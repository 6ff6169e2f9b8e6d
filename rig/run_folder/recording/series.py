"""A time series: position and drive of one stretch of a recording, with the times at which the drive acts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.sample_columns import Reads
from rig.run_folder.recording.stage import Stage

STAIR_S = 5e-4  # of a drive that is ramped
FEWEST_ROWS = 20  # of a series that can be fitted
RECORD_MORE = "record more: three swings to and fro at least, better ten"
SHORTEST_WINDOW = 60  # samples
GRID_REACHES = (4.0, 16.0, 64.0)  # steps of the quantisation that are looked at together, one after the other
WALKS = (5.3, 2.9)  # a step of a sum of sampled velocities over the noise of its fourth differences; of means of rows
MOST_PARTS = 8  # steps of the quantisation that the smallest step of a record may be
LATENCY_PERIODS, LATENCY_S = 10.0, 0.2  # longest time from a sample to its row's drive: the longer of both

# A serial link and a driver take this long at any sampling rate. Used if the recording is at least 100 times as long.
LEAST_DELAY_S = 0.01
TIMES_ERROR_S = 1e-4  # default error of t_u_s against t_s: a converter's step, a PWM period, an interrupt
SEAM_PERIODS, SAME_PERIOD = 1.5, 0.01  # longest gap between two series that are one, and how their periods may differ
ALIKE = 0.8  # correlation of a drive with itself, a period later, from which on it counts as periodic
# No bench shows more or less in any unit. Squares and cubes within this range stay finite.
LARGEST, SMALLEST = 1e12, 1e-12


class Steps(NamedTuple):
    """A drive that is constant between edges: ``u_V[j]``, V, acts from ``edge_s[j]``, s. Both have m entries."""

    edge_s: Array
    u_V: Array

    def area_V_s(self, t_s: Array) -> Array:
        """Integral of the drive from the first edge to each of these times, V s; the first one acts before it, too."""
        area = np.concatenate(([0.0], np.cumsum(self.u_V[:-1] * np.diff(self.edge_s))))
        acts = np.maximum(np.searchsorted(self.edge_s, t_s, side="right") - 1, 0)
        return np.asarray(area[acts] + self.u_V[acts] * (t_s - self.edge_s[acts]))

    def ramped(self, slew_V_s: float) -> Steps:
        """The drive of a device that goes from each of these drives to the next at so many V/s, > 0.

        In stairs of 0.5 ms, each at its middle: the shaft is where it would be behind the ramp, to 1e-5 of its swing.
        """
        edges, drives, at_V = [self.edge_s[:1]], [self.u_V[:1]], float(self.u_V[0])
        ends = np.append(self.edge_s[1:], math.inf)
        for begin, end, wanted_V in zip(self.edge_s[1:], ends[1:], self.u_V[1:], strict=True):
            way_V = float(wanted_V) - at_V
            whole_s = abs(way_V) / slew_V_s
            takes_s = min(whole_s, float(end - begin))
            stairs = max(1, math.ceil(takes_s / STAIR_S))
            share = np.arange(stairs) / stairs
            reached_V = at_V + (way_V * takes_s / whole_s if whole_s > 0.0 else 0.0)
            edges.append(begin + takes_s * share)
            drives.append(at_V + (reached_V - at_V) * (share + 0.5 / stairs))
            if takes_s == whole_s:
                edges.append(np.array([begin + takes_s]))
                drives.append(np.array([wanted_V]))
            at_V = reached_V
        return steps_of(np.concatenate(edges), np.concatenate(drives))


@dataclass(frozen=True, eq=False)
class TimeSeries:
    """Position and drive over time: rows of a recording. Row k: y sampled at t_s; u acts from t_u_s to the next t_u_s.

    t_s        n times, s, increasing
    y_rad      n positions, rad
    t_u_s      n times at which each row's drive took effect, s; None if unknown: then u acts a constant delay after
               ``even_s``, between `earliest_delay_s` and `longest_delay_s`
    u_V        n drives, V, after saturation and quantisation
    first_row  number of the first row in its file
    name       its name in messages
    times_error_s  largest error of t_u_s against t_s, s, at least 0
    times_shift_s  by how much all of t_u_s may be off alike, s, at least 0
    stage      the stage of these rows; None if the file has no stages
    delay_s    what is known of that constant delay, s: least and most; None: nothing
    units_stated  whether somebody has said in which units these are: then a large number is no sign of a wrong one
    even_s     n times from which that delay counts: t_s, each later or earlier by as much as its drive was later or
               earlier than the mean; None: t_s
    reads      what shows the positions
    most_V     the largest drive that the bench gives, V; inf: not known
    edges      the drive as it was, where each row stands for several and u_V is their mean; None: u_V from row to row
    Raises IdentifyError on columns of unequal length, fewer than 2 rows, values that are not finite, values beyond
    1e12, a column whose values are all below 1e-12 and not all zero, times that do not increase, and drives that act
    far before or after their samples.
    """

    t_s: Array
    y_rad: Array
    t_u_s: Array | None
    u_V: Array
    first_row: int = 0
    name: str = "recording"
    times_error_s: float = TIMES_ERROR_S
    times_shift_s: float = 0.0
    stage: Stage | None = None
    delay_s: tuple[float, float] | None = None
    even_s: Array | None = None
    units_stated: bool = False
    edges: Steps | None = None
    reads: Reads = "angle"
    most_V: float = math.inf

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
                    "leave these rows out with --rows FIRST:LAST, or record again: `rig relay CONFIG`",
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

    @cached_property
    def period_s(self) -> float:
        """Sampling period: the median step of t_s, s."""
        return float(np.median(np.diff(self.t_s)))

    def with_unknown_delay(self, delay_s: tuple[float, float]) -> TimeSeries:
        """The same, but its drives act an unknown constant delay later, s: at least and at most.

        How they differ from their mean is kept, if their times are known.
        """
        if self.t_u_s is None:
            return replace(self, delay_s=delay_s)
        mean_s = float(np.mean(self.t_u_s - self.t_s))
        edges = None if self.edges is None else Steps(self.edges.edge_s - mean_s, self.edges.u_V)
        return replace(self, t_u_s=None, even_s=self.t_u_s - mean_s, delay_s=delay_s, edges=edges)

    @property
    def longest_delay_s(self) -> float:
        """Longest constant delay to look for if t_u_s is unknown, s: two periods, or 10 ms if that is more.

        Where the delay is bounded: a period more than the bound.
        """
        if self.delay_s is not None:
            return self.delay_s[1] + self.period_s
        return max(2.0 * self.period_s, min(LEAST_DELAY_S, 0.01 * float(self.t_s[-1] - self.t_s[0])))

    @property
    def earliest_delay_s(self) -> float:
        """Shortest delay to look for if t_u_s is unknown, s: a column that is off by a row is a period early."""
        return (0.0 if self.delay_s is None else self.delay_s[0]) - self.period_s

    @property
    def edge_s(self) -> Array:
        """Times from which each row's drive acts, s: t_u_s if known; else it acts a constant delay later."""
        if self.t_u_s is not None:
            return self.t_u_s
        return self.t_s if self.even_s is None else self.even_s

    def drive_period_s(self) -> float | None:
        """Period of a periodic drive, s: the first lag at which it is like itself again. None without a period."""
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

    @cached_property
    def steps(self) -> Steps:
        """The drive, without edges that change nothing."""
        return steps_of(self.edge_s, self.u_V) if self.edges is None else self.edges

    def part(self, first: int, stop: int) -> TimeSeries:
        """Rows ``first`` to ``stop`` (exclusive)."""
        cut = slice(first, stop)
        return replace(
            self,
            t_s=self.t_s[cut],
            y_rad=self.y_rad[cut],
            t_u_s=None if self.t_u_s is None else self.t_u_s[cut],
            even_s=None if self.even_s is None else self.even_s[cut],
            u_V=self.u_V[cut],
            first_row=self.first_row + first,
        )

    def followed_by(self, later: TimeSeries) -> TimeSeries | None:
        """Both as one; None where rows are missing between them, or where they differ in more than their rows."""
        alike = (
            later.first_row == self.first_row + len(self)
            and 0.0 < later.t_s[0] - self.t_s[-1] < SEAM_PERIODS * self.period_s
            and abs(later.period_s - self.period_s) < SAME_PERIOD * self.period_s
            and later.delay_s == self.delay_s
            and self.edges is None is later.edges
            and (self.t_u_s is None) is (later.t_u_s is None)
            and (self.even_s is None) is (later.even_s is None)
        )
        if not alike:
            return None

        def both(first: Array | None, second: Array | None) -> Array | None:
            return None if first is None or second is None else np.concatenate((first, second))

        t_u_s = both(self.t_u_s, later.t_u_s)
        return replace(
            self,
            t_s=np.concatenate((self.t_s, later.t_s)),
            y_rad=np.concatenate((self.y_rad, later.y_rad)),
            t_u_s=None if t_u_s is None else np.maximum.accumulate(t_u_s),  # each has a clock correction of its own
            even_s=both(self.even_s, later.even_s),
            u_V=np.concatenate((self.u_V, later.u_V)),
            times_error_s=max(self.times_error_s, later.times_error_s),
            times_shift_s=max(self.times_shift_s, later.times_shift_s),
        )

    def predictable(self, longest_delay_s: float) -> Window:
        """The samples whose drive is known: those after the first drive took effect, at most ``longest_delay_s`` late.

        Raises IdentifyError if there are fewer than twenty.
        """
        first = int(np.searchsorted(self.t_s, self.edge_s[0] + longest_delay_s))
        if self.t_s.size - first < FEWEST_ROWS:
            raise IdentifyError(f"{self.name}: {self.t_s.size} rows are too few to fit", RECORD_MORE)
        return Window(self, first, self.t_s.size)

    def resolution_rad(self) -> float:
        """Step between neighbouring distinct positions, rad; 0 if they do not look quantised.

        Positions count as quantised if most differences between sorted distinct values are near multiples of a
        smallest one.
        """
        return self._resolution_rad

    @cached_property
    def _resolution_rad(self) -> float:
        steps = np.diff(np.unique(np.round(self.y_rad, 12)))
        steps = steps[steps > 1e-9]
        if steps.size < 3:
            return float(steps.min()) if steps.size else 0.0
        least = float(np.median(steps[steps < 1.5 * steps.min()]))
        # a fast shaft never shows a single step; a few positions fit some grid by chance
        for parts in range(1, MOST_PARTS + 1 if steps.size >= FEWEST_ROWS else 2):
            lsb = least / parts
            for reach in GRID_REACHES:  # a file rounds its positions: a wide step shows the smallest one better
                near = steps[steps < max(reach, 2.0 * parts) * lsb]
                count = np.round(near / lsb)
                lsb = float(near @ count / (count @ count))
            ratio = steps / lsb
            if float(np.mean(np.abs(ratio - np.round(ratio)) < 0.1)) > 0.9:
                return lsb
        return 0.0

    def noise_rad(self) -> float:
        """Standard deviation of white noise on the position, rad; at least that of the quantisation.

        It comes from fourth divided differences: motion almost vanishes in them, at any spacing of the samples. The
        median leaves out jumps of acceleration.
        """
        return self._noise_rad

    def noise_over_rad(self, rows: int) -> float:
        """RMS of what noise leaves of so many rows, rad, where a motor's start is fitted to them.

        Noise that adds up is a walk at random. Without its mean and its trend a walk of n steps of s has a variance of
        s^2 n/15, without its mean alone s^2 n/6: a motor's start is between them.
        """
        return math.hypot(self.noise_rad(), self.strays_rad(rows))

    def strays_rad(self, rows: int) -> float:
        """The same of noise that adds up alone."""
        return self.walk_rad() * math.sqrt(0.1 * rows)

    def walk_rad(self) -> float:
        """By how much noise that adds up moves the position from row to row, RMS, rad; 0 where it does not."""
        return WALKS[self.edges is not None] * self.noise_rad() if self.reads == "samples" else 0.0

    @cached_property
    def _noise_rad(self) -> float:
        scatter = 0.0
        if len(self) >= 5:
            each = np.lib.stride_tricks.sliding_window_view
            t, y = list(each(self.t_s / self.period_s, 5).T), each(self.y_rad, 5).T
            weights = [1.0 / math.prod(own - other for other in t if other is not own) for own in t]
            differences = sum(w * one for w, one in zip(weights, y, strict=True)) / np.sqrt(sum(w * w for w in weights))
            scatter = 1.4826 * float(np.median(np.abs(differences)))
        return float(max(scatter, self.resolution_rad() / np.sqrt(12.0)))


@dataclass(frozen=True, eq=False)
class Window:
    """Samples ``first`` to ``stop`` (exclusive) of a series. Their motion has an initial state of its own.

    The drive is the drive of the whole series, because the drive at the first sample was set before it.
    """

    series: TimeSeries
    first: int
    stop: int

    @cached_property
    def t_s(self) -> Array:
        """Times of its samples, s."""
        return self.series.t_s[self.first : self.stop]

    @cached_property
    def y_rad(self) -> Array:
        """Positions at these times, rad."""
        return self.series.y_rad[self.first : self.stop]

    @property
    def steps(self) -> Steps:
        """The drive of the whole series."""
        return self.series.steps

    @property
    def period_s(self) -> float:
        """Sampling period of the series, s."""
        return self.series.period_s

    @property
    def duration_s(self) -> float:
        """Time from its first sample to its last, s."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def rows(self) -> tuple[int, int]:
        """First and last row in the file."""
        return self.series.first_row + self.first, self.series.first_row + self.stop - 1

    def until(self, length_s: float) -> Window:
        """Its first ``length_s`` seconds, but at least 60 samples."""
        count = max(SHORTEST_WINDOW, int(np.searchsorted(self.t_s, self.t_s[0] + length_s, side="right")))
        return self if self.first + count >= self.stop else replace(self, stop=self.first + count)


def noise_of_all_rad(tests: Sequence[TimeSeries]) -> float:
    """Root mean square of the white noise on their positions, rad; as ``TimeSeries.noise_rad``."""
    return math.sqrt(sum(test.noise_rad() ** 2 for test in tests) / len(tests))


def delays_of_all_s(tests: Sequence[TimeSeries]) -> tuple[float, float]:
    """Bounds of one delay that any of them may have, s."""
    return min(test.earliest_delay_s for test in tests), max(test.longest_delay_s for test in tests)


def joined_times_s(windows: Iterable[Window]) -> Array:
    """Times of the samples of all windows, one window after the other, s."""
    return np.concatenate([window.t_s for window in windows])


def spread_rad(windows: Iterable[Window]) -> float:
    """Standard deviation of the positions about the mean of each window, rad."""
    return float(np.std(np.concatenate([window.y_rad - window.y_rad.mean() for window in windows])))


def steps_of(edge_s: Array, u_V: Array) -> Steps:
    """Edges (non-decreasing, s) and drives (V) as steps, without edges that change nothing.

    Raises ValueError if the edges decrease, if shapes differ, or if there are no edges.
    """
    if edge_s.shape != u_V.shape or edge_s.ndim != 1 or edge_s.size == 0:
        raise ValueError("edges and drives must be one-dimensional and of one length")
    if np.any(np.diff(edge_s) < 0.0):
        raise ValueError("the times at which the drive acts must not decrease")
    keep = np.concatenate(([True], u_V[1:] != u_V[:-1]))
    return Steps(np.asarray(edge_s[keep], dtype=float), np.asarray(u_V[keep], dtype=float))
