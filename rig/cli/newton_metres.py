"""`rig newton-metres`: what a volt of a motor is in N m, from a stated mass on an arm."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from rig.cli.failure import EXIT_BAD_INPUT, EXIT_FAILED, fail, fail_input
from rig.cli.options import JSON
from rig.newton_metres import Load, NewtonMetres, Quantity, newton_metres
from rig.recording.errors import RecordingError
from rig.recording.folder import json_text

_POSITIVE = click.FloatRange(min=0.0, min_open=True)
_FROM_ZERO = click.FloatRange(min=0.0)
_MASS_PERCENT, _ARM_M, _R_PERCENT = 1.0, 0.001, 2.0  # half widths at 95 % where nobody says better


@click.command("newton-metres")
@click.argument("loaded", metavar="LOADED", type=click.Path(path_type=Path))
@click.option("--mass-kg", type=_POSITIVE, required=True, help="Of the mass at the end of the arm.")
@click.option("--arm-m", type=_POSITIVE, required=True, help="From the shaft's axis to the middle of the mass.")
@click.option("--rod-kg", type=_FROM_ZERO, default=0.0, help="Of the arm itself, an even rod. Default: 0.")
@click.option(
    "--bare", type=click.Path(path_type=Path), metavar="FOUND",
    help="The same motor without the load: then inertia tells, too, and both ways are compared.",
)  # fmt: skip
@click.option("--R-ohm", "R_ohm", type=_POSITIVE, help="Of the winding, measured: for kt.")
@click.option("--mass-u95-kg", type=_FROM_ZERO, help="How far the mass may be off, at 95 %. Default: 1 % of it.")
@click.option("--arm-u95-m", type=_FROM_ZERO, default=_ARM_M, show_default=True, help="The same of the arm.")
@click.option("--R-u95-ohm", "R_u95_ohm", type=_FROM_ZERO, help="The same of the winding. Default: 2 % of it.")
@JSON
def newton_metres_command(
    loaded: Path,
    mass_kg: float,
    arm_m: float,
    rod_kg: float,
    bare: Path | None,
    R_ohm: float | None,
    mass_u95_kg: float | None,
    arm_u95_m: float,
    R_u95_ohm: float | None,
    as_json: bool,
) -> None:
    """Tell a motor's torque, inertia and friction in newton metres, by a mass on an arm.

    LOADED is a run with that mass on the shaft, which lies level: a run folder, or what `rig identify --json` printed
    into a file.
    """
    from rig.identify.known_model import answer_in

    mass = Quantity(mass_kg, 0.01 * _MASS_PERCENT * mass_kg if mass_u95_kg is None else mass_u95_kg)
    winding = None
    if R_ohm is not None:
        winding = Quantity(R_ohm, 0.01 * _R_PERCENT * R_ohm if R_u95_ohm is None else R_u95_ohm)
    try:
        load = Load(mass, Quantity(arm_m, arm_u95_m), rod_kg)
        found = newton_metres(answer_in(loaded), load, None if bare is None else answer_in(bare), winding)
    except RecordingError as error:
        fail_input(error)
    except ValueError as error:
        fail(EXIT_BAD_INPUT, str(error), "correct the numbers of the load")
    if as_json:
        click.echo(json_text(found.as_json()), nl=False)
    else:
        for line in _lines(found):
            click.echo(line)
    sys.exit(EXIT_FAILED if found.verdict == "refused" else 0)


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
