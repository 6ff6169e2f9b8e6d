"""The options that say what the columns of somebody's own log are."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import click

from rig.cli.failure import EXIT_BAD_INPUT, fail
from rig.recording.log_format import UNITS, LogColumn, LogFormat, LogFormatError, parse_period

_COLUMN = "[COLUMN:]UNIT"


def _units(quantity: str) -> str:
    *most, last = UNITS[quantity]
    return f"{', '.join(most)} or {last}"


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
        log = None
        if period is not None or any(value is not None for value in texts.values()) or any(rest.values()):
            try:
                columns = {name: LogColumn.parse(name, text) for name, text in texts.items() if text is not None}
                period_s = None if period is None else parse_period(period)
                time, drive, position, velocity = map(columns.get, UNITS)
                log = LogFormat(time, drive, position, velocity, period_s=period_s, **rest)
            except LogFormatError as error:
                fail(EXIT_BAD_INPUT, error.cause, error.cure)
        return command(log=log, **given)

    for option in reversed(_OPTIONS):
        with_log = option(with_log)
    return with_log
