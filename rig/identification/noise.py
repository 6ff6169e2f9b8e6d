"""Noise on a recorded position, white and coloured, and the filter that whitens it (docs/theory.md 7.5).

The position integrates disturbances of the motor and errors in the times of its drive, so the residual of a fit is
coloured. Least squares for white noise would then give errors far above the bound, and intervals far too narrow. The
coloured noise is an Ornstein-Uhlenbeck process: a random walk for a long memory, low-passed noise for a short one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.model.compiled import coloured_noise
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.recording.stage import StageKind

NEEDED = 8.0  # twice the gain of log likelihood from which on noise counts as coloured
GRID = 7  # points of each axis, memory and size, in each round of the search
ROUNDS = 4
LEAST_PAUSE_ROWS = 6
WALKS_FOR = 100.0  # times the record: the memory of a walk has no end
COASTS = 3.0  # times the median variance of all pauses


@dataclass(frozen=True)
class Noise:
    """White noise and coloured noise.

    memory_s  correlation time of the coloured noise, s
    ratio     variance of the coloured noise over the variance of the white noise; 0: white noise alone
    """

    memory_s: float = 1.0
    ratio: float = 0.0

    @property
    def white(self) -> bool:
        """Whether there is no coloured noise."""
        return self.ratio == 0.0

    def whiten(self, columns: Array, t_s: Array, lengths: Sequence[int]) -> Array:
        """Innovations of ``columns``, (n,) or (n, p): white, with the standard deviation of the white noise.

        t_s       n times of the rows, s
        lengths   number of rows of each window, in order; each window has coloured noise of its own
        """
        if self.white:
            return columns
        table = columns.reshape(columns.shape[0], -1)
        out, _ = coloured_noise.innovations(t_s, _starts(lengths), self.memory_s, self.ratio, table)
        return out.reshape(columns.shape)


WHITE = Noise()


def noise_of_sensor(tests: Sequence[TimeSeries], white_rad: float) -> Noise:
    """White, but of sampled velocities: their sum walks at random. In units of this white noise, rad."""
    if not tests or white_rad == 0.0 or not all(test.walk_rad() > 0.0 for test in tests):
        return WHITE
    memory_s = WALKS_FOR * max(float(test.t_s[-1] - test.t_s[0]) for test in tests)
    pace = sum(test.walk_rad() ** 2 / test.period_s for test in tests) / len(tests)  # of its variance, rad^2/s
    return Noise(memory_s, 0.5 * pace * memory_s / white_rad**2)


def noise_of(residual: Array, t_s: Array, lengths: Sequence[int], period_s: float | None = None) -> Noise:
    """The most likely noise of a ``residual``, (n,), rad; white unless coloured noise is much more likely.

    t_s       n times of the rows, s
    lengths   number of rows of each window, in order
    period_s  from one row to the next; None: as in the first window
    """
    starts = _starts(lengths)
    power = float(residual @ residual)
    if power == 0.0:
        return WHITE
    scaled = residual / np.sqrt(power / residual.size)
    period = float(np.median(np.diff(t_s[: lengths[0]]))) if period_s is None else period_s
    longest = float(max(t_s[a + n - 1] - t_s[a] for a, n in zip(starts.tolist(), lengths, strict=True)))
    low = np.log([0.5 * period, 1e-4])
    high = np.log([10.0 * longest, 1e8])
    best, centre = np.inf, 0.5 * (low + high)
    reach = 0.5 * (high - low)
    for _ in range(ROUNDS):
        memories, ratios = (
            np.clip(c + r * np.linspace(-1.0, 1.0, GRID), a, b)
            for c, r, a, b in zip(centre, reach, low, high, strict=True)
        )
        for memory in memories.tolist():
            deviances = coloured_noise.deviances(t_s, starts, float(np.exp(memory)), np.exp(ratios), scaled)
            least = int(np.argmin(deviances))
            if deviances[least] < best:
                best, centre = float(deviances[least]), np.array([memory, ratios[least]])
        reach = reach / (0.5 * GRID)
    if -best < NEEDED:
        return WHITE
    return Noise(float(np.exp(centre[0])), float(np.exp(centre[1])))


class RestNoise(NamedTuple):
    """Noise of a reading at rest.

    std_rad  standard deviation, rad
    error    its standard error, as a share of it
    """

    std_rad: float
    error: float


def noise_at_rest(recording: Recording) -> RestNoise:
    """The noise of all pauses before the first test: the breakaway check's, and the rests around it.

    A pause is rows without drive. Of each the last two thirds count, from ``LEAST_PAUSE_ROWS`` on, and a steady creep
    does not. Pauses in which the shaft still coasted are left out: their variance is far above the others'.
    Raises ValueError if there is no pause.
    """
    early = np.isin(recording.stage, (str(StageKind.REST), str(StageKind.BREAKAWAY)))
    rests = early & (recording.u_V == 0.0)
    edges = np.flatnonzero(np.diff(rests.astype(np.int8), prepend=0, append=0))
    powers: list[tuple[int, float]] = []  # degrees of freedom, sum of squares
    for first, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin = first + (stop - first) // 3
        if stop - begin >= LEAST_PAUSE_ROWS:
            y, x = recording.y_rad[begin:stop], np.arange(stop - begin, dtype=float)
            x -= x.mean()
            y = y - y.mean()
            y = y - x * float(x @ y) / float(x @ x)
            powers.append((y.size - 2, float(y @ y)))
    if not powers:
        raise ValueError("the noise at rest needs a pause before the first test")
    typical = float(np.median([power / freedom for freedom, power in powers]))
    kept = [(freedom, power) for freedom, power in powers if power <= COASTS * freedom * typical]
    freedom = sum(one for one, _ in kept)
    return RestNoise(math.sqrt(sum(power for _, power in kept) / freedom), 1.0 / math.sqrt(2.0 * freedom))


def _starts(lengths: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate(([0], np.cumsum(lengths)[:-1])).astype(np.int64)
