"""When it is enough: the rule by which a live estimate ends the tests (docs/until.md)."""

from __future__ import annotations

import math
from typing import Protocol

MOST_RESIDUAL = 1.04  # of the noise at rest
SIGMAS = 2.0  # by which that ratio may be larger, by the few rows that it comes from
IN_A_ROW = 2  # estimates


class Judged(Protocol):
    """What the rule looks at; ``rig.identify.live.LiveEstimate`` has it."""

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


class StopRule:
    """Enough is: the interval is reached, the residual is noise, the drives differ; at estimates in a row.

    Never that estimates agree: those of tiny cycles agree well, and are wrong together.

    interval_percent  wanted half width of the 95 % intervals, % of the value
    noise_error       standard error of the noise at rest, as a share of it
    """

    def __init__(self, interval_percent: float, noise_error: float = 0.0) -> None:
        self.interval_percent = interval_percent
        self.noise_error = noise_error
        self._in_a_row = 0

    def take(self, estimate: Judged) -> str | None:
        """Take the next estimate. Returns why it is enough, in words, or None."""
        self._in_a_row = self._in_a_row + 1 if self.lacks(estimate) is None else 0
        if self._in_a_row < IN_A_ROW:
            return None
        return (
            f"tau, K and f_c are known to {estimate.worst_percent:.2f} %, {self.interval_percent:g} % were asked for; "
            f"the residual is {estimate.residual_over_noise:.2f} of the noise at rest"
        )

    def lacks(self, estimate: Judged) -> str | None:
        """What an estimate lacks, in words; None if it has all."""
        if not estimate.worst_percent <= self.interval_percent:  # nan lacks, too
            return f"tau, K and f_c are known to {estimate.worst_percent:.2g} %"
        most = MOST_RESIDUAL + SIGMAS * math.hypot(estimate.residual_error, self.noise_error)
        if not estimate.residual_over_noise <= most:
            return (
                f"the residual is {estimate.residual_over_noise:.2f} of the noise at rest: the model leaves a part out"
            )
        return None if estimate.drives_differ else "the drives were too much alike"
