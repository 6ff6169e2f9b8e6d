"""Noise on a recorded position: white and coloured; and the filter that makes it white (docs/theory.md 7.5).

The position integrates whatever disturbs the motor and whatever is wrong with the times of its drive: what is left of
it after a fit is coloured. Least squares that take it for white give errors far above the bound and intervals far too
narrow. The coloured part is an Ornstein-Uhlenbeck process: with a long memory it is a random walk, with a short one
low-passed noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEEDED = 8.0  # twice the gain of log likelihood from which on coloured noise is believed
GRID = 7  # points each way in each round of the search for its memory and size
ROUNDS = 4


@dataclass(frozen=True)
class Noise:
    """White noise, and coloured noise of variance ``ratio`` times the white one's that lasts ``memory_s``."""

    memory_s: float = 1.0
    ratio: float = 0.0

    @property
    def white(self) -> bool:
        """Whether none of it is coloured."""
        return self.ratio == 0.0

    def whiten(self, columns: Array, t_s: Array, lengths: Sequence[int]) -> Array:
        """The rows of ``columns``, (n,) or (n, p), as innovations: white, in units of the white part's.

        t_s       times of the rows, s
        lengths   rows of each of the consecutive windows, each with coloured noise of its own
        """
        if self.white:
            return columns
        from rig.model.compiled import coloured_noise

        table = np.ascontiguousarray(columns.reshape(columns.shape[0], -1))
        out = np.empty_like(table)
        coloured_noise.innovations(t_s, _starts(lengths), self.memory_s, self.ratio, table, out)
        return out.reshape(columns.shape)


WHITE = Noise()


def noise_of(residual: Array, t_s: Array, lengths: Sequence[int]) -> Noise:
    """The most likely noise of a residual, rad; white unless coloured noise is much likelier.

    t_s       times of the rows, s
    lengths   rows of each of the consecutive windows
    """
    from rig.model.compiled import coloured_noise

    starts = _starts(lengths)
    power = float(residual @ residual)
    if power == 0.0:
        return WHITE
    scaled = residual / np.sqrt(power / residual.size)
    period = float(np.median(np.diff(t_s[: lengths[0]])))
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
            for ratio in ratios.tolist():
                deviance = coloured_noise.deviance(t_s, starts, float(np.exp(memory)), float(np.exp(ratio)), scaled)
                if deviance < best:
                    best, centre = deviance, np.array([memory, ratio])
        reach = reach / (0.5 * GRID)
    if -best < NEEDED:
        return WHITE
    return Noise(float(np.exp(centre[0])), float(np.exp(centre[1])))


def _starts(lengths: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate(([0], np.cumsum(lengths)[:-1])).astype(np.int64)
