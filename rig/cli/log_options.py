"""The options that say what the columns of somebody's own log are."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import click

from rig.cli.shared import Positive, fail
from rig.run_folder.recording.log_format import UNITS, LogColumn, LogFormat, parse_period
from rig.run_folder.recording.servo_law import ServoLaw, scale_of

_COLUMN = "[COLUMN:]UNIT"
_NUMBERS = ("counts_per_turn", "full", "supply_V", "direction", "drive_row", "time_row")
_OLDEST_S = 0.5  # position of a log


def _units(quantity: str) -> str:
    *most, last = UNITS[quantity]
    return f"{', '.join(most)} or {last}"


class Gains(click.ParamType):  # type: ignore[type-arg]
    """``P`` or ``P,I,D`` of a servo's position loop."""

    name = "gains"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """The one, or the three."""
        try:
            gains = tuple(map(float, str(value).split(",")))
        except ValueError:
            gains = ()
        if len(gains) not in (1, 3) or not all(map(math.isfinite, gains)) or not gains[0] > 0.0:
            self.fail(f"{value!r} must be the servo's P, above 0, or all three: 400,0,0", param, ctx)
        return gains


def _servo_law(given: dict[str, Any], rest: dict[str, Any], texts: dict[str, Any]) -> ServoLaw | None:
    """The law of --servo and the options of its loop; None without them. Counts of its position are the servo's own."""
    model, gain, scale, age = (given.pop(name) for name in ("servo_model", "gain", "p_scale", "position_age"))
    if model is None:
        if (gain, scale, age) != (None, None, None):
            fail("--gain, --p-scale and --position-age are for the log of a servo's own loop", "add --servo MODEL")
        return None
    from rig.backends.servo.first_config import model_named

    servo = model_named(model)
    in_counts = any(text is not None and text.rpartition(":")[2] == "counts" for text in texts.values())
    if in_counts and rest["counts_per_turn"] is None:
        rest["counts_per_turn"] = float(servo.counts_per_turn)
    roles = servo.roles
    slope = servo.role("slope") if "slope" in roles else None
    slew_V_s = slope.shipped * slope.scale if slope is not None and slope.shipped is not None else math.inf
    P, *others = gain or (None,)
    if any(others):
        fail(
            f"--gain: the law that rig knows is duty = P x error, and I is {others[0]:g}, D {others[1]:g}",
            "write 0 into both registers, and record again",
        )
    age_s = 0.0 if age is None else parse_period(age, "--position-age")
    if age_s > _OLDEST_S:
        fail(f"--position-age {age}: no link makes a position so old", f"give at most {_OLDEST_S:g}s")
    shipped = [servo[f"position_{one}_gain"].shipped for one in "id"]
    return ServoLaw(
        P,
        scale_of(servo.protocol, scale),
        slew_V_s,
        is_P_alone=bool(others) or shipped == [0, 0],
        model=servo.name,
        position_age_s=age_s,
    )


_OPTIONS = (
    click.option("--time", metavar=_COLUMN, help=f"Of a log: the time, in {_units('time')}."),
    click.option("--drive", metavar=_COLUMN, help=f"Of a log: the drive, in {_units('drive')}; signed."),
    click.option("--position", metavar=_COLUMN, help=f"Of a log: the position, in {_units('position')}."),
    click.option(
        "--velocity", metavar=_COLUMN, help=f"Of a log without a position: the velocity, in {_units('velocity')}."
    ),
    click.option("--counts-per-turn", type=float, help="Counts of one turn of the shaft, gear and all edges included."),
    click.option("--full", type=float, help="The drive's number at full drive; for pwm."),
    click.option(
        "--supply-V", "supply_V", type=float, help="Volts at the motor at full drive; for pwm, duty, percent."
    ),
    click.option("--reversed", "is_reversed", is_flag=True, help="A positive drive turns to falling positions."),
    click.option("--period", metavar="TIME", help="Of a log without a time: from row to row, such as 2ms."),
    click.option("--run", "run_column", metavar="COLUMN", help="Of a log of several runs: the column that says which."),
    click.option("--direction", metavar="COLUMN", help="Of a drive without a sign: the column that says which way."),
    click.option("--drive-row", type=int, default=0, help="-1: each drive stands a row too late, and moves up."),
    click.option("--servo", "servo_model", metavar="MODEL", help="Of a log that this servo's own position loop made."),
    click.option("--gain", type=Gains(), metavar="P[,I,D]", help="Of --servo: its P; with I and D, which must be 0."),
    click.option(
        "--p-scale",
        type=Positive(),
        metavar="1/RAD",
        help="Of --servo: the share of full duty that a P of 1 makes of 1 rad, as `rig servo facts` measures it.",
    ),
    click.option(
        "--position-age", metavar="TIME", help="Of --servo: how old the position is at its row's time, such as 6ms."
    ),
    click.option("--goal", metavar=_COLUMN, help=f"Of --servo: the goal, in {_units('goal')}."),
    click.option("--time-row", type=int, default=0, help="-1: each time stands a row too late, and moves up."),
)


def log_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options of a log, and its parameter ``log``: a LogFormat, or None without these options."""

    @functools.wraps(command)
    def with_log(**given: Any) -> Any:
        texts = {quantity: given.pop(quantity) for quantity in UNITS}
        period = given.pop("period")
        rest = {name: given.pop(name) for name in _NUMBERS}
        rest |= {"run": given.pop("run_column"), "reversed": given.pop("is_reversed")}
        servo = _servo_law(given, rest, texts)
        log = None
        said = {name: text for name, text in texts.items() if text is not None}
        if servo is not None or period is not None or said or any(rest.values()):
            columns: dict[str, Any] = {name: LogColumn.parse(name, text) for name, text in said.items()}
            period_s = None if period is None else parse_period(period)
            log = LogFormat(**columns, **rest, period_s=period_s, servo=servo)
        return command(log=log, **given)

    for option in reversed(_OPTIONS):
        with_log = option(with_log)
    return with_log
