"""Set-point programs for a feedback loop: steps through a reference model, then a smooth trajectory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from rig.control.trajectory import Reference, SumOfSines

# A second-order model of damping 1 is 3 dB down at this share of its natural frequency: sqrt(sqrt 2 - 1).
BANDWIDTH_OF_SECOND_ORDER = math.sqrt(math.sqrt(2.0) - 1.0)
# Time constants after which a step is called done: 0.3 % of it are left, and the reference goes there at once.
DONE = 8.0


class Program(Protocol):
    """A reference with two derivatives that begins at ``start_rad`` and lasts ``duration_s``."""

    start_rad: float
    duration_s: float

    def at(self, t_s: float) -> Reference:
        """Reference ``t_s`` >= 0 seconds after the start."""


class PositionStep:
    """A step of the position through a second-order model of damping 1: it never overshoots.

    step_rad      its size, with its sign
    bandwidth_1_s the model is 3 dB down there, rad/s, > 0
    """

    def __init__(self, step_rad: float, bandwidth_1_s: float, duration_s: float) -> None:
        self.step_rad = step_rad
        self.natural_1_s = bandwidth_1_s / BANDWIDTH_OF_SECOND_ORDER
        self.duration_s = duration_s
        self.start_rad = 0.0

    def at(self, t_s: float) -> Reference:
        """As ``Program``; at rest once the step is done."""
        w = self.natural_1_s
        x = w * t_s
        if x >= DONE:
            return Reference(self.start_rad + self.step_rad, 0.0, 0.0)
        left = math.exp(-x) * self.step_rad
        return Reference(self.start_rad + self.step_rad - (1.0 + x) * left, w * x * left, w * w * (1.0 - x) * left)


class MoveTo:
    """A move to a place, wherever it begins, through the same model."""

    def __init__(self, to_rad: float, bandwidth_1_s: float, duration_s: float) -> None:
        self.to_rad = to_rad
        self.duration_s = duration_s
        self._step = PositionStep(to_rad, bandwidth_1_s, duration_s)

    @property
    def start_rad(self) -> float:
        """Where it begins; set with the shaft's position."""
        return self._step.start_rad

    @start_rad.setter
    def start_rad(self, y_rad: float) -> None:
        self._step.start_rad, self._step.step_rad = y_rad, self.to_rad - y_rad

    def at(self, t_s: float) -> Reference:
        """As ``Program``."""
        return self._step.at(t_s)


class Sines:
    """A sum of sines for a time; it fades in from where it begins.

    components  pairs (amplitude rad, angular frequency rad/s), about ``centre_rad``
    """

    def __init__(
        self, components: Sequence[tuple[float, float]], duration_s: float, fade_s: float, centre_rad: float = 0.0
    ) -> None:
        self.duration_s = duration_s
        self.centre_rad = centre_rad
        self._sines = SumOfSines(components, fade_s=fade_s)

    @property
    def start_rad(self) -> float:
        """Where it begins."""
        return self._sines.start_rad + self.centre_rad

    @start_rad.setter
    def start_rad(self, y_rad: float) -> None:
        self._sines.start_rad = y_rad - self.centre_rad

    def at(self, t_s: float) -> Reference:
        """As ``Program``."""
        y_rad, v_rad_s, a_rad_s2 = self._sines.at(t_s)
        return Reference(y_rad + self.centre_rad, v_rad_s, a_rad_s2)


class SpeedSteps:
    """Steps of the speed through a first-order model, one after the other; the first begins at rest.

    speeds_rad_s   the wanted speeds
    each_s         how long each is wanted, s
    bandwidth_1_s  the model is 3 dB down there, rad/s, > 0
    """

    def __init__(self, speeds_rad_s: Sequence[float], each_s: float, bandwidth_1_s: float) -> None:
        self.speeds_rad_s = tuple(speeds_rad_s)
        self.each_s = each_s
        self.bandwidth_1_s = bandwidth_1_s
        self.duration_s = each_s * len(self.speeds_rad_s)
        self.start_rad = 0.0
        self._begins: list[tuple[float, float]] = [(0.0, 0.0)]  # speed and way at the start of each step
        for wanted in self.speeds_rad_s[:-1]:
            self._begins.append(self._after(*self._begins[-1], wanted, each_s)[:2])

    def _after(self, speed: float, way: float, wanted: float, t_s: float) -> tuple[float, float, float]:
        """Speed, way and acceleration ``t_s`` after the start of a step."""
        a = self.bandwidth_1_s
        gap = wanted - speed
        way += wanted * t_s + gap / a * math.expm1(-a * t_s)
        if a * t_s >= DONE:
            return wanted, way, 0.0
        left = gap * math.exp(-a * t_s)
        return wanted - left, way, a * left

    def at(self, t_s: float) -> Reference:
        """As ``Program``; the last speed stays."""
        k = min(int(t_s / self.each_s), len(self.speeds_rad_s) - 1)
        v, way, acceleration = self._after(*self._begins[k], self.speeds_rad_s[k], t_s - k * self.each_s)
        return Reference(self.start_rad + way, v, acceleration)


class InTurn:
    """Programs one after the other, each from where the one before it ends."""

    def __init__(self, parts: Sequence[Program]) -> None:
        self.parts = tuple(parts)
        self.duration_s = sum(part.duration_s for part in self.parts)

    @property
    def start_rad(self) -> float:
        """Where the first begins."""
        return self.parts[0].start_rad

    @start_rad.setter
    def start_rad(self, y_rad: float) -> None:
        for part in self.parts:
            part.start_rad = y_rad
            y_rad = part.at(part.duration_s).y_rad

    def at(self, t_s: float) -> Reference:
        """As ``Program``; the last part goes on."""
        for part in self.parts[:-1]:
            if t_s < part.duration_s:
                return part.at(t_s)
            t_s -= part.duration_s
        return self.parts[-1].at(t_s)
