"""A static level fs > fc, at rest alone. It shows only while the motor stands still under a drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rig.identify.breakaway import Ramps
from rig.identify.laws.coulomb import Coulomb
from rig.identify.laws.law import CLEAR, STATIC_LEVEL, Doubt, Fitted, LawComparison, LawParameter, Plain, Values
from rig.model.sensitivity import Theta

LEVELS = 24  # number of tried levels
LARGEST = 2.0  # the largest of them, times the moving level

RAMPS = "record breakaway ramps both ways"
SLOW_RAMPS = "record breakaway ramps again, slower"


class Static(Coulomb):
    """The static level comes from breakaway ramps, or else is the one that explains the motion best."""

    name = "static"
    title = "Coulomb friction with a static level"
    adds = "+ static level"
    asymmetric = True
    parameters = (LawParameter("excess_V", 1e-5, fitted=False),)
    reports = (STATIC_LEVEL,)
    has_static_level = True
    confounded_with = ("stribeck",)

    def static_V(self, theta: Theta, own: Sequence[float]) -> float:
        """The moving level plus the excess of static friction, V; the excess is the entry of ``own``."""
        return theta.fc_V + own[0]

    def trials(self, plain: Plain) -> list[list[float]]:
        """One level between each two drives of the tests: the motion is the same for all levels between them."""
        drives = np.concatenate([window.steps.u_V for window in plain.windows])
        levels = np.unique(np.abs(drives + plain.asym_V))
        levels = levels[levels > plain.fc_V]
        trials = 0.5 * (np.concatenate(([plain.fc_V], levels[:-1])) + levels) - plain.fc_V
        trials = trials[trials < (LARGEST - 1.0) * plain.fc_V]
        if trials.size > LEVELS:
            trials = np.quantile(trials, np.linspace(0.0, 1.0, LEVELS))
        return [[excess] for excess in trials.tolist()]

    def known(self, plain: Plain, ramps: Ramps | None) -> list[float] | None:
        """The level of the ramps."""
        return None if ramps is None else [max(0.0, ramps.fs_V - plain.fc_V)]

    def report(self, fit: Fitted, ramps: Ramps | None) -> Values:
        """The level, if ramps or the motion show one. Only ramps give its standard error."""
        if ramps is None and not fit.value("excess_V") > 0.0:
            return Values({}, {})
        level_V = fit.value("fc_V") + fit.value("excess_V")
        return Values({"fs_V": level_V}, {"fs_V": math.nan if ramps is None else ramps.error_V})

    def needs(self, against: LawComparison) -> str | Doubt | None:
        """It needs both ramps, or a motor that stands still during a test."""
        ramps = against.ramps
        if ramps is not None and any(ramps.significant):
            if all(ramps.significant) and against.gain > CLEAR:
                return f"{against.title}: both breakaway ramps show it, and {against.gained}"
            return Doubt("the breakaway ramps do not show it clearly both ways", SLOW_RAMPS)
        if ramps is None and not against.seen:
            return Doubt("the motor never stands still under a drive that could hold it", RAMPS)
        return None
