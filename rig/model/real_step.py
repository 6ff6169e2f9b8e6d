"""One step of a real motor: its parts, and its motion from one event to the next (docs/theory.md 12.1, 12.2 and 12.3).

    tau dv/dt + v = K (w + bias - G(y) - F - beta |v| - c v |v|),    dy/dt = v,    reading = S(x)

w is the drive behind its stage, G a force over the position, F the friction, x the position behind the backlash, and S
the sensor's linearity. ``RealMotor`` names all numbers; a part whose numbers are 0 is not there.

Between two events an exponential Runge-Kutta method of fourth order (Cox and Matthews, J. Comput. Phys. 176, 2002)
takes ``v`` and ``p = y + tau v``. It is exact where the right side is constant, as it is for a motor without parts. An
event is an edge of the drive, a reversal, or a shaft that breaks away from rest.

The functions are plain Python, and numba compiles the same text (``rig.model.compiled.real_motion``), as it does that
of ``rig.model.step``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

Numbers = tuple[float, ...]  # of a RealMotor or a Frame, without their names


class RealMotor(NamedTuple):
    """A motor with its parts, as numbers. Their order here is the order of every vector and Jacobian of them.

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


class Stages(NamedTuple):
    """Inner stages of one step: target velocities, rad/s, from the second on v, rad/s, y, rad, and f, V; rate, 1/s."""

    a1: float
    a2: float
    a3: float
    a4: float
    v2: float
    y2: float
    f2: float
    v3: float
    y3: float
    f3: float
    v4: float
    y4: float
    f4: float
    slide: float


class Step(NamedTuple):
    """Motion in one direction, or rest.

    sign         direction: +1, -1; 0 where friction holds the motor
    duration_s   how long it lasts, s
    reverses     whether it ends with the velocity at 0
    released     direction in which a held motor breaks away at its end; 0: it does not
    end          state at its end
    stages       of the method
    """

    sign: float
    duration_s: float
    reverses: bool
    released: float
    end: State
    stages: Stages


NO_STAGES = Stages(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
LEAST_LEVEL_V = 1e-4  # of bristles: their friction is divided by the level
LEAST_BEND_RAD = 1e-4  # bristles slide after at least this travel: stiffer ones nobody sees, and they take long
SLIDING = 1e-8  # share of the level that bristles which slide may still lack
LEVEL_CHANGES = 60.0  # what a level that changes along the way costs, as a multiple of its change within a bend
BALANCED = 1e-12  # of K times 1 V: bristles that pull less than this rest
ROUNDS = 60  # of the search for an event, which needs about five
EVENT_S = 1e-14  # the search for an event ends at a step of this size, s

# Largest steps, so that a relay test of 20 s stays within 1e-6 rad of its exact motion.
STEP_OF_TAU = 0.05  # s/s; any part that changes the right side
SHORT_LAG_S = 1e-3  # of a shorter lag the derivative would suffer before the motion does
STEP_OF_LAG = 0.065  # s/s, at 1 V s of fading drive times its time constant; longer the less there is
STEP_OF_TURN = 0.15  # rad of the phase of a force over position
STEP_OF_BRISTLE = 0.25  # of the length over which bristles bend
STEP_OF_SWING = 0.04  # rad of the swing of a motor on a spring
STEP_OF_STRIBECK = 0.2  # of the Stribeck velocity; longer beyond its range


def staged(m: RealMotor, u_V: float) -> float:
    """Drive behind dead band, gain by sign and sag, in this order, before the lag, V."""
    rest = abs(u_V) - m.dead_band_V
    if rest <= 0.0:
        return 0.0
    sign = 1.0 if u_V > 0.0 else -1.0
    size = rest * (1.0 + sign * m.gain_by_sign)
    return sign * size * (1.0 - m.sag_per_V * size)


def lagged(m: RealMotor, staged_V: float, w_V: float, h_s: float) -> float:
    """Drive behind the lag ``h_s`` later, V."""
    return staged_V if m.lag_s <= 0.0 else staged_V + (w_V - staged_V) * math.exp(-h_s / m.lag_s)


def mean_cosine(frame: Frame) -> float:
    """Mean of cos(y - centre) over the travel."""
    return math.sin(frame.half_travel_rad) / frame.half_travel_rad


def force(m: RealMotor, frame: Frame, y: float) -> float:
    """Force over position at ``y``, rad: what it takes from the drive, whichever way the motor moves, V."""
    total = 0.0
    if m.force_sin_V != 0.0 or m.force_cos_V != 0.0:
        q = y - frame.centre_rad
        total += m.force_sin_V * math.sin(q) + m.force_cos_V * (math.cos(q) - mean_cosine(frame))
    if m.cogging_sin_V != 0.0 or m.cogging_cos_V != 0.0:
        q = m.cogging_per_rad * y
        total += m.cogging_sin_V * math.sin(q) + m.cogging_cos_V * math.cos(q)
    return total


def level(m: RealMotor, frame: Frame, speed: float, y: float, t_s: float) -> float:
    """Level of the friction in motion at ``speed`` = abs(v), rad/s, and ``y``, rad; in V."""
    total = m.fc_V
    if m.drift != 0.0:
        total += m.fc_V * m.drift * ((t_s - frame.start_s) / frame.duration_s - 0.5)
    if m.friction_sin_V != 0.0 or m.friction_cos_V != 0.0:
        q = y - frame.centre_rad
        total += m.friction_sin_V * math.sin(q) + m.friction_cos_V * (math.cos(q) - mean_cosine(frame))
    if m.stribeck_V != 0.0 and m.stribeck_rad_s > 0.0:
        # a step that is tried beyond standstill and then cut: compiled, exp is inf there; in Python it raises
        total += m.stribeck_V * math.exp(min(-speed / m.stribeck_rad_s, 700.0))
    return total


def level_at_rest(m: RealMotor, frame: Frame, y: float, t_s: float) -> float:
    """Level that the drive must pass to move the motor from rest at ``y``, rad; in V."""
    return level(m, frame, 0.0, y, t_s) + m.static_V


def level_of_bristles(m: RealMotor, frame: Frame, speed: float, y: float, t_s: float) -> float:
    """Level that the bristles tend to at ``speed``, rad/s, and ``y``, rad; in V, > 0."""
    return max(level(m, frame, speed, y, t_s), LEAST_LEVEL_V)


def stiffness(m: RealMotor, level_V: float) -> float:
    """Stiffness of bristles that slide at ``level_V``, V/rad."""
    return min(m.bristle_V_rad, level_V / LEAST_BEND_RAD)


def target(m: RealMotor, frame: Frame, sign: float, at: State, t_s: float) -> float:
    """Velocity that the motor would tend to if all forces stayed as they are, rad/s: tau dv/dt + v.

    sign   direction of the motion, +1 or -1
    """
    friction = at.f if m.bristle_V_rad > 0.0 else sign * level(m, frame, sign * at.v, at.y, t_s)
    speed = sign * at.v
    viscous = speed * (m.viscous_by_direction_V_s_rad + m.drag_V_s2_rad2 * at.v)
    return m.K_rad_s_V * (at.w + m.bias_V - force(m, frame, at.y) - friction - viscous)


def bending(m: RealMotor, frame: Frame, sign: float, at: State, t_s: float) -> float:
    """Rate of the bristles' friction in the direction ``sign`` (+1 or -1), V/s; 0 without bristles."""
    if m.bristle_V_rad <= 0.0:
        return 0.0
    speed = sign * at.v
    floor = level_of_bristles(m, frame, speed, at.y, t_s)
    return stiffness(m, floor) * (at.v - speed * at.f / floor)


def direction(m: RealMotor, frame: Frame, at: State, staged_V: float, t_s: float) -> float:
    """Direction of motion: the sign of v; from rest that of the acceleration; 0 where friction holds the motor."""
    if at.v != 0.0:
        return 1.0 if at.v > 0.0 else -1.0
    pull = at.w + m.bias_V - force(m, frame, at.y)
    if m.bristle_V_rad > 0.0:
        pull -= at.f
        if abs(pull) <= BALANCED:
            pull = staged_V - at.w if m.lag_s > 0.0 else 0.0
            if abs(pull) <= BALANCED:
                return 0.0
        return 1.0 if pull > 0.0 else -1.0
    held = level_at_rest(m, frame, at.y, t_s)
    if pull > held:
        return 1.0
    return -1.0 if pull < -held else 0.0


def phi4(c: float) -> float:
    """The fourth exponential function at -c: the sum of (-c)^k / (k + 4)!"""
    if c < 0.5:
        total = 1.0
        for k in range(12, 4, -1):
            total = 1.0 - c / k * total
        return total / 24.0
    return ((((1.0 - math.exp(-c)) / c - 1.0) / -c - 0.5) / -c - 1.0 / 6.0) / -c


class Weights(NamedTuple):
    """Weights of a step of ``c`` time constants.

    keep, half   exp(-c) and exp(-c/2)
    mean         of the right side over a half step: (1 - half) / (c/2)
    b1, b2, b4   of the right side at the stages 1, 2 and 3, and 4, over the whole step
    """

    keep: float
    half: float
    mean: float
    b1: float
    b2: float
    b4: float


def weights(c: float) -> Weights:
    """Weights of the method of Cox and Matthews for a step of ``c`` time constants (docs/theory.md 12.3)."""
    p3 = 1.0 / 6.0 - c * phi4(c)
    p2 = 0.5 - c * p3
    p1 = 1.0 - c * p2
    keep = 1.0 - c * p1
    half = math.sqrt(keep)
    return Weights(keep, half, 2.0 * p1 / (1.0 + half), p1 - 3.0 * p2 + 4.0 * p3, 2.0 * p2 - 4.0 * p3, 4.0 * p3 - p2)


NO_FADING = Weights(1.0, 1.0, 1.0, 1.0 / 6.0, 1.0 / 3.0, 1.0 / 6.0)  # of a step of no time constants


def sliding(m: RealMotor, frame: Frame, sign: float, at: State, a1: float, when: tuple[float, float]) -> float:
    """Rate at which the friction of bristles nears its level in the middle of a step, 1/s; 0 without bristles.

    sign   direction of the motion, +1 or -1
    a1     target velocity at the start, rad/s
    when   time of the start of the step, s, and its size, s
    """
    if m.bristle_V_rad <= 0.0:
        return 0.0
    t, h = when
    speed = max(sign * (at.v + 0.5 * h * (a1 - at.v) / m.tau_s), 0.0)
    floor = level_of_bristles(m, frame, speed, at.y, t)
    return stiffness(m, floor) * speed / floor


def moved(
    m: RealMotor, frame: Frame, sign: float, at: State, staged_V: float, when: tuple[float, float]
) -> tuple[State, Stages]:
    """State after a step in the direction ``sign``, and its stages; ``when``: time of its start, s, and its size, s."""
    t, h = when
    tau, middle, end = m.tau_s, t + 0.5 * h, t + h
    c = h / tau
    k = weights(c)
    w2, w4 = lagged(m, staged_V, at.w, 0.5 * h), lagged(m, staged_V, at.w, h)
    v, p, f = at.v, at.y + tau * at.v, at.f
    near = 0.5 * c * k.mean
    a1 = target(m, frame, sign, at, t)
    slide = sliding(m, frame, sign, at, a1, when)
    b = weights(h * slide) if m.bristle_V_rad > 0.0 else NO_FADING
    near_f = 0.5 * h * b.mean
    n1 = bending(m, frame, sign, at, t) + slide * f
    v2 = k.half * v + near * a1
    y2, f2 = p + 0.5 * h * a1 - tau * v2, b.half * f + near_f * n1
    at2 = State(v2, y2, f2, w2, 0.0)
    a2, n2 = target(m, frame, sign, at2, middle), bending(m, frame, sign, at2, middle) + slide * f2
    v3 = k.half * v + near * a2
    y3, f3 = p + 0.5 * h * a2 - tau * v3, b.half * f + near_f * n2
    at3 = State(v3, y3, f3, w2, 0.0)
    a3, n3 = target(m, frame, sign, at3, middle), bending(m, frame, sign, at3, middle) + slide * f3
    v4 = k.half * v2 + near * (2.0 * a3 - a1)
    y4, f4 = p + h * a3 - tau * v4, b.half * f2 + near_f * (2.0 * n3 - n1)
    at4 = State(v4, y4, f4, w4, 0.0)
    a4, n4 = target(m, frame, sign, at4, end), bending(m, frame, sign, at4, end) + slide * f4
    v_end = k.keep * v + c * (k.b1 * a1 + k.b2 * (a2 + a3) + k.b4 * a4)
    p_end = p + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
    f_end = b.keep * f + h * (b.b1 * n1 + b.b2 * (n2 + n3) + b.b4 * n4)
    return (
        State(v_end, p_end - tau * v_end, f_end, w4, at.x),
        Stages(a1, a2, a3, a4, v2, y2, f2, v3, y3, f3, v4, y4, f4, slide),
    )


def longest_step(m: RealMotor, frame: Frame, sign: float, at: State, staged_V: float, t_s: float) -> float:
    """Largest step in the direction ``sign`` (+1 or -1) with a small error, s; inf for a motor without parts."""
    longest = math.inf
    tau, K, speed = m.tau_s, m.K_rad_s_V, abs(at.v)
    pull = abs(target(m, frame, sign, at, t_s) - at.v) / tau  # acceleration, rad/s2
    if m.lag_s > 0.0 and at.w != staged_V:
        longest = min(longest, STEP_OF_LAG * m.lag_s * (abs(at.w - staged_V) * max(m.lag_s, SHORT_LAG_S)) ** -0.2)
    turns = m.force_sin_V != 0.0 or m.force_cos_V != 0.0 or m.friction_sin_V != 0.0 or m.friction_cos_V != 0.0
    distance = STEP_OF_TURN if turns else math.inf
    spring = 0.0
    if m.cogging_sin_V != 0.0 or m.cogging_cos_V != 0.0:
        distance = min(distance, STEP_OF_TURN / abs(m.cogging_per_rad)) if m.cogging_per_rad != 0.0 else distance
        spring += abs(m.cogging_per_rad) * (abs(m.cogging_sin_V) + abs(m.cogging_cos_V))
    if m.bristle_V_rad > 0.0:  # the nearer they are to sliding, the less they matter
        floor = level_of_bristles(m, frame, speed, at.y, t_s)
        stiff = stiffness(m, floor)
        left = min(max(abs(1.0 - sign * at.f / floor), SLIDING), 2.0)
        left += LEVEL_CHANGES * (abs(m.friction_sin_V) + abs(m.friction_cos_V)) / stiff
        if m.stribeck_V != 0.0 and m.stribeck_rad_s > 0.0:
            left += abs(m.stribeck_V) * math.exp(-speed / m.stribeck_rad_s) / floor
        distance = min(distance, STEP_OF_BRISTLE * floor / stiff * left**-0.25)
        spring += stiff * left
    if distance < math.inf:
        longest = min(longest, 2.0 * distance / (speed + math.sqrt(speed * speed + 2.0 * pull * distance) + 1e-9))
    if spring > 0.0:
        longest = min(longest, STEP_OF_SWING * math.sqrt(tau / (K * spring)))
    falls = m.stribeck_V != 0.0 and m.stribeck_rad_s > 0.0
    if falls:
        unit = m.stribeck_rad_s
        fade = math.exp(min(speed / (5.0 * unit), 50.0))
        longest = min(longest, STEP_OF_STRIBECK * fade * unit / (pull + K * abs(m.stribeck_V) / tau + 1e-9))
    if falls or turns or spring > 0.0 or m.viscous_by_direction_V_s_rad != 0.0 or m.drag_V_s2_rad2 != 0.0:
        longest = min(longest, STEP_OF_TAU * tau)
    return longest


def next_step(m: RealMotor, frame: Frame, at: State, staged_V: float, t_s: float, longest_s: float) -> Step:
    """The next step under the constant drive ``staged_V`` before its lag: at most ``longest_s`` long, to an event."""
    sign = direction(m, frame, at, staged_V, t_s)
    if sign == 0.0:
        return rest(m, frame, at, staged_V, t_s, longest_s)
    h = min(longest_s, longest_step(m, frame, sign, at, staged_V, t_s))
    end, stages = moved(m, frame, sign, at, staged_V, (t_s, h))
    if sign * end.v > 0.0:
        return Step(sign, h, False, 0.0, end, stages)
    if at.v == 0.0:  # rounding sends a motor in balance back: it stays
        return Step(0.0, h, False, 0.0, State(0.0, at.y, at.f, end.w, at.x), stages)
    low, high = 0.0, h
    for _ in range(ROUNDS):
        slope = sign * (target(m, frame, sign, end, t_s + h) - end.v) / m.tau_s
        new = h - sign * end.v / slope if slope < 0.0 else 0.5 * (low + high)
        if not low < new < high:
            new = 0.5 * (low + high)
        change, h = abs(new - h), new
        end, stages = moved(m, frame, sign, at, staged_V, (t_s, h))
        if change <= EVENT_S or end.v == 0.0:
            break
        if sign * end.v > 0.0:
            low = h
        else:
            high = h
    return Step(sign, h, True, 0.0, State(0.0, end.y, end.f, end.w, at.x), stages)


def margin(m: RealMotor, frame: Frame, sign: float, at: State, staged_V: float, when: tuple[float, float]) -> float:
    """By how much the pull in the direction ``sign`` on a motor at rest is above its level, V, a time after a start."""
    t, h = when
    pull = lagged(m, staged_V, at.w, h) + m.bias_V - force(m, frame, at.y)
    return sign * pull - level_at_rest(m, frame, at.y, t + h)


def rest(m: RealMotor, frame: Frame, at: State, staged_V: float, t_s: float, longest_s: float) -> Step:
    """The next step of a motor that friction holds: to its end, or to where it breaks away."""
    h, released = longest_s, 0.0
    changes = m.lag_s > 0.0 or m.drift != 0.0
    if changes and m.bristle_V_rad <= 0.0:
        if m.lag_s > 0.0 and m.drift != 0.0:
            h = min(h, max(m.lag_s, 1e-3))  # within it the margin has no second zero
        for sign in (1.0, -1.0):
            if margin(m, frame, sign, at, staged_V, (t_s, h)) > 0.0:
                low, high = 0.0, h
                for _ in range(ROUNDS):
                    middle = 0.5 * (low + high)
                    if margin(m, frame, sign, at, staged_V, (t_s, middle)) > 0.0:
                        high = middle
                    else:
                        low = middle
                h, released = high, sign
    end = State(0.0, at.y, at.f, lagged(m, staged_V, at.w, h), at.x)
    return Step(0.0, h, False, released, end, NO_STAGES)


def behind_play(m: RealMotor, sign: float, at: State) -> float:
    """Position of the sensor's side of the backlash, rad, of a motor that moves in the direction ``sign``."""
    if sign > 0.0:
        return max(at.x, at.y - 0.5 * m.backlash_rad)
    return min(at.x, at.y + 0.5 * m.backlash_rad) if sign < 0.0 else at.x


def reading(m: RealMotor, frame: Frame, x: float) -> float:
    """What the sensor shows at the position ``x`` of its side, rad (docs/theory.md 12.5)."""
    if (
        m.linearity_sin1_rad == 0.0
        and m.linearity_cos1_rad == 0.0
        and m.linearity_sin2_rad == 0.0
        and m.linearity_cos2_rad == 0.0
    ):
        return x
    share = (x - frame.centre_rad) / frame.half_travel_rad
    q = math.pi * share
    return (
        x
        + m.linearity_sin1_rad * (math.sin(q) - 3.0 / math.pi * share)
        + m.linearity_cos1_rad * math.cos(q)
        + m.linearity_sin2_rad * (math.sin(2.0 * q) + 1.5 / math.pi * share)
        + m.linearity_cos2_rad * math.cos(2.0 * q)
    )


def advance(m: RealMotor, frame: Frame, at: State, u_V: float, t_s: float, dt_s: float) -> State:
    """State ``dt_s`` seconds after ``t_s`` under the constant drive ``u_V``, through every event.

    Its ``x`` is where the sensor's side is at the end. ``delay_s`` is not applied: a caller knows when a drive acts.
    """
    drive_V = staged(m, u_V)
    if m.lag_s <= 0.0:
        at = State(at.v, at.y, at.f, drive_V, at.x)
    left_s = dt_s
    while left_s > 0.0:
        step = next_step(m, frame, at, drive_V, t_s + dt_s - left_s, left_s)
        v, y, f, w, _ = step.end
        at = State(v, y, f, w, behind_play(m, step.sign, step.end))
        left_s -= step.duration_s
    return at
