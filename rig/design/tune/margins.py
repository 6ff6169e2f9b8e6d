"""Margins of a sampled loop, broken at the motor's input (docs/theory.md 15.2).

Motor and controller are exact matrices: the motor with its delay of whole periods and a part of one, the controller
with its observer, which predicts over the delay that it knows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_lyapunov

from rig.control.observer import MotorObserver
from rig.control.state_feedback import Gains
from rig.core.arrays import Array
from rig.design.tune.uncertain import LinearMotor
from rig.model.linear import input_vector, transition

POINTS = 800  # of the frequency response
LOWEST = 1e-4  # first frequency over the highest


class Matrices(NamedTuple):
    """x' = A x + B u, y = C x + D u, once a period; one input and one output."""

    A: Array
    B: Array
    C: Array
    D: float


@dataclass(frozen=True)
class Margins:
    """How far a loop is from instability; all 0 if it is unstable.

    gain_dB     by which the loop's gain may rise or fall, the smaller of both, dB
    phase_deg   by which its phase may fall, degrees
    modulus     least distance of the loop's response from -1: 1 over the peak of the sensitivity
    """

    gain_dB: float
    phase_deg: float
    modulus: float

    def keep(self, least: Margins) -> bool:
        """Whether none is less than ``least``'s."""
        return self.gain_dB >= least.gain_dB and self.phase_deg >= least.phase_deg and self.modulus >= least.modulus


UNSTABLE = Margins(0.0, 0.0, 0.0)


class Sampled:
    """The linear motor's exact motion: state velocity, position and, behind a lag, the drive that has come through."""

    def __init__(self, motor: LinearMotor) -> None:
        self.motor = motor
        self.order = 3 if motor.lag_s > 0.0 else 2

    def over(self, h_s: float) -> tuple[Array, Array]:
        """A and B over ``h_s`` (>= 0) seconds of constant drive."""
        m = self.motor
        if m.lag_s == 0.0:
            return transition(m.tau_s, h_s)[:2, :2], input_vector(m.tau_s, m.K_rad_s_V, h_s)[:2]
        rates = np.zeros((4, 4))
        rates[0, :3] = -1.0 / m.tau_s, 0.0, m.K_rad_s_V / m.tau_s
        rates[1, 0] = 1.0
        rates[2, 2:] = -1.0 / m.lag_s, 1.0 / m.lag_s
        whole: Array = expm(rates * h_s)
        return whole[:3, :3], whole[:3, 3]

    def move(self, x: Array, u_V: float, h_s: float) -> Array:
        """The state ``h_s`` later; ``x``: (2,) or (3,), rad/s, rad, and behind a lag V."""
        A, B = self.over(h_s)
        return A @ x + B * u_V


def periods_of(delay_s: float, period_s: float) -> tuple[int, float]:
    """A delay as whole periods and the part of one, s."""
    whole = int(delay_s / period_s + 1e-9)
    return whole, max(delay_s - whole * period_s, 0.0)


def motor_matrices(motor: LinearMotor, period_s: float) -> Matrices:
    """From the drive that is decided at a sample to the reading at the same sample; the delay is in it.

    State: the motor's, then the drives that were decided at the last samples, the latest first.
    """
    whole, part_s = periods_of(motor.delay_s, period_s)
    sampled = Sampled(motor)
    n = sampled.order

    def step(x: Array, u: float) -> tuple[Array, float]:
        drives = np.concatenate([[u], x[n:]])  # now, one period ago, ...
        moved = sampled.move(x[:n], drives[whole + 1], part_s)
        moved = sampled.move(moved, drives[whole], period_s - part_s)
        return np.concatenate([moved, drives[: whole + 1]]), float(x[1])

    return _probed(step, n + whole + 1)


def controller_matrices(known: LinearMotor, observer: MotorObserver, gains: Gains, period_s: float) -> Matrices:
    """From the reading to the drive, with all references at 0, no friction and no limit.

    State: the observer's, the integral, then the drives of the last samples, the latest first.
    """
    whole, part_s = periods_of(known.delay_s, period_s)
    sampled = Sampled(known)
    n = sampled.order
    gain = np.zeros(n)
    gain[:2] = observer.gain[0][0], observer.gain[1][0]

    def step(x: Array, y: float) -> tuple[Array, float]:
        drives = x[n + 1 :]  # one period ago, two, ...
        state = sampled.move(x[:n], drives[whole + 1], part_s)
        state = sampled.move(state, drives[whole], period_s - part_s)
        state = state + gain * (y - state[1])
        ahead = sampled.move(state, drives[whole], part_s)
        for k in range(whole - 1, -1, -1):
            ahead = sampled.move(ahead, drives[k], period_s)
        ahead = sampled.move(ahead, drives[0], known.lag_s)
        # of the velocity loop the integral of the error is the position itself
        integral = x[n] - period_s * y if gains.loop == "position" else -y
        r = -gains.speed_1_s * ahead[0] - gains.place_1_s2 * ahead[1] + gains.integral * integral
        u = float((known.tau_s * r + ahead[0]) / known.K_rad_s_V)
        kept = integral if gains.loop == "position" else 0.0
        return np.concatenate([state, [kept, u], drives[:-1]]), u

    return _probed(step, n + 1 + whole + 2)


def margins(controller: Matrices, motor: Matrices, period_s: float) -> Margins:
    """Margins of the loop of both."""
    if not _is_stable(controller, motor):
        return UNSTABLE
    highest = math.pi / period_s

    def loop(w: Array) -> NDArray[np.complex128]:
        return open_loop(controller, motor, w, period_s)

    w = highest * np.geomspace(LOWEST, 1.0, POINTS)
    L = loop(w)
    through_one = _refined(loop, w, np.log(np.abs(L)), lambda z: np.log(np.abs(z)))
    through_half_turn = _refined(loop, w, L.imag, lambda z: z.imag)
    phases = [abs(math.degrees(np.angle(-z))) for z in through_one]
    # at the highest frequency a sampled loop is real
    real = [z.real for z in through_half_turn] + [float(L[-1].real)]
    gains_dB = [abs(20.0 * math.log10(-x)) for x in real if x < 0.0]
    return Margins(min(gains_dB, default=math.inf), min(phases, default=180.0), float(np.min(np.abs(1.0 + L))))


def open_loop(controller: Matrices, motor: Matrices, w: Array, period_s: float) -> NDArray[np.complex128]:
    """Response of the loop that is broken at the motor's input, at the angular frequencies ``w``, rad/s, (n,)."""
    return -_response(controller, w, period_s) * _response(motor, w, period_s)


def noise_V(controller: Matrices, motor: Matrices, noise_rad: float) -> float:
    """Standard deviation of the drive that white noise of the reading makes in the closed loop, V."""
    A, B = _closed(controller, motor)
    P = solve_discrete_lyapunov(A, np.outer(B, B))
    C = np.concatenate([controller.D * motor.C, controller.C])
    return noise_rad * math.sqrt(max(float(C @ P @ C) + controller.D**2, 0.0))


def worst(each: Iterable[Margins]) -> Margins:
    """The least of each."""
    some = list(each)
    return Margins(
        min(one.gain_dB for one in some), min(one.phase_deg for one in some), min(one.modulus for one in some)
    )


def _refined(
    loop: Callable[[Array], NDArray[np.complex128]],
    w: Array,
    values: Array,
    of: Callable[[NDArray[np.complex128]], Array],
) -> list[complex]:
    """The loop's response where a function of it goes through 0."""
    found = []
    for k in np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1])):
        fine = np.linspace(w[k], w[k + 1], 60)
        L = loop(fine)
        here = of(L)
        i = int(np.flatnonzero(np.sign(here[1:]) != np.sign(here[:-1]))[0]) if np.any(here[1:] * here[:-1] <= 0) else 0
        found.append(complex(L[i]))
    return found


def _response(system: Matrices, w: Array, period_s: float) -> NDArray[np.complex128]:
    z = np.exp(1j * w * period_s)
    shifted = z[:, np.newaxis, np.newaxis] * np.eye(len(system.B)) - system.A
    x = np.linalg.solve(shifted, np.broadcast_to(system.B[:, np.newaxis], (len(w), len(system.B), 1)))[..., 0]
    return np.asarray(x @ system.C + system.D, dtype=np.complex128)


def _is_stable(controller: Matrices, motor: Matrices) -> bool:
    """Whether the closed loop's poles are inside the unit circle."""
    return bool(np.max(np.abs(np.linalg.eigvals(_closed(controller, motor)[0]))) < 1.0)


def _closed(controller: Matrices, motor: Matrices) -> tuple[Array, Array]:
    """A of motor and controller in a loop, and B by which the reading's noise comes in."""
    A = np.block(
        [
            [motor.A + controller.D * np.outer(motor.B, motor.C), np.outer(motor.B, controller.C)],
            [np.outer(controller.B, motor.C), controller.A],
        ]
    )
    return A, np.concatenate([controller.D * motor.B, controller.B])


def _probed(step: Callable[[Array, float], tuple[Array, float]], order: int) -> Matrices:
    """The matrices of a linear step, by its response to each unit state and to a unit input."""
    columns = [step(one, 0.0) for one in np.eye(order)]
    moved, out = step(np.zeros(order), 1.0)
    return Matrices(np.array([x for x, _ in columns]).T, moved, np.array([y for _, y in columns]), out)
