"""A static level fs > fc, at rest alone: seen only where the motor stands still under a drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rig.identify.breakaway import Ramps
from rig.identify.laws.coulomb import Coulomb
from rig.identify.laws.law import CLEAR, Doubt, Fitted, LawComparison, LawParameter, Plain, Values
from rig.model.sensitivity import Theta

LEVELS = 24  # that are tried,
LARGEST = 2.0  # up to so many times the moving one

RAMPS = "record breakaway ramps both ways"
SLOW_RAMPS = "record breakaway ramps again, slower"


class Static(Coulomb):
    """Known from breakaway ramps, or else the level that explains the motion best."""

    name = "static"
    title = "Coulomb friction with a static level"
    asymmetric = True
    parameters = (LawParameter("excess_V", 1e-5, fitted=False),)
    has_static_level = True
    confounded_with = ("stribeck",)

    def static_V(self, theta: Theta, own: Sequence[float]) -> float:
        """The moving level and what static friction exceeds it by, V."""
        return theta.fc_V + own[0]

    def trials(self, plain: Plain) -> list[list[float]]:
        """One level between each two drives that occur: between these nothing depends on it."""
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
        """The level, where ramps or the motion show one; only ramps give its error."""
        if ramps is None and not fit.value("excess_V") > 0.0:
            return Values({}, {})
        level_V = fit.value("fc_V") + fit.value("excess_V")
        return Values({"fs_V": level_V}, {"fs_V": math.nan if ramps is None else ramps.error_V})

    def needs(self, against: LawComparison) -> str | Doubt | None:
        """Both ramps, or a motor that stands still in motion."""
        ramps = against.ramps
        if ramps is not None and any(ramps.shown):
            if all(ramps.shown) and against.gain > CLEAR:
                return f"{against.title}: both breakaway ramps show it, and {against.gained}"
            return Doubt("the breakaway ramps do not show it clearly both ways", SLOW_RAMPS)
        if ramps is None and not against.seen:
            return Doubt("the motor never stands still under a drive that could hold it", RAMPS)
        return None
