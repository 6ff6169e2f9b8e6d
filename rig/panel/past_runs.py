"""Past runs: the run folders below the panel's --out folder, by name, and what came of each.

A name from a page is looked up among the folders that are there. It never becomes part of a path unchecked.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import re
import stat
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from rig.core.estimators import MAIN
from rig.core.plain_file import read_plain
from rig.core.signals import plain
from rig.panel.messages import RefusedError, RunRow
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CONFIG, META, RESULT
from rig.run_folder.recording.path_kind import is_run
from rig.run_folder.recording.reader import read_meta, read_result
from rig.run_folder.recording.writer import EVENTS, SAMPLES
from rig.run_folder.results import EstimateResult, RunMeta, RunResult
from rig.run_folder.results.answer_words import graded_words, validity

REPORT: Final = "report.html"
MOST_RUNS: Final = 300
_FILES: Final = (SAMPLES, EVENTS, META, RESULT, CONFIG, REPORT)
_LARGEST_REPORT: Final = 64 * 2**20  # bytes
_NAME: Final = re.compile(r"(\d{8}T\d{6}Z)-[^/\\]{1,180}")


class Runs:
    """The run folders of one folder. What does not change is read once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[str, tuple[float, RunRow]] = {}

    def find(self, name: str) -> Path:
        """The run folder of this name. Raises RefusedError 404 if there is none."""
        if _is_a_name(name):
            with contextlib.suppress(OSError):  # a name that is longer than the disk has any
                if _is_a_run(found := self.folder / name):
                    return found
        raise RefusedError(404, f"there is no run {plain(name)[:200]} in {self.folder}", "reload the list of runs")

    def report(self, name: str) -> bytes:
        """The report of a run; no link is followed, whenever it was put there. Raises RefusedError 404 without one."""
        try:
            return read_plain(self.find(name) / REPORT, _LARGEST_REPORT)
        except OSError as error:
            raise RefusedError(
                404, f"the run {name} has no report", f"make it: rig report {self.folder / name}"
            ) from error

    def rows(self) -> list[RunRow]:
        """A row for each run, the newest first; at most ``MOST_RUNS``."""
        rows = [self._row(folder) for folder in itertools.islice(self._newest(), MOST_RUNS)]
        shown = {row["name"] for row in rows}
        self._known = {name: known for name, known in self._known.items() if name in shown}
        return rows

    def row(self, folder: Path) -> RunRow:
        """What came of one run; reads its small files."""
        notes: list[str] = []
        meta = result = None
        try:
            meta, _ = read_meta(folder)
        except RecordingError as error:
            notes.append(f"{META} {error.cause}")
        try:
            result, _ = read_result(folder)
        except RecordingError as error:
            notes.append(f"{RESULT} {error.cause}")
        return _summary(folder, meta or RunMeta(), result, notes)

    def _row(self, folder: Path) -> RunRow:
        try:
            changed = max(path.stat().st_mtime for path in (folder, folder / RESULT) if path.exists())
        except (OSError, ValueError):
            changed = 0.0
        known = self._known.get(folder.name)
        if known is None or known[0] != changed:
            known = self._known[folder.name] = (changed, self.row(folder))
        return known[1]

    def _newest(self) -> Iterator[Path]:
        """The run folders, the newest first: each is looked at when its turn comes, for there may be thousands."""
        try:
            names = [path.name for path in self.folder.iterdir()]
        except OSError:
            return
        for name in sorted(filter(_is_a_name, names), reverse=True):
            with contextlib.suppress(OSError):  # it went meanwhile
                if _is_a_run(folder := self.folder / name):
                    yield folder


def _is_a_name(name: str) -> bool:
    """Whether a run folder of rig may have this name; none has a character that cannot be seen, or is no text."""
    return _NAME.fullmatch(name) is not None and name.isprintable()


def _is_a_run(path: Path) -> bool:
    """Whether this is a run folder of plain files. Raises OSError.

    A link could lead to a file that the watchers of this panel must not read, and nobody may write into a pipe.
    """
    if not stat.S_ISDIR(path.lstat().st_mode) or not is_run(path):
        return False
    for name in _FILES:
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISREG((path / name).lstat().st_mode):
                return False
    return True


def _summary(folder: Path, meta: RunMeta, result: RunResult | None, notes: list[str]) -> RunRow:
    answer = None if result is None else result.answer
    fault = result.faults[0].code if result is not None and result.faults else None
    loop = None if result is None else result.loop
    lasts_s = None if loop is None or not loop.ticks or not loop.period_s else loop.ticks * loop.period_s
    if lasts_s is not None and not math.isfinite(lasts_s):
        lasts_s = None
    return {
        "name": folder.name, "when": meta.started_utc or _stamp(folder.name),
        "command": None if meta.script is None else meta.script.name,
        "config": meta.name, "backend": meta.backend, "emulated": meta.emulated, "rehearsal": bool(meta.rehearsal),
        "verdict": "failed" if fault else None if answer is None else answer.verdict or None, "fault": fault,
        "estimate": None if answer is None else _numbers(answer),
        "says": [] if answer is None else [line for line in (graded_words(answer), *validity(answer)) if line],
        "lasts_s": lasts_s, "report": (folder / REPORT).is_file(), "notes": notes,
    }  # fmt: skip


def _numbers(estimate: EstimateResult) -> dict[str, tuple[float, float | None] | None]:
    """tau, K and f_c, each with half its 95 % interval; null where there is none."""
    numbers: dict[str, tuple[float, float | None] | None] = {}
    for name in MAIN:
        value, interval = estimate.value(name), estimate.at_95(name)
        half = None if interval is None else 0.5 * (interval[1] - interval[0])
        numbers[name] = None
        if value is not None and math.isfinite(value):
            numbers[name] = value, half if half is not None and math.isfinite(half) else None
    return numbers


def _stamp(name: str) -> str | None:
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    try:
        return datetime.strptime(match[1], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC).isoformat()
    except ValueError:
        return None
