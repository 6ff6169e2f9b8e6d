"""Tests in pieces: each with a start of its own, so that what the model leaves out cannot add up over the whole record.

Over a long test a departure that is left out moves the model's motion away from the recorded one, and a fit falls into
false minima. Over a piece of a cycle or so it cannot. A random force (process noise) adds up in the same way: so the
pieces that a motor bears say how random it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array, Rows
from rig.identification.departures.departure import Bench
from rig.identification.motions import Motion, fitted_rows, repeats
from rig.identification.noise import Noise, noise_of
from rig.model.compiled.real_motion import Windows
from rig.model.compiled.row_filter import filtered
from rig.model.real_motor import Frame, Readings, RealMotor, readings_of, windows_of
from rig.run_folder.recording.series import TimeSeries, Window

FEWEST_ROWS = 12  # of a piece
NEAR_ROWS = 4  # rows on either side that show a piece's start
SMALL_DRIVE, SAME_DRIVE, MOST_DRIVES = 0.1, 1e-3, 6  # of the largest drive; and how many of the small ones
VELOCITY_SHOWN = 0.1  # share of a piece's duration in which its start's velocity is taken to show at least
TAIL = 1e-3  # share of the samples on either side that may lie beyond the driven travel: noise
STILL = 1e6  # times the longest window: in so long a course a window is an instant
TURNED_BACK = 0.01  # of the whole motion: so little is noise of the sensor
BENT_WITHIN = 0.02  # of the largest speed: bristles of a faster shaft are bent fully


class Coupling(NamedTuple):
    """A soft coupling between the shaft and what the sensor shows: its frequency, rad/s, and its damping ratio."""

    rad_s: float
    damping: float


@dataclass(frozen=True, eq=False)
class Cut:
    """Tests cut into pieces.

    windows   the tests' rows with a known drive
    frames    for each, what parts over position and time refer to
    rows      for each, the first rows of its pieces; the first one is 0
    most_s    for each, the longest that its pieces may be, s
    resting   (p,) whether each piece begins with no speed; None: its speed there is fitted
    weight    (n,) of each row, 0 where it does not count, else 1; None: every row counts
    of        for each window the name of its recording; empty: nobody said
    coupling  between the shaft and what the sensor shows; None: it is stiff
    """

    windows: tuple[Window, ...]
    frames: tuple[Frame, ...]
    rows: tuple[Rows, ...]
    most_s: tuple[float, ...]
    resting: NDArray[np.bool_] | None = None
    weight: Array | None = None
    of: tuple[str, ...] = ()
    coupling: Coupling | None = None

    @classmethod
    def whole(cls, tests: Sequence[TimeSeries], longest_delay_s: float, of: Sequence[str] = ()) -> Cut:
        """Each test as one piece; ``of``: the name of each one's recording. Raises IdentifyError: one is too short."""
        windows = tuple(test.predictable(longest_delay_s) for test in tests)
        y = np.concatenate([window.y_rad for window in windows])
        low, high = np.quantile(y, [TAIL, 1.0 - TAIL])
        half = max(0.5 * float(high - low), 1e-9)
        begins = [float(window.t_s[0]) for window in windows]
        ends = [float(window.t_s[-1]) for window in windows]
        in_one_run = all(b >= e for b, e in zip(begins[1:], ends, strict=False))
        span = ends[-1] - begins[0] if in_one_run else sum(e - b for b, e in zip(begins, ends, strict=True))
        before = 0.0
        frames = []
        for begin, end in zip(begins, ends, strict=True):
            start = begins[0] if in_one_run else begin - before
            before += end - begin
            frames.append(Frame(0.5 * float(low + high), half, start, max(span, 1e-9)))
        whole_ones = tuple(np.zeros(1, dtype=np.int64) for _ in windows)
        return cls(windows, _centred(windows, frames), whole_ones, tuple(math.inf for _ in windows), of=tuple(of))

    @classmethod
    def of_windows(cls, windows: Sequence[Window]) -> Cut:
        """Each window as one piece, for a motor that has no parts over position and time."""
        ones = tuple(np.zeros(1, dtype=np.int64) for _ in windows)
        return cls(tuple(windows), tuple(Frame() for _ in windows), ones, tuple(math.inf for _ in windows))

    def rests_once(self) -> Cut:
        """The same, with each rest behind a sensor without noise as one chance; the same cut where there is none."""
        repeated = np.concatenate([repeats(window) for window in self.windows])
        return replace(self, weight=np.where(repeated, 0.0, 1.0)) if repeated.any() else self

    def each(self, of: Sequence[str]) -> Cut:
        """The same, with a course of time of its own for each recording; ``of``: for each window its recording."""
        begins = {name: min(w.t_s[0] for w, own in zip(self.windows, of, strict=True) if own == name) for name in of}
        ends = {name: max(w.t_s[-1] for w, own in zip(self.windows, of, strict=True) if own == name) for name in of}
        frames = tuple(
            frame._replace(start_s=float(begins[name]), duration_s=max(float(ends[name] - begins[name]), 1e-9))
            for frame, name in zip(self.frames, of, strict=True)
        )
        return replace(self, frames=frames)

    def with_levels(self, level: Mapping[str, float], of: Sequence[str]) -> Cut:
        """The same, with a friction that stays as it is in each recording: a drift of 1 is the largest of the levels.

        level   by recording how much more friction it has than all together, relative
        of      for each window its recording
        """
        largest = max(max(map(abs, level.values())), 1e-9)
        long_s = STILL * max(window.duration_s for window in self.windows)
        frames = []
        for frame, window, name in zip(self.frames, self.windows, of, strict=True):
            middle_s = 0.5 * float(window.t_s[0] + window.t_s[-1])
            frames.append(frame._replace(start_s=middle_s - (0.5 + level[name] / largest) * long_s, duration_s=long_s))
        return replace(self, frames=tuple(frames))

    def beside(self, further: Sequence[tuple[TimeSeries, int]], longest_delay_s: float, most_s: float) -> Cut:
        """The same tests, and behind them further records in pieces of at most ``most_s``.

        further   each with the number of the test whose time and travel it is measured in
        Raises IdentifyError if one is too short.
        """
        windows = tuple(series.predictable(longest_delay_s) for series, _ in further)
        frames = [*self.frames, *(self.frames[number] for _, number in further)]
        every = replace(
            self,
            windows=self.windows + windows,
            frames=_centred(self.windows + windows, frames),
            rows=self.rows + tuple(_first_rows(window, most_s) for window in windows),
            most_s=self.most_s + tuple(most_s for _ in windows),
            resting=None,
            weight=None,
            of=() if further else self.of,
        )
        return every if self.weight is None else every.rests_once()

    @classmethod
    def of_motions(cls, windows: Sequence[Window], frames: Sequence[Frame], found: Sequence[Sequence[Motion]]) -> Cut:
        """The motions of each window as pieces; rows at rest do not count."""
        pieces = [fitted_rows(each, window.t_s.size) for window, each in zip(windows, found, strict=True)]
        return cls(
            tuple(windows),
            tuple(frames),
            tuple(rows for rows, _, _ in pieces),
            tuple(math.inf for _ in windows),
            np.concatenate([resting for _, resting, _ in pieces]),
            np.concatenate([weight for _, _, weight in pieces]),
        )

    def joined(self, of: Sequence[str]) -> Cut:
        """The same rows with as few pieces as can be: a stage's end is no rest, so what follows it has no new start.

        of   for each window the name of its recording
        Each window is one piece, in the frame of its first record.
        """
        order = sorted(range(len(self.windows)), key=lambda k: (of[k], self.windows[k].series.first_row))
        windows: list[Window] = []
        frames: list[Frame] = []
        for k, before in zip(order, [None, *order], strict=False):
            window, last = self.windows[k], windows[-1] if windows else None
            follows = last is not None and before is not None and of[before] == of[k]
            one = last.series.followed_by(window.series) if follows and last is not None else None
            if one is None or last is None:
                windows.append(window)
                frames.append(self.frames[k])
            else:
                windows[-1] = Window(one, last.first, len(one))
        ones = tuple(np.zeros(1, dtype=np.int64) for _ in windows)
        endless = tuple(math.inf for _ in windows)
        every = Cut(tuple(windows), tuple(frames), ones, endless, coupling=self.coupling)
        return every if self.weight is None else every.rests_once()

    def every(self, length_s: float) -> Cut:
        """The same tests in pieces of about ``length_s``, each of at least 12 rows."""
        rows = (_first_rows(w, min(length_s, most_s)) for w, most_s in zip(self.windows, self.most_s, strict=True))
        return replace(self, rows=tuple(rows), resting=None)

    def only(self, chosen: NDArray[np.bool_]) -> Cut:
        """Some of its pieces, each as a window of its own; ``chosen``: (p,), at least one. Rows count as they do."""
        every = [
            (Window(window.series, window.first + first, window.first + stop), frame, most_s)
            for window, frame, rows, most_s in zip(self.windows, self.frames, self.rows, self.most_s, strict=True)
            for first, stop in pairwise([*rows.tolist(), window.t_s.size])
        ]
        windows, frames, most_s = zip(*(one for one, is_one in zip(every, chosen, strict=True) if is_one), strict=True)
        return Cut(
            windows,
            frames,
            tuple(np.zeros(1, dtype=np.int64) for _ in windows),
            most_s,
            None if self.resting is None else self.resting[chosen],
            None if self.weight is None else self.weight[chosen[self.piece]],
            coupling=self.coupling,
        )

    @cached_property
    def t_s(self) -> Array:
        """Times of all rows, s."""
        return np.concatenate([window.t_s for window in self.windows])

    @cached_property
    def y_rad(self) -> Array:
        """Positions of all rows, rad."""
        return np.concatenate([window.y_rad for window in self.windows])

    @cached_property
    def begins(self) -> Rows:
        """First row of each piece among all rows."""
        offset = np.cumsum([0, *(window.t_s.size for window in self.windows[:-1])])
        return np.concatenate([rows + at for rows, at in zip(self.rows, offset, strict=True)]).astype(np.int64)

    @cached_property
    def lengths(self) -> list[int]:
        """Number of rows of each piece."""
        return [int(n) for n in np.diff(np.append(self.begins, self.t_s.size))]

    @cached_property
    def piece(self) -> Rows:
        """For each row the number of its piece."""
        return np.repeat(np.arange(self.begins.size), self.lengths)

    @cached_property
    def adds_up(self) -> Array:
        """(p,) by how much noise leaves more of each piece than of a row alone, 1: more than 1 where it adds up."""
        of = np.repeat(np.arange(len(self.windows)), [rows.size for rows in self.rows])
        series = [window.series for window in self.windows]
        each = [
            series[k].noise_over_rad(n) / max(series[k].noise_rad(), 1e-300) if series[k].reads == "samples" else 1.0
            for k, n in zip(of.tolist(), self.lengths, strict=True)
        ]
        return np.array(each)

    @cached_property
    def durations_s(self) -> Array:
        """Length of each piece, s."""
        last = np.append(self.begins[1:], self.t_s.size) - 1
        return np.asarray(self.t_s[last] - self.t_s[self.begins])

    @cached_property
    def shown_s2(self) -> Array:
        """Square of the time in which the velocity of a piece's start is taken to show at least, s^2."""
        return np.asarray((VELOCITY_SHOWN * self.durations_s) ** 2)

    @cached_property
    def freedom(self) -> int:
        """Rows that count, less the fitted numbers of the starts of pieces that have any."""
        if self.weight is None:
            return int(self.t_s.size - 2 * self.begins.size)
        counts = np.add.reduceat(self.weight, self.begins) > 0.0
        speeds = counts if self.resting is None else counts & ~self.resting
        return int(np.count_nonzero(self.weight) - np.count_nonzero(counts) - np.count_nonzero(speeds))

    def noise_of(self, residual_rad: Array) -> Noise:
        """The most likely noise of a residual, (n,), rad, in the rows that count."""
        if self.weight is None:
            return noise_of(residual_rad, self.t_s, self.lengths)
        residual_rad, t_s, lengths = self.counting(residual_rad), self.counting(self.t_s), self.counting_lengths
        return noise_of(residual_rad, t_s, lengths, self.windows[0].period_s)

    def counting(self, rows: Array) -> Array:
        """Those of ``rows``, (n,) or (n, k), that count."""
        return rows if self.weight is None else rows[self.weight > 0.0]

    @cached_property
    def counting_lengths(self) -> list[int]:
        """Number of rows that count of each piece that has any."""
        if self.weight is None:
            return self.lengths
        return [int(n) for n in np.add.reduceat(self.weight, self.begins) if n]

    @property
    def longest_s(self) -> float:
        """Length of the longest piece, s."""
        return float(np.max(self.durations_s))

    def bench(self, motor: RealMotor, linearity_rad: float) -> Bench:
        """Sizes of this motor and record."""
        speeds = np.abs(self.guessed()[:, 0])
        largest_V = max(float(np.abs(window.steps.u_V).max()) for window in self.windows)
        full_V = max(window.series.most_V for window in self.windows)
        return Bench(
            motor.K_rad_s_V,
            motor.fc_V,
            largest_V,
            max(float(np.quantile(speeds, 0.95)), 1e-9),
            self.frames[0].half_travel_rad,
            linearity_rad,
            float(np.mean(np.concatenate([np.abs(np.diff(window.y_rad)) for window in self.windows]))),
            self._small_drives(),
            all(_goes_along(window) for window in self.windows),
            motor.delay_s,
            motor.tau_s,
            full_V if math.isfinite(full_V) else largest_V,
        )

    def _small_drives(self) -> tuple[float, ...]:
        """Sizes of the drives below a tenth of the largest, V: each one of a few, and of many some of all sizes."""
        drives = np.concatenate([np.abs(window.steps.u_V) for window in self.windows])
        largest = float(drives.max())
        grid = SAME_DRIVE * largest
        small = np.unique(np.round(drives[(drives > 0.0) & (drives < SMALL_DRIVE * largest)] / grid)) * grid
        if small.size > MOST_DRIVES:
            small = np.quantile(small, np.linspace(0.0, 1.0, MOST_DRIVES))
        return tuple(small[small > 0.0].tolist())

    def guessed(self) -> Array:
        """(p, 2) velocity, rad/s, and position, rad, at each start, by a parabola through the rows around it."""
        starts = np.concatenate(
            [_near(window.t_s, window.y_rad, rows) for window, rows in zip(self.windows, self.rows, strict=True)]
        )
        if self.resting is not None:
            starts[self.resting, 0] = 0.0
        return starts

    def readings(self, motor: RealMotor, starts: Array) -> Array:
        """Predicted readings of all rows, rad; ``starts`` is (p, 2) as ``guessed``."""
        y_rad = readings_of(motor, self._records, self._begins(starts)).y_rad
        if self.coupling is None:
            return y_rad
        return y_rad - self.swing(self.coupling, y_rad[:, None], starts[:, None, :], 1)[:, 0]

    def derivatives(
        self, motor: RealMotor, starts: Array, free: Sequence[int], waves_per_rad: Sequence[float] = ()
    ) -> Readings:
        """Predicted readings of all rows, rad, with their derivatives by the numbers ``free`` and the starts.

        waves_per_rad   as of ``rig.model.real_motor.readings_of``
        """
        found = readings_of(motor, self._records, self._begins(starts), free, waves_per_rad)
        if self.coupling is None:
            return found
        every = np.column_stack(found)
        begin = np.zeros((starts.shape[0], every.shape[1], 2))  # velocity and position at the start, by column
        begin[:, 0], begin[:, -2, 0], begin[:, -1, 1] = starts, 1.0, 1.0
        every = every - self.swing(self.coupling, every, begin, every.shape[1] - 2)
        return Readings(every[:, 0], np.ascontiguousarray(every[:, 1:-2]), np.ascontiguousarray(every[:, -2:]))

    def swing(self, coupling: Coupling, columns: Array, begin: Array, goes_on: int) -> Array:
        """(n, k) by how much a load behind the coupling is ahead of what follows it stiffly, for (n, k) ``columns``.

        begin     (p, k, 2) velocity and position of each column at the start of each piece
        goes_on   how many of the columns swing on from piece to piece: not those by the start of the own piece
        """
        since_s = self.t_s - self.t_s[self.begins][self.piece]
        accelerated = columns - begin[self.piece, :, 1] - begin[self.piece, :, 0] * since_s[:, None]
        found, at = [], 0
        for window, rows in zip(self.windows, self.rows, strict=True):
            swing = filtered(*_swings(coupling, window.period_s), accelerated[at : at + window.t_s.size], rows)
            for first, stop in pairwise([*rows.tolist(), window.t_s.size]):
                if first > 1:
                    before, last = swing[first - 2, :goes_on], swing[first - 1, :goes_on]
                    step_s = float(window.t_s[first - 1] - window.t_s[first - 2])
                    after_s = (window.t_s[first:stop] - window.t_s[first - 1])[:, None]
                    swing[first:stop, :goes_on] += _dies_away(coupling, after_s, last, (last - before) / step_s)
            found.append(swing)
            at += window.t_s.size
        return np.concatenate(found)

    @cached_property
    def _records(self) -> Windows:
        each = zip(self.windows, self.frames, self.rows, strict=True)
        return windows_of([(frame, window.steps, window.t_s, rows) for window, frame, rows in each])

    @staticmethod
    def _begins(starts: Array) -> Array:
        """(p, 4) the starts, with the play on the side of the motion, and bristles bent where it is fast."""
        begins = np.empty((starts.shape[0], 4))
        v0 = starts[:, 0]
        speed = np.abs(v0)
        begins[:, :2], begins[:, 2] = starts, np.sign(v0)
        begins[:, 3] = begins[:, 2] * (speed > BENT_WITHIN * max(float(speed.max()), 1e-9))
        return begins


def _near(t_s: Array, y_rad: Array, rows: Rows) -> Array:
    """(p, 2) slope and value at each of the ``rows``, of the parabola through the rows around it that there are."""
    near = rows[:, None] + np.arange(-NEAR_ROWS, NEAR_ROWS + 1)
    here = (near >= 0) & (near < t_s.size)
    near = np.clip(near, 0, t_s.size - 1)
    since = np.where(here, t_s[near] - t_s[rows][:, None], 0.0)
    value, slope, _ = parabolas(since, y_rad[near] - y_rad[rows][:, None], here)
    return np.column_stack((slope, value + y_rad[rows]))


def parabolas(t_s: Array, y: Array, counts: NDArray[np.bool_] | None = None) -> tuple[Array, Array, Array]:
    """(p,) value, slope and curve, y = value + slope t + curve t^2, of the parabola through each of p rows of points.

    t_s, y   (p, k); y of any unit
    counts   (p, k) which points there are; None: all
    """
    span = np.abs(t_s).max(axis=1)
    x = t_s / span[:, None]
    columns = np.stack((np.ones_like(x), x, x * x), axis=2)
    if counts is not None:
        columns *= counts[:, :, None]
    ways = columns.transpose(0, 2, 1)
    value, slope, curve = np.linalg.solve(ways @ columns, ways @ y[:, :, None])[:, :, 0].T
    return value, slope / span, curve / span**2


def _centred(windows: Sequence[Window], frames: Sequence[Frame]) -> tuple[Frame, ...]:
    """The frames with the mean time of the record as the middle of their course: f_c is the mean over it.

    By time, not by rows: several rows of a long window may be taken as one.
    """
    since_s = [float(np.mean(window.t_s)) - frame.start_s for window, frame in zip(windows, frames, strict=True)]
    mean_s = float(np.average(since_s, weights=[window.duration_s for window in windows]))
    later_s = mean_s - 0.5 * frames[0].duration_s
    return tuple(frame._replace(start_s=frame.start_s + later_s) for frame in frames)


def _goes_along(window: Window) -> bool:
    """Whether the drive, from its first push on, always pushes the one way that the shaft turns."""
    way = 1.0 if window.y_rad[-1] > window.y_rad[0] else -1.0
    u_V, y_rad = way * window.steps.u_V, way * window.y_rad
    least_V = SAME_DRIVE * float(np.abs(u_V).max())  # a drive that was measured has an offset at rest
    pushes = np.flatnonzero(np.abs(u_V) > least_V)
    back_rad = float(np.max(np.maximum.accumulate(y_rad) - y_rad))
    return bool(pushes.size and np.all(u_V[pushes[0] :] > least_V) and back_rad < TURNED_BACK * float(np.ptp(y_rad)))


def _swings(coupling: Coupling, period_s: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The filter d'' + 2 z w d' + w^2 d = x'' from rows of x, taken as straight between them: forward and back."""
    rad_s, damping = coupling
    fast = rad_s * math.sqrt(1.0 - damping**2)
    decay = math.exp(-damping * rad_s * period_s)
    gain = decay * math.sin(fast * period_s) / (fast * period_s)
    return (gain, -2.0 * gain, gain), (-2.0 * decay * math.cos(fast * period_s), decay**2)


def _dies_away(coupling: Coupling, t_s: Array, swing: Array, per_s: Array) -> Array:
    """What is left of a swing, and of its change with time, after ``t_s``, (m, 1)."""
    rad_s, damping = coupling
    damped = rad_s * math.sqrt(1.0 - damping**2)
    sine = (per_s + damping * rad_s * swing) / damped
    return np.asarray(np.exp(-damping * rad_s * t_s) * (swing * np.cos(damped * t_s) + sine * np.sin(damped * t_s)))


def _first_rows(window: Window, length_s: float) -> Rows:
    """First rows of pieces of about ``length_s``, each of at least 12 rows."""
    n = window.t_s.size
    count = max(1, min(round(window.duration_s / length_s), n // FEWEST_ROWS))
    return np.round(np.linspace(0, n, count + 1)[:-1]).astype(np.int64)
