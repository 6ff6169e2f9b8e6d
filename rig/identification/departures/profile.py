"""A law size by size, where the motion is not linear in it (docs/theory.md 12.8).

A dead band that swallows a small drive whole is such a law. The other numbers are fitted for each size in turn. If the
fit has the law, the other sizes are looked at: they may explain the record as well as the one that was found. If it has
not, the size that fits best may lie between two of them, and tell more than both: it is looked for, too.

Where a loop's drive never brakes, a dead band is friction: of any size the rest fits as well. So where the largest of
the usual sizes is as likely as none, ``untold`` looks at larger ones, up to what a bench may have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.identification.departures.choice import CHANCE, TRIAL_ITERATIONS, Chooser, without
from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.fit import Fit, refitted, sigma_of, solve, unit
from rig.identification.departures.nuisances import OF
from rig.model.real_motor import RealMotor

STEPS = 3  # of a fit, from the size before
AS_FRICTION = 0.1  # change of K over that of the drive, at most, by what is nothing but friction in a record
NARROWER = 3  # sizes between one that is likely and one that is not, less 1
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
        _found(fit, law, laws, chooser) if law in laws else _hidden(fit, law, laws, chooser, effect)
        for law in chooser.candidates
        if law.sizes(chooser.bench)
    ]


def untold(fit: Fit, laws: Sequence[Departure], chooser: Chooser) -> list[Array]:
    """(3,) what each candidate may move tau, K and friction by that the record does not even tell in a usual size.

    It moves them so in the largest size that a bench may have, and that the record does not exclude.
    """
    found, largest_V = [], chooser.bench.largest_V
    for law in (one for one in chooser.candidates if one not in laws and one.untold(chooser.bench) > 0.0):
        [name], most = law.numbers, law.untold(chooser.bench)
        one, likely, excluded, size, tries = fit, 0.0, math.inf, law.range_of(chooser.bench), NARROWER
        while tries:  # from the usual size on, each twice the one before; then between two of them
            trial = solve(refitted(one, motor=one.motor._replace(**{name: size})), TRIAL_ITERATIONS)
            moved = abs(_gain(trial.motor, largest_V) / _gain(fit.motor, largest_V) - 1.0)
            rise, as_friction = _rise(trial, fit), moved < AS_FRICTION * size / largest_V
            if rise < -CHANCE or (rise <= CHANCE and as_friction):
                one, likely = trial, size
            else:
                excluded = size
            tries = tries if math.isinf(excluded) else tries - 1 if likely else 0
            tries = tries if likely < most else 0
            size = min(2.0 * size, most) if math.isinf(excluded) else 0.5 * (likely + excluded)
        if likely:
            share = min(excluded, most) / likely
            found.append(share * np.array([getattr(one.motor, key) - getattr(fit.motor, key) for key in OF]))
    return found


def _gain(m: RealMotor, u_V: float) -> float:
    """K at a drive, which may sag.

    A bridge that lets the motor run free between its pulses brakes for their share of the time.
    """
    beyond_V = u_V - m.dead_band_V
    idle = max(1.0 - beyond_V / m.full_drive_V, 0.0) if m.free_between > 0.0 else 0.0
    return m.K_rad_s_V * (1.0 - 2.0 * m.sag_per_V * beyond_V) / (1.0 - m.free_between * (1.0 - m.viscous_share) * idle)


def best_size(fit: Fit, law: Departure, laws: Sequence[Departure], chooser: Chooser) -> Fit:
    """The fit with such a law beside its ``laws``, from the size that explains the record best of those looked at."""
    found = _by_size(fit, fit, law, chooser.bench)
    return _at(found.fits[int(np.argmin(found.rise))], fit, law, laws, chooser)


def _at(one: Fit, fit: Fit, law: Departure, laws: Sequence[Departure], chooser: Chooser) -> Fit:
    """``fit`` with the law beside its ``laws``, of the size that fits best near that of ``one``."""
    return solve(chooser.with_laws(fit, [*laws, law], one.motor), TRIAL_ITERATIONS)


def _hidden(fit: Fit, law: Departure, laws: Sequence[Departure], chooser: Chooser, effect: float) -> Profile:
    """Of a law that the fit has not. Beforehand each size up to its range is as likely.

    A size that fits best of those about it, in a peak that is narrower than they are apart, counts by its own width.
    """
    found, [name] = _by_size(fit, fit, law, chooser.bench), law.numbers
    range_, beside = law.range_of(chooser.bench), np.ones(found.sizes.size, dtype=bool)
    peaks: list[tuple[float, Array, Array]] = []
    for at in np.flatnonzero((np.diff(found.rise)[:-1] <= 0.0) & (np.diff(found.rise)[1:] > 0.0)) + 1:
        best = _at(found.fits[at], fit, law, laws, chooser)
        size, sigma, rise = getattr(best.motor, name), sigma_of(best, name), _rise(best, fit)
        width = math.sqrt(2.0 * math.pi) * sigma
        if rise < found.rise[at] and width < found.widths[at] and abs(size - found.sizes[at]) < found.widths[at]:
            beside &= np.abs(found.sizes - size) > ITS_OWN * sigma
            move = np.array([getattr(best.motor, key) - getattr(fit.motor, key) for key in OF])
            spread = found.spread[at] * sigma / found.widths[at] * math.sqrt(12.0)
            peaks.append((width / range_ * math.exp(-0.5 * rise / effect), move, spread))
    odds = found.widths / range_ * np.exp(-0.5 * found.rise / effect)
    return Profile(
        law,
        np.append(odds[beside], [odd for odd, _, _ in peaks]),
        np.vstack((found.moves[beside], *(move for _, move, _ in peaks))),
        np.vstack((found.spread[beside], *(spread for _, _, spread in peaks))),
    )


def _found(fit: Fit, law: Departure, laws: Sequence[Departure], chooser: Chooser) -> Profile:
    """Of a law that the fit has: of the sizes beside the one that was found, by what that one stands for."""
    [name] = law.numbers
    others = [one for one in laws if one is not law]
    problem = replace(chooser.problem(fit.problem.cut, others, math.inf), noise=fit.problem.noise)
    bare = refitted(fit, problem, without(fit.motor, law))
    sigma = sigma_of(fit, name)
    found = _by_size(fit, bare, law, chooser.bench)
    odds = found.widths / (math.sqrt(2.0 * math.pi) * sigma) * np.exp(-0.5 * found.rise)
    beside = np.abs(found.sizes - getattr(fit.motor, name)) > ITS_OWN * sigma
    return Profile(law, odds[beside], found.moves[beside], found.spread[beside], found=True)


def _rise(one: Fit, fit: Fit) -> float:
    """Of twice the negative log likelihood, against ``fit``."""
    return max((one.cost - fit.cost) / unit(fit), -HOPELESS)


class _Sizes(NamedTuple):
    """Sizes of a law that were looked at, as in ``Profile``.

    rise     (k,) of twice the negative log likelihood
    widths   (k,) of the sizes that each stands for
    fits     of each
    """

    sizes: Array
    rise: Array
    moves: Array
    spread: Array
    widths: Array
    fits: list[Fit]


def _by_size(fit: Fit, begin: Fit, law: Departure, bench: Bench) -> _Sizes:
    """The sizes, their rise against ``fit``, and what they move; each fit begins at the one before, first ``begin``."""
    [name] = law.numbers
    here = np.array([getattr(fit.motor, key) for key in OF])
    sizes, rise, moves = [], [], []
    one, fits, left = begin, [], sorted(law.sizes(bench))
    while left:
        size = left.pop(0)
        steps = STEPS if size < law.range_of(bench) else TRIAL_ITERATIONS
        one = solve(refitted(one, motor=one.motor._replace(**{name: size})), steps)
        sizes.append(size)
        rise.append(_rise(one, fit))
        fits.append(one)
        moves.append(np.array([getattr(one.motor, key) for key in OF]) - here)
        if rise[-1] > HOPELESS and size > max(bench.small_drives_V, default=0.0):
            break
        if not left and rise[-1] == min(rise) < -CHANCE and 2.0 * size < law.most(bench):
            left = [2.0 * size]  # the largest of the usual sizes is the likeliest: the true one may be larger
    at, found = np.array(sizes), np.array(moves)
    slopes = np.gradient(found, at, axis=0) if at.size > 1 else found / at[:, None]
    widths = _widths(at, law, bench)
    spread = np.abs(slopes) * widths[:, None] / math.sqrt(12.0)
    return _Sizes(at, np.array(rise), found, spread, widths, fits)


def _widths(sizes: Array, law: Departure, bench: Bench) -> Array:
    """Of the sizes that each of the first ones among ``law.sizes``, or of larger ones, stands for."""
    every = np.array(sorted({*law.sizes(bench), *sizes}))
    edges = np.concatenate(([0.0], 0.5 * (every[1:] + every[:-1]), [max(law.range_of(bench), every[-1])]))
    return np.asarray(np.diff(edges)[: sizes.size])
