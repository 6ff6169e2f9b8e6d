"""The index of a folder of runs: a line of JSON for each run, with size and time of the files that it was made from.

A line counts only while these are the folder's. A lost, damaged or older index is made anew; nobody has to delete it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.core import strict_json
from rig.core.package import VERSION
from rig.core.plain_file import read_plain
from rig.run_folder.catalogue.entry import read_entry
from rig.run_folder.recording.errors import CannotWriteError, RecordingError
from rig.run_folder.recording.folder import META, RESULT, write_whole
from rig.run_folder.recording.path_kind import CAMPAIGN_ROWS, is_run, no_run
from rig.run_folder.recording.text_file import is_folder
from rig.run_folder.results.listed import ListedRun
from rig.run_folder.results.reading import DamagedError, parsed

INDEX = ".rig-index.jsonl"
FORM = 2  # of the index
_MOST_BYTES = 64 * 2**20  # a hundred thousand runs
FROM = (META, RESULT)  # files that a line is made from

Stamp = tuple[tuple[int, int], ...]
"""Size in bytes, and time of the last change in ns, of each file of ``FROM``; (-1, -1): it is not there."""


@dataclass(frozen=True)
class Catalogue:
    """The runs of a folder.

    runs     by name, which is by their start
    read     how many of them had to be read; the others were in the index
    notes    why the index was not written, and which folders could not be looked into
    """

    runs: tuple[ListedRun, ...]
    read: int
    notes: tuple[str, ...] = ()


def catalogue(folder: Path) -> Catalogue:
    """The runs in a folder, not in those below. Writes the index if it has changed.

    Raises RecordingError if it is no folder of runs (`no_run`), or is not there.
    """
    if not os.path.lexists(folder):
        cure = "it comes with the first `rig run CONFIG`; for another one type `rig list FOLDER`"
        raise RecordingError(folder, "is not there", cure)
    if not is_folder(folder):
        raise no_run(folder)
    if is_run(folder):
        raise RecordingError(folder, "is a run itself", f"list the folder that holds it: `rig list {folder.parent}`")
    notes: list[str] = []
    try:
        stamps = dict(sorted(_stamps(folder, notes)))
    except OSError as error:
        raise RecordingError(folder, f"cannot be read: {error.strerror}", "check its permissions") from error
    known = _read(folder / INDEX)
    lines = {name: known[name][1] for name, stamp in stamps.items() if name in known and known[name][0] == stamp}
    missing = [name for name in stamps if name not in lines]
    lines |= {name: read_entry(folder / name) for name in missing}
    if missing or set(known) != set(stamps):
        try:
            _write(folder / INDEX, stamps, lines)
        except CannotWriteError as error:
            notes.append(f"no index: {error.path} {error.cause}; so the next `rig list` reads all runs again")
    return Catalogue(tuple(lines[name] for name in stamps), len(missing), tuple(notes))


def _stamps(folder: Path, notes: list[str]) -> Iterator[tuple[str, Stamp]]:
    """The runs with their stamps; ``notes`` take the folders that cannot be looked into."""
    for child in folder.iterdir():
        try:
            if child.is_dir() and is_run(child) and not (child / CAMPAIGN_ROWS).exists():
                yield child.name, tuple(_stamp(child / name) for name in FROM)
        except OSError as error:
            notes.append(f"left out: {child} cannot be looked into: {error.strerror}")


def _stamp(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return -1, -1
    return found.st_size, found.st_mtime_ns


def _read(path: Path) -> dict[str, tuple[Stamp, ListedRun]]:
    """The lines of the index by run; empty if it is lost, damaged or of another form."""
    try:
        head, *lines = read_plain(path, _MOST_BYTES).decode("utf-8").splitlines()
        if strict_json.parse(head) != _head():
            return {}
        return dict(_line(strict_json.parse(line)) for line in lines)
    except (OSError, ValueError, KeyError, TypeError, DamagedError):
        return {}  # it is made anew from the folder


def _line(entry: Any) -> tuple[str, tuple[Stamp, ListedRun]]:
    run = parsed(ListedRun, entry["run"])
    return run.name, (tuple((int(size), int(ns)) for size, ns in entry["stamp"]), run)


def _write(path: Path, stamps: dict[str, Stamp], lines: dict[str, ListedRun]) -> None:
    entries = [_head(), *({"stamp": stamps[name], "run": lines[name].as_json()} for name in stamps)]
    write_whole(path, "".join(json.dumps(entry) + "\n" for entry in entries).encode("utf-8"))


def _head() -> dict[str, object]:
    return {"rig_index": FORM, "rig": VERSION}
