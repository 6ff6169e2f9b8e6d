"""MuJoCo: the shaft as a hinge with its actuator, and a Python file for the laws that MJCF has no words for.

Without the torque of a volt, torques are in volts of drive: one volt at the motor is one N m of the model. With it they
are in N m, and the actuator gives no more than the supply can.
"""

from __future__ import annotations

import math
from xml.sax.saxutils import escape, quoteattr

from rig.model.real_step import mean_cosine
from rig.output.export.motor import IdentifiedMotor, law_words
from rig.output.export.tool import NOT_RIGID, Tool, python_file, rendered
from rig.output.export.whole_run import ExportedRun

STEP_S = 1e-4
GRAVITY_M_S2 = 9.81
LEVER_SHARE = 0.01  # of the inertia that the load of the lever takes; the armature has the rest
SHAFT_SHARE = 1e-6  # of the inertia, about the body's own centre: MuJoCo wants some
# Parts that motor_mujoco.py adds to motor.xml.
BY_HAND = (
    "dead_band", "gain_by_sign", "sag", "viscous_by_direction", "static", "stribeck", "friction_over_position",
    "cogging", "linearity", "load_friction", "source", "runs_free", "no_brake",
    "free_between",
)  # fmt: skip
LACKS = {part: why for part, why in NOT_RIGID.items() if part not in BY_HAND}


def files(motor: IdentifiedMotor, run: ExportedRun) -> dict[str, bytes]:
    """``motor.xml``, and ``motor_mujoco.py``, which steps it with every law."""
    m, frame = motor.framed.motor, motor.framed.frame
    a = motor.torque_N_m_V or 1.0
    inertia = a * m.tau_s / m.K_rad_s_V
    pull = a * math.hypot(m.force_sin_V, m.force_cos_V)
    # s sin q + c cos q = pull sin(y - hanging): the load hangs at rest where y = hanging
    hanging_rad = frame.centre_rad - math.atan2(m.force_cos_V, m.force_sin_V)
    lever_m = LEVER_SHARE * inertia * GRAVITY_M_S2 / pull if pull > 0.0 else 0.01
    mass_kg = pull / (GRAVITY_M_S2 * lever_m) if pull > 0.0 else 1e-9
    bias_V = m.bias_V + m.force_cos_V * mean_cosine(frame)
    by_hand = [part for part in BY_HAND if part in motor.framed.parts]
    alone = [f"motor_mujoco.py adds {part}: this file alone has it not" for part in by_hand]
    text = rendered(
        "motor.xml.j2",
        head=_in_comment("\n".join([*motor.head(), *alone])),
        numbers=[_in_comment(one.line()) for one in motor.numbers],
        step_s=STEP_S,
        gravity=GRAVITY_M_S2,
        armature=inertia - mass_kg * lever_m**2 - SHAFT_SHARE * inertia,
        own=SHAFT_SHARE * inertia,
        # MuJoCo before 3.5 takes one number
        damping=f"{a / m.K_rad_s_V!r}" + (f" {a * m.drag_V_s2_rad2!r}" if m.drag_V_s2_rad2 else ""),
        frictionloss=a * m.fc_V,
        solref=f"{2.0 * STEP_S!r} 1",
        mass=mass_kg,
        lever=lever_m,
        hanging=-hanging_rad,
        lag=m.lag_s,
        torque=motor.torque_N_m_V,
        gain=a,
        bias=a * bias_V,
        most=_most_N_m(motor, run, bias_V),
        by_hand=by_hand,
        about=[(name, quoteattr(value)) for name, value in _about(motor, alone).items()],
    )
    code = python_file("motor_mujoco.py.j2", motor, torque=a)
    return {"motor.xml": text, "motor_mujoco.py": code}


def _most_N_m(motor: IdentifiedMotor, run: ExportedRun, bias_V: float) -> float | None:
    """The torque that the full supply gives at standstill, N m; None: not known."""
    supply = run.recording.meta.drive
    if motor.torque_N_m_V is None or supply is None or not supply.supply_V:
        return None
    return motor.torque_N_m_V * (supply.supply_V - (supply.bridge_drop_V or 0.0) + abs(bias_V))


def _in_comment(text: str) -> str:
    """A text that ends no comment of XML."""
    return escape(text).replace("--", "- -")


def _about(motor: IdentifiedMotor, alone: list[str]) -> dict[str, str]:
    """What the compiled model carries as texts."""
    source = motor.provenance
    return {
        "run": source.run,
        "record_sha256": source.record_sha256 or "",
        "verdict": source.verdict,
        "laws": "; ".join(map(law_words, motor.laws)) or "none",
        "lacks": "; ".join([*alone, *motor.lacks_in_words()]) or "nothing",
    }


MUJOCO = Tool("MuJoCo", files, LACKS, in_N_m=True)
