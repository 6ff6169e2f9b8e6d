"""`rig export --to c`: the controller, compiled for this machine and for the Uno, beside ``rig.control.tracking``."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from evidence import evidence
from numpy.typing import NDArray
from run_with_laws import LAWS, PERIOD_S, PLAIN, motor_of, run_with

from rig.control.observer import MotorObserver
from rig.control.tracking import Tracking
from rig.control.trajectory import Reference, SumOfSines
from rig.core.signals import Sample
from rig.model.real_motor import FramedMotor, MovingMotor
from rig.output.export import export_model

Array = NDArray[np.float64]
HERE = Path(__file__).parent / "c"
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wshadow", "-Wstrict-prototypes")
UNO = ("-mmcu=atmega328p", "-DF_CPU=16000000UL", "-O2", "-flto", "-fuse-linker-plugin", "-fno-fat-lto-objects")
NOISE_RAD = 0.003
DELAY_S = PLAIN["delay_s"]
MOVED = (
    "dead_band",
    "gain_by_sign",
    "lag",
    "stribeck",
    "static",
    "viscous_by_direction",
    "force_over_position",
    "drag",
)


@dataclass(frozen=True)
class Ticks:
    """A closed loop of rig's own tracking: readings, rad, references, and the drives that rig asked for, V."""

    readings_rad: Array
    references: list[Reference]
    drives_V: Array

    def header(self) -> str:
        """As ``ticks.h``."""
        rows = ",\n".join(
            "    {" + ", ".join(repr(float(x)) for x in (y, to.y_rad, to.v_rad_s, to.a_rad_s2)) + "}"
            for y, to in zip(self.readings_rad, self.references, strict=True)
        )
        return (
            "#ifdef __AVR__\n#include <avr/pgmspace.h>\n#else\n#define PROGMEM\n#endif\n"
            f"enum {{ TICKS = {len(self.references)} }};\n"
            f"static const double TICK[TICKS][4] PROGMEM = {{\n{rows}\n}};\n"
        )


def tracked(motor: FramedMotor, ticks: int, seed: int) -> Ticks:
    """The tracking of rig, in a closed loop with the motor that its model is, and a noisy sensor."""
    observer = MotorObserver(motor, PERIOD_S, NOISE_RAD)
    observer.further_s = DELAY_S
    law = Tracking(motor, observer, SumOfSines([(0.5, 5.0), (0.1, 13.0)], fade_s=0.5), 12.0, 36.0, 1e9)
    shaft, noise = MovingMotor(motor.motor, motor.frame, 0.05), np.random.default_rng(seed)
    ahead_s = DELAY_S + motor.motor.lag_s
    readings, references, drives, acting_V = [], [], [], 0.0
    for k in range(ticks):
        reading = shaft.reading_rad + NOISE_RAD * noise.standard_normal()
        drives.append(law.step(Sample(k * PERIOD_S, reading, 0)))
        readings.append(reading)
        references.append(law.trajectory.at(k * PERIOD_S + ahead_s))
        shaft.advance(acting_V, 0.0, DELAY_S)
        acting_V = drives[-1]
        shaft.advance(acting_V, 0.0, PERIOD_S - DELAY_S)
    return Ticks(np.array(readings), references, np.array(drives))


def compiled(folder: Path, *command: str) -> Path:
    """The exported controller and the test's program, compiled; its path."""
    program = folder / f"ticks-{command[0]}"
    sources = [str(HERE / "ticks.c"), str(folder / "rig_controller.c"), str(folder / "real_motor.c")]
    subprocess.run([*command, *WARNINGS, f"-I{folder}", "-o", str(program), *sources, "-lm"], check=True)
    return program


@pytest.fixture(scope="module")
def chip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Uno's emulated chip, as a program that runs a program."""
    made = tmp_path_factory.mktemp("chip") / "uno"
    subprocess.run(["cc", "-O2", "-o", str(made), str(HERE / "uno.c"), "-lsimavr"], check=True)
    return made


OTHERS = ("cogging", "friction_over_position", "sag", "linearity")


@pytest.mark.parametrize("laws", [MOVED, OTHERS, *evidence(((),))], ids=len)
def test_the_controller_asks_for_rigs_own_drive_tick_for_tick(tmp_path: Path, laws: tuple[str, ...]) -> None:
    assert set(laws) <= set(LAWS)
    run = run_with(tmp_path, *laws)
    export_model(run, "c", tmp_path)
    ticks = tracked(motor_of(run), 400, 1)
    (tmp_path / "ticks.h").write_text(ticks.header(), encoding="ascii")
    program = compiled(tmp_path, "cc", "-O2", "-ffp-contract=off")
    said = subprocess.run([str(program)], check=True, capture_output=True).stdout
    theirs = np.frombuffer(said, dtype=np.float64)
    assert np.abs(ticks.drives_V).max() > 1.0
    np.testing.assert_allclose(theirs, ticks.drives_V, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("laws", [MOVED, *evidence(((),))], ids=len)
def test_on_the_uno_it_is_the_same_to_the_precision_of_its_numbers(
    tmp_path: Path, chip: Path, laws: tuple[str, ...]
) -> None:
    run = run_with(tmp_path, *laws)
    export_model(run, "c", tmp_path)
    ticks = tracked(motor_of(run), 60, 2)
    (tmp_path / "ticks.h").write_text(ticks.header(), encoding="ascii")
    program = compiled(tmp_path, "avr-gcc", *UNO)
    subprocess.run([str(chip), str(program), str(tmp_path / "drives")], check=True, capture_output=True)
    theirs = np.fromfile(tmp_path / "drives", dtype="<f4").astype(float)
    np.testing.assert_allclose(theirs, ticks.drives_V, rtol=0.0, atol=1e-4)
