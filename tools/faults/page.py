"""docs/evidence/fault-table.md and docs/evidence/fault-rows.md from what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from faults.backends import Backend
from faults.kept import Kept, Lines
from faults.realtime import RealFound
from faults.rows import SILENCE, Row
from faults.stages import CYCLE, OTHER_STAGES, START, Stage
from shared import page
from shared.table import markdown

_SUMMARY, _ROWS = (Path(__file__).with_name(f"{name}.md.j2") for name in ("summary", "rows"))


def _time(s: float) -> str:
    if math.isnan(s):
        return "-"
    if math.isinf(s):
        return "never"
    if s >= 1.0:
        return f"{s:.2f} s"
    return f"{1e3 * s:.1f} ms" if s >= 1e-4 or s == 0.0 else f"{1e6 * s:.0f} us"


def cells(row: Row, kept: Kept) -> tuple[str, ...]:
    """A line of a device's table; the row as it is there."""
    worst = ("runs on; " if kept.runs_on else "") + _time(kept.off_s)
    worst += " at the device, never at the motor" if row.only_seen else ""
    shown = "; ".join(kept.shown)
    within = _time(kept.within_s)
    return row.name, worst + _broken(kept), within, _beyond(kept.beyond_rad), shown, str(kept.lost), kept.next_run


def _broken(kept: Kept) -> str:
    return " **broken**" if kept.is_broken else ""


def _beyond(beyond_rad: float) -> str:
    return f"{beyond_rad:.2f}" if beyond_rad > 0.0 else "-"


def _by_stage(backend: Backend, lines: Lines, rows: Sequence[Row]) -> dict[str, object] | None:
    """A device's table of the stages besides the cycle; None where nothing was measured there."""
    own = {(row.name, stage): kept for row in rows for stage, kept in lines.of(row, backend) if stage in OTHER_STAGES}
    shown = [row for row in rows if any((row.name, stage) in own for stage in OTHER_STAGES)]
    stages = [stage for stage in OTHER_STAGES if any((row.name, stage) in own for row in shown)]
    return (
        None
        if not shown
        else {
            "title": backend.title[0].upper() + backend.title[1:],
            "head": ["fault", *(stage.title for stage in stages)],
            "rows": [[row.name, *(_cell(own.get((row.name, stage))) for stage in stages)] for row in shown],
        }
    )


def _cell(kept: Kept | None) -> str:
    if kept is None:
        return ""
    within = "0" if kept.off_s == kept.within_s == 0.0 else f"{_time(kept.off_s)} of {_time(kept.within_s)}"
    beyond = _beyond(kept.beyond_rad)
    return f"{'; '.join(kept.codes)}, {within}{_broken(kept)}" + ("" if beyond == "-" else f", {beyond} rad beyond")


def real_rows(found: Sequence[RealFound]) -> list[tuple[object, ...]]:
    """The cells of the table of what was tried in real time."""
    names = list(dict.fromkeys((one.row, one.device) for one in found))
    return [_real_cells([one for one in found if (one.row, one.device) == name]) for name in names]


def _real_cells(found: Sequence[RealFound]) -> tuple[object, ...]:
    worst = max(found, key=lambda one: one.off_s - one.bound_s)
    shown = sorted({f"{one.code or '-'}, {one.status}" for one in found})
    runs_on = "runs on; " if worst.code == "" and worst.status >= 0 else ""
    broken = " **broken**" if any(one.trouble for one in found) else ""
    return (
        worst.row,
        worst.device,
        f"{runs_on}{_time(worst.off_s)}{broken}",
        _time(worst.bound_s),
        _time(worst.late_s),
        _beyond(max(one.beyond_rad for one in found)),
        "; ".join(shown),
        sum(one.lost for one in found),
        max(one.skipped for one in found),
        "; ".join(sorted({one.restart for one in found if one.restart})),
    )


def summary(lines: Lines, rows: Sequence[Row], backends: Sequence[Backend]) -> str:
    """One line a device: how much was tried, what came of it."""
    told = [
        _device_cells(backend, own, lines.untold.get(backend.key, 0))
        for backend in backends
        if (own := _on(backend, lines, rows))
    ]
    return markdown(
        ("device", "rows", "cases", "host silent: drive 0", "within", "nearest to its bound", "lost", "wrong"), told
    )


_Place = tuple[Row, Backend, Stage, Kept]  # the row as it is there


def _on(backend: Backend, lines: Lines, rows: Sequence[Row]) -> list[_Place]:
    """All that was measured on a device."""
    return [
        (row.on(stage.traits(backend.traits)), backend, stage, kept)
        for row in rows
        for stage, kept in lines.of(row, backend)
    ]


def at_worst(lines: Lines, rows: Sequence[Row], backends: Sequence[Backend]) -> str:
    """One line a fault, on the device where the drive was on for longest in the breakaway check or the relay test."""
    told = []
    for row in rows:
        own = [
            (kept, row.on(stage.traits(backend.traits)), backend)
            for backend in backends
            for stage, kept in lines.of(row, backend)
            if stage in (START, CYCLE)
        ]
        if own:
            codes = sorted({code.replace("killed", "-") for kept, _, _ in own for code in kept.codes})
            kept, there, backend = max(own, key=lambda one: one[0].off_s)
            name, drive_0, within = cells(there, kept)[:3]
            told.append((name, "; ".join(codes), drive_0, within, backend.title))
    return markdown(("fault", "code", "drive 0, longest", "within", "on"), told)


def _device_cells(backend: Backend, own: Sequence[_Place], untold: int) -> tuple[object, ...]:
    silent = [kept for row, _, stage, kept in own if row.bound == SILENCE and stage is CYCLE]
    silent_s = max((kept.off_s for kept in silent), default=math.nan)
    within_s = max((kept.within_s for kept in silent), default=math.nan)
    share, name = max(
        (kept.off_s / kept.within_s, f"{row.name}, {stage.title}") for row, _, stage, kept in own if kept.within_s > 0.0
    )
    return (
        backend.title,
        len({row.name for row, *_ in own}),
        sum(kept.cases for *_, kept in own),
        _time(silent_s),
        _time(within_s),
        f"{name}, {100.0 * share:.0f} %",
        sum(kept.lost for *_, kept in own),
        sum(kept.wrong for *_, kept in own) + untold,
    )


def render_summary(lines: Lines, rows: Sequence[Row], backends: Sequence[Backend]) -> str:
    """The page that people read: docs/evidence/fault-table.md."""
    return page.render(
        _SUMMARY,
        made=_made(kept.made for kept in lines.lines.values()),
        summary=summary(lines, rows, backends),
        at_worst=at_worst(lines, rows, backends),
    )


def render_rows(lines: Lines, rows: Sequence[Row], backends: Sequence[Backend]) -> str:
    """The page with every row: docs/evidence/fault-rows.md."""
    places = [place for backend in backends for place in _on(backend, lines, rows)]
    first = places[0][1]
    low, high = first.config()["limits"]["hard_rad"]
    tried = [backend for backend in backends if any(one is backend for _, one, _, _ in places)]
    others = [stage for stage in OTHER_STAGES if any(one in OTHER_STAGES for _, _, one, _ in places)]
    return page.render(
        _ROWS,
        made=_made(kept.made for kept in lines.lines.values()),
        period_ms=1e3 * lines.times[first.key]["period"],
        watchdog_ms=1e3 * lines.times[first.key]["watchdog"],
        low=low,
        high=high,
        devices=[device for backend in tried if (device := _in_cycle(backend, lines, rows))["rows"]],
        stages=[table for backend in tried if (table := _by_stage(backend, lines, rows))],
        absent=sorted(
            {
                f"* {row.name}, {stage.title}: {row.absent[stage.key]}."
                for row in rows
                for stage in others
                if stage.key in row.absent
            }
        ),
        real=lines.real,
        bounds=_bounds(places),
        times=[_times(backend, lines) for backend in tried],
        notes=[f"* {row.name}: {'. '.join(filter(None, (row.how, row.remark, row.either)))}." for row in rows],
    )


def _made(days: Iterable[str]) -> str:
    """The days on which lines were measured, in words."""
    known = sorted(set(days))
    return known[0] if len(known) == 1 else f"{known[0]} to {known[-1]} (each device's section says when)"


def _in_cycle(backend: Backend, lines: Lines, rows: Sequence[Row]) -> dict[str, object]:
    """A device's table of the breakaway check and the relay test."""
    own = _on(backend, lines, rows)
    return {
        "title": backend.title,
        "remark": backend.remark,
        "made": page.listed([str(day) for day in sorted({kept.made for *_, kept in own})]) if own else "",
        "rows": [cells(row, kept) for row, _, stage, kept in own if stage in (START, CYCLE)],
        "absent": [(row.name, why) for row in rows if (why := row.why_absent(backend.traits))],
    }


def _bounds(places: Sequence[_Place]) -> list[tuple[str, str, str]]:
    """Each bound once: what it bounds, where it is not the same everywhere; the sum; why."""
    seen: dict[tuple[str, str, str], list[str]] = {}
    for row, backend, stage, _ in places:
        where = backend.key if stage in (START, CYCLE) else f"{backend.key} {stage.title}"
        seen.setdefault((row.name, row.bound.formula(), row.bound.why), []).append(where)
    keys = {row.name: {k[0:2] for k in seen if k[0] == row.name} for row, *_ in places}
    return [
        (f"{name}{'' if len(keys[name]) == 1 else ' (' + ', '.join(where) + ')'}", formula, why)
        for (name, formula, why), where in seen.items()
        if formula != "0"
    ]


def _times(backend: Backend, lines: Lines) -> str:
    return f"* {backend.title}: " + ", ".join(f"{name} {_time(s)}" for name, s in lines.times[backend.key].items())
