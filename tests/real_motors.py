"""Real motors of the tests: each part, mixtures of parts, and a drive that shows them."""

from __future__ import annotations

import numpy as np

from rig.model.real_motor import PARTS, Frame, RealMotor

PLAIN = RealMotor(0.17, 6.5, 0.5, 0.03, 0.004)
FRAME = Frame(centre_rad=0.2, half_travel_rad=1.3, start_s=-1.0, duration_s=30.0)

EACH = {
    "dead_band": {"dead_band_V": 0.05},
    "gain_by_sign": {"gain_by_sign": 0.03},
    "sag": {"sag_per_V": 0.03},
    "lag": {"lag_s": 0.01},
    "viscous_by_direction": {"viscous_by_direction_V_s_rad": 0.01},
    "static": {"static_V": 0.2},
    "stribeck": {"stribeck_V": 0.15, "stribeck_rad_s": 0.3},
    "drag": {"drag_V_s2_rad2": 0.008},
    "bristle": {"bristle_V_rad": 120.0},
    "force_over_position": {"force_sin_V": 0.05, "force_cos_V": -0.08},
    "friction_over_position": {"friction_sin_V": 0.04, "friction_cos_V": 0.05},
    "cogging": {"cogging_sin_V": 0.06, "cogging_cos_V": 0.05, "cogging_per_rad": 12.0},
    "backlash": {"backlash_rad": 0.02},
    "linearity": {
        "linearity_sin1_rad": 0.01, "linearity_cos1_rad": -0.008, "linearity_sin2_rad": 0.004,
        "linearity_cos2_rad": 0.003,
    },
    "drift": {"drift": 0.1},
    "load_friction": {"load_friction": 0.2, "load_outside": 0.6, "viscous_share": 0.15},
    "source": {"source_per_V2": 0.02},
    "runs_free": {"runs_free": 0.7},
    "no_brake": {"no_brake": 0.6},
    "free_between": {"free_between": 0.8, "full_drive_V": 2.5},
}  # fmt: skip
MIXED = {
    "a loaded arm on a worn gear": ("force_over_position", "friction_over_position", "backlash", "drift"),
    "a cheap stage": ("dead_band", "gain_by_sign", "sag", "lag", "linearity"),
    "a dry bearing": ("static", "stribeck", "viscous_by_direction", "drift"),
    "a stepper as a motor": ("cogging", "drag", "lag", "static"),
    "bristles in a gear": ("bristle", "stribeck", "backlash", "friction_over_position", "lag"),
    "bristles on cogs": ("bristle", "cogging", "viscous_by_direction", "drag", "drift"),
    "a bridge without a brake": ("runs_free", "no_brake", "free_between", "dead_band", "source", "load_friction"),
    "an arm on a servo": ("load_friction", "source", "force_over_position"),
    "everything rigid": tuple(
        name for name in PARTS if name not in ("bristle", "runs_free", "no_brake", "free_between")
    ),
}
CASES = {name: (name,) for name in EACH} | MIXED


def with_parts(*names: str) -> RealMotor:
    """The plain motor with these parts."""
    return PLAIN._replace(**{key: value for name in names for key, value in EACH[name].items()})


def relay(duration_s: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Edges and levels of a drive as two relays make it, with drives of 0 and small ones in between."""
    random = np.random.default_rng(seed)
    edges, levels, at, sign = [0.0], [0.0], 0.05, 1.0
    while at < duration_s:
        for level, lasts in ((1.9, 0.14), (0.0, 0.03), (-0.3 if random.uniform() < 0.3 else 0.2, 0.16)):
            edges.append(at)
            levels.append(sign * level * random.uniform(0.9, 1.1))
            at += lasts * random.uniform(0.7, 1.3)
        if random.uniform() < 0.25:
            edges.append(at)
            levels.append(sign * random.uniform(-0.55, 0.55))
            at += 0.2
        sign = -sign
    return np.array(edges), np.array(levels)
