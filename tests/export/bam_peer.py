"""BAM's loader and its simulation of a free shaft, written anew from its own documents.

Source: better-actuator-models 1.0.2 (Rhoban/bam), which wants Python 3.12: it takes the keys by name, `model` and
`actuator` among those that it knows, leaves out others, and steps by the torque that would stop the shaft, clipped to
the friction's level.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

ACTUATORS = ("mx64", "mx106", "xl320", "xl330", "xl330i", "sts3215")
OF_MOTOR = ("kt", "R", "armature", "q_offset", "friction_base", "friction_viscous")
STRIBECK = ("friction_stribeck", "dtheta_stribeck", "alpha")
LOAD = tuple(f"load_friction_{side}{ending}" for side in ("motor", "external") for ending in ("", "_stribeck"))
KEYS = {"m1": OF_MOTOR, "m2": (*OF_MOTOR, *STRIBECK), "m5": (*OF_MOTOR, *STRIBECK, *LOAD)}


def load(file: Path) -> dict[str, float]:
    """The parameters of a file, as BAM takes them; one that is missing is an error here, not a default."""
    data = json.loads(file.read_text(encoding="utf-8"))
    assert data["actuator"] in ACTUATORS
    return {name: float(data[name]) for name in KEYS[data["model"]]}


def positions(p: dict[str, float], u_V: list[float], period_s: float, step_s: float = 1e-4) -> list[float]:
    """Positions at the ticks, rad, from rest at 0, each drive held for a period."""
    q, v, found = 0.0, 0.0, []
    for volts in u_V:
        found.append(q)
        for _ in range(round(period_s / step_s)):
            torque = p["kt"] * (volts - p["kt"] * v) / p["R"]
            level = p["friction_base"] + p["friction_viscous"] * abs(v)
            if "alpha" in p:
                level += p["friction_stribeck"] * math.exp(-((abs(v) / p["dtheta_stribeck"]) ** p["alpha"]))
            if "load_friction_motor" in p:  # no outside torque
                level += p["load_friction_motor"] * abs(torque)
            stopping = p["armature"] / step_s * v + torque
            acceleration = (torque - math.copysign(min(abs(stopping), level), stopping)) / p["armature"]
            v += acceleration * step_s
            q += v * step_s + 0.5 * acceleration * step_s**2
    return found
