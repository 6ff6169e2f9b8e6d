"""Run folders whose result has the laws that a test asks for: a golden recording with a result.json of its own."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.identification.known_model import known_model
from rig.model.real_motor import PARTS, FramedMotor, MovingMotor

Array = NDArray[np.float64]
GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "simulated"
PERIOD_S = 0.01
PLAIN = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48, "asym_V": -0.01, "delay_s": 0.0012}
FRAME = {"centre_rad": 0.1, "half_travel_rad": 1.2, "start_s": 0.0, "duration_s": 20.0}
# Each with a size that the real motors of docs/evidence/real-motors-table.md have.
LAWS: dict[str, dict[str, float]] = {
    "dead_band": {"dead_band_V": 0.15},
    "gain_by_sign": {"gain_by_sign": 0.04},
    "sag": {"sag_per_V": 0.02},
    "lag": {"lag_s": 0.008},
    "viscous_by_direction": {"viscous_by_direction_V_s_rad": 0.01},
    "static": {"static_V": 0.12},
    "stribeck": {"stribeck_V": 0.15, "stribeck_rad_s": 0.3},
    "drag": {"drag_V_s2_rad2": 0.004},
    "force_over_position": {"force_sin_V": 0.06, "force_cos_V": 0.04},
    "friction_over_position": {"friction_sin_V": 0.05, "friction_cos_V": -0.03},
    "cogging": {"cogging_sin_V": 0.03, "cogging_cos_V": 0.02, "cogging_per_rad": 12.0},
    "linearity": {
        "linearity_sin1_rad": 0.01, "linearity_cos1_rad": 0.005, "linearity_sin2_rad": 0.004, "linearity_cos2_rad": 0.0,
    },
    "backlash": {"backlash_rad": 0.01},
    "bristle": {"bristle_V_rad": 50.0},
    "drift": {"drift": 0.1},
    "load_friction": {"load_friction": 0.2, "load_outside": 0.5, "viscous_share": 0.1},
    "source": {"source_per_V2": 0.002, "viscous_share": 0.1},
    "runs_free": {"runs_free": 0.8},
    "no_brake": {"no_brake": 0.8},
    "free_between": {"free_between": 0.8, "full_drive_V": 8.0},
}  # fmt: skip
assert all(set(numbers) == set(PARTS[name]) for name, numbers in LAWS.items())


def run_with(folder: Path, *laws: str, verdict: str = "ok", golden: Path = GOLDEN) -> Path:
    """A run folder, named by its laws, whose result has a plain motor, or one with these laws."""
    run = folder / f"20260101T000000Z-{'-'.join(laws) or 'plain'}"
    shutil.copytree(golden, run)
    (run / "golden.json").unlink()
    estimate: dict[str, Any] = {
        **PLAIN,
        "covariance_of": ["tau_s", "K_rad_s_V"],
        "correlation": [[1.0, 0.5], [0.5, 1.0]],
        "ci95": {name: [value - 0.001, value + 0.001] for name, value in PLAIN.items()},
        "verdict": verdict,
        "reasons": [] if verdict == "ok" else ["why */ it is --> so"],
    }
    result: dict[str, Any] = {"schema": 1, "estimates": {"sampled-data": estimate}, "law": [], "u95": {"tau_s": 0.002}}
    if laws:
        result["with_law"], result["law_frame"] = estimate, FRAME
        result["law"] = [
            {"name": law, "value": float(np.hypot.reduce(list(LAWS[law].values()))), "unit": "V", "ci95": [0.0, 1.0],
             "bic": 30.0, "numbers": LAWS[law]}
            for law in laws
        ]  # fmt: skip
    (run / "result.json").write_text(json.dumps(result), encoding="utf-8")
    return run


def motor_of(run: Path) -> FramedMotor:
    """Its motor, as rig reads it."""
    return known_model(run, math.inf)


def drive(ticks: int = 400) -> Array:
    """A drive that reverses, rests, creeps about the level of friction, and jumps, V, one for each tick."""
    k = np.arange(ticks)
    swing = 1.3 * np.sign(np.sin(k / 11.0)) + 0.5 * np.sin(k / 37.0)
    quiet = 0.62 * np.sin(k / 23.0)
    return np.where((k // 100) % 2 == 0, swing, quiet)


def own_motion(motor: FramedMotor, u_V: Array, period_s: float = PERIOD_S) -> tuple[Array, Array]:
    """What rig's own motor does under that drive, from rest at 0: readings, rad, and velocities, rad/s, per tick."""
    moving = MovingMotor(motor.motor, motor.frame, 0.0)
    readings, velocities = [], []
    for k, volts in enumerate(u_V.tolist()):
        readings.append(moving.reading_rad)
        velocities.append(moving.state.v)
        moving.advance(volts, k * period_s, period_s)
    return np.array(readings), np.array(velocities)
