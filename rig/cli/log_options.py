"""The options that say what the columns of somebody's own log are."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import click

from rig.cli.failure import EXIT_BAD_INPUT, fail
from rig.run_folder.recording.log_format import UNITS, LogColumn, LogFormat, LogFormatError, parse_period
from rig.run_folder.recording.servo_law import ServoLaw, scale_of

_COLUMN = "[COLUMN:]UNIT"


def _units(quantity: str) -> str:
    *most, last = UNITS[quantity]
    return f"{', '.join(most)} or {last}"


def _servo_law(
    model: str | None, gain: float | None, scale: float | None, rest: dict[str, Any], texts: dict[str, Any]
) -> ServoLaw | None:
    """The law of --servo, --gain and --p-scale; None without them. Counts of its position are the servo's own."""
    if model is None:
        if gain is not None or scale is not None:
            fail(EXIT_BAD_INPUT, "--gain and --p-scale are for the log of a servo's own loop", "add --servo MODEL")
        return None
    from rig.backends.servo.models import MODELS

    if model not in MODELS:
        fail(EXIT_BAD_INPUT, f"{model} is no servo that rig knows", f"give one of {', '.join(MODELS)}")
    in_counts = any(text is not None and text.rpartition(":")[2] == "counts" for text in texts.values())
    if in_counts and rest["counts_per_turn"] is None:
        rest["counts_per_turn"] = float(MODELS[model].counts_per_turn)
    roles = MODELS[model].roles
    slope = MODELS[model].role("slope") if "slope" in roles else None
    slew_V_s = slope.shipped * slope.scale if slope is not None and slope.shipped is not None else math.inf
    return ServoLaw(gain, scale_of(MODELS[model].protocol, scale), slew_V_s)


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
    click.option("--drive-row", type=int, default=0, help="-1: each drive stands a row too late, and moves up."),
    click.option("--servo", "servo_model", metavar="MODEL", help="Of a log that this servo's own position loop made."),
    click.option("--gain", type=click.FloatRange(min=0.0, min_open=True), metavar="P", help="Of --servo: its P."),
    click.option(
        "--p-scale",
        type=click.FloatRange(min=0.0, min_open=True),
        metavar="1/RAD",
        help="Of --servo: the share of full duty that a P of 1 makes of 1 rad, as `rig servo facts` measures it.",
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
        rest = {name: given.pop(name) for name in ("counts_per_turn", "full", "supply_V", "drive_row", "time_row")}
        rest |= {"run": given.pop("run_column"), "reversed": given.pop("is_reversed")}
        servo = _servo_law(given.pop("servo_model"), given.pop("gain"), given.pop("p_scale"), rest, texts)
        log = None
        if (
            servo is not None
            or period is not None
            or any(value is not None for value in texts.values())
            or any(rest.values())
        ):
            try:
                columns: dict[str, Any] = {
                    name: LogColumn.parse(name, text) for name, text in texts.items() if text is not None
                }
                period_s = None if period is None else parse_period(period)
                log = LogFormat(**columns, **rest, period_s=period_s, servo=servo)
            except LogFormatError as error:
                fail(EXIT_BAD_INPUT, error.cause, error.cure)
        return command(log=log, **given)

    for option in reversed(_OPTIONS):
        with_log = option(with_log)
    return with_log
