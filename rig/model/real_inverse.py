"""The inverse of a real motor: which drive gives a wanted acceleration.

The parts are those of ``rig.model.real_step``. Left out is what has no inverse at an instant: lag, bristles, backlash
and drift (docs/theory.md 11.4).
"""

from __future__ import annotations

import math

from rig.core.motor_numbers import Frame, RealMotor
from rig.model.real_step import force, level

SOFT_SHARE = 0.1  # of fc: so little drive behind the stage moves no shaft, and the dead band is crossed within it
STILL_SHARE = 0.03  # of tau: within it a shaft that has broken away leaves the static level behind


def drive_before_stage(m: RealMotor, wanted_V: float) -> float:
    """Drive, V, whose stage gives ``wanted_V``: the inverse of ``real_step.staged``, continuous in ``wanted_V``.

    Within a tenth of fc around zero it crosses the dead band on a straight line, so that noise there does not make the
    drive jump to and fro. Of a stage that sags, a drive beyond the largest that it can give gets that one.
    """
    size = abs(wanted_V)
    if size == 0.0:
        return 0.0
    sign = 1.0 if wanted_V > 0.0 else -1.0
    given_V = size if m.sag_per_V <= 0.0 else min(size, 0.25 / m.sag_per_V)
    before_sag = 2.0 * given_V / (1.0 + math.sqrt(1.0 - 4.0 * m.sag_per_V * given_V))
    soft_V = SOFT_SHARE * m.fc_V
    crossed = 1.0 if size >= soft_V else size / soft_V
    return sign * (before_sag / (1.0 + sign * m.gain_by_sign) + crossed * m.dead_band_V)


def drive_for_torque(m: RealMotor, torque_V: float, v: float, outside_V: float, direction: float) -> float:
    """Drive behind the stage, V, whose torque is ``torque_V`` beyond the friction that grows with it.

    v           speed, rad/s
    outside_V   force over position, V
    direction   in which friction acts against it; 0: no friction
    """
    seen_V = torque_V + m.load_outside * outside_V
    against = math.copysign(m.load_friction, direction * seen_V) if direction != 0.0 else 0.0
    passed_V = torque_V + against * seen_V / (1.0 - against)
    back_V = (1.0 - m.viscous_share) * v / m.K_rad_s_V
    braking_V = (1.0 - m.free_between) * back_V  # at no drive
    if m.no_brake > 0.0 and min(0.0, -braking_V) < passed_V < max(0.0, -braking_V):
        if abs(passed_V) >= (1.0 - m.no_brake) * abs(braking_V):
            return 0.0  # no drive brakes so: with the motion it is too little, against it too much
        passed_V /= 1.0 - m.no_brake
    always_on_V = _against_supply(m, passed_V, passed_V + back_V, 1.0)
    if m.free_between <= 0.0 or abs(always_on_V) >= m.full_drive_V:
        return always_on_V
    wanted_V = passed_V + braking_V
    gain = 1.0 - math.copysign(m.free_between / m.full_drive_V, wanted_V) * back_V  # of a drive, whose pulses brake
    return _against_supply(m, passed_V, wanted_V, gain) if gain > 0.0 else 0.0


def _against_supply(m: RealMotor, passed_V: float, wanted_V: float, gain: float) -> float:
    """Drive w with ``gain w = wanted_V + rho w^2 passed_V``, V; where none gives as much, the one that gives most."""
    inside = gain**2 - 4.0 * m.source_per_V2 * passed_V * wanted_V
    return 2.0 * wanted_V / (gain + math.sqrt(max(inside, 0.0)))


def still_share(m: RealMotor, speed_rad_s: float) -> float:
    """How much of the static level a drive has to add at an estimated speed, rad/s: 1 at rest, 0 in motion.

    An estimate is never exactly 0. So it falls over the speed that the static level itself gives within 0.03 tau.
    """
    still_rad_s = STILL_SHARE * m.K_rad_s_V * m.static_V
    return max(1.0 - speed_rad_s / still_rad_s, 0.0) if still_rad_s > 0.0 else 0.0


def drive_for(
    m: RealMotor, frame: Frame, at: tuple[float, float], acceleration_rad_s2: float, direction: float
) -> float:
    """Drive, V, that gives the acceleration against all forces.

    at         velocity, rad/s, and position, rad
    direction  in which friction acts against the drive: only its sign counts; 0: no friction. A shaft that stands, or
               still moves the other way, has to break away
    """
    v, y = at
    friction = 0.0
    if direction != 0.0:
        speed = max(math.copysign(v, v * direction), 0.0)
        height_V = level(m, frame, speed, y) + still_share(m, speed) * m.static_V
        friction = math.copysign(height_V, direction)
    viscous = abs(v) * (m.viscous_by_direction_V_s_rad + m.drag_V_s2_rad2 * v)
    outside_V = force(m, frame, y)
    wanted_V = (m.tau_s * acceleration_rad_s2 + v) / m.K_rad_s_V + outside_V + friction + viscous - m.bias_V
    if m.load_friction > 0.0 or m.source_per_V2 > 0.0 or m.no_brake > 0.0 or m.free_between > 0.0:
        back_V = (1.0 - m.viscous_share) * v / m.K_rad_s_V
        wanted_V = drive_for_torque(m, wanted_V - back_V, v, outside_V, direction)
    return drive_before_stage(m, wanted_V)
