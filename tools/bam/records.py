"""Records of a servo as rig would have them: 10 ms, 12 bit, duty in the servo's steps, relay, strokes and open loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bam.servo import ACTS_S, REGISTER_V, RIPPLE_V, SOURCE_OHM, Friction, Load, Servo

Array = NDArray[np.float64]

PERIOD_S = 0.010
STEP_RAD = 2.0 * math.pi / 4096
RIPPLE_S = 1e-3  # the ripple is another one after it
STROKE_LEVELS = (0.45, 0.8, 0.3, 1.0, 0.6, 0.35, 0.9, 0.5)  # of the largest drive
STROKES_S, OPEN_S, OPEN_RECORDS = 15.0, 1.0, 12
CYCLES = 13  # of each relay test, settling included
LOADED_S = 0.8  # period of a relay test with a load, which a slower one would not swing
STROKE_RAD, REST_S = 0.5, 0.2
AT_REST_ROWS = 8
AT_REST = 0.02  # of the largest speed: below it the shaft counts as at rest, as in rig's answer


@dataclass(frozen=True)
class Kind:
    """A servo: its file without the model, supply, steps of its duty, largest drive, and its slope as shipped, V/s."""

    file: str
    supply_V: float
    full: int
    max_V: float
    slope_V_s: float
    cycle: tuple[float, float]


KINDS = {
    "XL330": Kind("xl330", 5.0, 885, 3.2, 276.8, (0.4, 0.9)),
    "STS3215": Kind("feetech_sts3215_7_4V", 7.4, 1000, 4.5, math.inf, (0.25, 1.3)),
}
"""cycle: amplitude of its relay test, rad, and period, s, as in config/servo.yaml and config/servo-sts3215.yaml."""


@dataclass(frozen=True)
class Case:
    """A servo, BAM's model of its friction, its load, and how it is driven."""

    servo: str
    model: str
    load: Load
    record: str
    ramped: bool = False
    ideal: bool = False

    @property
    def title(self) -> str:
        """As a row of the table has it."""
        load = f"pendulum {self.load.mass_kg:g} kg at {self.load.arm_m:g} m" if self.load.mass_kg else "free"
        more = (", slope as shipped" if self.ramped else "") + (", ideal supply" if self.ideal else "")
        return f"{self.servo} {self.model.upper()}, {load}{more}"


@dataclass(frozen=True)
class Record:
    """Times of samples and of drives, s; readings and true positions, rad; drives, V.

    volt   true volts without current for one of these
    """

    t_s: Array
    t_u_s: Array
    y_rad: Array
    true_rad: Array
    u_V: Array
    volt: float


class Truth:
    """What rig should say: tau, K and f_c; f_c without load, and beyond all speeds of a Stribeck effect."""

    def __init__(self, friction: Friction, load: Load) -> None:
        a = friction.kt / friction.R
        self.friction = friction
        damping = a * friction.kt + friction.friction_viscous
        self.tau_s = (friction.armature + load.mass_kg * load.arm_m**2) / damping
        self.K_rad_s_V = a / damping
        self.fc_V = friction.friction_base / a
        self.weight_V = 9.81 * load.mass_kg * load.arm_m / a

    def driven_fc_V(self, records: Sequence[Record]) -> float:
        """f_c at the speeds that ``records`` hold, in true volts: the mean over all their time in motion."""
        speed = np.abs(np.concatenate([np.diff(one.true_rad) / np.diff(one.t_s) for one in records]))
        falls = self.friction.falls(speed[speed > AT_REST * speed.max()])
        return self.fc_V * (1.0 + float(np.mean(falls)) * self.friction.friction_stribeck / self.friction.friction_base)


Law = Callable[[int, float], float]


def driven(case: Case, friction: Friction, law: Law, rows: int, rng: np.random.Generator) -> Record:
    """A record from rest under a law, which makes volts of a row's number and its reading, rad."""
    kind = KINDS[case.servo]
    slope = kind.slope_V_s if case.ramped else math.inf
    servo = Servo(friction, case.load, kind.supply_V, slope, 0.0 if case.ideal else SOURCE_OHM)
    reads_ripple = 0.0 if case.ideal else RIPPLE_V
    duty, registers = 0.0, []
    out = np.empty((rows, 3))
    for k in range(rows):
        seen = STEP_RAD * math.floor(servo.y / STEP_RAD + 0.5)
        true = servo.y
        servo.advance(duty, reads_ripple * rng.standard_normal(), ACTS_S)
        wanted = law(k, seen)
        steps = round(max(-kind.max_V, min(kind.max_V, wanted)) / kind.supply_V * kind.full)
        duty = steps / kind.full
        registers.append(REGISTER_V * round(servo.terminal_V / REGISTER_V))
        for _ in range(round((PERIOD_S - ACTS_S) / RIPPLE_S)):
            servo.advance(duty, reads_ripple * rng.standard_normal(), RIPPLE_S)
        out[k] = seen, true, duty
    t_s: Array = PERIOD_S * np.arange(rows, dtype=np.float64)
    seen_V = float(np.mean(registers))
    acts_s: Array = t_s + np.float64(ACTS_S)
    return Record(t_s, acts_s, out[:, 0], out[:, 1], out[:, 2] * seen_V, kind.supply_V / seen_V)


def relay_law(case: Case, truth: Truth, amplitude_rad: float, period_s: float) -> Law:
    """Rig's relay on position and its integral, with gains for this cycle of a plain motor on its load."""
    w = 2.0 * math.pi / period_s
    share = math.pi * amplitude_rad / 4.0
    h1 = share * (w * w * truth.tau_s / truth.K_rad_s_V - truth.weight_V)
    h2 = truth.fc_V + share * w / truth.K_rad_s_V
    if h1 <= 0.0:
        raise ValueError(f"{case.title}: a relay of {period_s} s cannot swing this load")
    z, last, sy, sz = 0.0, 0.0, 1.0, 1.0

    def law(k: int, y: float) -> float:
        nonlocal z, last, sy, sz
        z += 0.5 * PERIOD_S * (y + last) if k else 0.0
        last = y
        sy = math.copysign(1.0, y) if y else sy
        sz = math.copysign(1.0, z) if z else sz
        return -h1 * sy - h2 * sz

    return law


def stroke_law(max_V: float) -> Law:
    """To and fro between two sides, each stroke at another drive, with a rest at 0 V between them."""
    way, number, rest = 1.0, 0, 0

    def law(k: int, y: float) -> float:
        nonlocal way, number, rest
        if rest > 0:
            rest -= 1
            return 0.0
        if way * y > STROKE_RAD:
            way, number, rest = -way, number + 1, round(REST_S / PERIOD_S) if number % 2 else 0
            return 0.0 if rest else way * max_V * STROKE_LEVELS[number % len(STROKE_LEVELS)]
        return way * max_V * STROKE_LEVELS[number % len(STROKE_LEVELS)]

    return law


def open_law(max_V: float, rng: np.random.Generator) -> Law:
    """At rest first, then drives of random sizes for random times."""
    rows = round(OPEN_S / PERIOD_S)
    u_V, at = np.zeros(rows), AT_REST_ROWS
    while at < rows:
        held = int(rng.integers(5, 25))
        u_V[at : at + held] = max_V * rng.uniform(-1.0, 1.0)
        at += held
    return lambda k, y: float(u_V[k])


def records_of(case: Case, folder: Path, seed: int) -> tuple[list[Record], list[Record], Friction]:
    """The records that rig identifies; those that it is to predict; the motor."""
    kind = KINDS[case.servo]
    friction = Friction.read(folder / f"{kind.file}-{case.model}.json")
    truth, rng = Truth(friction, case.load), np.random.default_rng(seed)
    if case.record == "relay":
        amplitude, period_s = kind.cycle
        period_s = min(period_s, LOADED_S) if case.load.mass_kg else period_s
        rows = round(CYCLES * period_s / PERIOD_S)
        found = [
            driven(case, friction, relay_law(case, truth, share * amplitude, period_s), rows, rng)
            for share in (1.0, 0.7)
        ]
    else:
        found = [driven(case, friction, stroke_law(kind.max_V), round(STROKES_S / PERIOD_S), rng)]
    rows = round(OPEN_S / PERIOD_S)
    unseen = [driven(case, friction, open_law(kind.max_V, rng), rows, rng) for _ in range(OPEN_RECORDS)]
    return found, unseen, friction
