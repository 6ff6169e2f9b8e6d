"""Laws that a bench may have and the motor's model has not: what they do to the readings, and in the place of others.

None is fitted. What such a law would move tau, K and friction by is a line of the budget.

A supply or a bridge with a resistance loses what the current takes from it: much while the shaft speeds up, little once
it turns. Where the records hold few sizes of drive, a sag by the drive alone explains them as well, and then tau, K and
friction are too large by about the share that the largest drives lose. So it is tried in the place of a sag: the drive
less what the fitted motion's current takes, and the other numbers fitted to that.

A drive that bends need not sag: beside a sag a bend with the square of the drive stands for any other. Three sizes of
drive tell the two apart, if they lie apart and the noise lets them.

Behind a soft coupling the load swings: the reading is behind the shaft of a stiff bench by a swing that its
acceleration drives, d'' + 2 z w d' + w^2 d = a, whatever share of the mass is the load. A fit takes that for a shorter
tau and a longer delay. So each of some frequencies w is a start of that law, each with two dampings; its size follows.

Friction that changes along the way with any period is a voltage against the motion. What it does to the readings is, to
first order, what that voltage does to a motor that turns: no stick, and no jump at a reversal. Where a fit leaves white
noise, there is none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.identification.departures.choice import TRIAL_ITERATIONS, Chooser, without
from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.fit import Fit, refitted, solve
from rig.identification.departures.in_place import InPlace, gained
from rig.identification.departures.laws import (
    BEND,
    DAMPINGS,
    DEPARTURES,
    FREQUENCIES_RAD_S,
    FRICTION_WAVE,
    SAG_BY_CURRENT,
    SOFT_COUPLING,
    WAVES_PER_RAD,
    orders,
)
from rig.identification.departures.nuisances import OF
from rig.identification.departures.pieces import Coupling, Cut
from rig.model.compiled.row_filter import filtered
from rig.run_folder.recording.series import Steps

(COGGING,) = (law for law in DEPARTURES if law.name == "cogging")
SIZES = (0.5, 1.0, 1.5)  # of the sag that was found
INSTEAD_OF = ("sag", "source")  # a resistance behind a bridge that does not chop is neither
AT_REST = 0.02  # of the largest speed
BESIDE = 0.25  # of the size of a coupling, between two that are looked at
FIRST = 1.0 / 3.0  # of the range: the size of a sag by the current whose effect stands for all


class Outside(NamedTuple):
    """One start of such a law.

    change   (n, k) of the fit's readings, rad, for 1 of each of its sizes
    starts   how many of them the law has
    known    what its size is, and its standard deviation, where it follows from the start; None: it does not
    """

    law: Departure
    change: Array
    starts: int = 1
    known: tuple[float, float] | None = None


def outside(fit: Fit, laws: Sequence[Departure], bench: Bench) -> list[Outside]:
    """Each start of each such law.

    laws   those of the fit: a sag has its own in its place, and a supply's resistance is what a sag by the current is
    """
    found = list[Outside]()
    if fit.problem.cut.coupling is None:
        found = [
            Outside(
                SOFT_COUPLING,
                by_coupling(fit, Coupling(rad_s, damping)) * rad_s**2,
                len(FREQUENCIES_RAD_S) * len(DAMPINGS),
                (rad_s**-2, BESIDE * rad_s**-2),
            )
            for rad_s in FREQUENCIES_RAD_S
            for damping in DAMPINGS
        ]
    if any(law.name in INSTEAD_OF for law in laws):
        found.append(Outside(BEND, _by_bend(fit, bench)))
    else:
        found.append(Outside(SAG_BY_CURRENT, _by_sag(fit, bench)))
    if not fit.problem.noise.white and COGGING.fits(bench):
        every = orders(bench)
        slow = [order for order in every if order <= WAVES_PER_RAD] or every[:1]
        by_waves = by_friction_waves(fit, slow)
        found += [Outside(FRICTION_WAVE, by_waves[:, 2 * k : 2 * k + 2], len(slow)) for k in range(len(slow))]
    return found


def instead_of_sag(fit: Fit, law: Departure, laws: Sequence[Departure], chooser: Chooser) -> list[InPlace]:
    """The best sag by the current in the place of the fit's sag, or of its supply's resistance.

    fit    with its noise
    law    that of ``laws``, one of ``INSTEAD_OF``
    """
    like_per_V = fit.motor.sag_per_V if law.name == "sag" else fit.motor.source_per_V2 * chooser.bench.largest_V
    others = [one for one in laws if one is not law]

    def of_size(share: float) -> InPlace:
        trial = fit  # with the law it is nearer than without it
        for _ in range(2):  # the current is that of the motor as it is fitted
            cut = by_current(fit, trial.motor.K_rad_s_V, share * like_per_V)
            problem = replace(chooser.problem(cut, others, fit.problem.robust_rad), noise=fit.problem.noise)
            trial = solve(refitted(trial, problem, without(trial.motor, law)), TRIAL_ITERATIONS)
        moves = np.array([getattr(trial.motor, name) - getattr(fit.motor, name) for name in OF])
        return InPlace(law, SAG_BY_CURRENT, gained(fit, trial), moves)

    found = [of_size(share) for share in SIZES]
    low, here, high = (one.rise for one in found)
    if low + high > 2.0 * here:  # a parabola through the three says where the best one is
        step = 0.5 * (low - high) / (low + high - 2.0 * here)
        found.append(of_size(SIZES[1] + (SIZES[1] - SIZES[0]) * min(max(step, -1.5), 1.5)))
    return [min(found, key=lambda one: one.rise)]


def _by_sag(fit: Fit, bench: Bench) -> Array:
    size = FIRST * SAG_BY_CURRENT.range_of(bench)
    return _by_drive(fit, by_current(fit, fit.motor.K_rad_s_V, size), size)


def _by_bend(fit: Fit, bench: Bench) -> Array:
    size = FIRST * BEND.range_of(bench)
    bent = [
        Steps(window.steps.edge_s, window.steps.u_V * (1.0 - size * window.steps.u_V**2))
        for window in fit.problem.cut.windows
    ]
    return _by_drive(fit, _driven(fit, bent), size)


def _by_drive(fit: Fit, cut: Cut, size: float) -> Array:
    """(n, 1) change of the readings under the drive of ``cut``, for 1 of what is ``size`` there."""
    change = cut.readings(fit.motor, fit.starts) - fit.problem.cut.readings(fit.motor, fit.starts)
    return np.asarray(change / size)[:, None]


def _driven(fit: Fit, drives: Sequence[Steps]) -> Cut:
    """The fit's rows under another drive of each window."""
    cut = fit.problem.cut
    windows = [
        replace(window, series=replace(window.series, edges=drive))
        for window, drive in zip(cut.windows, drives, strict=True)
    ]
    return replace(cut, windows=tuple(windows))


def by_coupling(fit: Fit, coupling: Coupling) -> Array:
    """(n, 1) change of the readings behind that coupling, rad."""
    cut = fit.problem.cut
    stiff_rad = (cut.y_rad + fit.residual_rad)[:, None]
    return -cut.swing(coupling, stiff_rad, fit.starts[:, None, :], 1)


def by_friction_waves(fit: Fit, orders: Sequence[float]) -> Array:
    """(n, 2 m) change of the readings, rad, for 1 V of friction over the angle, sine and cosine of each of m orders."""
    change = np.zeros((fit.residual_rad.size, 2 * len(orders)))
    pieces = list(_pieces(fit))
    speeds = [np.gradient(y_rad, t_s) if t_s.size > 2 else np.zeros(t_s.size) for _, t_s, y_rad in pieces]
    at_rest = AT_REST * max(float(np.abs(speed).max()) for speed in speeds)
    tau_s, gain = fit.motor.tau_s, fit.motor.K_rad_s_V
    for (rows, t_s, y_rad), speed in zip(pieces, speeds, strict=True):
        if t_s.size > 2:
            period_s = float(np.median(np.diff(t_s)))
            stays = math.exp(-period_s / tau_s)
            way = np.where(np.abs(speed) > at_rest, np.sign(speed), 0.0)[:, None]
            phase = np.outer(y_rad, orders)
            against = way * np.stack((np.sin(phase), np.cos(phase)), axis=2).reshape(t_s.size, -1)
            slower = filtered((0.0, -gain * (1.0 - stays)), (-stays,), against)
            change[rows] = period_s * (np.cumsum(slower, axis=0) - 0.5 * slower)
    return change


def _pieces(fit: Fit) -> Iterator[tuple[slice, Array, Array]]:
    """Rows, times, s, and fitted readings, rad, of each piece."""
    cut = fit.problem.cut
    y_rad = cut.y_rad + fit.residual_rad
    for first, stop in pairwise([*cut.begins.tolist(), y_rad.size]):
        yield slice(first, stop), cut.t_s[first:stop], y_rad[first:stop]


def by_current(fit: Fit, K_rad_s_V: float, size_per_V: float) -> Cut:
    """The fit's rows under the drive that is left: less ``size_per_V`` of it for each volt that drives the current.

    The speed is that of the fitted motion.
    """
    cut = fit.problem.cut
    y_rad = cut.y_rad + fit.residual_rad
    drives, first = [], 0
    for window in cut.windows:
        stop = first + window.t_s.size
        speed = np.gradient(y_rad[first:stop], window.t_s)
        drives.append(_less(window.steps, window.t_s, speed, fit.motor.delay_s, K_rad_s_V, size_per_V))
        first = stop
    return _driven(fit, drives)


def _less(steps: Steps, t_s: Array, speed: Array, delay_s: float, K_rad_s_V: float, size_per_V: float) -> Steps:
    edge_s = np.union1d(steps.edge_s, t_s - delay_s)
    edge_s = edge_s[edge_s >= steps.edge_s[0]]
    u_V = steps.u_V[np.searchsorted(steps.edge_s, edge_s, side="right") - 1]
    middle_s = edge_s + 0.5 * np.diff(np.append(edge_s, t_s[-1])) + delay_s
    current_V = u_V - np.interp(middle_s, t_s, speed) / K_rad_s_V
    lost = size_per_V * np.maximum(np.sign(u_V) * current_V, 0.0)
    return Steps(edge_s, u_V * (1.0 - np.minimum(lost, 1.0)))
