"""docs/fault-table.md and docs/fault-rows.md from what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from faults.backends import Backend
from faults.bounds import Times
from faults.case import Found
from faults.realtime import RealFound
from faults.rows import SILENCE, Row
from faults.stages import CYCLE, OTHER_STAGES, START, Stage
from shared import page
from shared.table import markdown

_SUMMARY, _ROWS = (Path(__file__).with_name(f"{name}.md.j2") for name in ("summary", "rows"))


@dataclass(frozen=True)
class Line:
    """A row of the matrix on one device in one stage, over all phases; the row as it is there."""

    row: Row
    backend: Backend
    stage: Stage
    times: Times
    found: tuple[Found, ...]

    @property
    def trouble(self) -> list[str]:
        """What should not be."""
        return [
            f"{f.row}, {f.backend}, {f.stage}, phase {f.phase:.2f}: {words}" for f in self.found for words in f.trouble
        ]

    @property
    def worst_s(self) -> float:
        """Longest time that the drive was on, s."""
        return max(f.off_s for f in self.found)


def _time(s: float) -> str:
    if math.isnan(s):
        return "-"
    if math.isinf(s):
        return "never"
    if s >= 1.0:
        return f"{s:.2f} s"
    return f"{1e3 * s:.1f} ms" if s >= 1e-4 or s == 0.0 else f"{1e6 * s:.0f} us"


def cells(measured: Line) -> tuple[str, ...]:
    """A line of a device's table."""
    row, found = measured.row, measured.found
    shown = sorted({f"{f.code or '-'}, {f.status}" for f in found})
    runs_on = all(f.code == "" and f.status in (0, 1) for f in found)
    worst = ("runs on; " if runs_on else "") + _time(measured.worst_s)
    worst += " at the device, never at the motor" if row.only_seen else ""
    next_run = "; ".join(sorted({f.restart for f in found if f.restart}))
    lost = str(sum(f.lost for f in found))
    within = _time(row.bound.seconds(measured.times))
    return row.name, worst + _broken(found), within, _beyond(found), "; ".join(shown), lost, next_run


def _broken(found: Iterable[Found | RealFound]) -> str:
    return "" if all(f.off_s <= f.bound_s for f in found) else " **broken**"


def _beyond(found: Iterable[Found | RealFound]) -> str:
    beyond_rad = max(f.beyond_rad for f in found)
    return f"{beyond_rad:.2f}" if beyond_rad > 0.0 else "-"


def _by_stage(backend: Backend, lines: Sequence[Line], rows: Sequence[Row]) -> dict[str, object] | None:
    """A device's table of the stages besides the cycle; None where nothing was measured there."""
    own = {(one.row.name, one.stage): one for one in lines if one.backend is backend}
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


def _cell(measured: Line | None) -> str:
    if measured is None:
        return ""
    codes = sorted({f.code or ("killed" if f.status < 0 else "runs on") for f in measured.found})
    off_s, bound_s = measured.worst_s, measured.row.bound.seconds(measured.times)
    within = "0" if off_s == bound_s == 0.0 else f"{_time(off_s)} of {_time(bound_s)}"
    beyond = _beyond(measured.found)
    return f"{'; '.join(codes)}, {within}{_broken(measured.found)}" + (
        "" if beyond == "-" else f", {beyond} rad beyond"
    )


def _real_rows(found: Sequence[RealFound]) -> list[tuple[object, ...]]:
    names = list(dict.fromkeys((one.row, one.device) for one in found))
    return [_real_cells([one for one in found if (one.row, one.device) == name]) for name in names]


def _real_cells(found: Sequence[RealFound]) -> tuple[object, ...]:
    worst = max(found, key=lambda one: one.off_s - one.bound_s)
    shown = sorted({f"{one.code or '-'}, {one.status}" for one in found})
    runs_on = "runs on; " if worst.code == "" and worst.status >= 0 else ""
    return (
        worst.row,
        worst.device,
        f"{runs_on}{_time(worst.off_s)}{_broken(found)}",
        _time(worst.bound_s),
        _time(worst.late_s),
        _beyond(found),
        "; ".join(shown),
        sum(one.lost for one in found),
        max(one.skipped for one in found),
        "; ".join(sorted({one.restart for one in found if one.restart})),
    )


def summary(lines: Sequence[Line], backends: Sequence[Backend]) -> str:
    """One line a device: how much was tried, what came of it."""
    told = [_device_cells(backend, own) for backend in backends if (own := [o for o in lines if o.backend is backend])]
    return markdown(
        ("device", "rows", "cases", "host silent: drive 0", "within", "nearest to its bound", "lost", "wrong"), told
    )


def at_worst(lines: Sequence[Line]) -> str:
    """One line a fault, on the device where the drive was on for longest in the breakaway check or the relay test."""
    named: dict[str, list[Line]] = {}
    for one in lines:
        if one.stage in (START, CYCLE):
            named.setdefault(one.row.name, []).append(one)
    rows = []
    for own in named.values():
        codes = sorted({f.code or ("-" if f.status < 0 else "runs on") for one in own for f in one.found})
        worst = max(own, key=lambda one: one.worst_s)
        name, drive_0, within = cells(worst)[:3]
        rows.append((name, "; ".join(codes), drive_0, within, worst.backend.title))
    return markdown(("fault", "code", "drive 0, longest", "within", "on"), rows)


def _device_cells(backend: Backend, own: Sequence[Line]) -> tuple[object, ...]:
    silent = [one for one in own if one.row.bound == SILENCE and one.stage is CYCLE]
    silent_s = max((f.off_s for one in silent for f in one.found), default=math.nan)
    within_s = max((one.row.bound.seconds(one.times) for one in silent), default=math.nan)
    share, name = max(
        (one.worst_s / bound_s, f"{one.row.name}, {one.stage.title}")
        for one in own
        if (bound_s := one.row.bound.seconds(one.times)) > 0.0
    )
    found = [f for one in own for f in one.found]
    rows = len({one.row.name for one in own})
    lost, wrong = sum(f.lost for f in found), sum(bool(f.trouble) for f in found)
    nearest = f"{name}, {100.0 * share:.0f} %"
    return backend.title, rows, len(found), _time(silent_s), _time(within_s), nearest, lost, wrong


def render_summary(made: str, lines: Sequence[Line], backends: Sequence[Backend]) -> str:
    """The page that people read: docs/fault-table.md."""
    return page.render(_SUMMARY, made=made, summary=summary(lines, backends), at_worst=at_worst(lines))


def render_rows(
    made: str,
    lines: Sequence[Line],
    rows: Sequence[Row],
    backends: Sequence[Backend],
    real: Sequence[RealFound] = (),
) -> str:
    """The page with every row: docs/fault-rows.md."""
    first = lines[0]
    low, high = first.backend.config()["limits"]["hard_rad"]
    tried = [backend for backend in backends if any(one.backend is backend for one in lines)]
    others = [stage for stage in OTHER_STAGES if any(one.stage in OTHER_STAGES for one in lines)]
    return page.render(
        _ROWS,
        made=made,
        period_ms=1e3 * first.times.period,
        watchdog_ms=1e3 * first.times.watchdog,
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
        real=_real_rows(real),
        bounds=_bounds(lines),
        times=[_times(backend, lines) for backend in tried],
        notes=[f"* {row.name}: {'. '.join(filter(None, (row.how, row.remark, row.either)))}." for row in rows],
    )


def _in_cycle(backend: Backend, lines: Sequence[Line], rows: Sequence[Row]) -> dict[str, object]:
    """A device's table of the breakaway check and the relay test."""
    return {
        "title": backend.title,
        "remark": backend.remark,
        "rows": [cells(one) for one in lines if one.backend is backend and one.stage in (START, CYCLE)],
        "absent": [(row.name, why) for row in rows if (why := row.why_absent(backend.traits))],
    }


def _bounds(lines: Sequence[Line]) -> list[tuple[str, str, str]]:
    """Each bound once: what it bounds, where it is not the same everywhere; the sum; why."""
    seen: dict[tuple[str, str, str], list[str]] = {}
    for one in lines:
        where = one.backend.key if one.stage in (START, CYCLE) else f"{one.backend.key} {one.stage.title}"
        seen.setdefault((one.row.name, one.row.bound.formula(), one.row.bound.why), []).append(where)
    keys = {one.row.name: {k[0:2] for k in seen if k[0] == one.row.name} for one in lines}
    return [
        (f"{name}{'' if len(keys[name]) == 1 else ' (' + ', '.join(where) + ')'}", formula, why)
        for (name, formula, why), where in seen.items()
        if formula != "0"
    ]


def _times(backend: Backend, lines: Sequence[Line]) -> str:
    known = _known(one.times for one in lines if one.backend is backend)
    return f"* {backend.title}: " + ", ".join(f"{name} {_time(value)}" for name, value in known.items())


def _known(times: Iterable[Times]) -> dict[str, float]:
    """Of several, the numbers that there are."""
    return {name: value for some in times for name, value in reversed(some._asdict().items()) if math.isfinite(value)}
