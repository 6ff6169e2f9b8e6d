"""A path that should be a run or a recording, and is not: what it is, and what to type instead."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from typing import Final

from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CONFIG, CURVES, META, RESULT
from rig.run_folder.recording.writer import EVENTS, SAMPLES

CAMPAIGN_ROWS: Final = "results.csv"
_CONFIGS: Final = (".yaml", ".yml")
_OF_A_RUN: Final = (SAMPLES, EVENTS, META, RESULT, CURVES, CONFIG, "report.html")
_OTHER_EXPORTS: Final = (".mat", ".npz", ".npy", ".json")
_PRINTED: Final = "give the folder that `rig run` printed"
_HEAD_BYTES: Final = 65536
# Keys of what `rig identify --json` prints, and of what `rig export` writes alone
_ANSWER, _EXPORT = b'"answer":', b'"units":'


def is_run(path: Path) -> bool:
    """Whether a path is a run folder, complete or not: it has samples, or at least the meta.json of a run."""
    return (path / SAMPLES).exists() or ((path / META).exists() and not (path / CAMPAIGN_ROWS).exists())


def require_run(path: Path) -> None:
    """Raise RecordingError, as `no_run` words it, if ``path`` is not a run folder."""
    with _looking_at(path):
        if is_run(path):
            return
    raise no_run(path)


def is_file_of_a_run(path: Path) -> bool:
    """Whether a path is a file of a run, in its run folder."""
    return path.name in _OF_A_RUN and is_run(path.parent)


def require_free(path: Path, other: str, *, overwrite: bool) -> None:
    """Raise RecordingError where a file of a run is, or anything else that is not to be replaced; OSError.

    other  what to name instead
    """
    if is_file_of_a_run(path):
        raise RecordingError(path, "is a file of the run itself", f"name {other}")
    if path.is_dir() or (path.exists() and not overwrite):
        raise RecordingError(path, "is there already", f"name {other}, or add --force to replace it")


def require_distinct(paths: Iterable[Path]) -> None:
    """Raise RecordingError if two paths are one recording: its rows would count twice."""
    seen = set()
    for path in paths:
        with _looking_at(path):
            recording = (path.parent if path.name == SAMPLES and is_run(path.parent) else path).resolve()
        if recording in seen:
            raise RecordingError(path, "is given twice: the same rows would count twice", "name it once")
        seen.add(recording)


def no_run(path: Path) -> RecordingError:
    """The error for a ``path`` that is not a run folder with samples: what it is instead, and what to type."""
    with _looking_at(path):
        if path.is_dir():
            return _folder(path)
        if is_file_of_a_run(path):
            return _file_of_a_run(path)
        found = no_recording(path)
        if found is not None:
            return found
        if _looks_like_csv(path):
            name = quote(str(path))
            return RecordingError(
                path,
                "is a CSV file, not a run folder",
                f"this takes a run of rig's; `rig identify {name}` reads it, and `rig predict-run` takes its answer",
            )
    return RecordingError(path, "is a file, not a run folder", _PRINTED)


def no_recording(path: Path) -> RecordingError | None:
    """The error for a ``path`` that is neither run folder nor CSV file; None if it may be one of them."""
    with _looking_at(path):
        if path.is_dir():
            return None if (path / SAMPLES).exists() else _folder(path)
        if not path.exists():
            return _missing(path)
        if path.name != SAMPLES and is_file_of_a_run(path):
            return _file_of_a_run(path)
        if path.is_file() and path.suffix.lower() in _CONFIGS:
            return _config(path)
        if path.suffix.lower() == ".json" and path.is_file() and _is_answer(path):
            return RecordingError(
                path,
                "is an answer of `rig identify --json`, not a recording",
                "give the log or the run folder that it comes from; `rig tune` and `rig predict-run --model` take the "
                "answer",
            )
        if path.is_file() and path.suffix.lower() in _OTHER_EXPORTS:
            return RecordingError(
                path,
                "is neither a run folder nor a CSV file",
                "of a run give its folder, or what `rig export RUN --to FILE.csv` wrote; of other numbers export time, "
                "drive and position as CSV, or type in Python: rig.identify(t, u, y), in s, V and rad",
            )
    return None


def _is_answer(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return _ANSWER in head and _EXPORT not in head


@contextmanager
def _looking_at(path: Path) -> Iterator[None]:
    """Raise RecordingError if a path cannot be read at all."""
    try:
        yield
    except OSError as error:
        raise RecordingError(path, f"cannot be read: {error.strerror}", "check the path and its permissions") from error


def _folder(path: Path) -> RecordingError:
    if (path / CAMPAIGN_ROWS).exists():
        command = f"rig campaign {quote(str(path / CONFIG))}"
        return RecordingError(
            path,
            "is the folder of a campaign: its experiments are simulated and have no run folders",
            f"its report: `{command} --resume {quote(str(path))}`; experiment 0 again: `{command} --experiment 0`",
        )
    if is_run(path):
        return RecordingError(
            path, f"has no {SAMPLES}: nothing was recorded in this run", "run it again: `rig run CONFIG`"
        )
    runs = [child for child in path.iterdir() if (child / SAMPLES).exists()]
    if runs:
        newest = max(runs, key=lambda run: ((run / SAMPLES).stat().st_mtime, run.name))
        count = "1 run" if len(runs) == 1 else f"{len(runs)} runs"
        return RecordingError(
            path, f"holds {count} but is not a run itself", f"name one of them; the newest is {quote(str(newest))}"
        )
    return RecordingError(path, "is a folder without a run", _PRINTED)


def _missing(path: Path) -> RecordingError:
    there = [child.name for child in path.parent.iterdir()] if path.parent.is_dir() else []
    close = difflib.get_close_matches(path.name, there, n=1)
    cure = f"did you mean {quote(str(path.parent / close[0]))}?" if close else f"check the path, or {_PRINTED}"
    return RecordingError(path, "is not there", cure)


def _file_of_a_run(path: Path) -> RecordingError:
    return RecordingError(path, "is one file of a run", f"give the whole folder: {quote(str(path.parent))}")


def _config(path: Path) -> RecordingError:
    with path.open("rb") as file:
        keys = [line.split(b":")[0] for line in file.read(_HEAD_BYTES).splitlines() if b":" in line]
    if b"experiments" in keys and b"daq" not in keys:
        kind, command = "the config of a campaign", "rig campaign"
    else:
        kind, command = "a config, not a recording", "rig run"
    return RecordingError(path, f"is {kind}", f"`{command} {quote(str(path))}` runs it, and prints its folder")


def _looks_like_csv(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return b"\0" not in head and (b"t_s" in head or path.suffix.lower() == ".csv")
