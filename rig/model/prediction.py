"""The predicted limit cycle of a motor under given gains: exact, and by the describing function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.core.strict_json import JsonObject
from rig.model import describing_function
from rig.model.describing_function import Oscillation
from rig.model.limit_cycle import LimitCycle, NoLimitCycle, limit_cycle

LARGEST = 1e6  # of any parameter: no motor has a larger one


@dataclass(frozen=True)
class PredictedCycle:
    """What theory expects of a motor under a dual-channel relay.

    exact   the limit cycle by Theorems 2.1 and 2.2; None without a simple oscillation
    reason  why there is none; None if there is one
    sine    the cycle by the describing function; None without one
    """

    exact: LimitCycle | None
    reason: str | None
    sine: Oscillation | None

    def as_json(self) -> JsonObject:
        """As `rig predict --json` prints it.

        ``oscillates``; ``reason``; ``describing_function`` with ``period_s`` and ``amplitude_rad``, or null. Of a
        simple oscillation also ``durations_s`` (t1, t2, t3), ``period_s``, ``amplitude_rad``, ``y_switch_rad`` (y at 0,
        t1), ``eigenvalues`` (pairs re, im of J), ``largest_eigenvalue_J3`` and ``stable``.
        """
        sine, cycle = self.sine, self.exact
        found: JsonObject = {
            "oscillates": cycle is not None,
            "reason": self.reason,
            "describing_function": None
            if sine is None
            else {"period_s": sine.period_s, "amplitude_rad": sine.amplitude_rad},
        }
        if cycle is None:
            return found
        return found | {
            "durations_s": list(cycle.durations_s),
            "period_s": cycle.period_s,
            "amplitude_rad": cycle.amplitude_rad,
            "y_switch_rad": [float(cycle.states[0, 1]), float(cycle.states[1, 1])],
            "eigenvalues": [[value.real, value.imag] for value in cycle.eigenvalues().tolist()],
            "largest_eigenvalue_J3": float(np.abs(np.linalg.eigvals(cycle.stage_jacobians()[2])).max()),
            "stable": cycle.stable,
        }


def predict_cycle(tau_s: float, K_rad_s_V: float, fc_V: float, fs_V: float, h1_V: float, h2_V: float) -> PredictedCycle:
    """Limit cycle and stability by Theorems 2.1 and 2.2, and the cycle by the describing function.

    Raises ValueError on parameters out of range.
    """
    given = {"tau": tau_s, "K": K_rad_s_V, "fc": fc_V, "fs": fs_V, "h1": h1_V, "h2": h2_V}
    for name, value in given.items():
        if not abs(value) <= LARGEST:
            raise ValueError(f"{name} = {value:g} is beyond {LARGEST:g}")
    sine: Oscillation | None = None
    try:
        sine = describing_function.predict(tau_s, K_rad_s_V, fc_V, h1_V, h2_V)
        return PredictedCycle(limit_cycle(tau_s, K_rad_s_V, fc_V, h1_V, h2_V, fs_V), None, sine)
    except NoLimitCycle as none:
        return PredictedCycle(None, str(none), sine)
