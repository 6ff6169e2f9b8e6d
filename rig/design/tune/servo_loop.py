"""A servo's own position loop, duty = gain x error, on an identified motor: its P by margins (docs/tune.md). Pure.

What a step of P means, manuals do not say well: so P keeps its margins at the largest meaning, and is as slow as the
smallest makes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from rig.core.motor_numbers import AT_REST_V
from rig.design.tune.margins import Margins, Matrices, margins, motor_matrices, worst
from rig.design.tune.tuning import TuneError
from rig.design.tune.uncertain import UncertainMotor
from rig.run_folder.recording.servo_law import Scale
from rig.run_folder.results import JsonObject

PERIOD_S: Final = 1e-3  # of a servo's loop; design assumption, as in the emulated one
_LATE_S: Final = 2e-3  # at worst: a position is a step old, and a duty acts a step later


@dataclass(frozen=True)
class PositionMode:
    """What a servo's position mode is made of.

    model      its name
    addresses  of the gains' registers, by name
    scale      of P
    most_P     that its register takes
    known_P    gains that others write, by whose they are
    """

    model: str
    addresses: Mapping[str, int]
    scale: Scale
    most_P: int
    known_P: Mapping[str, int]


class Setting(NamedTuple):
    """A register of the loop and what to write there; None: it does not count in this mode, leave it."""

    name: str
    address: int
    value: int | None
    words: str


@dataclass(frozen=True)
class Row:
    """A gain P, and what it makes of the motor.

    margins   of the worst motor within the intervals, at the highest scale
    held_rad  how far from its goal friction at rest and a load may hold the shaft, at the lowest scale, rad
    """

    whose: str
    P: int
    margins: Margins
    held_rad: float

    def as_json(self) -> JsonObject:
        """All of it; null: there is no gain margin."""
        dB = self.margins.gain_dB
        return {
            "whose": self.whose,
            "P": self.P,
            "phase_deg": self.margins.phase_deg,
            "gain_dB": dB if math.isfinite(dB) else None,
            "modulus": self.margins.modulus,
            "held_rad": self.held_rad,
        }


@dataclass(frozen=True)
class ServoLoop:
    """What to write to a servo for its position mode; rig writes none of it."""

    model: str
    scale: Scale
    supply_V: float
    rows: tuple[Row, ...]
    settings: tuple[Setting, ...]

    def as_json(self) -> JsonObject:
        """All of it."""
        return {
            "servo": self.model,
            "p_scale_1_rad": {"low": self.scale.low, "high": self.scale.high, "source": self.scale.source},
            "supply_V": self.supply_V,
            "gains": [row.as_json() for row in self.rows],
            "registers": [one._asdict() for one in self.settings],
        }


def servo_loop(motor: UncertainMotor, mode: PositionMode, supply_V: float, least: Margins) -> ServoLoop:
    """P for the position mode of a servo, and what it does beside the gains that others write.

    supply_V   of the run, > 0
    least      margins that the worst motor keeps at the highest scale
    Raises TuneError where no P keeps the margins.
    """
    scale = mode.scale
    low, high = 0, mode.most_P + 1  # the margins fall as P rises
    while high - low > 1:
        middle = (low + high) // 2
        if _margins(motor, scale.high * supply_V * middle).keep(least):
            low = middle
        else:
            high = middle
    if low == 0:
        raise TuneError(
            f"no P keeps {least.phase_deg:g} degrees and {least.gain_dB:g} dB on every motor of the intervals",
            "identify the motor better, or lower --gain-margin or --phase-margin",
        )
    rows = tuple(
        Row(name, P, _margins(motor, scale.high * supply_V * P), _held_rad(motor, scale.low * supply_V * P))
        for name, P in ({"rig": low} | dict(mode.known_P)).items()
    )
    return ServoLoop(mode.model, scale, supply_V, rows, _settings(mode, low))


def _margins(motor: UncertainMotor, gain_V_rad: float) -> Margins:
    """The least over the motors of the intervals, with the servo's own delay in the place of the bench's."""
    controller = Matrices(np.zeros((1, 1)), np.zeros(1), np.zeros(1), -gain_V_rad)
    inside = {replace(corner, delay_s=_LATE_S) for corner in motor.corners()}
    return worst(margins(controller, motor_matrices(one, PERIOD_S), PERIOD_S) for one in inside)


def _held_rad(motor: UncertainMotor, gain_V_rad: float) -> float:
    m = motor.framed.motor
    level_V: float = sum(getattr(m, name) for name in AT_REST_V) + math.hypot(m.friction_sin_V, m.friction_cos_V)
    held_V = level_V + motor.half_95[2] + motor.pull_V * (1.0 + m.load_friction * m.load_outside)
    return held_V / (1.0 - m.load_friction) / gain_V_rad


def _settings(mode: PositionMode, P: int) -> tuple[Setting, ...]:
    other = None, "counts in velocity mode alone"
    unknown = 0, "what a step of it means nobody has measured"
    words: dict[str, tuple[int | None, str]] = {
        "position_p_gain": (P, "keeps the margins"),
        "position_i_gain": (0, "an integral hunts about a goal that friction holds; its scale is not measured"),
        "position_d_gain": unknown,
        "velocity_i_gain": other,
        "velocity_p_gain": other,
        "feedforward_2nd_gain": unknown,
        "feedforward_1st_gain": unknown,
    }
    return tuple(Setting(name, mode.addresses[name], *one) for name, one in words.items() if name in mode.addresses)
