"""What is believed of a motor before a test: its numbers, their covariance, and the motors that it may be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from rig.core.arrays import Array
from rig.model.step import Numbers, Plant

RADIUS = 3.0  # standard deviations, along any direction, within which the motor is taken to be
TOGETHER = math.sqrt(3.0)  # tau, K and fc may all be wrong at once
LEAST_DOUBT = 0.05  # of tau, K, fc and, in parts of fc, asym, at that radius: the covariance knows the plain law only
NORMAL_95 = 1.959964


@dataclass(frozen=True)
class Belief:
    """A motor as far as it is known.

    tau_s, K_rad_s_V, fc_V, asym_V   the plain law's numbers; all > 0 but asym_V
    delay_s      by which a drive acts later than the device says, s
    covariance   (5, 5), of log tau, log K, fc, asym, delay; a delay of variance 0 is known
    Raises ValueError outside these ranges.
    """

    tau_s: float
    K_rad_s_V: float
    fc_V: float
    asym_V: float
    delay_s: float
    covariance: Array

    def __post_init__(self) -> None:
        if not (min(self.tau_s, self.K_rad_s_V, self.fc_V) > 0.0 and math.isfinite(self.asym_V + self.delay_s)):
            raise ValueError("a design needs tau, K and f_c > 0, and finite numbers")
        if self.covariance.shape != (5, 5) or not np.all(np.diag(self.covariance) >= 0.0):
            raise ValueError("a design needs a covariance of log tau, log K, f_c, asym and delay")

    @classmethod
    def within(
        cls, motor: tuple[float, float, float, float], percent: float, delay_s: float = 0.0, late_s: float = 0.003
    ) -> Belief:
        """A motor (tau, K, fc, asym) of which tau, K and fc may all be wrong by ``percent`` % at once.

        So may be the friction of either direction. ``late_s``: standard deviation of the delay, s.
        """
        tau_s, K_rad_s_V, fc_V, asym_V = motor
        share = percent / 100.0 * TOGETHER / RADIUS
        each_V = share * fc_V / math.sqrt(2.0)  # of the mean of both directions, and of half their difference
        deviations = np.array([share, share, each_V, each_V, late_s])
        return cls(tau_s, K_rad_s_V, fc_V, asym_V, delay_s, np.diag(deviations**2))

    @property
    def delay_is_known(self) -> bool:
        """Whether no test need find the delay."""
        return bool(self.covariance[4, 4] == 0.0)

    @property
    def delay_doubt_s(self) -> float:
        """By how much the delay may be longer, s."""
        return 2.0 * math.sqrt(float(self.covariance[4, 4]))

    def plant(self, static_V: float) -> Numbers:
        """The motor itself, as plain numbers."""
        return self._moved(np.zeros(4), static_V)

    def fast(self, excess_V: tuple[float, ...]) -> list[Numbers]:
        """The motors, of those that it may be, that go farthest, as plain numbers.

        excess_V   drives beyond friction, V, for which to say so
        """
        return [
            self._moved(self._farthest(np.array([tau, 1.0, -1.0 / excess, asym / excess])), 0.0)
            for excess, tau, asym in product(excess_V, (-1.0, 1.0), (-1.0, 1.0))
        ]

    def slow(self, excess_V: float, static_V: float) -> list[Numbers]:
        """The motors, of those that it may be, that are slowest in the one direction and in the other.

        static_V   level that the shaft breaks away at: friction in motion is no higher
        """
        motors = []
        for asym in (-1.0, 1.0):
            change = self._farthest(np.array([1.0, -1.0, 1.0 / excess_V, asym / excess_V]))
            over_V = self.fc_V + change[2] + asym * (self.asym_V + change[3]) - max(static_V, self.fc_V)
            if static_V > 0.0 and over_V > 0.0:
                change[2:] -= 0.5 * over_V * np.array([1.0, asym])
            motors.append(self._moved(change, static_V))
        return motors

    def _farthest(self, direction: Array) -> Array:
        """The change of log tau, log K, fc and asym, within ``RADIUS``, that goes farthest in a direction."""
        least = LEAST_DOUBT / RADIUS * np.array([1.0, 1.0, self.fc_V, self.fc_V])
        covariance = self.covariance[:4, :4] + np.diag(least**2)
        return np.asarray(RADIUS * covariance @ direction / math.sqrt(direction @ covariance @ direction))

    def _moved(self, change: Array, static_V: float) -> Numbers:
        tau_s, K_rad_s_V = self.tau_s * math.exp(change[0]), self.K_rad_s_V * math.exp(change[1])
        fc_V = max(self.fc_V + change[2], 0.02 * self.fc_V)
        static_V = max(static_V, fc_V)
        return tuple(map(float, Plant(tau_s, K_rad_s_V, fc_V, fc_V, static_V, static_V, 0.0, self.asym_V + change[3])))
