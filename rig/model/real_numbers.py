"""The numbers of a real motor by name. A command that only reads a config imports them, and loads no physics."""

from __future__ import annotations

import math
from typing import NamedTuple

Numbers = tuple[float, ...]  # of a RealMotor or a Frame, without their names


class RealMotor(NamedTuple):
    """A motor with its parts, as numbers. Their order here is that of every vector and Jacobian of them, and of the C.

    tau_s, K_rad_s_V   time constant, s, and gain, (rad/s)/V, both > 0; viscous friction equal both ways is in both
    fc_V               Coulomb friction: mean over both directions, the run and the travel, V, >= 0
    bias_V             constant added to the drive, V; friction that differs by direction is in it
    delay_s            by which the drive acts later than its edges say, s
    dead_band_V        drive up to which the stage gives nothing, V, >= 0; above it is missing from the drive
    gain_by_sign       g: the stage gives u (1 + g sgn u)
    sag_per_V          s: the stage gives u (1 - s |u|), 1/V
    lag_s              time constant of the stage and the current, s, >= 0
    viscous_by_direction_V_s_rad   beta: half the difference of the viscous friction of both directions, V s/rad
    static_V           by which the level at rest is above the level in motion, V, >= 0
    stribeck_V, stribeck_rad_s   e, v_s: friction e exp(-|v|/v_s) beside fc, V, and its velocity, rad/s
    drag_V_s2_rad2     c: drag c v |v|, V s2/rad2
    bristle_V_rad      sigma_0: stiffness of the bristles, V/rad, > 0; 0: rigid, with stick and release
    force_sin_V, force_cos_V         force over position, one period per turn, V
    friction_sin_V, friction_cos_V   friction over position, one period per turn, V
    cogging_sin_V, cogging_cos_V, cogging_per_rad   force of a period of its own, V, and its order n, 1/rad
    backlash_rad       whole width of the play between motor and sensor, rad, >= 0
    linearity_sin1_rad, linearity_cos1_rad, linearity_sin2_rad, linearity_cos2_rad   the sensor's curvature, rad
    drift              relative change of fc from the frame's start to its end
    load_friction, load_outside      L, l: friction L |p + l G| beside fc, of the motor's torque p, V, and of the force
                       over position G, V; 0 <= L < 1, l >= 0
    viscous_share      r: share of 1/K that is viscous friction, and no back-EMF, 0 <= r < 1
    source_per_V2      rho: the torque is p = (w - (1 - r) v/K) / (1 + rho w^2), 1/V2, >= 0; the supply's resistance
                       over the winding's, over the square of the supply's voltage
    """

    tau_s: float
    K_rad_s_V: float
    fc_V: float
    bias_V: float = 0.0
    delay_s: float = 0.0
    dead_band_V: float = 0.0
    gain_by_sign: float = 0.0
    sag_per_V: float = 0.0
    lag_s: float = 0.0
    viscous_by_direction_V_s_rad: float = 0.0
    static_V: float = 0.0
    stribeck_V: float = 0.0
    stribeck_rad_s: float = 0.0
    drag_V_s2_rad2: float = 0.0
    bristle_V_rad: float = 0.0
    force_sin_V: float = 0.0
    force_cos_V: float = 0.0
    friction_sin_V: float = 0.0
    friction_cos_V: float = 0.0
    cogging_sin_V: float = 0.0
    cogging_cos_V: float = 0.0
    cogging_per_rad: float = 0.0
    backlash_rad: float = 0.0
    linearity_sin1_rad: float = 0.0
    linearity_cos1_rad: float = 0.0
    linearity_sin2_rad: float = 0.0
    linearity_cos2_rad: float = 0.0
    drift: float = 0.0
    load_friction: float = 0.0
    load_outside: float = 0.0
    viscous_share: float = 0.0
    source_per_V2: float = 0.0


class Frame(NamedTuple):
    """What the parts over position and time refer to: constants of a fit, and no parameters.

    centre_rad, half_travel_rad   middle of the driven travel, rad, and half its width, rad, > 0
    start_s, duration_s           time of the run's start, s, and its duration, s, > 0; only ``drift`` uses them
    """

    centre_rad: float = 0.0
    half_travel_rad: float = math.pi
    start_s: float = 0.0
    duration_s: float = 1.0


class State(NamedTuple):
    """State of a real motor.

    v, y   velocity, rad/s, and position, rad, of the motor's side of the backlash
    f      friction of the bristles, V; 0 without them
    w      drive behind its stage, V
    x      position of the sensor's side of the backlash when the motor last reversed, rad
    """

    v: float
    y: float
    f: float
    w: float
    x: float
