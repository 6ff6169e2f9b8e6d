"""Shows results in a terminal: lines and tables on stdout, progress on stderr. The values are those of result.json."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from statistics import fmean, stdev
from typing import TYPE_CHECKING

import click

from rig.cli.shared import as_typed
from rig.core.estimators import MAIN
from rig.core.signals import plain
from rig.output.text import (
    BUDGET_HEADINGS,
    MOTOR_LAW_HEADINGS,
    budget_rows,
    comparison_words,
    law_causes,
    motor_law_rows,
    plain_table,
)
from rig.run_folder.results import (
    Answer,
    EstimateResult,
    FrictionMapResult,
    IdentificationResult,
    LoopResult,
    RunResult,
    TrackingResult,
    TrueMotor,
    known,
)
from rig.run_folder.results.answer_words import answer_lines, records_in_words
from rig.run_folder.results.comparison import ComparedRunResult, ComparisonResult
from rig.run_folder.results.design import DesignResult
from rig.run_folder.results.meta import REHEARSAL
from rig.run_folder.results.result import NO_ESTIMATE
from rig.run_folder.results.tuned import TunedResult

if TYPE_CHECKING:  # each loads slowly
    from rig.campaign.summary import Summary
    from rig.design.tune.servo_loop import ServoLoop
    from rig.model.prediction import PredictedCycle
    from rig.run_folder.catalogue import ListedRun
    from rig.running.doctor.finding import Finding
    from rig.running.replay import Replay
    from rig.running.session import Outcome

MAP_HEADINGS = ("speed, rad/s", "drive, V", "by the identified motor, V", "")
MOST_NOTES = 2  # that are shown unless all are asked for
LIST_HEADINGS = ("run", "tau, s", "K, (rad/s)/V", "f_c, V", "verdict", "laws", "ended")
RECORD_AGAIN = (
    "to record again: `rig relay CONFIG`; more cycles: relay.cycles; slower, larger or other cycles: relay.target or "
    "relay.gains; part of a recording: --rows FIRST:LAST"
)


def show_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table as wide as the terminal; plain in a pipe. It never cuts the first column: people type these names."""
    if not sys.stdout.isatty():
        click.echo("\n".join([title, *plain_table(headings, rows)]))
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title)
    for k, heading in enumerate(headings):
        table.add_column(heading, no_wrap=k == 0, overflow="fold")
    if rows:
        table.columns[0].min_width = max(len(row[0]) for row in rows)
    for row in rows:
        table.add_row(*map(Text, row))
    Console().print(table)


@contextmanager
def progress(what: str, as_json: bool) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar. Yields the function (done, total) that moves it; None in a pipe or for JSON: there is no bar."""
    if as_json or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def patience(what: str) -> Iterator[None]:
    """A spinner while the block runs; none in a pipe."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


def show_run(outcome: Outcome, *, verbose: bool = True) -> None:
    """Show a run: answer, tracking, where the files are; on stderr why it failed.

    verbose  also the relay tests, each method, the friction map and the loop
    """
    result = outcome.result
    if result.rehearsal:
        click.echo(REHEARSAL)
    click.echo(f"backend: {result.backend}")
    for test in result.relays if verbose else ():
        click.echo(
            f"{test.stage}: h1 {test.h1_V:.3f} V, h2 {test.h2_V:.3f} V -> "
            f"amplitude {test.amplitude_rad:.3f} rad, period {test.period_s:.3f} s, {test.cycles} cycles"
        )
    if result.stopped is not None:
        click.echo(
            f"tests: {known(result.stopped.tests_s):.1f} s, {result.stopped.cycles} swings; ended: {result.stopped.why}"
        )
    for run in result.hysteretic or ():
        switched = "no switching" if run.switched_s is None else f"switches after {run.switched_s:.3f} s"
        click.echo(
            f"{run.stage}: d {run.d_V:+.3f} V, eps {known(run.eps_rad):.3f} rad -> {switched}, "
            f"from {1e3 * known(run.start_rad):+.1f} mrad"
        )
    if result.answer is not None:
        if result.models_from is not None:
            for note in (note for note in result.notes if note.endswith(REHEARSAL)):
                click.echo(note)
        show_answer(result.answer, result.truth)
        if verbose:
            show_estimates(result.estimates, result.truth, result.tracking)
            show_friction_map(result.friction_map)
        elif result.tracking:
            click.echo(tracking_words(result.tracking))
    if result.loop is not None and verbose:
        _show_loop(result.loop)
    notes = [f"note: {note}" for note in result.config_notes] + ([f"time: {outcome.paced}"] if outcome.paced else [])
    for note in notes if verbose else notes[:MOST_NOTES]:
        click.echo(note)
    if len(notes) > MOST_NOTES and not verbose:
        click.echo(f"{len(notes) - MOST_NOTES} more notes are in the report")
    if result.answer is not None and result.models_from is None:
        click.echo(f"more:   rig identify {quote(str(outcome.folder))} --verbose")
    click.echo(f"run:    {outcome.folder}")
    if (outcome.folder / "report.html").is_file():  # if it is missing, the failure says why
        click.echo(f"report: {outcome.folder / 'report.html'}")
    if outcome.traceback:
        click.echo(outcome.traceback, err=True, nl=False)
    if outcome.failure:
        click.echo(f"rig: {outcome.failure}", err=True)
        if outcome.fault is not None:
            click.echo(f"     {as_typed(outcome.fault.cure)}", err=True)


def tracking_words(tracking: Mapping[str, TrackingResult]) -> str:
    """The RMS error with the model of each method, in brackets that of the emulated shaft; then what did not run.

    A method that these tests are not for has no estimate, and nothing to say.
    """
    ran, others = [], []
    for method, one in tracking.items():
        if one.rms_rad is None:
            if one.not_run != NO_ESTIMATE:
                others.append(f"{method} ({one.not_run or 'no outcome was recorded'})")
        else:
            shaft = "" if one.true_rms_rad is None else f" ({1e3 * one.true_rms_rad:.1f})"
            ran.append(f"{method} {1e3 * one.rms_rad:.1f}{shaft}")
    true = " (in brackets the true shaft's)" if any(one.true_rms_rad is not None for one in tracking.values()) else ""
    parts = [f"tracking error, mrad RMS{true}: {', '.join(ran)}"] if ran else []
    if tracking and not ran and not others:
        return "tracking not run: no method of tracking.methods has an estimate of these tests"
    return "; ".join(parts + ([f"{'' if ran else 'tracking '}not run: {', '.join(others)}"] if others else []))


def _show_loop(loop: LoopResult) -> None:
    late = loop.late_us
    if late is not None and late.p50 is not None:
        click.echo(
            f"loop: {loop.ticks} ticks of {known(loop.period_s) * 1e3:g} ms, {loop.skipped} skipped; "
            f"late by {late.p50:.0f} us (median), {known(late.p99):.0f} (p99), {known(late.max):.0f} (largest)"
        )
    for line in () if loop.real_time is None else loop.real_time.refused:
        click.echo(f"loop: {line}")


def show_replay(done: Replay) -> None:
    """Show a replay: the same drive, or the first difference; and which rows were not compared."""
    for note in done.notes:
        click.echo(note)
    if not done.is_same:
        click.echo(f"different after {done.replayed} of {done.rows} rows:")
        click.echo(f"  {done.difference}")
        return
    ending = "its last row" if done.ending == "no end" else done.ending
    click.echo(f"the same drive in {done.compared} of {done.rows} rows, {done.duration_s:.1f} s, to {ending}")
    if done.lost:
        click.echo(f"not compared: {done.lost} rows whose drive never reached the device")
    if done.limited:
        click.echo(f"not compared: {done.limited} rows in which the device drove less than commanded")
    if done.fault is not None:
        click.echo(f"the fault at the end: {done.fault}")
    elif done.ending == "no end":
        click.echo("the recording has no end: the run was killed, or its last rows are lost")


def show_tuned(found: TunedResult) -> None:
    """Show a tuned loop: gains, margins, what is predicted, and what a bench did."""
    pid, forward = found.pid, found.feedforward
    named = zip(("Kp", "Ki", "Kd"), (pid.Kp, pid.Ki, pid.Kd), pid.units, strict=True)
    gains = ", ".join(f"{name} {value:.4g} {unit}" for name, value, unit in named if value or name != "Kd")
    click.echo(f"{found.loop} loop, {found.bandwidth_rad_s:.4g} rad/s (3 dB down, from the set-point)")
    click.echo(f"feedback, of the observed state: {gains}")
    click.echo(
        f"feed-forward: kS {forward.kS_V:.4g} V, kV {forward.kV_V_s_rad:.4g} V s/rad, "
        f"kA {forward.kA_V_s2_rad:.4g} V s2/rad"
    )
    click.echo(
        f"the largest bandwidth: {found.largest_bandwidth_rad_s:.4g} rad/s; more is forbidden: {found.bounded_by}"
    )
    margins = [
        (words, f"{one.phase_deg:.1f} degrees", f"{known(one.gain_dB):.1f} dB", f"{one.modulus:.2f}")
        for words, one in (
            ("the identified motor", found.margins["nominal"]),
            ("the worst of the intervals", found.margins["worst"]),
        )
    ]
    click.echo("\n".join(["", "margins", *plain_table(("motor", "phase", "gain", "modulus"), margins)]))
    click.echo(f"the sensor's noise shakes the drive by {found.drive_noise_V:.3g} V (standard deviation)")
    if found.beyond:
        click.echo(f"beyond what is known: {found.beyond}")
    tried = any(one.inside is not None for one in found.prediction.values())
    rows = []
    for one in found.prediction.values():
        *predicted, bench = one.words()
        cells = [f"{one.meaning}, {one.unit}", *predicted]
        rows.append(cells + ([bench, "inside" if one.inside else "OUTSIDE"] if tried else []))
    heads = ["measure", "predicted", "95 % interval", *(["bench", ""] if tried else [])]
    title = f"a step of {found.step:.3g} {found.curves['step'].unit}, and tracking, on {found.draws} motors"
    click.echo("\n".join(["", title, *plain_table(heads, rows)]))


def show_servo_loop(found: ServoLoop) -> None:
    """Show the gains of a servo's own loop: their margins, and what would be written."""
    low, high, source = found.scale
    of = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
    click.echo(
        f"{found.model}, position mode, {found.supply_V:g} V: a P of 1 makes {of} of full duty of 1 rad ({source})"
    )
    rows = [
        (
            one.whose,
            str(one.P),
            f"{one.margins.phase_deg:.1f} degrees",
            f"{one.margins.gain_dB:.1f} dB",
            f"{one.held_rad:.3g} rad",
        )
        for one in found.rows
    ]
    heads = ("gains", "P", "phase margin", "gain margin", "friction may hold it off by")
    click.echo("\n".join(plain_table(heads, rows)))
    for setting in found.settings:
        value = "as it is" if setting.value is None else setting.value
        click.echo(f"{setting.address:>3} {setting.name}: {value} ({setting.words})")
    click.echo(
        "rig writes none of them. LeRobot writes P 16, I 0, D 32 to a Feetech at each connect: it would undo yours"
    )


def show_finding(finding: Finding) -> None:
    """Show a finding of `rig doctor`, and what to type."""
    click.echo("\n".join(finding.lines()))


def show_prediction(prediction: PredictedCycle) -> None:
    """Show a limit cycle and its stability, or why there is none."""
    cycle, sine = prediction.exact, prediction.sine
    if cycle is None:
        click.echo(f"no simple oscillation: {prediction.reason}")
    else:
        t1, t2, t3 = cycle.durations_s
        stable = "locally stable" if cycle.stable else "not locally stable"
        pairs = [(value.real, value.imag) for value in cycle.eigenvalues().tolist()]
        eigenvalues = ", ".join(f"{re:.6f}" + (f"{im:+.6f}j" if im else "") for re, im in pairs)
        click.echo(f"limit cycle (Theorem 2.1): period {cycle.period_s:.6f} s, amplitude ", nl=False)
        click.echo(f"{cycle.amplitude_rad:.6f} rad; t1 {t1:.6f}, t2 {t2:.6f}, t3 {t3:.6f} s")
        click.echo(f"stability (Theorem 2.2): {stable}; eigenvalues of J: {eigenvalues}")
    if sine is not None:
        click.echo(f"describing function: period {sine.period_s:.6f} s, amplitude {sine.amplitude_rad:.6f} rad")


def show_design(found: DesignResult) -> None:
    """Show a design: motor and room, how long for what interval, the best gains and strokes."""
    motor, room = found.motor, found.room
    click.echo(
        f"motor: tau {motor.tau_s:.4g} s, K {motor.K_rad_s_V:.4g} (rad/s)/V, f_c {motor.fc_V:.3g} V, all of them wrong "
        f"by {motor.doubt_percent:g} % at most; breaks away at {motor.static_V:.3g} V"
    )
    click.echo(
        f"room: {room.low_rad:.3g} to {room.high_rad:.3g} rad, {room.max_speed_rad_s:.3g} rad/s, {room.max_V:g} V; "
        f"the guard looks {room.horizon_s:.2g} s ahead; noise {1e3 * motor.noise_rad:.2g} mrad"
    )
    rows = [
        [f"{one.interval_percent:g} %", *map(_seconds, (one.strokes_s, one.pair_s, one.single_s))]
        for one in found.until
    ]
    headings = ["interval", "strokes, s", "two pairs of gains, s", "one pair of gains, s"]
    show_table("seconds of test until the 95 % intervals of tau, K and f_c are so narrow", headings, rows)
    if found.gains:
        names = ("hard", "soft") if len(found.gains) > 1 else ("gains",)
        words = [f"{name} h1 {g.h1_V:.3f} V, h2 {g.h2_V:.3f} V" for name, g in zip(names, found.gains, strict=True)]
        tried = len(found.map.h1_V) * len(found.map.h2_V)
        click.echo(f"gains: {'; '.join(words)} ({found.map.inside} of {tried} pairs stay inside the room)")
    else:
        click.echo("gains: no pair stays inside the room")
    strokes = ", ".join(f"{one.u_V:+.3f} V to {one.turn_rad:+.3f} rad" for one in found.strokes)
    click.echo(f"strokes: {strokes or 'none stay inside the room'}")


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def show_runs(runs: Sequence[ListedRun], of: int) -> None:
    """Show runs, one line each; ``of``: how many there are in the folder."""
    rows = []
    for run in runs:
        numbers = [
            "" if value is None else _listed(value, percent)
            for value, percent in (
                (run.tau_s, run.tau_percent), (run.K_rad_s_V, run.K_percent), (run.fc_V, run.fc_percent)
            )
        ]  # fmt: skip
        ended = ("rehearsal: " if run.rehearsal else "") + (run.fault or run.state)
        rows.append([plain(run.name), *numbers, run.verdict or "", run.laws.replace("_", " "), ended])
    count = f"{len(runs)} of {of} runs" if len(runs) < of else f"{of} runs" if of != 1 else "1 run"
    if rows:
        show_table(count, LIST_HEADINGS, rows)
    else:
        click.echo(count)
    for run in runs:
        if run.problem is not None:
            click.echo(f"{plain(run.name)}: {run.problem}")


def _listed(value: float, percent: float | None) -> str:
    if percent is None:
        return f"{value:.4f}"
    return f"{value:.4f} ±{percent:.2g} %" if percent <= 100.0 else "unknown"


def show_comparison(found: ComparisonResult) -> None:
    """Show a comparison: the runs, how far each is off the others, both answers, the trends."""
    benches = len({run.bench for run in found.runs})
    others = "the other" if len(found.runs) == 2 else "the others"
    head = ("run", *(("bench",) if benches > 1 else ()), "tau, s", "K, (rad/s)/V", "f_c, V", "verdict")
    rows = [[run.name, *([str(run.bench)] if benches > 1 else []), *_compared(run), run.verdict] for run in found.runs]
    show_table(f"{len(found.runs)} runs, ±: noise alone (Type A, 95 %)", head, rows)
    head = ("run", "tau, %", "K, %", "f_c, %", "chance")
    rows = [
        [
            run.name,
            *(_off_others(run.off_percent[key], run.off_ci95_percent[key]) for key in MAIN),
            "< 0.01 %" if run.chance < 1e-4 else f"{100.0 * run.chance:.{1 if run.chance < 0.1 else 0}f} %",
        ]
        for run in found.runs
    ]
    show_table(f"how far off {others}, ±: 95 %, with what the runs do not share", head, rows)
    for line in comparison_words(found):
        click.echo(line)


def _compared(run: ComparedRunResult) -> list[str]:
    values = (run.tau_s, run.K_rad_s_V, run.fc_V)
    return [
        f"{value:.4f} ±{0.5 * (known(run.ci95[key][1]) - known(run.ci95[key][0])):.4f}"
        for key, value in zip(MAIN, values, strict=True)
    ]


def _off_others(percent: float, interval: tuple[float | None, float | None]) -> str:
    return f"{percent:+.2f} ±{0.5 * (known(interval[1]) - known(interval[0])):.2f}"


def show_answer(answer: Answer | None, truth: TrueMotor | None = None) -> None:
    """Show the answer in a few lines; ``truth``: the emulated motor, if there is one."""
    for line in answer_lines(answer, law_causes() if answer is not None and answer.law else {}, truth):
        click.echo(line)


def show_details(result: IdentificationResult) -> None:
    """Show what the answer is made of: notes, each method, laws, uncertainty, friction map."""
    for note in result.notes:
        click.echo(note)
    show_estimates(result.estimates, None)
    reasons = [(method, reason) for method, one in result.estimates.items() for reason in one.reasons]
    for method, reason in reasons:
        click.echo(f"{method}: {reason}")
    if any("record" in reason for _, reason in reasons):
        click.echo(RECORD_AGAIN)
    show_motor_law(result)
    show_friction_map(result.friction_map)


def show_estimates(
    estimates: Mapping[str, EstimateResult],
    truth: TrueMotor | None,
    tracking: Mapping[str, TrackingResult] | None = None,
) -> None:
    """Show the plain motor by each method as a table; ``truth``: the emulated motor, if there is one."""
    headings = ["method", "tau, s", "K, (rad/s)/V", "f_c, V", "verdict", *(["tracking RMS, rad"] if tracking else [])]
    rows: list[list[str]] = []
    for method, estimate in estimates.items():
        # a refusal gives no number
        cells = ["-" if estimate.is_refused else _interval(estimate, name, truth) for name in MAIN]
        row = [method, *cells, estimate.verdict]
        if tracking:
            row.append(_tracking_cell(tracking.get(method)))
        rows.append(row)
    if truth is not None:
        row = ["truth", *(f"{value:.4f}" for value in (truth.tau_s, truth.K_rad_s_V, truth.fc_V))]
        rows.append([*row, *[""] * (len(headings) - len(row))])
    off = " (in brackets: error against the emulated motor)" if truth else ""
    show_table(f"the plain motor by each method, ± the scatter of its fit alone{off}", headings, rows)
    for method, check_run in (tracking or {}).items():
        if check_run.not_run not in (None, NO_ESTIMATE):
            click.echo(f"tracking with {method}: not run: {check_run.not_run}")
        if check_run.law:
            names = " and ".join(name.replace("_", " ") for name in check_run.law)
            click.echo(f"tracking with {method}: the drive makes up for {names}")


def _tracking_cell(outcome: TrackingResult | None) -> str:
    """The RMS error as measured, and that of the emulated shaft."""
    if outcome is None or outcome.rms_rad is None:
        return "not run"
    true = "" if outcome.true_rms_rad is None else f" (true {outcome.true_rms_rad:.4f})"
    return f"{outcome.rms_rad:.4f}{true}"


def show_motor_law(result: IdentificationResult) -> None:
    """Show the laws that the motor has beyond the plain one, and what the uncertainty of the answer is made of."""
    rows = motor_law_rows(result)
    if rows:
        show_table("what the motor has beyond tau, K and friction", MOTOR_LAW_HEADINGS, rows)
    if words := records_in_words(result.law_records):
        click.echo(f"the answer is fitted to {words}")
    rows = budget_rows(result)
    if rows:
        show_table("uncertainty at 95 % (u95), in % of the answer, and what it is made of", BUDGET_HEADINGS, rows)


def show_friction_map(found: FrictionMapResult | None) -> None:
    """Show the drive over speed as a table, and in a line how far force and friction change over the position."""
    if found is None:
        return
    show_table("friction map: the drive that each speed takes", MAP_HEADINGS, map_rows(found))
    places = [(known(one.y_rad), known(one.force_V), known(one.friction_V)) for one in found.positions]
    if places:
        y, force, friction = zip(*places, strict=True)
        click.echo(
            f"friction map: from {min(y):.2f} to {max(y):.2f} rad, force is from {min(force):+.3f} to "
            f"{max(force):+.3f} V, and friction from {min(friction):.3f} to {max(friction):.3f} V"
        )


def map_rows(found: FrictionMapResult) -> list[list[str]]:
    """The sweeps of a survey, a row of ``MAP_HEADINGS`` each."""
    rows = []
    for one in found.speeds:
        drive = f"{known(one.drive_V):+.4f} ±{2.0 * known(one.error_V):.4f}"
        stuck = "sticks and slips" if one.sticks else ""
        rows.append([f"{known(one.speed_rad_s):+.3f}", drive, f"{known(one.law_V):+.4f}", stuck])
    return rows


def _interval(estimate: EstimateResult, name: str, truth: TrueMotor | None) -> str:
    value = estimate.value(name)
    if value is None:
        return "-"
    text = f"{value:.4f}"
    bounds = estimate.interval(name)
    if bounds is not None:
        text += f" ±{0.5 * (bounds[1] - bounds[0]):.4f}"
    true = None if truth is None else truth.value(name)
    if true:
        text += f" ({100.0 * (value / true - 1.0):+.1f} %)"
    return text


def show_campaign(found: Summary, folder: Path) -> None:
    """Show a campaign: its errors against the bound, and where the files are; ``found`` is its summary.json."""
    from rig.campaign.report import HEADINGS, sentences, table_rows

    title = f"campaign {found['campaign']}: {found['ok']['number']} experiments called ok"
    show_table(title, HEADINGS, list(table_rows(found["ok"])))
    click.echo("\n".join(sentences(found)))
    click.echo(f"rows:   {folder / 'results.csv'}")
    click.echo(f"report: {folder / 'report.html'}")


def show_scatter(results: Sequence[RunResult]) -> None:
    """Show the scatter between runs beside the intervals that each run gave; ``results``: the result.json of each."""
    estimates = [run.answer for run in results if run.answer is not None and not run.answer.is_refused]
    if len(estimates) < 2:
        click.echo(f"no scatter: it takes two answers, not refused, and {len(results)} runs gave {len(estimates)}")
        return
    headings = ("", "mean", "scatter between runs (1.96 s)", "mean half-width of the 95 % intervals")
    rows: list[list[str]] = []
    for name in MAIN:
        values = [value for e in estimates if (value := e.value(name)) is not None]
        widths = [0.5 * (b[1] - b[0]) for e in estimates if (b := e.interval(name)) is not None]
        if len(values) >= 2 and widths:
            rows.append([name, f"{fmean(values):.5f}", f"{1.96 * stdev(values):.5f}", f"{fmean(widths):.5f}"])
    show_table(f"answers of {len(estimates)} of {len(results)} runs", headings, rows)
