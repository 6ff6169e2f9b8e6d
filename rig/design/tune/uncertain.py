"""An identified motor with its uncertainty: its corners, and motors drawn from it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rig.core.arrays import Array
from rig.model.real_motor import FramedMotor
from rig.model.real_step import mean_cosine

OF = ("tau_s", "K_rad_s_V", "fc_V", "bias_V", "delay_s")
COVERAGE = 1.96  # half a 95 % interval over its standard deviation
LEAST = 0.05  # no drawn tau, K or f_c is below this share of the estimate


@dataclass(frozen=True)
class LinearMotor:
    """What the loop's stability depends on.

    tau_s, K_rad_s_V   of the motor, > 0
    lag_s              time constant of stage and current, s, >= 0
    delay_s            from a sample to the effect of its drive, s, >= 0
    """

    tau_s: float
    K_rad_s_V: float
    lag_s: float
    delay_s: float


@dataclass(frozen=True)
class UncertainMotor:
    """A motor as a run knows it.

    framed        the motor with its laws; its own delay is 0
    delay_s       from a sample to the effect of its drive, s, >= 0
    half_95       half widths of the 95 % intervals of ``OF``, each in its unit
    correlation   of ``OF``, (5, 5)
    """

    framed: FramedMotor
    delay_s: float
    half_95: tuple[float, ...]
    correlation: Array

    @property
    def linear(self) -> LinearMotor:
        """Its linear part."""
        motor = self.framed.motor
        return LinearMotor(motor.tau_s, motor.K_rad_s_V, motor.lag_s, self.delay_s)

    @property
    def pull_V(self) -> float:
        """The most that load, cogging and bias take from the drive at any angle, V."""
        motor, frame = self.framed.motor, self.framed.frame
        constant_V = abs(motor.bias_V + motor.force_cos_V * mean_cosine(frame))
        cogging_V = math.hypot(motor.cogging_sin_V, motor.cogging_cos_V)
        return constant_V + math.hypot(motor.force_sin_V, motor.force_cos_V) + cogging_V

    def corners(self) -> Iterator[LinearMotor]:
        """The motor itself, then each corner of the box of the intervals of tau, K and delay."""
        yield self.linear
        tau, K, _, _, delay = self.half_95
        for signs in itertools.product((-1.0, 1.0), repeat=3):
            yield LinearMotor(
                max(self.linear.tau_s + signs[0] * tau, LEAST * self.linear.tau_s),
                max(self.linear.K_rad_s_V + signs[1] * K, LEAST * self.linear.K_rad_s_V),
                self.linear.lag_s,
                max(self.delay_s + signs[2] * delay, 0.0),
            )

    def drawn(self, number: int, random: np.random.Generator) -> Iterator[tuple[FramedMotor, float]]:
        """So many motors and delays from the joint normal distribution that the intervals say; laws stay as found."""
        spread = np.array(self.half_95) / COVERAGE
        motor = self.framed.motor
        means = np.array([motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V, self.delay_s])
        values, vectors = np.linalg.eigh(self.correlation)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        least = np.array([*(LEAST * means[:3]), -np.inf, 0.0])
        for one in random.standard_normal((number, len(OF))):
            tau, K, fc, bias, delay = np.maximum(means + spread * (root @ one), least).tolist()
            yield (FramedMotor(motor._replace(tau_s=tau, K_rad_s_V=K, fc_V=fc, bias_V=bias), self.framed.frame), delay)
