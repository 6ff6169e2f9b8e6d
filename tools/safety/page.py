"""docs/evidence/safety-table.md, from what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from rig.running.preflight.rules import preflight
from safety.driven_chip import UNO, Way
from safety.garbage import Errors, Guesses, Thrown
from safety.promises import Measured
from shared import page
from shared.table import markdown

_TEMPLATE = Path(__file__).with_name("page.md.j2")
_PICO_TEMPLATE = Path(__file__).with_name("pico.md.j2")


class Found(NamedTuple):
    """All that the page shows.

    made       when and from what, in words
    chip       output of `make size` by baud rate
    """

    made: str
    promises: Sequence[Measured]
    thrown: Sequence[Thrown]
    errors: Errors
    guesses: Guesses
    chip: Mapping[int, str]


def is_kept(found: Found) -> bool:
    """Whether nothing is broken."""
    late = sum(row.late for row in found.promises)
    return late == 0 and found.errors.taken == 0 and all(thrown.moves == 0 for thrown in found.thrown)


def _way(way: Way) -> str:
    words: list[str] = [way.where]
    words += ["full drive"] if way.full else []
    words += ["flood"] if way.floods else []
    words += [f"{way.baud // 1_000_000} Mbaud"] if way.baud >= 1_000_000 else []
    words += ["IN1_IN2"] if way.bridge == "IN1_IN2" else []
    return ", ".join(words)


def _bound(bound_s: float) -> str:
    return f"{1e3 * bound_s:.0f} ms"


def _time(time_s: float) -> str:
    return f"{1e3 * time_s:.2f} ms" if time_s >= 1e-4 else f"{1e6 * time_s:.0f} us"


def row(measured: Measured) -> tuple[str, ...]:
    """One line of the table."""
    promise = measured.promise
    late = f" **late: {measured.late}**" if measured.late else ""
    rad = (f"{measured.coast_rad:.2f}", f"{measured.travel_rad:.2f}")
    return promise.what, _way(promise.way), _bound(promise.bound_s), f"{_time(measured.off_s)}{late}", *rad


def table(rows: Sequence[Measured]) -> str:
    """The table of promises."""
    head = ("what happens", "driven by", "off within", "worst", "coast, rad", "in all, rad")
    return markdown(head, map(row, rows))


def replaced(text: str, rows: Sequence[tuple[str, ...]], made: str) -> str:
    """A page with these rows in place of its own of that name and way; what else it says stays.

    rows  as ``row`` gives them; made: when and from what, as of ``Found``
    Raises ValueError for a row that the page does not have: then it has to be made whole.
    """
    lines = text.splitlines()
    for cells in rows:
        begin = f"| {cells[0]} | {cells[1]} |"
        at = [k for k, line in enumerate(lines) if line.startswith(begin)]
        if len(at) != 1:
            raise ValueError(f"the page has {len(at)} rows {begin}: make it whole")
        lines[at[0]] = f"| {' | '.join(cells)} |"
    last = max(k for k, line in enumerate(lines) if line.startswith(f"| {rows[-1][0]} | {rows[-1][1]} |"))
    end = next(k for k in range(last, len(lines)) if not lines[k].startswith("|"))
    names = dict.fromkeys(cells[0] for cells in rows)
    lines[end:end] = ["", f"Measured anew on {made}: {'; '.join(names)}."]
    return "\n".join(lines) + "\n"


def render(found: Found) -> str:
    """The page."""
    limits = UNO.experiment.limits
    stopping = next(line for line in preflight(UNO.experiment).lines if line.startswith("stopping"))
    return page.render(
        _TEMPLATE,
        made=found.made,
        phases=min(row.phases for row in found.promises),
        watchdog_ms=UNO.setup.watchdog_ms,
        speed=max(abs(UNO.steady(direction)[1]) for direction in (1, -1)),
        period_ms=1e3 * UNO.experiment.period_s,
        promises=table(found.promises),
        full_rad=max(row.travel_rad for row in found.promises if row.promise.way.full),
        stopping=stopping.removeprefix("stopping ").split(";")[0],
        counted_rad=limits.max_speed_rad_s * (UNO.experiment.daq.watchdog_s + limits.coast_tau_s),
        thrown=found.thrown,
        errors=found.errors,
        guesses=found.guesses,
        max_drive=UNO.setup.max_drive,
        full=UNO.full,
        random_drive=2.0**-16 * 2.0**-8 * 2.0**-8 * (2 * UNO.setup.max_drive + 1) / 2.0**16,
        chip=found.chip,
    )


def render_pico(made: str, rows: Sequence[Measured], thrown: Sequence[Thrown]) -> str:
    """The Pico's page; ``made`` as of ``Found``."""
    phases = min(row.phases for row in rows)
    return page.render(_PICO_TEMPLATE, made=made, phases=phases, promises=table(rows), thrown=thrown)
