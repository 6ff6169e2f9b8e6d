"""The law of a survey: slow sweeps to and fro at constant speeds, in a closed loop (docs/theory.md 13.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rig.control.disturbance_observer import DisturbanceObserver
from rig.control.law import BareLaw
from rig.control.motion import Standstill
from rig.control.sweep_plan import SweepPlan, fastest_loop_1_s
from rig.control.trajectory import Reference, SumOfSines
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.linear import settled

SLOWEST_1_S = 0.5
OBSERVER = 3.0  # its bandwidth over the loop's
NOISE_SHARE = 0.06  # of the breakaway level: the drive's scatter by the sensor's noise
STEADY = 3.5  # standard deviations of the speed, by noise, that the slowest sweep is away from rest
ALLOWED = 1.5  # of the breakaway level: the largest drive beside that of the speed
PUSHED = 1.15  # of the breakaway level: under such a drive the reading has to move
STANDS_S = 0.15  # longer than that no reading stands still under it,
STANDS_COUNTS = 3.0  # while the reference passes so many counts of the sensor
APPROACH = 1.875  # peak of a quintic's speed over its mean


@dataclass(frozen=True)
class CrudeMotor:
    """What is known of the motor before it is identified, from the breakaway check and a limit cycle.

    tau_s, K_rad_s_V  by the describing function
    plus_V, minus_V   breakaway level in each direction, > 0
    """

    tau_s: float
    K_rad_s_V: float
    plus_V: float
    minus_V: float

    @property
    def friction_V(self) -> float:
        """Friction in motion: a little less than the level that breaks the shaft away."""
        return 0.45 * (self.plus_V + self.minus_V)


@dataclass(frozen=True)
class SweepLoop:
    """The loop that the sweeps run in.

    period_s   between two samples
    latency_s  from a sample until its drive acts
    max_V      largest drive
    lost_rad   a shaft that is farther from the reference than that does not follow it
    lsb_rad    a count of the sensor
    """

    period_s: float
    latency_s: float
    max_V: float
    lost_rad: float
    lsb_rad: float


def loop_bandwidth_1_s(motor: CrudeMotor, loop: SweepLoop, noise_rad: float) -> float:
    """Bandwidth of the loop, 1/s: the largest by its delay and by the noise, but at least 0.5."""
    bandwidth = fastest_loop_1_s(0.5 * loop.period_s + loop.latency_s)
    largest_V = NOISE_SHARE * min(motor.plus_V, motor.minus_V)
    while bandwidth > SLOWEST_1_S and noise_rad * scatter(motor, loop.period_s, bandwidth).drive_V > largest_V:
        bandwidth *= 0.9
    return bandwidth


def slowest_rad_s(motor: CrudeMotor, plan_1_s: float, period_s: float, noise_rad: float) -> float:
    """Slowest speed that noise does not bring to a stop, rad/s, in a loop of the bandwidth ``plan_1_s``, 1/s."""
    return STEADY * noise_rad * scatter(motor, period_s, plan_1_s).speed_rad_s


class Scatter(NamedTuple):
    """What white noise of 1 rad on the position makes of the loop: standard deviations, V and rad/s."""

    drive_V: float
    speed_rad_s: float


def scatter(motor: CrudeMotor, period_s: float, bandwidth_1_s: float) -> Scatter:
    """The scatter of the loop, from the covariance of motion and observer (docs/theory.md 13.1)."""
    tau, K, a = motor.tau_s, motor.K_rad_s_V, bandwidth_1_s
    observer = DisturbanceObserver(tau, K, period_s, OBSERVER * a)
    A, B, L = observer.transition, observer.transition[:2, 2:] * -1.0, observer.gain[:, None]
    by_state = np.array([[(1.0 - 2.0 * a * tau) / K, -a * a * tau / K, 1.0]])
    # velocity and position, then the observer's error; the drive is by_state times (motion - error)
    step = np.zeros((5, 5))
    step[:2, :2] = A[:2, :2] + B @ by_state[:, :2]
    step[:2, 2:] = -B @ by_state
    step[2:, 2:] = (np.eye(3) - L @ np.array([[0.0, 1.0, 0.0]])) @ A
    noise = np.zeros((5, 1))
    noise[2:] = L
    covariance = settled(step, np.zeros((5, 5)), noise @ noise.T)
    drive = np.concatenate((by_state[0, :2], -by_state[0]))
    return Scatter(float(np.sqrt(drive @ covariance @ drive)), float(np.sqrt(covariance[0, 0])))


class Sweeps(BareLaw):
    """Bring the shaft to the lower end of the travel, then sweep it to and fro by the plan.

    motor      the crude motor: its friction changes sign with the reference, all else is left to the observer
    plan       the sweeps
    loop       the loop that they run in

    The loop has two poles at the plan's bandwidth; the observer's load gives it integral action. The drive is at most
    1.5 breakaway levels and what the speed takes, and under a drive above the breakaway level the reading must not
    stand still: so a shaft whose reading freezes does not run far. Raises Fault NOT_FOLLOWING or SENSOR_STUCK.
    """

    def __init__(self, motor: CrudeMotor, plan: SweepPlan, loop: SweepLoop) -> None:
        self.motor = motor
        self.plan = plan
        self.loop = loop
        self.largest_u_V = 0.0
        self.observer = DisturbanceObserver(
            motor.tau_s, motor.K_rad_s_V, loop.period_s, OBSERVER * plan.bandwidth_1_s, loop.latency_s
        )
        self._start_s = math.nan
        self._approach = SumOfSines([])
        self._way = 0.0  # direction of the reference
        self._standstill = Standstill()  # under a drive that moves the shaft
        self._passed_rad = 0.0  # by the reference, in this standstill

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V; ``yd_rad`` is the reference at the sample's own time."""
        if math.isnan(self._start_s):
            self._begin(sample)
        elapsed = sample.t_s - self._start_s
        self.yd_rad = self._reference(elapsed).y_rad
        self.finished = elapsed >= self._approach.fade_s + self.plan.duration_s
        reference = self._reference(elapsed + self.loop.latency_s)
        if abs(self.yd_rad - sample.y_rad) > self.loop.lost_rad:
            raise Fault(
                "NOT_FOLLOWING",
                f"at {sample.y_rad:.3f} rad instead of {self.yd_rad:.3f} rad, in a sweep at "
                f"{reference.v_rad_s:+.3f} rad/s; {sample.u_V:+.2f} V acted",
            )
        if self.finished:
            return 0.0
        self._turn(reference.v_rad_s)
        u_V = self._drive_V(sample, reference)
        self._check_motion(sample, u_V, reference.v_rad_s)
        self.largest_u_V = max(self.largest_u_V, abs(u_V))
        self.observer.drive(u_V)
        return u_V

    def _check_motion(self, sample: Sample, u_V: float, v_rad_s: float) -> None:
        """Raise SENSOR_STUCK if a drive above the breakaway level does not move the reading.

        In a slow sweep it takes seconds until the shaft counts as lost.
        """
        way_rad = abs(v_rad_s) * self.loop.period_s
        if abs(u_V) < PUSHED * (self.motor.plus_V if u_V > 0.0 else self.motor.minus_V):
            self._standstill.restart()
        still_s = self._standstill.step(sample.t_s, sample.y_rad, 1.5 * self.loop.lsb_rad)
        self._passed_rad = self._passed_rad + way_rad if still_s > 0.0 else 0.0
        if still_s > self.loop.latency_s + STANDS_S and self._passed_rad > STANDS_COUNTS * self.loop.lsb_rad:
            raise Fault(
                "SENSOR_STUCK",
                f"{u_V:+.2f} V for {still_s:.2f} s did not move the reading, in a sweep at {v_rad_s:+.3f} rad/s; "
                f"{self._standstill.words()}",
            )

    def _begin(self, sample: Sample) -> None:
        self._start_s = sample.t_s
        way_rad = sample.y_rad - self.plan.low_rad
        middle_rad_s = sorted(self.plan.speeds_rad_s)[len(self.plan.speeds_rad_s) // 2]
        fade_s = max(APPROACH * abs(way_rad) / middle_rad_s, self.plan.turn_s)
        self._approach = SumOfSines([], way_rad, fade_s)

    def _reference(self, t_s: float) -> Reference:
        """The reference ``t_s`` after the first sample."""
        if t_s >= self._approach.fade_s:
            return self.plan.at(t_s - self._approach.fade_s)
        near = self._approach.at(t_s)
        return near._replace(y_rad=self.plan.low_rad + near.y_rad)

    def _turn(self, v_rad_s: float) -> None:
        """Friction turns with the motion, and from rest it is there at once: the observer need not find that out."""
        way = math.copysign(1.0, v_rad_s) if v_rad_s else self._way
        self.observer.shift(self.motor.friction_V * (way - self._way))
        self._way = way

    def _drive_V(self, sample: Sample, reference: Reference) -> float:
        state, motor, a = self.observer.step(sample), self.motor, self.plan.bandwidth_1_s
        r = reference.a_rad_s2 + 2.0 * a * (reference.v_rad_s - state.v_rad_s) + a * a * (reference.y_rad - state.y_rad)
        u_V = (motor.tau_s * r + state.v_rad_s) / motor.K_rad_s_V + state.load_V
        speed_V = abs(reference.v_rad_s) / motor.K_rad_s_V
        high_V = min(ALLOWED * motor.plus_V + speed_V, self.loop.max_V)
        low_V = max(-ALLOWED * motor.minus_V - speed_V, -self.loop.max_V)
        return max(low_V, min(high_V, u_V))
