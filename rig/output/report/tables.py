"""The report's tables, as rows of cells. A cell is the exact number, if there is one, and its text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from pydantic import JsonValue

from rig.identification.departures import BY_NAME
from rig.output.report.budget import budget_in_words
from rig.output.report.source import PREFERRED, ReportedRun
from rig.output.report.style import short
from rig.output.report.words import PARAMETERS, Quantity, quantity, rounded
from rig.run_folder.results import Quantiles, TrackingResult, TrueLaw, known
from rig.run_folder.results.answer_words import records_in_words
from rig.run_folder.results.budget_lines import BudgetLine
from rig.run_folder.results.result import NO_ESTIMATE

_STATIC = BY_NAME["static"].title
AT_REST = (
    "Static friction is by how much more drive it takes at rest than in motion: these tests do not show that, and the "
    "levels at the top, to move the shaft from rest, are the breakaway check's."
)
Cell = tuple[float | None, str]
Row = tuple[str, list[Cell]]  # its first column is a name


@dataclass(frozen=True)
class EstimateRow:
    """One line of the table of estimates."""

    method: str
    short: str
    quantities: tuple[Quantity, ...]
    rms_rad: float | None
    rms_text: str
    iterations: str
    rows: str
    verdict: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class MotorLawRow:
    """One law that the motor has beyond the plain one: its size, what it may come from, and what looks alike.

    ``true`` is its size in the emulated motor; "" where nobody knows. Not ``found``: the emulated motor alone has it.
    """

    law: str
    size: Cell
    interval: str
    unit: str
    cause: str
    alike: str
    true: str
    found: bool = True


@dataclass(frozen=True)
class TrackingRow:
    """The tracking check of one model: its errors in mrad, and what is to be said of it."""

    method: str
    short: str
    cells: list[Cell]
    remark: str


def estimates(run: ReportedRun) -> list[EstimateRow]:
    """The answer where it is none of the methods' own estimates, then these, the preferred first."""
    table = []
    for method, e in run.compared.items():
        rms_rad = known(e.rms_rad)
        is_known = math.isfinite(rms_rad)
        table.append(
            EstimateRow(
                method,
                short(run.method_of(method)),
                tuple(quantity(p, e, run.truth) for p in PARAMETERS),
                rms_rad if is_known else None,
                rounded(1e3 * rms_rad) if is_known else "–",
                "–" if e.iterations is None else str(e.iterations),
                "–" if e.rows is None else f"{e.rows[0]} to {e.rows[1]}",
                e.verdict,
                e.reasons,
            )
        )
    return table


def relays(run: ReportedRun) -> list[Row]:
    """The relay tests of the result."""
    return [
        _stage_row(test.stage, (test.h1_V, test.h2_V, test.period_s, test.amplitude_rad, test.cycles))
        for test in run.result.relays
    ]


def _stage_row(stage: str, values: Sequence[float | None]) -> Row:
    return stage.replace("-", " "), [_cell(value) for value in values]


def motor_law(run: ReportedRun) -> list[MotorLawRow]:
    """The laws that the motor has beyond the plain one."""
    causes = {law.name: (law.title, law.cause) for law in BY_NAME.values()}
    groups = {group[0]: group[1:] for group in run.result.not_told_apart or () if group}
    truth = {law.name: law for law in run.true_laws or ()}
    rows = []
    for law in run.laws:
        title, cause = causes.get(law.name, (law.name.replace("_", " "), ""))
        bounds = law.ci95 or (None, None)
        low, high = known(bounds[0]), known(bounds[1])
        half = 0.5 * (high - low)
        interval = f"{rounded(low, half)} to {rounded(high, half)}" if math.isfinite(half) else ""
        size = (known(law.value), rounded(known(law.value), half)) if math.isfinite(half) else _cell(law.value)
        alike = ", ".join(causes.get(name, (name, ""))[0] for name in groups.get(law.name, ()))
        true = _true_size(truth.pop(law.name, None)) if run.true_laws is not None else ""
        rows.append(MotorLawRow(title, size, interval, "" if law.unit == "1" else law.unit, cause, alike, true))
    if run.result.answer is not None and run.result.answer.law is not None:
        for missed in truth.values():
            title, _ = causes.get(missed.name, (missed.name.replace("_", " "), ""))
            rows.append(MotorLawRow(title, (None, "not found"), "", "", "", "", _true_size(missed), found=False))
    return rows


def at_rest(run: ReportedRun) -> str:
    """What a true static friction that was not found is beside the breakaway levels of the headline; else empty."""
    missed = any(line.law == _STATIC and not line.found for line in motor_law(run))
    return AT_REST if missed and run.result.breakaway is not None else ""


def _true_size(law: TrueLaw | None) -> str:
    """Its size with its unit; of a law that the emulated motor has not: "none"."""
    if law is None:
        return "none"
    return f"{known(law.value):.3g} {law.unit}".removesuffix(" 1")


def records(run: ReportedRun) -> str:
    """What the law was fitted to, with its lengths; empty if nothing was."""
    return records_in_words(run.result.law_records) if "answer" in run.compared else ""


def budget(run: ReportedRun) -> list[tuple[BudgetLine, list[Cell]]]:
    """The uncertainty budget, % of the estimate that it belongs to."""
    return [
        (line, [(share, f"{share:.2f}") if math.isfinite(share) else (None, "–") for share in line.percent])
        for line in budget_in_words(run)
    ]


def hysteretic(run: ReportedRun) -> list[Row]:
    """The hysteretic runs of the result, in V, rad, mrad, s and rad."""
    rows = []
    for one in run.result.hysteretic or ():
        name, cells = _stage_row(one.stage, (one.d_V, one.eps_rad, one.start_rad, one.switched_s, one.switched_rad))
        cells[2] = _cell(one.start_rad, 1e3)
        rows.append((name, cells))
    return rows


def tracking(run: ReportedRun) -> list[TrackingRow]:
    """The tracking checks, the preferred model first; errors in mrad. A method without an estimate has none."""
    table = []
    outcomes = {
        method: one
        for method, one in run.result.tracking.items()
        if one.not_run != NO_ESTIMATE or one.rms_rad is not None
    }
    for method in sorted(outcomes, key=lambda m: (*PREFERRED, m).index(m)):
        outcome = outcomes[method]
        is_known = math.isfinite(known(outcome.rms_rad))
        remark = _made_up_for(outcome)
        if not is_known:
            remark = f"not run: {outcome.not_run or 'no outcome was recorded'}"
        errors = [outcome.rms_rad, outcome.max_rad]
        if knows_shaft(run):
            errors += [outcome.true_rms_rad, outcome.true_max_rad]
        table.append(TrackingRow(method, short(method), [_cell(error, 1e3) for error in errors], remark))
    return table


def law_used(run: ReportedRun) -> str:
    """Which pictures and which drive are of the motor with the laws of the answer."""
    pictures = "The pictures of cycles and residual are of the motor with these laws."
    tracked = [outcome for outcome in run.result.tracking.values() if math.isfinite(known(outcome.rms_rad))]
    if not tracked:
        return pictures
    drive = "makes up for them" if any(outcome.law for outcome in tracked) else "left them out"
    return f"{pictures} The drive of the tracking check {drive}."


def knows_shaft(run: ReportedRun) -> bool:
    """Whether the run tells where an emulated shaft really was while it tracked."""
    return any(math.isfinite(known(outcome.true_rms_rad)) for outcome in run.result.tracking.values())


def tracking_heads(run: ReportedRun) -> list[str]:
    """Heads of the columns of ``tracking``."""
    true = ["true RMS error, mrad", "true largest error, mrad"] if knows_shaft(run) else []
    remark = ["remark"] if any(row.remark for row in tracking(run)) else []
    return ["model", "RMS error, mrad", "largest error, mrad", *true, *remark]


def _made_up_for(outcome: TrackingResult) -> str:
    """Which laws the drive made up for, and which not."""
    done, left = (
        " and ".join(one.replace("_", " ") for one in names or ()) for names in (outcome.law, outcome.law_left_out)
    )
    words = [f"the drive makes up for {done}" if done else "", f"not for {left}" if left else ""]
    return ", ".join(word for word in words if word)


def tuned(run: ReportedRun) -> list[Row]:
    """The measures of a tuned loop: prediction, interval, this bench."""
    found = run.result.tuned
    made: list[Row] = []
    for one in () if found is None else found.prediction.values():
        median, interval, bench = one.words()
        cells: list[Cell] = [
            (one.median, median),
            (None, interval),
            (one.bench, bench),
            (None, "" if one.inside else "outside"),
        ]
        made.append((f"{one.meaning}, {one.unit}", cells))
    return made


def loop(run: ReportedRun) -> list[tuple[str, Cell]]:
    """Heading and cell of each column of the loop's table; empty if the result has no loop."""
    timing = run.result.loop
    if timing is None:
        return []
    cells = [
        ("period, ms", _cell(run.period_s, 1e3)),
        ("ticks", _cell(timing.ticks)),
        ("skipped", _cell(timing.skipped)),
    ]
    if not run.in_virtual_time:
        late = timing.late_us or Quantiles()
        columns = (("median", late.p50), ("99 %", late.p99), ("99.9 %", late.p999), ("largest", late.max))
        cells += [(f"late, {name}, µs", _cell(value)) for name, value in columns]
    return cells


def started(run: ReportedRun) -> str:
    """When the run started, in words; empty if meta.json does not say."""
    try:
        utc = datetime.fromisoformat(run.meta.started_utc or "")
    except ValueError:
        return ""
    return f"{utc:%Y-%m-%d %H:%M:%S} UTC"


def facts(run: ReportedRun) -> list[tuple[str, str]]:
    """What meta.json says, in words: (name, value) pairs in its order."""
    pairs = [
        (key.replace("_", " "), _in_words(value))
        for key, value in run.meta.as_json().items()
        if key not in ("truth", "backend", "schema")
    ]
    if run.truth:
        pairs.append(("truth (emulated)", ", ".join(f"{k} = {v:.6g}" for k, v in run.truth.items())))
    return pairs


def _cell(value: float | None, factor: float = 1.0) -> Cell:
    x = float(known(value))
    if not math.isfinite(x):
        return None, "–"
    return x, f"{factor * x:.4g}" if abs(factor * x) < 1e4 else f"{factor * x:.0f}"


def _in_words(value: JsonValue) -> str:
    """A value of meta.json as people write it: yes and no, numbers with six digits, lists and mappings in a row."""
    if value is None or value == [] or value == {}:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return "; ".join(_in_words(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')}: {_in_words(item)}" for key, item in value.items())
    return str(value)
