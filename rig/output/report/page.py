"""The report: reads a run folder, writes one self-contained report.html; and the page of any recordings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ParamSpec

import numpy as np

from rig.identification import Identification, IdentifyError, identify
from rig.identification.verdict import PROMISE, RISK
from rig.output.report import checked, fitted, friction_map, measured, narrowing, tables, transient, tuned_loop
from rig.output.report.model_curves import curves_of
from rig.output.report.simulated import picture_of
from rig.output.report.source import ReportedRun, load
from rig.output.report.style import AbsentError, Picture, rendered, style
from rig.output.report.words import driven, headline, rounded
from rig.run_folder.recording.curves import write_curves
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import write_whole
from rig.run_folder.recording.recording import Recording
from rig.run_folder.results import LiveResult, RunMeta, RunResult

REPORT = "report.html"
_Given = ParamSpec("_Given")


@dataclass(frozen=True)
class Figure:
    """A figure of the page: the picture, or the sentence that says why there is none."""

    picture: Picture | None
    absent: str = ""


def write_report(
    run_folder: Path, identification: Identification | None = None, known: Recording | None = None
) -> Path:
    """Write ``report.html`` into a run folder and return its path.

    The page says what is missing from the folder. With ``identification`` curves.json is written, too.

    identification  of this recording; None: identify it here, if the run has no result
    known           the rows that were read before, so that they are not parsed again
    Raises FileNotFoundError if ``run_folder`` is no folder, CannotWriteError if the file cannot be written.
    """
    run = load(Path(run_folder), known)
    curves = None if identification is None or run.result.models_from else identification.curves
    if identification is None and not run.has_result:
        run, identification = _identify_unfinished(run)
    page = render_page(run, identification)
    path = run.folder / REPORT
    write_whole(path, page)
    if curves is not None and run.recording is not None:
        write_curves(run.folder, run.recording, curves)
    return path


def write_identified(found: Identification, records: Sequence[str], path: Path) -> None:
    """Write the page into a file. Raises CannotWriteError.

    records  what was read, in words; the first names the page
    """
    result = RunResult(answer=found.answer, estimates=found.as_result().estimates, **found.evidence)
    about = RunMeta(backend=", ".join(records), rehearsal=found.rehearsal or None)
    run = ReportedRun(Path(records[0]), None, about, result, of_recordings=True)
    spread_rad = float(np.std(np.concatenate([test.y_rad for test in found.tests]))) if found.tests else math.nan
    with style():
        figures = {
            "simulated": drawn(picture_of, found, run.foot),
            "residual": drawn(fitted.residuals, run, found.curves, spread_rad),
        }
    page = rendered(
        "rig.output.report",
        "identified.html.j2",
        name=Path(records[0]).name,
        rehearsal=run.rehearsal,
        records=records,
        headline=headline(run),
        figures=figures,
        estimates=tables.estimates(run),
        motor_law=tables.motor_law(run),
        budget=tables.budget(run),
        notes=found.notes,
    )
    write_whole(path, page)


def _identify_unfinished(run: ReportedRun) -> tuple[ReportedRun, Identification | None]:
    """Identify a run that ended before its result. Returns the run with that result; None if there is nothing."""
    if run.recording is None or not (run.spans("relay") or run.spans("hysteretic")):
        return run, None
    try:
        found = identify([run.recording])
    except (IdentifyError, RecordingError) as error:
        run.notes.append(f"The recording of this run cannot be identified: {error.cause}. What to do: {error.cure}.")
        return run, None
    identified = found.as_result()
    result = RunResult(
        answer=identified.answer,
        estimates=identified.estimates,
        relays=identified.relays,
        hysteretic=identified.hysteretic,
        friction_map=identified.friction_map,
        **found.evidence,
    )
    run.notes.append("The run ended before it had a result. For this page its recording was identified.")
    return replace(run, result=result), found


def render_page(run: ReportedRun, identification: Identification | None = None) -> str:
    """The whole page as text; identifies the recording again unless ``identification`` is given."""
    return rendered(
        "rig.output.report",
        "report.html.j2",
        run=run,
        rounded=rounded,
        headline=headline(run),
        driven=driven(run),
        figures=draw(run, identification),
        estimates=tables.estimates(run),
        relays=tables.relays(run),
        motor_law=tables.motor_law(run),
        promise_percent=100.0 * PROMISE,
        risk_percent=100.0 * RISK,
        records=tables.records(run),
        budget=tables.budget(run),
        hysteretic=tables.hysteretic(run),
        why_it_ended=narrowing.why_it_ended(run),
        tracking=tables.tracking(run),
        tracking_heads=tables.tracking_heads(run),
        law_used=tables.law_used(run),
        at_rest=tables.at_rest(run),
        tuned=tables.tuned(run),
        loop_cells=tables.loop(run),
        facts=tables.facts(run),
        started=tables.started(run),
        notes=run.result.notes,
        config_notes=run.result.config_notes,
    )


def draw(run: ReportedRun, identification: Identification | None = None) -> dict[str, list[Figure]]:
    """All figures by section. For a missing one: the sentence that says why."""
    with style():
        curves, trouble = curves_of(run, identification)
        relays, is_read = run.spans("relay"), run.recording is not None
        tracks = run.result.tracking or run.spans("track") or run.config.tracks or not is_read

        def of(*pictures: Callable[[ReportedRun], Picture], where: object = True) -> list[Figure]:
            return [drawn(picture, run) for picture in pictures] if where else []

        evidence = [Figure(None, trouble)] if trouble else []
        if curves is not None and not trouble:
            spans = [*relays, *run.spans("hysteretic")]
            positions = [run.rows.y_rad[s.first : s.last + 1] for s in spans] if is_read else []
            spread_rad = float(np.std(np.concatenate(positions))) if positions else math.nan
            evidence = [drawn(fitted.residuals, run, curves, spread_rad)]
        transients = of(transient.first_transients, where=run.spans("hysteretic"))
        return {
            "whole": of(measured.whole_run),
            "breakaway": of(measured.breakaway),
            "narrowing": of(narrowing.narrowing, where=run.result.stopped or run.events_of("live", LiveResult)),
            "search": of(measured.gain_search),
            "relays": of(measured.relay_tests, where=relays or not is_read),
            "portraits": of(measured.portraits, where=relays or not is_read),
            "forest": of(fitted.forest),
            "budget": of(fitted.budget),
            "map": of(friction_map.over_speed, friction_map.over_position, where=run.spans("survey")),
            "transients": [*transients, drawn(transient.recursion, run, curves)] if transients else [],
            "cycles": [drawn(fitted.averaged_cycle, run, span) for span in relays],
            "evidence": evidence,
            "tracking": [
                *of(checked.tracking, where=tracks),
                *of(checked.decay, where=tracks and run.config.decay is not None),
            ],
            "tuned": of(tuned_loop.loop, where=run.result.tuned),
            "loop": of(checked.loop_timing),
        }


def drawn(make: Callable[_Given, Picture], *given: _Given.args, **named: _Given.kwargs) -> Figure:
    """The figure of what is given, or the sentence that says why there is none."""
    try:
        return Figure(make(*given, **named))
    except AbsentError as absent:
        return Figure(None, str(absent))
