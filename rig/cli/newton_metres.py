"""`rig newton-metres`: what a volt of a motor is in N m, from a stated mass on an arm."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import click

from rig.cli.shared import EXIT_FAILED, JSON, PATH, FiniteRange, asks_json, fail, say_json
from rig.output.newton_metres import Load, NewtonMetres, Quantity, newton_metres
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CONFIG

_PERCENT, _ARM_M, _R_PERCENT = 1.0, 0.001, 2.0  # half widths at 95 % where nobody says better


class Measured(click.ParamType):  # type: ignore[type-arg]
    """``VALUE`` or ``VALUE,ERROR``: a number above 0, and how far it may be off at 95 %.

    percent, error   without ERROR: %, of the value, and a part in its own unit beside that
    """

    name = "measured"

    def __init__(self, percent: float = 0.0, error: float = 0.0) -> None:
        self.percent, self.error = percent, error

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Quantity:
        """Both."""
        number, comma, error = str(value).partition(",")
        try:
            of = float(number)
            half = float(error) if comma else 0.01 * self.percent * of + self.error
        except ValueError:
            of = half = math.nan
        if not (0.0 < of < math.inf and 0.0 <= half < of):
            self.fail(f"{value!r} must be a number above 0, or with its error at 95 %: 0.1,0.001", param, ctx)
        return Quantity(of, half)


@click.command("newton-metres")
@click.argument("loaded", metavar="LOADED", type=PATH)
@click.option(
    "--mass-kg", type=Measured(percent=_PERCENT), metavar="KG[,ERROR]",
    help="Of the mass at the end of the arm, and how far it may be off at 95 %. Default of that: 1 %; of the mass: "
    "`load` of LOADED's config.",
)  # fmt: skip
@click.option(
    "--arm-m", type=Measured(error=_ARM_M), metavar="M[,ERROR]",
    help="From the shaft's axis to the middle of the mass; default of its error: 1 mm; of the arm: as of the mass.",
)  # fmt: skip
@click.option("--rod-kg", type=FiniteRange(min=0.0), default=0.0, help="Of the arm itself, an even rod.")
@click.option(
    "--bare", type=PATH, metavar="FREE",
    help="The same motor without the load: then inertia tells, too, and both ways are compared.",
)  # fmt: skip
@click.option(
    "--R-ohm", "R_ohm", type=Measured(percent=_R_PERCENT), metavar="OHM[,ERROR]",
    help="Of the winding, measured, for kt; default of its error: 2 %.",
)  # fmt: skip
@JSON
def newton_metres_command(
    loaded: Path,
    mass_kg: Quantity | None,
    arm_m: Quantity | None,
    rod_kg: float,
    bare: Path | None,
    R_ohm: Quantity | None,
) -> None:
    """Tell a motor in newton metres, by a mass on an arm.

    LOADED is a run with that mass on the shaft, which lies level: a run folder, or what `rig identify --json` printed
    into a file; FREE is one without it.
    """
    from rig.identification.known_model import answer_in

    try:
        if mass_kg is None or arm_m is None:
            stated = _stated(loaded)
            mass_kg, arm_m = mass_kg or stated.mass_kg, arm_m or stated.arm_m
        load = Load(mass_kg, arm_m, rod_kg)
        found = newton_metres(answer_in(loaded), load, None if bare is None else answer_in(bare), R_ohm)
    except ValueError as error:
        fail(str(error), "correct the numbers of the load")
    if asks_json():
        say_json(found.as_json())
    else:
        for line in _lines(found):
            click.echo(line)
    sys.exit(EXIT_FAILED if found.verdict == "refused" else 0)


def _stated(loaded: Path) -> Load:
    """The load that the config of a run states, all in one place. Raises RecordingError, ConfigError."""
    from rig import config

    file = loaded / CONFIG
    load = config.load(file, follows_links=False).load if file.is_file() else None
    if load is None:
        raise RecordingError(
            loaded,
            "states no load",
            "give --mass-kg and --arm-m, or `load: {mass_kg, arm_m}` in the config before a run",
        )
    mass_kg = Quantity(load.mass_kg, 0.01 * _PERCENT * load.mass_kg)
    return Load(mass_kg, Quantity(load.arm_m, _ARM_M))


def _lines(found: NewtonMetres) -> list[str]:
    rows = (
        ("a", found.torque_N_m_V, "N m/V", "torque of a volt"),
        ("  by gravity", found.by_gravity, "N m/V", ""),
        ("  by inertia", found.by_inertia, "N m/V", ""),
        ("J", found.inertia_kg_m2, "kg m2", "without the load"),
        ("f_c", found.friction_N_m, "N m", "Coulomb friction"),
        ("b + kt2/R", found.damping_N_m_s_rad, "N m s/rad", "torque for each rad/s"),
        ("kt", found.kt_N_m_A, "N m/A", ""),
    )
    shown = [
        f"{name:<13}{one.value:<10.4g} {unit:<10}± {one.percent:.2g} %  {words}".rstrip()
        for name, one, unit, words in rows
        if one is not None
    ]
    if found.difference is not None and found.verdict != "refused":
        shown.append(f"both ways agree: {100.0 * found.difference.value:+.2g} ± {100.0 * found.difference.u95:.2g} %")
    return [*shown, found.verdict, *(f"- {reason}" for reason in found.reasons)]
