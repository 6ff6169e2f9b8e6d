"""The predicted limit cycle of a motor under given gains: exact, and by the describing function."""

from __future__ import annotations

from typing import Any

import numpy as np

from rig.model import describing_function
from rig.model.limit_cycle import NoLimitCycle, limit_cycle

LARGEST = 1e6  # of any parameter: no motor has a larger one


def predict_cycle(tau_s: float, K_rad_s_V: float, fc_V: float, fs_V: float, h1_V: float, h2_V: float) -> dict[str, Any]:
    """Limit cycle and stability by Theorems 2.1 and 2.2, and the cycle by the describing function.

    Returns ``oscillates`` (bool). Without a simple oscillation it adds ``reason``; else ``durations_s`` (t1, t2, t3),
    ``period_s``, ``amplitude_rad``, ``y_switch_rad`` (y at 0, t1), ``eigenvalues`` (pairs re, im of J),
    ``largest_eigenvalue_J3``, ``stable``; and ``describing_function`` with ``period_s``, ``amplitude_rad``, or None.
    Raises ValueError on parameters out of range.
    """
    given = {"tau": tau_s, "K": K_rad_s_V, "fc": fc_V, "fs": fs_V, "h1": h1_V, "h2": h2_V}
    for name, value in given.items():
        if not abs(value) <= LARGEST:
            raise ValueError(f"{name} = {value:g} is beyond {LARGEST:g}")
    result: dict[str, Any] = {"oscillates": False, "reason": None, "describing_function": None}
    try:
        sine = describing_function.predict(tau_s, K_rad_s_V, fc_V, h1_V, h2_V)
        result["describing_function"] = {"period_s": sine.period_s, "amplitude_rad": sine.amplitude_rad}
        cycle = limit_cycle(tau_s, K_rad_s_V, fc_V, h1_V, h2_V, fs_V)
    except NoLimitCycle as none:
        result["reason"] = str(none)
        return result
    j3 = np.abs(np.linalg.eigvals(cycle.stage_jacobians()[2])).max()
    return result | {
        "oscillates": True,
        "durations_s": list(cycle.durations_s),
        "period_s": cycle.period_s,
        "amplitude_rad": cycle.amplitude_rad,
        "y_switch_rad": [float(cycle.states[0, 1]), float(cycle.states[1, 1])],
        "eigenvalues": [[value.real, value.imag] for value in cycle.eigenvalues().tolist()],
        "largest_eigenvalue_J3": float(j3),
        "stable": cycle.stable,
    }
