"""A run folder in one line, from its meta.json and result.json."""

from __future__ import annotations

import math
from pathlib import Path

from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.reader import read_meta, read_result
from rig.run_folder.results import RunMeta, RunResult, known
from rig.run_folder.results.listed import ListedRun

DONE, FAULT, NO_RESULT, DAMAGED = "done", "fault", "no result", "damaged"


def read_entry(folder: Path) -> ListedRun:
    """The line of a run folder. What is wrong with its files is its ``problem``."""
    try:
        meta, meta_notes = read_meta(folder)
        result, notes = read_result(folder)
    except (RecordingError, OSError) as error:
        return ListedRun(name=folder.name, state=DAMAGED, problem=str(error))
    problem = "; ".join([*meta_notes, *notes, *([] if meta is not None else ["meta.json is missing"])])
    return of_files(folder.name, meta or RunMeta(), result, problem)


def of_files(name: str, meta: RunMeta, result: RunResult | None, problem: str = "") -> ListedRun:
    """The line of a run from its two files; ``result``: None of a run without one."""
    about = ListedRun(
        name=name,
        started_utc=meta.started_utc,
        command=None if meta.script is None else meta.script.name,
        config=meta.name or None,
        backend=meta.backend or None,
        emulated=meta.emulated,
        rehearsal=meta.rehearsal,
        state=NO_RESULT if result is None else FAULT if result.faults else DONE,
        fault=result.faults[0].code if result is not None and result.faults else None,
        problem=problem or None,
    )
    return about if result is None else about.model_copy(update=_found(result))


def _found(result: RunResult) -> dict[str, object]:
    answer = result.answer
    tracked = None if answer is None else result.tracking.get(answer.method)
    loop = result.loop
    found: dict[str, object] = {
        "laws": ", ".join(law.name for law in (answer.law if answer else None) or ()),
        "tracking_rms_rad": None if tracked is None else tracked.rms_rad,
        "duration_s": None
        if loop is None or loop.ticks is None or loop.period_s is None
        else round(loop.ticks * loop.period_s, 6),
    }
    if answer is None:
        return found
    found |= {"method": answer.method, "verdict": answer.verdict}
    if answer.is_refused:
        return found  # a refusal gives no number
    for key, percent in (("tau_s", "tau_percent"), ("K_rad_s_V", "K_percent"), ("fc_V", "fc_percent")):
        value, interval = known(answer.value(key)), answer.at_95(key)
        found[key] = value if math.isfinite(value) else None
        if interval is not None and value > 0.0:
            found[percent] = 50.0 * (interval[1] - interval[0]) / value
    return found
