"""Laws that would explain the record nearly as well in place of one that was found, and what tau, K, fc are then.

docs/theory.md 12.8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.identify.departures.departure import Departure
from rig.identify.departures.nuisances import Nuisance, Nuisances

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class InPlace:
    """A law in place of another.

    law, other   the one that was found, and the one in its place
    rise         of Schwarz's criterion
    moves        (3,) of tau, K and friction, each in its unit
    """

    law: Departure
    other: Departure
    rise: float
    moves: Array


def in_place(nuisances: Nuisances, laws: Sequence[Departure]) -> list[InPlace]:
    """For each of the fit's ``laws`` each other law in its place, as its best start explains the record, linearly."""
    found: dict[tuple[str, str], InPlace] = {}
    for law in laws:
        for one in nuisances.each:
            new = _replaced(nuisances, law, one)
            best = found.get((law.name, one.law.name))
            if new is not None and (best is None or new.rise < best.rise):
                found[law.name, one.law.name] = new
    return list(found.values())


def _replaced(nuisances: Nuisances, law: Departure, one: Nuisance) -> InPlace | None:
    """``one`` in place of ``law``; None where it would need a size below 0 that it cannot have."""
    fit = nuisances.fit
    free = fit.problem.free
    own = [free.index(name) for name in law.numbers]
    gone = {*own, *(free.index(name) for name in law.shape)}
    rest = [k for k in range(len(free)) if k not in gone] + [nuisances.core + k for k in one.columns]
    size = np.array([getattr(fit.motor, name) for name in law.numbers])
    pull = nuisances.gradient[rest] - nuisances.matrix[np.ix_(rest, own)] @ size
    matrix = nuisances.matrix[np.ix_(rest, rest)]
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    step = -np.linalg.lstsq(matrix / np.outer(scale, scale), pull / scale, rcond=1e-11)[0] / scale
    if one.law.one_sided and step[-one.count] <= 0.0:
        return None
    loss = float(-2.0 * nuisances.gradient[own] @ size + size @ nuisances.matrix[np.ix_(own, own)] @ size)
    count = math.log(max(2, fit.residual_rad.size - 2 * fit.starts.shape[0] - len(free)))
    extra = len(one.law.numbers + one.law.shape) - len(law.numbers + law.shape)
    moves = step[[rest.index(k) for k in nuisances.at]] * nuisances.size
    return InPlace(law, one.law, loss + float(pull @ step) + extra * count, moves)
