"""Laws that would explain the record nearly as well in place of one that was found, and what tau, K, fc are then.

The linear model shows most of them. It fails where the motion is not linear in a law: a dead band of the drive and a
Stribeck effect of slow speeds; and where it moves tau, K or friction far. So where the record hardly shows a law, the
best of the others are fitted, and so is each that would move them far (docs/theory.md 12.8).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.core.arrays import Array
from rig.identification.departures.choice import FAINT, TRIAL_ITERATIONS, TRIED, Chooser
from rig.identification.departures.departure import Departure
from rig.identification.departures.fit import Fit, refitted, solve, unit
from rig.identification.departures.nuisances import OF, Nuisance, Nuisances
from rig.identification.departures.profile import best_size
from rig.identification.noise import WHITE
from rig.identification.side_by_side import side_by_side

FAR = 0.1  # of tau, K or friction: what the linear model would move it by, beyond which a fit is asked
FAR_WORSE = 2.0  # what another law leaves beyond the sensor's noise over what the fit leaves: then it counts no more
RIVAL = 20.0  # rise of Schwarz's criterion up to which a law in place of another counts at all


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


def bare_fits(fit: Fit, laws: Sequence[Departure], chooser: Chooser) -> dict[str, Fit]:
    """For each of the fit's ``laws``, by name: the fit of the same rows without it, with the noise of ``fit``."""
    found = side_by_side(lambda law: chooser.bare(fit, laws, law), laws, fit.residual_rad.size)
    return {law.name: bare for law, bare in zip(laws, found, strict=True)}


def in_place(
    nuisances: Nuisances, laws: Sequence[Departure], chooser: Chooser, bare: Mapping[str, Fit]
) -> list[InPlace]:
    """For each of the fit's ``laws`` each other law in its place, as its best start explains the record.

    nuisances   the laws that the fit has not
    bare        the fits without each of the laws: ``bare_fits``
    """
    found: dict[tuple[str, str], InPlace] = {}
    for law in laws:
        for new in filter(None, (_replaced(nuisances, law, one) for one in nuisances.each if not law.leaps)):
            best = found.get((law.name, new.other.name))
            if best is None or new.rise < best.rise:
                found[law.name, new.other.name] = new
        size = np.array([abs(getattr(nuisances.fit.motor, name)) for name in OF])
        far = {
            one.other.name
            for one in found.values()
            if one.law is law and one.rise < RIVAL and np.any(np.abs(one.moves) > FAR * size)
        }
        for new in _fitted(nuisances.fit, law, laws, chooser, bare[law.name], far):
            best = found.get((law.name, new.other.name))
            if best is None or new.rise < best.rise or new.other.name in far:
                found[law.name, new.other.name] = new
    return list(found.values())


def nearly_as_good(
    fit: Fit, laws: Sequence[Departure], chooser: Chooser, bare: Mapping[str, Fit]
) -> list[tuple[Fit, float]]:
    """Fits far from one that leaves more than white noise, with another law in place of one, and how much each counts.

    What both leave beyond the sensor's noise is no noise but the motor, so likelihood says nothing of the two. A law
    enters where it takes away a share of what is left, ``asked.cuts``; so one that leaves no more than that share more
    counts in full, and one that leaves twice as much not at all. Of
    those that hardly move a number likelihood says enough.
    """
    if fit.problem.noise.white:
        return []

    def by_squares(one: Fit) -> Fit:
        return solve(refitted(one, replace(one.problem, noise=WHITE)), TRIAL_ITERATIONS)

    def left_rad(one: Fit) -> float:
        return math.sqrt(max(one.rms_rad**2 - chooser.sigma_rad**2, 0.0))

    least_rad = max(left_rad(by_squares(fit)), 1e-300)
    alike = 1.0 / (1.0 - chooser.asked.cuts)
    tried = []
    for law in laws:
        others = [one for one in laws if one is not law]
        without_it = by_squares(bare[law.name])
        promises = [one for one in chooser.promises(without_it, others) if one.law is not law]
        for promise in promises[:TRIED]:
            motor = without_it.motor._replace(**promise.first)
            tried.append(chooser.with_laws(without_it, [*others, promise.law], motor))
    fits = side_by_side(lambda one: solve(one, TRIAL_ITERATIONS), tried, fit.residual_rad.size)
    here = np.array([getattr(fit.motor, name) for name in OF])
    far = [np.any(np.abs([getattr(one.motor, name) for name in OF] - here) > FAR * np.abs(here)) for one in fits]
    counts = [min((FAR_WORSE - left_rad(one) / least_rad) / (FAR_WORSE - alike), 1.0) for one in fits]
    return [(one, count) for one, count, is_far in zip(fits, counts, far, strict=True) if is_far and count > 0.0]


def gained(fit: Fit, bare: Fit) -> float:
    """Twice the log likelihood that a law brings: by it the fit without it, ``bare``, is worse."""
    return (bare.cost - fit.cost) / unit(fit)


def _fitted(
    fit: Fit, law: Departure, laws: Sequence[Departure], chooser: Chooser, bare: Fit, far: Collection[str]
) -> list[InPlace]:
    """Laws in place of another, each fitted: those named in ``far``; and of one that the record hardly shows the best.

    Those that promise most are the best, and any whose sizes are looked at one by one is fitted.
    """
    most = TRIED if gained(fit, bare) <= FAINT else 0
    if not most and not far:
        return []
    found = []
    bench = chooser.bench
    others = [one for one in laws if one is not law]
    promises = [one for one in chooser.promises(bare, others) if one.law is not law]
    for promise in [one for k, one in enumerate(promises) if k < most or one.law.name in far or one.law.sizes(bench)]:
        one = promise.law
        if one.sizes(bench):  # no linear model says what it would gain
            trial = best_size(bare, one, others, chooser)
        else:
            motor = bare.motor._replace(**promise.first)
            trial = solve(chooser.with_laws(bare, [*others, one], motor), TRIAL_ITERATIONS)
        moves = np.array([getattr(trial.motor, name) - getattr(fit.motor, name) for name in OF])
        found.append(InPlace(law, one, gained(fit, trial) + _extra(fit, law, one), moves))
    return found


def _extra(fit: Fit, law: Departure, other: Departure) -> float:
    """By how much Schwarz's criterion is higher for the numbers that ``other`` has more than ``law``."""
    count = math.log(max(2, fit.problem.cut.freedom - len(fit.problem.free)))
    return (len(other.numbers + other.shape) - len(law.numbers + law.shape)) * count


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
    moves = step[[rest.index(k) for k in nuisances.at]] * nuisances.size
    return InPlace(law, one.law, loss + float(pull @ step) + _extra(fit, law, one.law), moves)
