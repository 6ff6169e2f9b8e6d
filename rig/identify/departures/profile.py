"""A law that the fit has not, size by size, where the motion is not linear in it (docs/theory.md 12.8).

A dead band that swallows a small drive whole is such a law. The other numbers are fitted for each size in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.identify.departures.departure import Bench, Departure
from rig.identify.departures.fit import Fit, refitted, solve, unit
from rig.identify.departures.nuisances import OF

Array = NDArray[np.float64]

STEPS = 3  # of a fit, from the size before
HOPELESS = 60.0  # rise of the sum of squares from which on larger sizes are left out


@dataclass(frozen=True, eq=False)
class Profile:
    """What the record says of each size of a law.

    law     the law
    share   (k,) of all its sizes that each size stands for, before the record is looked at; their sum is at most 1
    rise    (k,) of twice the negative log likelihood, against the fit without the law
    moves   (k, 3) of tau, K and friction, each in its unit
    spread  (k, 3) standard deviations of these among the sizes that each stands for
    """

    law: Departure
    share: Array
    rise: Array
    moves: Array
    spread: Array

    @property
    def weight(self) -> Array:
        """(k,) Odds of each size against none, but for those of the law before the record is looked at."""
        return np.asarray(self.share * np.exp(-0.5 * self.rise))


def profiles(fit: Fit, laws: Sequence[Departure], candidates: Sequence[Departure], bench: Bench) -> list[Profile]:
    """Of every candidate that is not among the ``laws`` of the fit, and has sizes of its own to be looked at."""
    absent = [law for law in candidates if law not in laws]
    return [_profile(fit, law, bench) for law in absent if law.sizes(bench)]


def _profile(fit: Fit, law: Departure, bench: Bench) -> Profile:
    [name] = law.numbers
    sizes = np.array(sorted(law.sizes(bench)))
    edges = np.concatenate(([0.0], 0.5 * (sizes[1:] + sizes[:-1]), [law.range_of(bench)]))
    here = np.array([getattr(fit.motor, key) for key in OF])
    rise, moves = [], []
    one = fit
    for size in sizes.tolist():
        one = solve(refitted(one, motor=one.motor._replace(**{name: size})), STEPS)
        rise.append((one.cost - fit.cost) / unit(fit))
        moves.append(np.array([getattr(one.motor, key) for key in OF]) - here)
        if rise[-1] > HOPELESS and size > max(bench.small_drives_V, default=0.0):
            break
    count = len(rise)
    widths = np.diff(edges)[:count]
    found = np.array(moves)
    slopes = np.gradient(found, sizes[:count], axis=0) if count > 1 else found / sizes[:1, None]
    return Profile(
        law, widths / law.range_of(bench), np.array(rise), found, np.abs(slopes) * widths[:, None] / np.sqrt(12.0)
    )
