"""BAM (Rhoban/bam): its JSON of a friction model: m1, m2 (friction falls with speed), m5 (it grows with torque).

BAM's motor is in N m: torque t = kt (u - kt v) / R, friction f_b + e exp(-(|v|/v_s)^alpha) + f_v |v|, in m5 with
|L_e t_e - L_m t| beside it for an outside torque t_e. Of a rig motor that is known in N m, with a = kt / R:
f_b = a f_c, f_v = a/K - a kt, armature = a tau/K. Friction that grows with torque shows which part of 1/K is
back-EMF: then kt is (1 - r)/K, and R follows from it.
"""

from __future__ import annotations

import math
from typing import Final

from rig.output.export.motor import IdentifiedMotor
from rig.output.export.tool import NOT_RIGID, ExportError, Tool
from rig.output.export.whole_run import ExportedRun
from rig.run_folder.recording.folder import json_text
from rig.run_folder.results import JsonObject

# What BAM calls the servos that it knows, by what stands in rig's name of a bench.
ACTUATORS: Final = {"xl330": "xl330", "sts3215": "sts3215", "mx-64": "mx64", "mx64": "mx64", "mx-106": "mx106"}
LACKS: Final = {name: why for name, why in NOT_RIGID.items() if name != "load_friction"} | {
    "dead_band": "each drive acts",
    "gain_by_sign": "the torque of a volt is that of both directions together",
    "sag": "the torque of a volt is that of a small drive",
    "lag": "the current follows at once",
    "viscous_by_direction": "friction is that of both directions together",
    "static": "a shaft at rest breaks away at the level of motion",
    "drag": "friction is that of slow motion",
    "force_over_position": "BAM takes a load's mass and length from its log; the armature has its inertia in it",
    "friction_over_position": "friction is its mean over the travel",
    "cogging": "there is none",
    "linearity": "positions are those that the sensor shows",
}


def files(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``motor_bam.json``. Raises ExportError where BAM has no such motor."""
    return {"motor_bam.json": json_text(parameters(motor)).encode("utf-8")}


def parameters(motor: IdentifiedMotor) -> JsonObject:
    """BAM's parameters, and under `rig` what they come from. Raises ExportError where BAM has no such motor."""
    m, a, R_ohm = motor.framed.motor, motor.torque_N_m_V, motor.R_ohm
    grows = m.load_friction > 0.0
    if grows and a is not None:
        R_ohm = (1.0 - m.viscous_share) / (a * m.K_rad_s_V)
    if a is None or R_ohm is None:
        raise ExportError(
            "BAM's models are in N m and ohm", "add --N-m-per-V (`rig newton-metres` tells it) and --R-ohm"
        )
    bench = motor.provenance.bench.lower()
    actuator = next((name for part, name in ACTUATORS.items() if part in bench), None)
    if actuator is None:
        raise ExportError(
            f"BAM has no control law for this bench: {motor.provenance.bench or 'not known'}",
            f"give a run of a servo that it knows: {', '.join(dict.fromkeys(ACTUATORS.values()))}",
        )
    viscous = a / m.K_rad_s_V - a * a * R_ohm
    if viscous < 0.0:
        raise ExportError(
            f"with {R_ohm:g} ohm the back-EMF alone would damp more than this motor is damped",
            f"measure the winding again: it has at most {1.0 / (a * m.K_rad_s_V):.3g} ohm",
        )
    found: JsonObject = {
        "kt": a * R_ohm,
        "R": R_ohm,
        "armature": a * m.tau_s / m.K_rad_s_V,
        "q_offset": _offset_rad(motor),
        "friction_base": a * m.fc_V,
        "friction_viscous": viscous,
        "model": "m1",
        "actuator": actuator,
    }
    if m.stribeck_rad_s > 0.0:
        found |= {
            "friction_stribeck": a * m.stribeck_V,
            "dtheta_stribeck": m.stribeck_rad_s,
            "alpha": 1.0,
            "model": "m2",
        }
    if grows:
        found |= {
            "friction_stribeck": a * m.stribeck_V,
            "dtheta_stribeck": m.stribeck_rad_s or 1.0,
            "alpha": 1.0,
            "load_friction_motor": m.load_friction,
            "load_friction_external": m.load_friction * m.load_outside,
            "load_friction_motor_stribeck": 0.0,
            "load_friction_external_stribeck": 0.0,
            "model": "m5",
        }
    return found | {"rig": motor.as_json()}


def _offset_rad(motor: IdentifiedMotor) -> float:
    """What BAM adds to a position, rad: then 0 is where the load hangs."""
    m = motor.framed.motor
    if m.force_sin_V == 0.0 and m.force_cos_V == 0.0:
        return 0.0
    return math.atan2(m.force_cos_V, m.force_sin_V) - motor.framed.frame.centre_rad


BAM = Tool("BAM", files, LACKS, in_N_m=True)
