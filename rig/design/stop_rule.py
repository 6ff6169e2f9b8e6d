"""When it is enough: the rule by which a live estimate ends the tests, and the noise at rest that it judges by.

Each further pause tells that noise better (docs/until.md).
"""

from __future__ import annotations

import math
from collections import deque
from typing import Protocol

import numpy as np

from rig.core.arrays import Array

STILL_SHARE = 0.6  # of a pause, its end: by then the shaft stands
FEWEST_ROWS = 20
MOVES = 2.0  # times the variance so far: the shaft still moved
NORMAL = 3.0  # standard deviations


class RestNoise:
    """What is known of the noise at rest.

    std_rad   standard deviation, rad, > 0
    error     its standard error, as a share of it, >= 0; 0: it is known
    """

    def __init__(self, std_rad: float, error: float) -> None:
        self.std_rad = std_rad
        self.error = error

    def take(self, y_rad: Array) -> bool:
        """Take the positions (n,), rad, of a pause. Returns False, and learns nothing, if the shaft still moved.

        Nor from noise that is not white: a pause shows too little of it, and a fit's residual follows another rule.
        """
        y = np.asarray(y_rad[-round(STILL_SHARE * y_rad.size) :], dtype=float)
        if y.size < FEWEST_ROWS or self.error == 0.0:
            return False
        x = np.arange(float(y.size)) - 0.5 * (y.size - 1)
        y = y - y.mean()
        slope = float(x @ y) / float(x @ x)
        freedom = y.size - 2
        power = float(y @ y) - slope**2 * float(x @ x)
        variance = power / freedom
        creeps = abs(slope) > NORMAL * math.sqrt(variance / float(x @ x)) if variance > 0.0 else slope != 0.0
        line = y - slope * x
        if creeps or variance > MOVES * self.std_rad**2 or not _is_white(line, variance):
            return False
        before = 0.5 / self.error**2
        self.std_rad = math.sqrt((before * self.std_rad**2 + power) / (before + freedom))
        self.error = 1.0 / math.sqrt(2.0 * (before + freedom))
        return True


def _is_white(noise: Array, variance: float) -> bool:
    """Whether first and second differences have the variances of white noise, twice and six times the noise's own."""
    by_first, by_second = (float(np.mean(np.diff(noise, k) ** 2)) / of for k, of in ((1, 2.0), (2, 6.0)))
    off = NORMAL / math.sqrt(noise.size)  # the second ratio scatters half as much
    return variance > 0.0 and abs(by_first / variance - 1.0) <= off and abs(by_second / by_first - 1.0) <= 0.5 * off


MOST_RESIDUAL = 1.04  # of the noise at rest
SIGMAS = 2.0  # by which that ratio may be larger, by the few rows that it comes from
IN_A_ROW = 2  # estimates
BESIDE_LAWS = 0.6  # of the wanted interval: beside a law that shows, another one hides more easily
DOUBT_SIGMAS = 4.0  # by which the ratio may be larger, and the noise be to blame as well as the motor


class Judged(Protocol):
    """What the rule looks at; ``rig.identification.live.LiveEstimate`` has it."""

    @property
    def worst_percent(self) -> float:
        """Largest half width of the 95 % intervals of tau, K and f_c, in % of the value."""

    @property
    def residual_over_noise(self) -> float:
        """RMS residual over the noise at rest."""

    @property
    def residual_error(self) -> float:
        """Standard error of that, from the number of rows in motion."""

    @property
    def drives_differ(self) -> bool:
        """Whether clearly different drives were seen."""

    @property
    def laws(self) -> tuple[str, ...]:
        """Names of the laws beyond the plain one."""


class StopRule:
    """Enough is: the interval is reached, the residual is noise, the drives differ; at estimates in a row.

    Never that estimates agree: those of tiny cycles agree well, and are wrong together.

    interval_percent  wanted half width of the 95 % intervals, % of the value
    noise_error       standard error of the noise at rest, as a share of it
    """

    def __init__(self, interval_percent: float, noise_error: float = 0.0) -> None:
        self.interval_percent = interval_percent
        self.noise_error = noise_error
        self._noise_ratio = 1.0  # of the noise at rest as it is known now to that of the estimates' residuals
        self._last: deque[Judged] = deque(maxlen=IN_A_ROW)

    def wanted_percent(self, estimate: Judged) -> float:
        """Half width that this estimate must reach, %: a smaller one beside laws."""
        return self.interval_percent * (BESIDE_LAWS if estimate.laws else 1.0)

    def take(self, estimate: Judged) -> str | None:
        """Take the next estimate. Returns why it is enough, in words, or None.

        Estimates with other laws than this one do not count with it.
        """
        if self._last and self._last[-1].laws != estimate.laws:
            self._last.clear()
        self._last.append(estimate)
        return self.enough()

    def confirm(self, estimate: Judged) -> str | None:
        """Take the last estimate anew, of the same rows. Returns why it is enough, in words, or None."""
        if self._last:
            laws = self._last.pop().laws
            if laws != estimate.laws:
                self._last.clear()
        self._last.append(estimate)
        return self.enough()

    def learn(self, noise_ratio: float, noise_error: float) -> None:
        """Know the noise at rest better from now on.

        noise_ratio  of the noise at rest to the one that the estimates measure their residuals in, 1
        noise_error  its standard error, as a share of it, 1
        """
        self._noise_ratio, self.noise_error = noise_ratio, noise_error

    def enough(self) -> str | None:
        """Why the last estimates are enough, in words, by what is known of the noise now; None if they are not."""
        if len(self._last) < IN_A_ROW or any(self.lacks(estimate) is not None for estimate in self._last):
            return None
        estimate = self._last[-1]
        return (
            f"tau, K and f_c are known to {estimate.worst_percent:.2f} % by their scatter, "
            f"{self.interval_percent:g} % were asked for; "
            f"the residual is {self._residual(estimate):.2f} of the noise at rest"
        )

    @property
    def noise_in_doubt(self) -> bool:
        """Whether the last estimates lack nothing but a smaller residual, and the noise at rest may be to blame."""
        return (
            len(self._last) == IN_A_ROW
            and all(each.worst_percent <= self.wanted_percent(each) and each.drives_differ for each in self._last)
            and any(self.lacks(each) is not None for each in self._last)
            and all(self._residual(each) <= self._most(each, DOUBT_SIGMAS) for each in self._last)
        )

    def _residual(self, estimate: Judged) -> float:
        """RMS residual over the noise at rest as it is known now."""
        return estimate.residual_over_noise / self._noise_ratio

    def _most(self, estimate: Judged, sigmas: float) -> float:
        return MOST_RESIDUAL + sigmas * math.hypot(estimate.residual_error, self.noise_error)

    def lacks(self, estimate: Judged) -> str | None:
        """What an estimate lacks, in words; None if it has all."""
        if not estimate.worst_percent <= self.wanted_percent(estimate):  # nan lacks, too
            return f"tau, K and f_c are known to {estimate.worst_percent:.2g} % by their scatter"
        if not self._residual(estimate) <= self._most(estimate, SIGMAS):
            return f"the residual is {self._residual(estimate):.2f} of the noise at rest: the model leaves a part out"
        return None if estimate.drives_differ else "the drives were too much alike"
