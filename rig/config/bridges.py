"""Bridges as they are sold, and the inputs that each has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class BridgeModule:
    """A bridge as it is sold.

    words      what it is, for people
    inputs     drive.bridge: the kind of its inputs
    drop_V     lost in it at about 1 A, V
    largest_V  motor supply by its data sheet, V
    """

    words: str
    inputs: str
    drop_V: float
    largest_V: float


BRIDGES: Final = {
    "l298n": BridgeModule("L298N, with its jumper on ENA", "in1-in2", 2.0, 35.0),
    "tb6612": BridgeModule("TB6612FNG, PWMA and STBY tied high", "in1-in2", 0.5, 13.5),
    "drv8871": BridgeModule("DRV8871", "in1-in2", 0.6, 45.0),
    "drv8833": BridgeModule("DRV8833", "in1-in2", 0.4, 10.8),
    "bts7960": BridgeModule("BTS7960 (IBT-2), R_EN and L_EN tied high", "in1-in2", 0.1, 27.0),
    "md10c": BridgeModule("Cytron MD10C", "pwm-dir", 0.1, 30.0),
    "in1-in2": BridgeModule("another with two inputs, which brakes while both are high", "in1-in2", 0.5, 50.0),
    "pwm-dir": BridgeModule("another with PWM and direction, which brakes while PWM is low", "pwm-dir", 0.5, 50.0),
}

RUNS_FREE: Final = {
    "l298-ena": "L298 with PWM at ENA, or a shield with one: rig refuses it, and says what to do",
}


COASTS: Final = (  # cause and cure
    "with PWM at ENA an L298 lets the motor run free while PWM is low: nothing brakes it then, and rig finds "
    "no motor, or another one (docs/real-bench.md, Which bridge)",
    "a module: put the jumper back on ENA, lead the two PWM pins to IN1 and IN2, and answer l298n; a shield: "
    "take another bridge",
)


def of_module(name: str) -> str:
    """What to write as drive.bridge for a bridge as it is sold; empty where rig does not know it."""
    sold = name.lower()
    if sold in RUNS_FREE:
        return "; ".join(COASTS)
    return f"write {BRIDGES[sold].inputs}, the inputs of {BRIDGES[sold].words}" if sold in BRIDGES else ""
