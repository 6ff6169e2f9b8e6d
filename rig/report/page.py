"""The report: a run folder in, one self-contained report.html out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import jinja2

import rig
from rig.identify import Identification, IdentifyError, identify
from rig.recording.errors import RecordingError
from rig.recording.folder import write_whole
from rig.recording.reader import Recording
from rig.report import checked, fitted, measured, transient
from rig.report.fit import fits_of
from rig.report.source import PREFERRED, Json, Run, load, mappings, number, section, texts
from rig.report.style import AbsentError, Picture, short, style
from rig.report.words import PARAMETERS, Quantity, headline, quantity, rounded

REPORT = "report.html"
TEMPLATE = "report.html.j2"
LAWS = {"coulomb": "Coulomb", "asymmetric": "+ asymmetry", "static": "+ static level", "stribeck": "+ Stribeck effect"}


@dataclass(frozen=True)
class Figure:
    """A place for a figure: the picture, or the sentence that says why there is none."""

    picture: Picture | None
    absent: str = ""


def write_report(
    run_folder: Path, identification: Identification | None = None, known: Recording | None = None
) -> Path:
    """Write ``report.html`` into a run folder and return its path.

    ``identification`` is what `rig.identify` made of this recording, ``known`` its rows as far as they were read,
    where the caller has them already. Whatever is missing from the folder is said on the page.
    Raises FileNotFoundError if ``run_folder`` is no folder, CannotWriteError where the file cannot be written.
    """
    run = load(Path(run_folder), known)
    if identification is None and not run.result:
        identification = _identify_unfinished(run)
    page = render_page(run, identification)
    path = run.folder / REPORT
    write_whole(path, page.encode("utf-8"))
    return path


def _identify_unfinished(run: Run) -> Identification | None:
    """What a run that ended before its result has left, put where the result would be; None if that is nothing."""
    if run.recording is None or not (run.spans("relay") or run.spans("hysteretic")):
        return None
    try:
        found = identify([run.recording])
    except (IdentifyError, RecordingError) as error:
        run.notes.append(f"The record of this run cannot be identified: {error.cause}. {error.cure}.")
        return None
    run.result["estimates"] = {method: estimate.as_dict() for method, estimate in found.estimates.items()}
    run.result["relays"] = found.relays
    run.result["hysteretic"] = found.hysteretic
    run.result["friction_law"] = None if found.friction_law is None else found.friction_law.as_dict()
    run.notes.append("The run ended before it had a result: its record was identified for this page.")
    return found


def render_page(run: Run, identification: Identification | None = None) -> str:
    """The whole page as text; identifies the recording anew unless ``identification`` is given."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rig.report", package_path="."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["rounded"] = rounded
    return environment.get_template(TEMPLATE).render(
        run=run,
        version=rig.__version__,
        headline=headline(run),
        figures=draw(run, identification),
        estimates=_estimates(run),
        relays=_relays(run),
        friction_law=_friction_law(run),
        hysteretic=_hysteretic(run),
        tracking=_tracking(run),
        loop_cells=_loop(run),
        facts=_facts(run),
        started=_started(run),
        notes=list(texts(run.result.get("notes"))),
        config_notes=list(texts(run.result.get("config_notes"))),
    )


def draw(run: Run, identification: Identification | None = None) -> dict[str, list[Figure]]:
    """All figures by section; a part that is missing becomes its sentence."""
    with style():
        fits, trouble = fits_of(run, identification)
        best = next(iter(run.estimates), "sampled-data")
        relays = run.spans("relay")

        def transients() -> list[Figure]:
            if not run.spans("hysteretic"):
                return []
            return [_figure(lambda: transient.first_transients(run)), _figure(lambda: transient.recursion(run, fits))]

        cycles = [_figure(lambda span=span: fitted.averaged_cycle(run, span)) for span in relays]  # type: ignore[misc]
        return {
            "whole": [_figure(lambda: measured.whole_run(run))],
            "breakaway": [_figure(lambda: measured.breakaway(run))],
            "search": [_figure(lambda: measured.gain_search(run))],
            "relays": [_figure(lambda: measured.relay_tests(run))],
            "portraits": [_figure(lambda: measured.portraits(run))],
            "forest": [_figure(lambda: fitted.forest(run))],
            "transients": transients(),
            "cycles": cycles or [Figure(None, "There was no relay test, so there is no averaged cycle.")],
            "evidence": [Figure(None, trouble) if trouble else _figure(lambda: fitted.residuals(run, best, fits))],
            "tracking": [_figure(lambda: checked.tracking(run))],
            "loop": [_figure(lambda: checked.loop_timing(run))],
        }


def _figure(make: Callable[[], Picture]) -> Figure:
    try:
        return Figure(make())
    except AbsentError as absent:
        return Figure(None, str(absent))


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


def _estimates(run: Run) -> list[EstimateRow]:
    table = []
    for method, e in run.estimates.items():
        rms = number(e.get("rms_rad"))
        rows = e.get("rows")
        table.append(
            EstimateRow(
                method,
                short(method),
                tuple(quantity(p, e, run.truth) for p in PARAMETERS),
                rms if math.isfinite(rms) else None,
                rounded(1e3 * rms) if math.isfinite(rms) else "–",
                str(e.get("iterations", "–")),
                f"{rows[0]} to {rows[1]}" if isinstance(rows, list) and len(rows) == 2 else "–",
                str(e.get("verdict", "not judged")),
                texts(e.get("reasons")),
            )
        )
    return table


def _relays(run: Run) -> list[Json]:
    """Relay tests as the result has them; every value a pair of exact number (or None) and text."""
    keys = ("h1_V", "h2_V", "period_s", "amplitude_rad", "cycles")
    return [
        {"stage": str(relay.get("stage", "")).replace("-", " "), "cells": [_cell(relay.get(k)) for k in keys]}
        for relay in mappings(run.result.get("relays"))
    ]


def _friction_law(run: Run) -> Json | None:
    """The friction laws that were tried: a line for each, and its reason; None without one."""
    found = section(run.result, "friction_law")
    rungs = mappings(found.get("rungs"))
    if not rungs:
        return None
    keys = ("fc_V", "asym_V", "fs_V", "stribeck_rad_s")
    lines = []
    for rung in rungs:
        parameters = section(rung, "parameters")
        cells = [_cell(parameters.get(key)) for key in keys]
        cells += [_cell(rung.get("criterion")), _cell(rung.get("held_out_rms_rad"), 1e3)]
        law = str(rung.get("law", ""))
        lines.append({"law": LAWS.get(law, law), "cells": cells, "standing": str(rung.get("standing", ""))})
    words = [str(found[key]) for key in ("reason", "viscous") if found.get(key)]
    held_out = found.get("held_out")
    return {
        "lines": lines,
        "words": [*words, *texts(found.get("record"))],
        "held_out": str(held_out).replace("-", " ") if held_out else "",
    }


def _hysteretic(run: Run) -> list[Json]:
    """Hysteretic runs as the result has them, in V, rad, mrad and s."""
    factors = {"d_V": 1.0, "eps_rad": 1.0, "start_rad": 1e3, "switched_s": 1.0, "switched_rad": 1.0}
    return [
        {
            "stage": str(entry.get("stage", "")).replace("-", " "),
            "cells": [_cell(entry.get(key), factor) for key, factor in factors.items()],
        }
        for entry in mappings(run.result.get("hysteretic"))
    ]


def _cell(value: Any, factor: float = 1.0) -> tuple[float | None, str]:
    x = number(value)
    if not math.isfinite(x):
        return None, "–"
    return x, f"{factor * x:.4g}" if abs(factor * x) < 1e4 else f"{factor * x:.0f}"


def _tracking(run: Run) -> list[Json]:
    table = []
    outcomes = section(run.result, "tracking")
    for method in sorted(outcomes, key=lambda m: (*PREFERRED, m).index(m)):
        outcome = outcomes[method]
        entry = outcome if isinstance(outcome, dict) else {}
        known = math.isfinite(number(entry.get("rms_rad")))
        reason = "" if known else str(entry.get("not_run") or "no outcome was recorded")
        cells = [_cell(entry.get(k), 1e3) for k in ("rms_rad", "max_rad")]
        table.append({"method": method, "short": short(method), "cells": cells, "reason": reason})
    return table


def _loop(run: Run) -> list[tuple[str, tuple[float | None, str]]]:
    """Heading and cell of each column of the loop's table; none where the result has no loop."""
    loop = section(run.result, "loop")
    if not loop:
        return []
    late = section(loop, "late_us")
    cells = [("period, ms", _cell(run.period_s, 1e3)), ("ticks", _cell(loop.get("ticks"))),
             ("skipped", _cell(loop.get("skipped")))]  # fmt: skip
    if not run.in_virtual_time:
        names = (("median", "p50"), ("99 %", "p99"), ("99.9 %", "p999"), ("largest", "max"))
        cells += [(f"late, {name}, µs", _cell(late.get(key))) for name, key in names]
    return cells


def _started(run: Run) -> str:
    """When the run started, in words; empty where it is not recorded."""
    try:
        started = datetime.fromisoformat(str(run.meta.get("started_utc")))
    except ValueError:
        return ""
    return f"{started:%Y-%m-%d %H:%M:%S} UTC"


def _facts(run: Run) -> list[tuple[str, str]]:
    """What is known about the run, in words: (name, value) pairs in the order of meta.json."""
    facts = [
        (key.replace("_", " "), _in_words(value))
        for key, value in run.meta.items()
        if key not in ("truth", "backend", "schema")
    ]
    if run.truth:
        facts.append(("truth (emulated)", ", ".join(f"{k} = {v:.6g}" for k, v in run.truth.items())))
    return facts


def _in_words(value: Any) -> str:
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
        return ", ".join(f"{str(key).replace('_', ' ')}: {_in_words(item)}" for key, item in value.items())
    return str(value)
