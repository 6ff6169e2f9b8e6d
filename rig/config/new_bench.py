"""The first config of a bench, from a few answers: config/uno.yaml with its comments, and the answers put in.

What can be answered stands in tables: a board, a sensor or a bridge more is one line more.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final

from rig.config import ready
from rig.errors import RigError

_EXAMPLE: Final = "uno"
_EXAMPLE_HARD_RAD: Final = 1.6  # limits.hard_rad of the example: its limits, speed and amplitudes go with it
_MARGIN_RAD: Final = 0.2  # from the hard limits to the mechanical stops
_POTENTIOMETER_RAD: Final = math.radians(270.0)  # electrical travel of a usual one
_LARGEST_TRAVEL_DEG: Final = 125.0  # to each side: what that potentiometer shows without its ends
_LEAST_TRAVEL_DEG: Final = 40.0  # less is too small for the steps of 10 bits


class AnswerError(RigError):
    """An answer that cannot be: one line of cause, one of cure."""

    def __init__(self, cause: str, cure: str) -> None:
        self.cause = cause
        self.cure = cure
        super().__init__(f"{cause}\n{cure}")


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


BOARDS: Final = {"uno": "Arduino Uno"}
SENSORS: Final = {"potentiometer": "potentiometer on the shaft, 10 bits"}
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


@dataclass(frozen=True)
class Answers:
    """What somebody says of a bench.

    board, sensor, bridge  keys of ``BOARDS``, ``SENSORS`` and ``BRIDGES``
    port                   of the board
    supply_V               motor supply, V
    travel_deg             from the centre of travel to the mechanical stop on each side, degrees
    no_load_rpm            speed of the measured shaft without load at that supply, revolutions a minute
    Raises AnswerError.
    """

    board: str
    sensor: str
    bridge: str
    port: str
    supply_V: float
    travel_deg: float
    no_load_rpm: float

    def __post_init__(self) -> None:
        for answer, table in ((self.board, BOARDS), (self.sensor, SENSORS), (self.bridge, BRIDGES)):
            if answer not in table:
                raise AnswerError(f"{answer!r} is not among {', '.join(table)}", "give one of these")
        module = BRIDGES[self.bridge]
        if not 2.0 * module.drop_V < self.supply_V <= module.largest_V:
            raise AnswerError(
                f"a motor supply of {self.supply_V:g} V is nothing for {module.words}: {2.0 * module.drop_V:g} to "
                f"{module.largest_V:g} V",
                "another supply or another bridge",
            )
        if not _LEAST_TRAVEL_DEG <= self.travel_deg <= _LARGEST_TRAVEL_DEG:
            raise AnswerError(
                f"{self.travel_deg:g} degrees to each side are not {_LEAST_TRAVEL_DEG:g} to {_LARGEST_TRAVEL_DEG:g}",
                "less is too little to stop and to measure in; a potentiometer of 270 degrees shows no more",
            )
        if not (math.isfinite(self.no_load_rpm) and self.no_load_rpm > 0.0):
            raise AnswerError(
                f"a speed of {self.no_load_rpm:g} revolutions a minute is none",
                "see the motor's data sheet, behind the gear",
            )


def text(answers: Answers, file: str) -> str:
    """The config for this ``file``: the commented example with these answers in it."""
    module = BRIDGES[answers.bridge]
    hard_rad = round(math.radians(answers.travel_deg) - _MARGIN_RAD, 2)
    size = hard_rad / _EXAMPLE_HARD_RAD
    soft_rad = round(0.56 * hard_rad, 2)
    calibrated_rad = round(hard_rad + 0.5 * _MARGIN_RAD, 2)
    counts = round(calibrated_rad * 1023 / _POTENTIOMETER_RAD)
    top_rad_s = math.ceil(answers.no_load_rpm * math.pi / 30.0 * 10.0) / 10.0
    new = ready.text(_EXAMPLE)
    for key, value in (
        ("name", "bench"),
        ("port", answers.port),
        ("calibration", _rows((512 - counts, -calibrated_rad), (512 + counts, calibrated_rad))),
        ("bridge", module.inputs),
        ("supply_V", f"{answers.supply_V:g}"),
        ("bridge_drop_V", f"{module.drop_V:g}"),
        ("max_V", f"{min(3.0, round(0.5 * (answers.supply_V - module.drop_V), 1)):g}"),
        ("no_load_speed_rad_s", f"{top_rad_s:g}"),
        ("soft_rad", f"[{-soft_rad:g}, {soft_rad:g}]"),
        ("hard_rad", f"[{-hard_rad:g}, {hard_rad:g}]"),
        ("max_speed_rad_s", f"{math.floor(45.0 * size) / 10.0:g}"),
        ("target", f"{{amplitude_rad: {0.45 * size:.2f}, period_s: 1.0}}"),
        ("trajectory", _trajectory((0.4 * size, 1.5), (0.2 * size, 3.1))),
    ):
        new = _with(new, key, value)
    return _with_introduction(new, answers, module).replace(f"config/{_EXAMPLE}.yaml", file)


def _rows(*points: tuple[int, float]) -> str:
    return "\n" + "\n".join(f"    - {{counts: {counts}, rad: {rad:g}}}" for counts, rad in points)


def _trajectory(*sines: tuple[float, float]) -> str:
    return "\n" + "\n".join(f"    - {{amplitude_rad: {size:.2f}, omega_rad_s: {omega:g}}}" for size, omega in sines)


def _with(config: str, key: str, value: str) -> str:
    """The text with another value of the first key of this name; its comment stays in its column, if it can.

    A value that begins with a line break replaces the list below the key.
    """
    if value.startswith("\n"):
        new, count = re.subn(rf"(?m)^(\s*{key}:)[ ]*(?:\n\s+- .*)+", lambda found: found[1] + value, config, count=1)
    else:

        def line(found: re.Match[str]) -> str:
            start = f"{found[1]} {value}"
            if found[3] is None:
                return start
            column = found.start(3) - found.start()
            return f"{start}{' ' * max(1, column - len(start))}{found[3]}"

        new, count = re.subn(rf"(?m)^(\s*{key}:) ([^#\n]*?)[ ]*(#.*)?$", line, config, count=1)
    if count != 1:
        raise KeyError(key)
    return new


def _with_introduction(config: str, answers: Answers, module: BridgeModule) -> str:
    """With the first comment, which speaks of the example, in words of this bench."""
    start, end = config.index("# A real bench"), config.index("#\n# Wiring that no software")
    introduction = f"""\
# A real bench: {BOARDS[answers.board]}, {module.words}, DC gear motor,
# {SENSORS[answers.sensor]}. Written by `rig init`; what it asked is put in.
# Every other number is an example of a plausible bench: measure yours, as the comments say, then run `rig check` on
# this file. docs/real-bench.md has the wiring diagram, the firmware (for this bridge `rig flash --bridge
# {module.inputs} --baud 1000000`) and the first steps, one by one.
"""
    head = config[:start]
    without_schema = "\n".join(line for line in head.splitlines() if "yaml-language-server" not in line)
    return without_schema + introduction + config[end:]
