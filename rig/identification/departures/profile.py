"""A law size by size, where the motion is not linear in it (docs/theory.md 12.8).

A dead band that swallows a small drive whole is such a law. The other numbers are fitted for each size in turn. If the
fit has the law, the other sizes are looked at: they may explain the record as well as the one that was found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.identification.departures.choice import Chooser, without
from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.fit import Fit, Normal, refitted, solve, unit
from rig.identification.departures.nuisances import OF

Array = NDArray[np.float64]

STEPS = 3  # of a fit, from the size before
HOPELESS = 60.0  # rise of the sum of squares from which on larger sizes are left out
ITS_OWN = 2.0  # standard deviations of a size that was found, within which another size is the same


@dataclass(frozen=True, eq=False)
class Profile:
    """What the record says of each size of a law.

    law     the law
    odds    (k,) of each size, against the fit, but for those of the law before the record is looked at
    moves   (k, 3) of tau, K and friction, each in its unit
    spread  (k, 3) standard deviations of these among the sizes that each stands for
    found   whether the fit has the law: then its odds beforehand are in ``odds``
    """

    law: Departure
    odds: Array
    moves: Array
    spread: Array
    found: bool = False


def profiles(fit: Fit, laws: Sequence[Departure], chooser: Chooser, effect: float = 1.0) -> list[Profile]:
    """Of every candidate that has sizes of its own to be looked at.

    laws     those of the fit
    effect   as ``Nuisances.tempered``
    """
    return [
        _found(fit, law, laws, chooser) if law in laws else _hidden(fit, law, chooser.bench, effect)
        for law in chooser.candidates
        if law.sizes(chooser.bench)
    ]


def _hidden(fit: Fit, law: Departure, bench: Bench, effect: float) -> Profile:
    """Of a law that the fit has not. Beforehand each size up to its range is as likely."""
    sizes, rise, moves, spread = _by_size(fit, fit, law, bench)
    odds = _widths(sizes, law, bench) / law.range_of(bench) * np.exp(-0.5 * rise / effect)
    return Profile(law, odds, moves, spread)


def _found(fit: Fit, law: Departure, laws: Sequence[Departure], chooser: Chooser) -> Profile:
    """Of a law that the fit has: of the sizes beside the one that was found, by what that one stands for."""
    [name] = law.numbers
    others = [one for one in laws if one is not law]
    problem = replace(chooser.problem(fit.problem.cut, others, math.inf), noise=fit.problem.noise)
    bare = refitted(fit, problem, without(fit.motor, law))
    normal = Normal.of(fit.rows, fit.problem.cut)
    covariance = np.linalg.pinv(normal.matrix, rcond=1e-14, hermitian=True) * unit(fit)
    at = fit.problem.free.index(name)
    sigma = max(math.sqrt(max(float(covariance[at, at]), 0.0)), 1e-12)
    sizes, rise, moves, spread = _by_size(fit, bare, law, chooser.bench)
    odds = _widths(sizes, law, chooser.bench) / (math.sqrt(2.0 * math.pi) * sigma) * np.exp(-0.5 * rise)
    beside = np.abs(sizes - getattr(fit.motor, name)) > ITS_OWN * sigma
    return Profile(law, odds[beside], moves[beside], spread[beside], found=True)


def _by_size(fit: Fit, begin: Fit, law: Departure, bench: Bench) -> tuple[Array, Array, Array, Array]:
    """The sizes, the rise of twice the negative log likelihood against ``fit`` at each, and what they move."""
    [name] = law.numbers
    here = np.array([getattr(fit.motor, key) for key in OF])
    sizes, rise, moves = [], [], []
    one = begin
    for size in sorted(law.sizes(bench)):
        one = solve(refitted(one, motor=one.motor._replace(**{name: size})), STEPS)
        sizes.append(size)
        rise.append(max((one.cost - fit.cost) / unit(fit), -HOPELESS))
        moves.append(np.array([getattr(one.motor, key) for key in OF]) - here)
        if rise[-1] > HOPELESS and size > max(bench.small_drives_V, default=0.0):
            break
    at, found = np.array(sizes), np.array(moves)
    slopes = np.gradient(found, at, axis=0) if at.size > 1 else found / at[:, None]
    return at, np.array(rise), found, np.abs(slopes) * _widths(at, law, bench)[:, None] / math.sqrt(12.0)


def _widths(sizes: Array, law: Departure, bench: Bench) -> Array:
    """Of the sizes that each of the first ones among ``law.sizes`` stands for."""
    every = np.array(sorted(law.sizes(bench)))
    edges = np.concatenate(([0.0], 0.5 * (every[1:] + every[:-1]), [law.range_of(bench)]))
    return np.asarray(np.diff(edges)[: sizes.size])
