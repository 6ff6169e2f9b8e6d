"""Tune a loop: the gains of a wanted bandwidth, or the largest that keeps the margins (docs/theory.md 15.1, 15.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.control.observer import MotorObserver
from rig.control.set_point import BANDWIDTH_OF_SECOND_ORDER, PositionStep, Program, SpeedSteps
from rig.control.state_feedback import DriveLimits, Gains, Loop, StateFeedback
from rig.core.errors import CauseError
from rig.design.tune.margins import Margins, controller_matrices, margins, motor_matrices, noise_V, open_loop, worst
from rig.design.tune.trial import Sensing
from rig.design.tune.uncertain import OF, UncertainMotor
from rig.identification.known_model import model_of
from rig.run_folder.results import Answer
from rig.run_folder.results.tuned import TunedPid

INTEGRAL_POLE = 0.2  # the integral's pole over the others: it must not shape the step


def gains_for(loop: Loop, bandwidth_1_s: float, tau_s: float) -> Gains:
    """Gains of a loop whose response to its set-point is 3 dB down at ``bandwidth_1_s``, rad/s, > 0.

    The poles of a position loop are (s + w)^2 (s + a w), w = bandwidth / 0.6436; those of a velocity loop
    (s + w)(s + a w), w = bandwidth.
    A slower loop than the motor itself (w tau < 1) gets w = 1/tau: the reference model alone makes its set-point slow.
    A feedback that slow would first have to undo the motor's own damping, and would be fragile.
    """
    a = INTEGRAL_POLE
    w = max(bandwidth_1_s / (BANDWIDTH_OF_SECOND_ORDER if loop == "position" else 1.0), 1.0 / tau_s)
    if loop == "position":
        return Gains(loop, w * (2.0 + a), w * w * (1.0 + 2.0 * a), a * w**3)
    return Gains(loop, w * (1.0 + a), 0.0, a * w * w)


def as_pid(gains: Gains, tau_s: float, K_rad_s_V: float) -> TunedPid:
    """The same feedback as a PID controller of the position, or a PI controller of the velocity.

    u = Kp e + Ki int e dt + Kd de/dt + kS sgn(v_ref) + kV v_ref + kA a_ref, with e = reference - measured.
    """
    per = tau_s / K_rad_s_V
    speed = per * gains.speed_1_s - 1.0 / K_rad_s_V
    if gains.loop == "position":
        units = ("V/rad", "V/(rad s)", "V s/rad")
        return TunedPid(Kp=per * gains.place_1_s2, Ki=per * gains.integral, Kd=speed, units=units)
    return TunedPid(Kp=speed, Ki=per * gains.integral, Kd=0.0, units=("V s/rad", "V/rad", "V s2/rad"))


LEAST = Margins(gain_dB=6.0, phase_deg=45.0, modulus=0.0)
HIGHEST = 0.2  # bandwidth over the highest frequency of the sampling, pi / period
LOWEST = 0.002
TRIED = 40  # bandwidths between both
NOISE_SHARE = 0.1  # standard deviation that the sensor's noise makes in the drive, over the largest drive
_OF_ESTIMATE = {"bias_V": "asym_V"}  # what the estimate calls what the motor calls otherwise
STEP_TIMES = 12.0  # how long a step lasts, over the time constant of its reference: a third of it is for settling


class TuneError(CauseError):
    """A loop cannot be tuned as asked."""

    status = 1


def motor_of(answer: Answer | None) -> UncertainMotor:
    """The motor of an answer with its laws, and how well it is known.

    Half widths are u95 where there is one, else those of its scatter. The laws' own sizes count as known:
    what they leave open is in u95 of tau, K and f_c. Raises TuneError without an answer that was not refused, or
    without intervals of tau and K.
    """
    try:
        framed = model_of(answer)
    except ValueError as error:
        raise TuneError(f"the result holds a model that no motor has: {error}", "give another run") from error
    if framed is None or answer is None:
        raise TuneError("there is no motor that was not refused", "see why: `rig identify RUN`")
    names = [_OF_ESTIMATE.get(name, name) for name in OF]
    half = tuple(0.5 * (high - low) for low, high in (answer.at_95(name) or (0.0, 0.0) for name in names))
    if not half[0] > 0.0 or not half[1] > 0.0:
        raise TuneError("tau and K have no intervals, so no worst case is known", "see why: `rig identify RUN`")
    # numbers that the estimate does not have are independent
    correlation = [[1.0 if a == b else answer.correlation_of(a, b) or 0.0 for b in names] for a in names]
    return UncertainMotor(framed, max(answer.delay_s or 0.0, 0.0), half, np.array(correlation))


@dataclass(frozen=True)
class Wish:
    """What the loop shall do.

    loop           position or velocity
    step           the step that it shall make within the drive and the speed, rad; of a velocity loop rad/s; > 0
    bandwidth_1_s  where its response to the set-point is 3 dB down, rad/s; None: the largest that is possible
    least          margins that the worst motor of the intervals keeps
    top_rad_s      largest speed
    """

    loop: Loop
    step: float
    bandwidth_1_s: float | None = None
    least: Margins = LEAST
    top_rad_s: float = math.inf


@dataclass(frozen=True)
class Tuned:
    """A tuned loop.

    bandwidth_1_s  of the set-point's response, rad/s
    largest_1_s    the largest that was possible, rad/s
    bound_by       what forbids more, in words
    nominal        margins of the identified motor
    worst          the least over all corners of the intervals
    noise_V        standard deviation of the drive by the sensor's noise, V
    """

    motor: UncertainMotor
    sensing: Sensing
    wish: Wish
    bandwidth_1_s: float
    gains: Gains
    largest_1_s: float
    bound_by: str
    nominal: Margins
    worst: Margins
    noise_V: float

    def law(self, program: Program) -> StateFeedback:
        """The law, made anew: it remembers."""
        limits = DriveLimits(self.sensing.largest_V, self.sensing.shown_rad)
        return StateFeedback(self.motor.framed, observer_of(self.motor, self.sensing), self.gains, program, limits)

    def responses(self) -> list[NDArray[np.complex128]]:
        """The open loop's response from a tenth of the bandwidth on: of the motor itself, then of each corner."""
        w = np.geomspace(0.1 * self.bandwidth_1_s, math.pi / self.sensing.period_s, 120)
        period_s = self.sensing.period_s
        observer = observer_of(self.motor, self.sensing)
        controller = controller_matrices(self.motor.linear, observer, self.gains, period_s)
        return [open_loop(controller, motor_matrices(corner, period_s), w, period_s) for corner in self.motor.corners()]

    @property
    def each_s(self) -> float:
        """How long one step lasts, s."""
        w = self.bandwidth_1_s / (BANDWIDTH_OF_SECOND_ORDER if self.wish.loop == "position" else 1.0)
        return STEP_TIMES / w


def observer_of(motor: UncertainMotor, sensing: Sensing) -> MotorObserver:
    """The observer of a bench that does not report its delay."""
    observer = MotorObserver(motor.framed, sensing.period_s, sensing.whole_noise_rad)
    observer.latency_s = motor.delay_s
    return observer


def tune(motor: UncertainMotor, sensing: Sensing, wish: Wish) -> Tuned:
    """The loop that was asked for. Raises TuneError if a bound forbids it, with the largest possible bandwidth."""
    observer = observer_of(motor, sensing)
    highest = HIGHEST * math.pi / sensing.period_s
    bound_by = f"the sampling: a fifth of half its frequency, {highest:.3g} rad/s"
    largest = 0.0
    for bandwidth in np.geomspace(LOWEST * highest, highest, TRIED).tolist():
        reason = _forbidden(motor, sensing, wish, observer, bandwidth)
        if reason:
            bound_by = reason
            if largest:
                largest, bound_by = _between(motor, sensing, wish, observer, (largest, bandwidth, reason))
            break
        largest = bandwidth
    if not largest:
        raise TuneError(
            f"no {wish.loop} loop keeps what is asked for: {bound_by}",
            "identify the motor better, give a smaller step, or lower --gain-margin or --phase-margin",
        )
    bandwidth = largest if wish.bandwidth_1_s is None else wish.bandwidth_1_s
    if bandwidth > largest:
        reason = _forbidden(motor, sensing, wish, observer, bandwidth) or bound_by
        raise TuneError(
            f"a bandwidth of {bandwidth:.4g} rad/s is too much: {reason}",
            f"the largest that is possible is {math.floor(largest * 100.0) / 100.0:.2f} rad/s",
        )
    gains = gains_for(wish.loop, bandwidth, motor.linear.tau_s)
    controller = controller_matrices(motor.linear, observer, gains, sensing.period_s)
    each = _margins(motor, sensing, observer, gains)
    return Tuned(
        motor,
        sensing,
        wish,
        bandwidth,
        gains,
        largest,
        bound_by,
        each[0],
        worst(each),
        noise_V(controller, motor_matrices(motor.linear, sensing.period_s), sensing.whole_noise_rad),
    )


def _between(
    motor: UncertainMotor, sensing: Sensing, wish: Wish, observer: MotorObserver, bracket: tuple[float, float, str]
) -> tuple[float, str]:
    """The largest bandwidth between one that is possible and one that is not, to 0.1 %, and what bounds it."""
    low, high, reason = bracket
    while high > 1.001 * low:
        middle = math.sqrt(low * high)
        why = _forbidden(motor, sensing, wish, observer, middle)
        if why:
            high, reason = middle, why
        else:
            low = middle
    return low, reason


def _margins(motor: UncertainMotor, sensing: Sensing, observer: MotorObserver, gains: Gains) -> list[Margins]:
    """Of the motor itself, then of each corner."""
    controller = controller_matrices(motor.linear, observer, gains, sensing.period_s)
    return [
        margins(controller, motor_matrices(corner, sensing.period_s), sensing.period_s) for corner in motor.corners()
    ]


def _forbidden(
    motor: UncertainMotor, sensing: Sensing, wish: Wish, observer: MotorObserver, bandwidth_1_s: float
) -> str:
    """What forbids a bandwidth, in words; empty if nothing does."""
    top_V, top_rad_s = _reference_needs(motor, wish, bandwidth_1_s)
    what = f"a step of {wish.step:.3g} {'rad' if wish.loop == 'position' else 'rad/s'}"
    if top_rad_s > wish.top_rad_s * (1.0 + 1e-9):
        return f"{what} would turn the shaft at {top_rad_s:.3g} rad/s, and {wish.top_rad_s:.3g} rad/s is its limit"
    if top_V > sensing.largest_V:
        return f"{what} would take {top_V:.3g} V, and the largest drive is {sensing.largest_V:.3g} V"
    gains = gains_for(wish.loop, bandwidth_1_s, motor.linear.tau_s)
    least = wish.least
    found = worst(_margins(motor, sensing, observer, gains))
    if found.gain_dB == 0.0:
        return "the worst motor of the intervals is unstable"
    if not found.keep(least):
        return (
            f"the worst motor of the intervals keeps {found.phase_deg:.1f} degrees and {found.gain_dB:.1f} dB, and "
            f"{least.phase_deg:g} degrees and {least.gain_dB:g} dB are asked for"
        )
    controller = controller_matrices(motor.linear, observer, gains, sensing.period_s)
    shaken_V = noise_V(controller, motor_matrices(motor.linear, sensing.period_s), sensing.whole_noise_rad)
    if shaken_V > NOISE_SHARE * sensing.largest_V:
        return (
            f"the sensor's noise would shake the drive by {shaken_V:.3g} V (standard deviation), more than a tenth of "
            f"the largest drive"
        )
    return ""


def _reference_needs(motor: UncertainMotor, wish: Wish, bandwidth_1_s: float) -> tuple[float, float]:
    """Largest drive, V, and speed, rad/s, of the step's reference on the identified motor, load and all."""
    linear, m = motor.linear, motor.framed.motor
    against_V = m.fc_V + m.dead_band_V + motor.pull_V
    program: Program
    if wish.loop == "position":
        step = PositionStep(wish.step, bandwidth_1_s, math.inf)
        program, times = step, np.linspace(0.0, STEP_TIMES, 200) / step.natural_1_s
    else:
        each_s = STEP_TIMES / bandwidth_1_s
        program = SpeedSteps((wish.step, -wish.step), each_s, bandwidth_1_s)
        times = np.linspace(0.0, 2.0 * each_s, 400)
    drives = []
    speeds = []
    for t in times.tolist():
        one = program.at(t)
        push = (linear.tau_s * one.a_rad_s2 + one.v_rad_s) / linear.K_rad_s_V + m.drag_V_s2_rad2 * one.v_rad_s * abs(
            one.v_rad_s
        )
        drives.append(abs(push + math.copysign(against_V, one.v_rad_s or 1.0)))
        speeds.append(abs(one.v_rad_s))
    return max(drives), max(speeds)
