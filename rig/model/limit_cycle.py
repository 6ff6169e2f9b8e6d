"""The exact limit cycle under a dual-channel relay (Theorem 2.1), and its stability (Theorem 2.2).

The relay u = -h1 sgn(y) - h2 sgn(z) drives tau dv/dt + v = K (u - fc sgn(v)), dy/dt = v, dz/dt = y. At time 0 the
drive steps up to h1 + h2 (docs/theory.md 3.1, 3.2 and 3.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.model.linear import input_vector, transition

# The plane that ends each stage: RA (velocity), RB (position), RC (integral).
PLANES = np.eye(3)

# Range of h1 / (h2 - fc), which sets the period in tau. Outside it double precision cannot separate the stages.
COMPUTED = (1e-4, 1.1e3)


class NoLimitCycle(Exception):
    """The motor and the relay have no simple oscillation. The message says why."""


@dataclass(frozen=True)
class LimitCycle:
    """A simple oscillation: each relay switches once per half period.

    durations_s    t1 (until v crosses zero), t2 (until y does), t3 (until z does), s
    inputs_V       effective inputs of the three stages
    states         (4, 3): [v, y, z] at 0, t1, t1 + t2, t1 + t2 + t3, in rad/s, rad, rad s
    tau_s, K_rad_s_V   of the motor
    """

    durations_s: tuple[float, float, float]
    inputs_V: tuple[float, float, float]
    states: Array
    tau_s: float
    K_rad_s_V: float

    @property
    def period_s(self) -> float:
        """T = 2 (t1 + t2 + t3), s."""
        return 2.0 * sum(self.durations_s)

    @property
    def amplitude_rad(self) -> float:
        """Largest |y|, reached at t1, rad."""
        return -float(self.states[1, 1])

    @property
    def speed_rad_s(self) -> float:
        """Largest |v|, rad/s."""
        return float(np.abs(self.states[:, 0]).max())

    def stage_jacobians(self) -> tuple[Array, Array, Array]:
        """J1, J2, J3 of Theorem 2.2: Ji = (I - wi Ci / (Ci wi)) Phi_i."""
        jacobians = []
        for i, (duration, U) in enumerate(zip(self.durations_s, self.inputs_V, strict=True)):
            v, y, _ = self.states[i + 1]
            w = np.array([(self.K_rad_s_V * U - v) / self.tau_s, v, y])
            projection = np.eye(3) - np.outer(w, PLANES[i]) / w[i]
            jacobians.append(projection @ transition(self.tau_s, duration))
        return jacobians[0], jacobians[1], jacobians[2]

    def jacobian(self) -> Array:
        """J = J3 J2 J1 of the map from one half period to the next."""
        j1, j2, j3 = self.stage_jacobians()
        return np.asarray(j3 @ j2 @ j1)

    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of J, by falling magnitude; one is 0 (along the switching plane)."""
        values = np.linalg.eigvals(self.jacobian()).astype(complex)
        return values[np.argsort(-np.abs(values))]

    @property
    def stable(self) -> bool:
        """Locally stable: every eigenvalue of J inside the unit circle (Theorem 2.2)."""
        return bool(np.abs(self.eigenvalues()).max() < 1.0)


def effective_inputs(fc_V: float, h1_V: float, h2_V: float) -> tuple[float, float, float]:
    """Effective inputs of the three stages, V (docs/theory.md 3.1)."""
    return h1_V + h2_V + fc_V, h1_V + h2_V - fc_V, h2_V - h1_V - fc_V


def initial_state(
    tau_s: float, K_rad_s_V: float, durations_s: tuple[float, float, float], inputs_V: tuple[float, float, float]
) -> Array:
    """x(0) from odd symmetry, x(T/2) = -x(0) (docs/theory.md 3.2)."""
    phi, forced = np.eye(3), np.zeros(3)
    for duration, U in zip(durations_s, inputs_V, strict=True):
        step = transition(tau_s, duration)
        phi = step @ phi
        forced = step @ forced + input_vector(tau_s, K_rad_s_V, duration) * U
    return np.asarray(-np.linalg.solve(np.eye(3) + phi, forced))


def stage_states(
    tau_s: float, K_rad_s_V: float, durations_s: tuple[float, float, float], inputs_V: tuple[float, float, float]
) -> Array:
    """(4, 3): [v, y, z] at the begin and at the end of each stage, from odd symmetry."""
    states = [initial_state(tau_s, K_rad_s_V, durations_s, inputs_V)]
    for duration, U in zip(durations_s, inputs_V, strict=True):
        states.append(transition(tau_s, duration) @ states[-1] + input_vector(tau_s, K_rad_s_V, duration) * U)
    return np.array(states)


def limit_cycle(
    tau_s: float, K_rad_s_V: float, fc_V: float, h1_V: float, h2_V: float, fs_V: float | None = None
) -> LimitCycle:
    """The simple oscillation of Theorem 2.1.

    fs_V   static friction, V; default: fc_V
    Raises NoLimitCycle with the reason if there is none, ValueError on parameters out of range.
    """
    static = fc_V if fs_V is None else fs_V
    if not (tau_s > 0.0 and K_rad_s_V > 0.0 and h1_V > 0.0 and h2_V >= 0.0 and 0.0 <= fc_V <= static):
        raise ValueError("need tau, K, h1 > 0, h2 >= 0 and 0 <= f_c <= f_s")
    if h2_V <= fc_V:
        raise NoLimitCycle(f"h2 = {h2_V:g} V does not exceed the friction of {fc_V:g} V (Property 3.1)")
    if h1_V + h2_V <= static:
        raise NoLimitCycle(
            f"the motor sticks: h1 + h2 = {h1_V + h2_V:g} V does not exceed static friction, {static:g} V"
        )
    ratio = h1_V / (h2_V - fc_V)
    if not COMPUTED[0] <= ratio <= COMPUTED[1]:
        within = f"only between {COMPUTED[0]:g} and {COMPUTED[1]:g}"
        raise NoLimitCycle(f"no cycle can be computed at h1 / (h2 - f_c) = {ratio:.3g}: {within}")
    inputs = effective_inputs(fc_V, h1_V, h2_V)
    normal = _durations(inputs, ratio)
    durations = (normal[0] * tau_s, normal[1] * tau_s, normal[2] * tau_s)
    cycle = LimitCycle(durations, inputs, stage_states(tau_s, K_rad_s_V, durations, inputs), tau_s, K_rad_s_V)
    _check_no_additional_switching(cycle)
    return cycle


def _durations(inputs: tuple[float, float, float], omega: float) -> tuple[float, float, float]:
    """t1, t2, t3 in units of tau, for which z(0) = 0, v(t1) = 0 and y(t1 + t2) = 0.

    Two unknowns remain (see ``_unfolded``). The search starts from several fractions of the describing function's half
    period (omega in 1/tau).
    """
    from scipy.optimize import root  # it loads slowly, and most runs need none of these cycles

    half = math.pi / omega
    for inner in (0.45, 0.3, 0.2, 0.6):
        for early in (-1.0, -3.0, 0.5, -6.0):
            for stretch in (1.0, 0.5, 2.0):
                longer = stretch * inner * half
                # in a long cycle the speed at RC has almost reached the final speed of stage 3
                late = -longer if inputs[2] > 0.0 and longer > 5.0 else early
                guess = np.array([math.log(math.expm1(longer)) if longer < 30.0 else longer, late])
                found = root(_reduced, guess, args=(inputs,), method="hybr", tol=1e-13)
                if np.abs(found.fun).max() < 1e-9:
                    return _unfolded(found.x, inputs)
    raise NoLimitCycle("no durations satisfy the switching conditions: additional switching")


def _unfolded(unknown: Array, inputs: tuple[float, float, float]) -> tuple[float, float, float]:
    """Durations in units of tau from two unbounded numbers, with v(t1) = 0 and v(T/2) = -v(0) built in.

    The speed v2 at RB lies between the final speed of stage 3 (or 0) and that of stage 2. The speed at RC, -v(0), lies
    between the final speed of stage 3 (or 0) and v2. The two unknowns are these places as logistic fractions.
    """
    lowest = max(inputs[2], 0.0)
    p, s = (float(value) for value in np.clip(unknown, [-300.0, -1e5], [1e5, 300.0]))
    t2 = math.log(inputs[1] / (inputs[1] - lowest)) + float(np.logaddexp(0.0, p))
    above = (inputs[1] - lowest) * math.exp(-float(np.logaddexp(0.0, -p)))  # v2 - lowest
    beyond = above * math.exp(-float(np.logaddexp(0.0, -s)))  # -v(0) - lowest
    rest = lowest - inputs[2]
    t3 = math.log((above + rest) / (beyond + rest)) if rest > 0.0 else float(np.logaddexp(0.0, -s))
    return math.log1p((lowest + beyond) / inputs[0]), t2, t3


def _reduced(unknown: Array, inputs: tuple[float, float, float]) -> list[float]:
    """Conditions y(t1 + t2) = 0 and z(0) = 0 for tau = K = 1, relative to the motion within a half period."""
    durations = _unfolded(unknown, inputs)
    states = stage_states(1.0, 1.0, durations, inputs)
    size = float(np.abs(states[:, 1]).max())
    return [float(states[2, 1]) / size, float(states[0, 2]) / (size * sum(durations))]


def _check_no_additional_switching(cycle: LimitCycle) -> None:
    """Check v < 0 until t1 and > 0 after; y < 0 until t1 + t2 and > 0 after; z < 0 in the whole half (Theorem 2.1)."""
    t1, t2, t3 = cycle.durations_s
    states = cycle.states
    # Velocity is monotone within a stage, so its ends are enough to check v. Then v decides y, and y decides z.
    if not (min(t1, t2, t3) > 0.0 and states[0, 0] < 0.0 < min(states[2, 0], states[3, 0])):
        raise NoLimitCycle("the velocity reverses more than once in a half period: additional switching of RA")
    if not states[0, 1] < 0.0 < states[3, 1]:
        raise NoLimitCycle("the position crosses zero more than once in a half period: additional switching of RB")
    if not states[2, 2] < 0.0:
        raise NoLimitCycle("the integral crosses zero more than once in a half period: additional switching of RC")
