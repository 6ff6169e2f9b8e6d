"""Laws that a bench may have and the motor's model has not: what they do to the readings, and in the place of others.

None is fitted. What such a law would move tau, K and friction by is a line of the budget.

A supply or a bridge with a resistance loses what the current takes from it: much while the shaft speeds up, little once
it turns. Where the records hold few sizes of drive, a sag by the drive alone explains them as well, and then tau, K and
friction are too large by about the share that the largest drives lose. So it is tried in the place of a sag: the drive
less what the fitted motion's current takes, and the other numbers fitted to that.

Behind a soft coupling the reading is, to first order, behind the shaft of a stiff bench by its acceleration over the
square of the coupling's frequency. A fit takes that for a shorter tau and a longer delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rig.identify.departures.choice import TRIAL_ITERATIONS, Chooser, without
from rig.identify.departures.departure import Bench, Departure
from rig.identify.departures.fit import Fit, refitted, solve
from rig.identify.departures.in_place import InPlace, gained
from rig.identify.departures.nuisances import OF
from rig.identify.departures.pieces import Cut
from rig.identify.departures.sag import Sag
from rig.identify.departures.sag_by_current import SagByCurrent
from rig.identify.departures.soft_coupling import SoftCoupling
from rig.recording.series import Steps

Array = NDArray[np.float64]

SIZES = (0.5, 1.0, 1.5)  # of the sag that was found
FIRST = 1.0 / 3.0  # of the range: the size of a sag by the current whose effect stands for all


def outside(fit: Fit, laws: Sequence[Departure], bench: Bench) -> list[tuple[Departure, Array]]:
    """Each such law with the change of the fit's readings, (n, 1), rad for 1 of its size.

    laws   those of the fit: a sag has its own in its place
    """
    found: list[tuple[Departure, Array]] = [(SoftCoupling(), _by_coupling(fit))]
    if not any(isinstance(law, Sag) for law in laws):
        found.append((SagByCurrent(), _by_sag(fit, bench)))
    return found


def instead_of_sag(fit: Fit, laws: Sequence[Departure], chooser: Chooser, bare: Fit) -> list[InPlace]:
    """The best sag by the current in the place of the fit's sag; empty where it has none.

    fit    with its noise
    bare   the same without its sag
    """
    law = next((one for one in laws if isinstance(one, Sag)), None)
    if law is None:
        return []
    others = [one for one in laws if one is not law]
    found = []
    for share in SIZES:
        size = share * fit.motor.sag_per_V
        trial = bare
        for _ in range(2):  # the current is that of the motor as it is fitted
            cut = by_current(fit, trial.motor.K_rad_s_V, size)
            problem = replace(chooser.problem(cut, others, fit.problem.robust_rad), noise=fit.problem.noise)
            trial = solve(refitted(trial, problem, without(trial.motor, law)), TRIAL_ITERATIONS)
        moves = np.array([getattr(trial.motor, name) - getattr(fit.motor, name) for name in OF])
        found.append(InPlace(law, SagByCurrent(), gained(fit, trial), moves))
    return [min(found, key=lambda one: one.rise)]


def _by_sag(fit: Fit, bench: Bench) -> Array:
    size = FIRST * SagByCurrent().range_of(bench)
    cut = by_current(fit, fit.motor.K_rad_s_V, size)
    change = cut.readings(fit.motor, fit.starts) - fit.problem.cut.readings(fit.motor, fit.starts)
    return np.asarray(change / size)[:, None]


def _by_coupling(fit: Fit) -> Array:
    cut = fit.problem.cut
    y_rad = cut.y_rad + fit.residual_rad
    change = np.zeros(y_rad.size)
    for first, stop in pairwise([*cut.begins.tolist(), y_rad.size]):
        if stop - first > 2:
            t_s = cut.t_s[first:stop]
            change[first:stop] = -np.gradient(np.gradient(y_rad[first:stop], t_s), t_s)
    return change[:, None]


def by_current(fit: Fit, K_rad_s_V: float, size_per_V: float) -> Cut:
    """The fit's rows under the drive that is left: less ``size_per_V`` of it for each volt that drives the current.

    The speed is that of the fitted motion.
    """
    cut = fit.problem.cut
    y_rad = cut.y_rad + fit.residual_rad
    windows, first = [], 0
    for window in cut.windows:
        stop = first + window.t_s.size
        speed = np.gradient(y_rad[first:stop], window.t_s)
        drive = _less(window.steps, window.t_s, speed, fit.motor.delay_s, K_rad_s_V, size_per_V)
        windows.append(replace(window, series=replace(window.series, edges=drive)))
        first = stop
    return replace(cut, windows=tuple(windows))


def _less(steps: Steps, t_s: Array, speed: Array, delay_s: float, K_rad_s_V: float, size_per_V: float) -> Steps:
    edge_s = np.union1d(steps.edge_s, t_s - delay_s)
    edge_s = edge_s[edge_s >= steps.edge_s[0]]
    u_V = steps.u_V[np.searchsorted(steps.edge_s, edge_s, side="right") - 1]
    middle_s = edge_s + 0.5 * np.diff(np.append(edge_s, t_s[-1])) + delay_s
    current_V = u_V - np.interp(middle_s, t_s, speed) / K_rad_s_V
    lost = size_per_V * np.maximum(np.sign(u_V) * current_V, 0.0)
    return Steps(edge_s, u_V * (1.0 - np.minimum(lost, 1.0)))
