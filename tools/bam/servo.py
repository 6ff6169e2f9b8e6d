"""A servo with the friction of BAM's models M1 to M6, in small fixed steps. It shares no code with ``rig.model``.

Source of equations and numbers: Rhoban/bam (Apache-2.0), ``bam/params``. The torque of the motor is kt I. Its current
flows through the winding and, for the share of time that the bridge is on, through the supply: the duty d makes of the
supply's resistance R_s the part R_s d^2 of the circuit, I = (d V_0 - kt v) / (R + R_s d^2). The duty may be ramped.
Each step takes speed and place at its middle. Quartering it moves a position by less than a microradian in 4 s.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 1e-4
GRAVITY_M_S2 = 9.81
ACTS_S = 1e-3  # after its sample a duty acts
SOURCE_OHM, RIPPLE_V, REGISTER_V = 0.15, 0.010, 0.1  # assumed: supply, its ripple, step of the voltage register


@dataclass(frozen=True)
class Friction:
    """A motor with its friction, SI units; what a model has not is 0. Names as the file's."""

    kt: float
    R: float
    armature: float
    friction_base: float
    friction_viscous: float
    model: str
    friction_stribeck: float = 0.0
    load_friction_motor: float = 0.0
    load_friction_external: float = 0.0
    load_friction_motor_stribeck: float = 0.0
    load_friction_external_stribeck: float = 0.0
    load_friction_motor_quad: float = 0.0
    load_friction_external_quad: float = 0.0
    dtheta_stribeck: float = 1.0
    alpha: float = 1.0

    @classmethod
    def read(cls, file: Path) -> Friction:
        """From BAM's JSON. A model with one load friction for both has it for each."""
        given = json.loads(file.read_text())
        for name in ("base", "stribeck"):
            both = given.pop(f"load_friction_{name}", None)
            ending = "" if name == "base" else "_stribeck"
            for side in ("motor", "external") if both is not None else ():
                given[f"load_friction_{side}{ending}"] = both
        return cls(**{name: value for name, value in given.items() if name in cls.__dataclass_fields__})

    def falls(self, speed: Array) -> Array:
        """What is left of the Stribeck parts at each speed, rad/s."""
        return np.asarray(np.exp(-((speed / self.dtheta_stribeck) ** self.alpha)))

    def limit_N_m(self, v: float, t_m: float, t_e: float) -> float:
        """Largest friction at the speed ``v``, rad/s, with the torques of motor and load, N m."""
        s = math.exp(-((abs(v) / self.dtheta_stribeck) ** self.alpha))
        total = self.friction_base + s * self.friction_stribeck + self.friction_viscous * abs(v)
        total += abs(self.load_friction_external * t_e - self.load_friction_motor * t_m)
        total += s * abs(self.load_friction_external_stribeck * t_e - self.load_friction_motor_stribeck * t_m)
        if t_e * t_m < 0.0:
            total += s * (
                self.load_friction_external_quad * t_e**2
                if abs(t_e) < abs(t_m)
                else self.load_friction_motor_quad * t_m**2
            )
        return total


@dataclass(frozen=True)
class Load:
    """A mass on an arm that hangs down at 0 rad."""

    mass_kg: float = 0.0
    arm_m: float = 0.0


class Servo:
    """A servo at rest at 0 rad, its duty at 0.

    supply_V     without current
    slope_V_s    by which its duty is ramped, times the supply; infinite: it acts at once
    source_ohm   resistance of the supply
    """

    def __init__(
        self,
        friction: Friction,
        load: Load,
        supply_V: float,
        slope_V_s: float = math.inf,
        source_ohm: float = SOURCE_OHM,
    ) -> None:
        self.friction, self.supply_V, self.source_ohm = friction, supply_V, source_ohm
        self.inertia = friction.armature + load.mass_kg * load.arm_m**2
        self.weight_N_m = GRAVITY_M_S2 * load.mass_kg * load.arm_m
        self.slope = slope_V_s / supply_V
        self.v = self.y = self.duty = 0.0
        self.terminal_V = supply_V

    def advance(self, duty: float, ripple_V: float, dt_s: float) -> None:
        """Let ``dt_s`` pass under the wanted duty, with the supply off by ``ripple_V``."""
        count = max(1, round(dt_s / STEP_S))
        h = dt_s / count
        for _ in range(count):
            most = self.slope * h
            before, self.duty = self.duty, self.duty + max(-most, min(most, duty - self.duty))
            self._step(0.5 * (before + self.duty) if math.isfinite(most) else duty, ripple_V, h)

    def _torques(self, duty: float, ripple_V: float, v: float, y: float) -> tuple[float, float]:
        f = self.friction
        resistance = f.R + self.source_ohm * duty * duty
        current = (duty * (self.supply_V + ripple_V) - f.kt * v) / resistance
        self.terminal_V = self.supply_V + ripple_V - self.source_ohm * duty * current
        return f.kt * current, -self.weight_N_m * math.sin(y)

    def _step(self, duty: float, ripple_V: float, h: float) -> None:
        left = h
        while left > 0.0:
            left -= self._stretch(duty, ripple_V, left)

    def _stretch(self, duty: float, ripple_V: float, left: float) -> float:
        """Go on for at most ``left`` s, to where the shaft comes to rest; returns how long that was."""
        if self.v == 0.0:
            t_m, t_e = self._torques(duty, ripple_V, 0.0, self.y)
            if abs(t_m + t_e) <= self.friction.limit_N_m(0.0, t_m, t_e):
                return left
            sign = math.copysign(1.0, t_m + t_e)
        else:
            sign = math.copysign(1.0, self.v)
        first = self._acceleration(sign, duty, ripple_V, self.v, self.y)
        middle = self.v + 0.5 * left * first
        a = self._acceleration(sign, duty, ripple_V, max(middle * sign, 0.0) * sign, self.y + 0.5 * left * self.v)
        end = self.v + left * a
        if end * sign > 0.0 or self.v == 0.0:
            end = end if end * sign > 0.0 else 0.0
            self.y += 0.5 * left * (self.v + end)
            self.v = end
            return left
        part = min(-self.v / a, left)
        self.y += 0.5 * part * self.v
        self.v = 0.0
        return part

    def _acceleration(self, sign: float, duty: float, ripple_V: float, v: float, y: float) -> float:
        t_m, t_e = self._torques(duty, ripple_V, v, y)
        return (t_m + t_e - sign * self.friction.limit_N_m(v, t_m, t_e)) / self.inertia
