"""WPILib: the gains of its feed-forward classes, kS, kV, kA and for an unbalanced load kG, in volts and radians.

``SimpleMotorFeedforward`` computes kS sgn(v) + kV v + kA a, and ``ArmFeedforward`` adds kG cos(angle). A motor of ours
needs (tau a + v) / K + fc sgn(v) + dead band sgn(u) + G(y) - bias.
"""

from __future__ import annotations

import math

from rig.model.real_step import mean_cosine
from rig.output.export.motor import IdentifiedMotor, KnownNumber
from rig.output.export.tool import NOT_RIGID, Tool
from rig.output.export.whole_run import ExportedRun
from rig.run_folder.recording.folder import json_text
from rig.run_folder.results import JsonObject, whole

LACKS = NOT_RIGID | {
    "dead_band": "it is in kS, which is right while the drive has the sign of the velocity",
    "gain_by_sign": "kV and kA are those of both directions together",
    "sag": "the gains are those of a small drive",
    "lag": "ask for the velocity that is wanted the lag later",
    "viscous_by_direction": "kV is that of both directions together",
    "static": "a shaft at rest needs a push beyond kS",
    "stribeck": "kS is that of fast motion; slow motion needs more",
    "drag": "kV is that of slow motion; fast motion needs more",
    "friction_over_position": "kS is its mean over the travel",
    "cogging": "it stays as a ripple",
    "linearity": "positions are those that the sensor shows",
}


def files(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``motor_wpilib.json``."""
    return {"motor_wpilib.json": json_text(gains(motor)).encode("utf-8")}


def gains(motor: IdentifiedMotor) -> JsonObject:
    """The gains with their intervals, and the model that they come from."""
    m = motor.framed.motor
    tau, K, fc, dead_band = (motor.number(name) for name in ("tau_s", "K_rad_s_V", "fc_V", "dead_band_V"))
    simple: JsonObject = {
        "kS": _gain(
            fc.value + dead_band.value, "V", _sum_of_intervals(fc, dead_band), None if dead_band.value else fc.u95
        ),
        "kV": _gain(1.0 / K.value, "V s/rad", _inverse(K.ci95), None if K.u95 is None else K.u95 / K.value**2),
        "kA": _gain(tau.value / K.value, "V s^2/rad", _ratio(tau, K, motor.correlation), None),
    }
    force_V = math.hypot(m.force_sin_V, m.force_cos_V)
    arm: JsonObject = {}
    constant_V = -m.bias_V
    if force_V > 0.0:
        constant_V -= m.force_cos_V * mean_cosine(motor.framed.frame)
        interval = next((whole(law.ci95) for law in motor.laws if law.name == "force_over_position"), None)
        simple["kG"] = _gain(force_V, "V", interval, None)
        # s sin q + c cos q = kG cos(q - atan2(s, c)), with q from the middle of the travel
        offset = -motor.framed.frame.centre_rad - math.atan2(m.force_sin_V, m.force_cos_V)
        arm = {"angle_offset_rad": {"value": offset, "meaning": "add to the position: the angle of ArmFeedforward"}}
    return {
        "mechanism": "Arm" if arm else "Simple",
        "class": "ArmFeedforward" if arm else "SimpleMotorFeedforward",
        "units": {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "output": "V"},
        "gains": simple,
        **arm,
        "constant_V": {"value": constant_V, "meaning": "add to the output: WPILib's classes have no constant drive"},
        "motor": motor.as_json(),
    }


def _gain(value: float, unit: str, ci95: tuple[float, float] | None, u95: float | None) -> JsonObject:
    return {"value": value, "unit": unit, "ci95": None if ci95 is None else list(ci95), "u95": u95}


def _inverse(interval: tuple[float, float] | None) -> tuple[float, float] | None:
    """Interval of 1/x."""
    return None if interval is None or interval[0] <= 0.0 else (1.0 / interval[1], 1.0 / interval[0])


def _sum_of_intervals(one: KnownNumber, other: KnownNumber) -> tuple[float, float] | None:
    """Interval of a sum, as if both errors were one: it is at most so wide."""
    if one.ci95 is None or (other.ci95 is None and other.value != 0.0):
        return None
    low, high = other.ci95 or (0.0, 0.0)
    return one.ci95[0] + low, one.ci95[1] + high


def _ratio(tau: KnownNumber, K: KnownNumber, correlation: float | None) -> tuple[float, float] | None:
    """Interval of tau/K, with the correlation of both; None where it is not known."""
    if tau.ci95 is None or K.ci95 is None or correlation is None:
        return None
    a, b = (0.5 * (n.ci95[1] - n.ci95[0]) / n.value for n in (tau, K) if n.ci95 is not None)
    half = math.sqrt(max(a * a + b * b - 2.0 * correlation * a * b, 0.0)) * tau.value / K.value
    return tau.value / K.value - half, tau.value / K.value + half


WPILIB = Tool("WPILib", files, LACKS)
