"""docs/fault-table.md and docs/fault-rows.md from what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from faults.backends import Backend
from faults.bounds import Times
from faults.case import Found
from faults.realtime import RealFound
from faults.rows import SILENCE, Row
from faults.stages import CYCLE, OTHER_STAGES, START, Stage
from shared.table import markdown

_SUMMARY_HEAD = """\
# What goes wrong, and what the bench does

Made by `make faults`, {made}, which puts each fault on each emulated device. It fails if a bound is broken, a sample is
lost, a code is another than expected, a record with a whole relay test cannot be identified, `result.json` is missing,
or the next run does what it should not. It warns where a drive was on for 1.5 times the longest time on record, in
[fault-worst.json](fault-worst.json). `make test` runs a part of it.

This page is the summary. **[fault-rows.md](fault-rows.md) has every row**: on each device, in each stage of the
experiment, in real time, with its bound and how it is done. The tool is [tools/faults](../tools/faults).

{summary}

* *Host silent*: the worst of the rows that only the device's own watchdog can end.
* *Lost*: samples that the device told of, and that reached the host intact and in time, but are not in the record.
* *Wrong*: cases with anything that should not be.

## Each fault at its worst

In the breakaway check or the relay test, on the device where the drive was on for longest.

"""

_HEAD = """\
# Every row of the fault matrix

Made by `make faults`, {made}; the summary is [fault-table.md](fault-table.md). `make test` runs, at one of the phases,
each row on the first three devices (on one where the device makes no difference), on the others those that are theirs
or are other there, and each of the rest on one of them; in the other stages each row once, and all that may happen to
a device in a pause.

The real `rig relay` runs in each case of the first tables: the breakaway check, then a relay test whose limit cycle has
settled to its amplitude when the fault comes, at several phases of the cycle, and at any time within the loop's tick.
The [other stages](#in-the-other-stages) are those of a `rig run` with a short search or a short tracking check. The
devices are in virtual time, which waits for the recorder's process, so each number is exact and the same again. Bench
and limits are those of
[config/demo.yaml](../config/demo.yaml) unless the device's section says otherwise; the loop's period is
{period_ms:g} ms, the watchdog {watchdog_ms:g} ms.

* *Drive 0*: from the fault until the drive is 0 for good, at the device's own output, the worst phase. Where the run
  goes on: the longest time that one drive acted without a new word of the host, or that the output was not what the
  host had said.
* *Within*: the bound of that row, from the config; what it is made of is below the table.
* *Beyond*: farthest that the shaft went beyond a hard limit (they are at {low:g} and {high:g} rad, the stops at 2.6).
* *Shown*: the fault's code, and `rig`'s exit status.
* *Lost*: samples that the device told of, and that reached the host intact and in time, but are not in the record. A
  reading that came with the fault is in the fault's event, with its counts or its bytes. Of a host that was killed the
  recorder, which lives on, writes what there is. Of a relay in the device each row of a block counts, up to the first
  block that is missing: that one ends the run.
* *Next run*: tried, as far as the breakaway check: first with the cause still there, then *mended*.
"""

_COLUMNS = ("fault", "drive 0", "within", "beyond, rad", "shown", "lost", "next run")
_REAL_COLUMNS = (
    "fault", "device", "drive 0", "within", "late", "beyond, rad", "shown", "lost", "skipped", "next run",
)  # fmt: skip

_REAL_HEAD = """\
## Host and link in real time

`rig relay` as a process of its own, and the device as another, behind a pseudo-terminal or on a TCP port of this
machine; the drive is that of the device's own trace. *Late* is by how much this machine let device and loop wait in
that run, which the bound is longer by. *Skipped* are ticks of the loop. A Modbus run ends with the first reply that is
late, by design: an overloaded host mostly ends it.

"""


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


_STAGES_HEAD = """\
## In the other stages

When the fault comes in the gain search, at rest (armed, 0 V, after the relay tests), in the pause (disarmed, while the
record is identified), while the device is armed again, in tracking. At rest, in the pause and at re-arming the drive is
0: there *0* means that nothing drove any more, and a time counts from the first drive after the fault. A cell has the
fault's code, how long the drive was on, and the bound; *runs on*: the longest time that one drive acted without a new
word.

Each row is tried in each stage on the host-board device; on the others what is other there: the contacts, resets and
hangs of the Uno's chip, all that may happen to a Modbus I/O block while it is disarmed or armed again (it is asked
otherwise then), and what a block without limits of its own leaves to the loop. "From the start" is a stage of its own.
A relay in the device is the cycle alone; whatever else such a run does, the host drives.
"""


def stage_tables(lines: Sequence[Line], rows: Sequence[Row], backends: Sequence[Backend]) -> str:
    """What was measured in the stages besides the cycle, a table a device; why a row cannot occur in one of them."""
    parts = [_STAGES_HEAD]
    for backend in backends:
        own = {(one.row.name, one.stage): one for one in lines if one.backend is backend}
        shown = [row for row in rows if any((row.name, stage) in own for stage in OTHER_STAGES)]
        if not shown:
            continue
        stages = [stage for stage in OTHER_STAGES if any((row.name, stage) in own for row in shown)]
        table = markdown(
            ["fault", *(stage.title for stage in stages)],
            ([row.name, *(_cell(own.get((row.name, stage))) for stage in stages)] for row in shown),
        )
        title = backend.title[0].upper() + backend.title[1:]
        parts.append(f"### {title}, by stage\n\n{table}\n")
    absent = {
        f"* {row.name}, {stage.title}: {row.absent[stage.key]}."
        for row in rows
        for stage in OTHER_STAGES
        if stage.key in row.absent
    }
    if absent:
        parts.append("\n".join(sorted(absent)) + "\n")
    return "\n".join(parts)


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


def real_table(found: Sequence[RealFound]) -> str:
    """The table of what was measured in real time."""
    names = list(dict.fromkeys((one.row, one.device) for one in found))
    rows = [_real_cells([one for one in found if (one.row, one.device) == name]) for name in names]
    return f"{_REAL_HEAD}{markdown(_REAL_COLUMNS, rows)}\n"


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
    return _SUMMARY_HEAD.format(made=made, summary=summary(lines, backends)) + at_worst(lines) + "\n"


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
    parts = [
        _HEAD.format(
            made=made,
            period_ms=1e3 * first.times.period,
            watchdog_ms=1e3 * first.times.watchdog,
            low=low,
            high=high,
        )
    ]
    for backend in backends:
        own = [one for one in lines if one.backend is backend and one.stage in (START, CYCLE)]
        if not own:
            continue
        remark = f"{backend.remark}\n\n" if backend.remark else ""
        parts.append(f"## On {backend.title}\n\n{remark}{markdown(_COLUMNS, map(cells, own))}\n")
        absent = [f"* {row.name}: does not apply: {why}." for row in rows if (why := row.why_absent(backend.traits))]
        if absent:
            parts.append("\n".join(absent) + "\n")
    if any(one.stage in OTHER_STAGES for one in lines):
        parts.append(stage_tables(lines, rows, backends))
    if real:
        parts.append(real_table(real))
    parts.append("## The bounds\n\n" + _bounds(lines, backends))
    parts.append("## How it is done, and what else is to be said\n\n" + _notes(rows))
    return "\n".join(parts)


def _bounds(lines: Sequence[Line], backends: Sequence[Backend]) -> str:
    seen: dict[tuple[str, str, str], list[str]] = {}
    for one in lines:
        where = one.backend.key if one.stage in (START, CYCLE) else f"{one.backend.key} {one.stage.title}"
        seen.setdefault((one.row.name, one.row.bound.formula(), one.row.bound.why), []).append(where)
    keys = {one.row.name: {k[0:2] for k in seen if k[0] == one.row.name} for one in lines}
    rows = [
        (f"{name}{'' if len(keys[name]) == 1 else ' (' + ', '.join(where) + ')'}", formula, why)
        for (name, formula, why), where in seen.items()
        if formula != "0"
    ]
    times = [
        f"* {backend.title}: "
        + ", ".join(
            f"{name} {_time(value)}"
            for name, value in _known(one.times for one in lines if one.backend is backend).items()
        )
        for backend in backends
        if any(o.backend is backend for o in lines)
    ]
    return markdown(("fault", "within", "why"), rows) + "\n\n" + "\n".join(times) + "\n"


def _known(times: Iterable[Times]) -> dict[str, float]:
    """Of several, the numbers that there are."""
    return {name: value for some in times for name, value in reversed(some._asdict().items()) if math.isfinite(value)}


def _notes(rows: Sequence[Row]) -> str:
    return (
        "\n".join(f"* {row.name}: {'. '.join(filter(None, (row.how, row.remark, row.either)))}." for row in rows) + "\n"
    )
