"""The one table of a real motor's numbers: each field of ``RealMotor`` and ``Frame`` is a row.

It makes the C struct (``tools/motor_numbers.py`` writes firmware/motor/real_motor.h), the section
``emulated.motor.parts`` of a config, the numbers of the laws in ``rig.identification.departures``, what an export says
of each, and the symbols of docs/theory.md 12.1. A command that only reads a config imports it, and loads no physics.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple, get_type_hints

Numbers = tuple[float, ...]  # of a RealMotor or a Frame, without their names


class Number(NamedTuple):
    """A row: what is known of a number beside its name and its value where the part is not there.

    unit       1: none
    meaning    in words
    laws       that it belongs to, by their names in a result; none: it is of every motor, or of a frame
    symbol     in docs/theory.md 12.1
    is_shape   whether it has no effect while the other numbers of its law are 0: a speed, an order or a share
    least, above, below   bounds that the model takes: at least, above and below
    one_sided  whether no bench has it below 0, though the model takes it
    steers     whether the motor is integrated more finely where it is not 0
    linear     whether the motion between two events stays linear in velocity and time where it is not 0
    at_rest    whether it is one of those whose sum holds a shaft at rest (docs/theory.md 8.4)
    """

    unit: str
    meaning: str
    laws: tuple[str, ...] = ()
    symbol: str = ""
    is_shape: bool = False
    least: float = -math.inf
    above: float = -math.inf
    below: float = math.inf
    one_sided: bool = False
    steers: bool = False
    linear: bool = False
    at_rest: bool = False

    @property
    def of_benches(self) -> float:
        """The least that it may be on a bench."""
        return max(self.least, self.above, 0.0 if self.one_sided else -math.inf)


_CURVE = "the sensor's curvature: of"
_SINE, _COSINE = "times sin(y - centre)", "times cos(y - centre) less its mean over the travel"


class RealMotor(NamedTuple):
    """A motor with its parts, as numbers. Their order here is that of every vector and Jacobian of them, and of the C.

    Viscous friction equal both ways is in tau and K; f_c is the mean over both directions, the run and the travel.
    """

    tau_s: Annotated[float, Number("s", "time constant of the velocity", above=0.0, linear=True)]
    K_rad_s_V: Annotated[float, Number("(rad/s)/V", "velocity gain of the measured shaft", above=0.0, linear=True)]
    fc_V: Annotated[float, Number("V", "Coulomb friction", least=0.0, at_rest=True, linear=True)]
    bias_V: Annotated[
        float, Number("V", "constant added to the drive; friction that differs by direction is in it", linear=True)
    ] = 0.0
    delay_s: Annotated[
        float, Number("s", "from a sample to the effect of its drive on the recording bench", linear=True)
    ] = 0.0
    dead_band_V: Annotated[
        float,
        Number(
            "V", "drive up to which the stage gives nothing; above it is missing from the drive", ("dead_band",), "d",
            least=0.0, at_rest=True, linear=True),
    ] = 0.0  # fmt: skip
    gain_by_sign: Annotated[
        float,
        Number("1", "g: the stage gives u (1 + g sgn u)", ("gain_by_sign",), "g", above=-1.0, below=1.0, linear=True),
    ] = 0.0
    sag_per_V: Annotated[
        float, Number("1/V", "s: the stage gives u (1 - s |u|)", ("sag",), "s", one_sided=True, linear=True)
    ] = 0.0
    lag_s: Annotated[float, Number("s", "time constant of the stage and the current", ("lag",), "tau_e", least=0.0)] = (
        0.0
    )
    viscous_by_direction_V_s_rad: Annotated[
        float,
        Number(
            "V s/rad", "beta: force beta |v|, half the difference of both directions", ("viscous_by_direction",),
            "beta", steers=True, linear=True),
    ] = 0.0  # fmt: skip
    static_V: Annotated[
        float,
        Number(
            "V",
            "by which the level at rest is above the level in motion",
            ("static",),
            "e_s",
            least=0.0,
            at_rest=True,
            linear=True,
        ),
    ] = 0.0
    stribeck_V: Annotated[
        float,
        Number(
            "V", "e: friction e exp(-|v|/v_s) beside Coulomb friction", ("stribeck",), "e",
            one_sided=True, steers=True, at_rest=True,
        ),
    ] = 0.0  # fmt: skip
    stribeck_rad_s: Annotated[
        float,
        Number("rad/s", "v_s: speed of the Stribeck effect", ("stribeck",), "v_s", is_shape=True, least=0.0),
    ] = 0.0
    drag_V_s2_rad2: Annotated[
        float, Number("V s2/rad2", "c: drag c v |v|", ("drag",), "c", one_sided=True, steers=True)
    ] = 0.0
    bristle_V_rad: Annotated[
        float,
        Number("V/rad", "stiffness of the bristles at rest; 0: rigid", ("bristle",), "sigma_0", least=0.0),
    ] = 0.0
    force_sin_V: Annotated[
        float, Number("V", f"force over position: {_SINE}", ("force_over_position",), "A", steers=True)
    ] = 0.0
    force_cos_V: Annotated[
        float, Number("V", f"force over position: {_COSINE}", ("force_over_position",), "B", steers=True)
    ] = 0.0
    friction_sin_V: Annotated[
        float,
        Number("V", f"friction over position: {_SINE}", ("friction_over_position",), "A", steers=True),
    ] = 0.0
    friction_cos_V: Annotated[
        float,
        Number("V", f"friction over position: {_COSINE}", ("friction_over_position",), "B", steers=True),
    ] = 0.0
    cogging_sin_V: Annotated[float, Number("V", "cogging: times sin(n y)", ("cogging",), "A", steers=True)] = 0.0
    cogging_cos_V: Annotated[float, Number("V", "cogging: times cos(n y)", ("cogging",), "B", steers=True)] = 0.0
    cogging_per_rad: Annotated[
        float,
        Number(
            "1/rad",
            "n, order of the cogging: cogs for each radian of the shaft",
            ("cogging",),
            "n",
            is_shape=True,
            one_sided=True,
        ),
    ] = 0.0
    backlash_rad: Annotated[
        float, Number("rad", "whole width of the play between motor and sensor", ("backlash",), least=0.0, linear=True)
    ] = 0.0
    linearity_sin1_rad: Annotated[
        float, Number("rad", f"{_CURVE} one sine over the travel, less its line", ("linearity",), linear=True)
    ] = 0.0
    linearity_cos1_rad: Annotated[float, Number("rad", f"{_CURVE} one cosine", ("linearity",), linear=True)] = 0.0
    linearity_sin2_rad: Annotated[
        float, Number("rad", f"{_CURVE} two sines, less their line", ("linearity",), linear=True)
    ] = 0.0
    linearity_cos2_rad: Annotated[float, Number("rad", f"{_CURVE} two cosines", ("linearity",), linear=True)] = 0.0
    drift: Annotated[
        float,
        Number(
            "1",
            "relative change of Coulomb friction from the start of the tests to their end",
            ("drift",),
            "d",
            linear=True,
        ),
    ] = 0.0
    load_friction: Annotated[
        float,
        Number(
            "1", "L: friction L |p + l G| beside Coulomb friction, of torque p and force over position G",
            ("load_friction",), "L", least=0.0, below=1.0, steers=True, linear=True),
    ] = 0.0  # fmt: skip
    load_outside: Annotated[
        float,
        Number(
            "1",
            "l: share of the force over position that it sees",
            ("load_friction",),
            "l",
            is_shape=True,
            least=0.0,
            linear=True,
        ),
    ] = 0.0
    viscous_share: Annotated[
        float,
        Number(
            "1", "r: share of 1/K that is viscous friction; the rest is back-EMF", ("load_friction", "source"), "r",
            is_shape=True, least=0.0, below=1.0, linear=True),
    ] = 0.0  # fmt: skip
    source_per_V2: Annotated[
        float,
        Number(
            "1/V2",
            "rho: torque p = (w - (1 - r) v/K) / (1 + rho w^2)",
            ("source",),
            "rho",
            least=0.0,
            steers=True,
            linear=True,
        ),
    ] = 0.0
    runs_free: Annotated[
        float,
        Number(
            "1", "f: share of the torque p that is missing at a drive of 0", ("runs_free",), "f", least=0.0, below=1.2,
            steers=True, linear=True),
    ] = 0.0  # fmt: skip
    no_brake: Annotated[
        float,
        Number(
            "1", "b: share that is missing of a torque p against the drive, or without one", ("no_brake",), "b",
            least=0.0, below=1.2, steers=True, linear=True),
    ] = 0.0  # fmt: skip
    free_between: Annotated[
        float,
        Number(
            "1", "c: share of the back-EMF that brakes only while a pulse is on, for |w|/U of the time",
            ("free_between",), "c", least=0.0, below=1.2, steers=True, linear=True),
    ] = 0.0  # fmt: skip
    full_drive_V: Annotated[
        float,
        Number(
            "V", "U: drive at which the pulses meet; tau and K are those of it", ("free_between",), "U", is_shape=True,
            least=0.0, linear=True),
    ] = 0.0  # fmt: skip


class Frame(NamedTuple):
    """What the parts over position and time refer to: constants of a fit, and no parameters.

    ``start_s`` and ``duration_s`` are those of the run; only ``drift`` uses them.
    """

    centre_rad: Annotated[float, Number("rad", "middle of the driven travel, to which terms over position refer")] = 0.0
    half_travel_rad: Annotated[float, Number("rad", "half its width", above=0.0)] = math.pi
    start_s: Annotated[float, Number("s", "start of the tests")] = 0.0
    duration_s: Annotated[float, Number("s", "their duration", above=0.0)] = 1.0


def _rows(of: type[RealMotor] | type[Frame]) -> dict[str, Number]:
    hints = get_type_hints(of, include_extras=True)
    return {name: hints[name].__metadata__[0] for name in of._fields}


NUMBERS = _rows(RealMotor)
FRAME = _rows(Frame)
AT_REST_V = tuple(name for name, number in NUMBERS.items() if number.at_rest)
"""Their sum, V, holds a shaft at rest (docs/theory.md 8.4)."""

PARTS: dict[str, tuple[str, ...]] = {
    law: tuple(name for name, number in NUMBERS.items() if law in number.laws)
    for law in dict.fromkeys(law for number in NUMBERS.values() for law in number.laws)
}
"""The parts by their names in a result, each with its numbers."""


def of_every_bench(name: str) -> bool:
    """Whether the number is of the plain motor that every bench has: it has friction at rest, and a Stribeck effect."""
    return set(NUMBERS[name].laws) <= {"static", "stribeck"}


class State(NamedTuple):
    """State of a real motor.

    v, y   velocity, rad/s, and position, rad, of the motor's side of the backlash
    f      friction of the bristles, V; 0 without them
    w      drive behind its stage, V
    x      position of the sensor's side of the backlash when the motor last reversed, rad
    """

    v: float
    y: float
    f: float
    w: float
    x: float
