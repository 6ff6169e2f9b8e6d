"""The result file of a campaign: rows in the file stay there, whatever ends the program.

A campaign folder holds config.yaml (resolved), meta.json (hashes of the config and the program behind the rows) and
results.csv. Rows are appended in whole chunks. A torn last line is cut off, and its experiment is done again.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from rig.campaign.random_motors import CampaignError
from rig.campaign.trial import COLUMNS, Row
from rig.config import Campaign, dump
from rig.core.package import FOLDER, VERSION
from rig.core.plain_file import open_plain, read_plain
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CONFIG, META, json_text, write_whole
from rig.run_folder.recording.reader import read_object
from rig.run_folder.results import JsonObject

RESULTS: Final = "results.csv"
_MOST_BYTES: Final = 2**30  # of it: millions of experiments
FREE: Final = ("name", "experiments")  # keys that change no row
HEADER: Final = ",".join(COLUMNS) + "\n"

Table = Mapping[str, NDArray[Any]]


def config_hash(campaign: Campaign) -> str:
    """Hash of all config keys that a row depends on."""
    return hashlib.sha256(json.dumps(_keys(campaign), sort_keys=True).encode()).hexdigest()


def program_hash() -> str:
    """Hash of the sources that a row depends on: models, identification, and the campaign's own grid and trial."""
    room = FOLDER
    files = [*sorted((room / "model").rglob("*.py")), *sorted((room / "identification").rglob("*.py"))]
    files += [room / "campaign" / "random_motors.py", room / "campaign" / "trial.py"]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()


def folder_for(parent: Path, campaign: Campaign) -> Path:
    """The folder of this campaign under this version of the program. It is always the same one."""
    identity = hashlib.sha256((config_hash(campaign) + program_hash()).encode()).hexdigest()
    return parent / f"campaign-{campaign.name}-{identity[:8]}"


class ResultFile:
    """The rows of one campaign folder, and the file that they go to. ``opened`` makes it."""

    def __init__(self, folder: Path, descriptor: int, done: set[int]) -> None:
        self.folder = folder
        self.done = done
        self._descriptor = descriptor

    def append(self, rows: Iterable[Row]) -> None:
        """Write rows at once. Raises OSError, e.g. if there is no room."""
        chunk = list(rows)
        data = "".join(map(_line, chunk)).encode()
        while data:
            data = data[os.write(self._descriptor, data) :]
        os.fdatasync(self._descriptor)
        self.done.update(int(row["number"]) for row in chunk)


@contextmanager
def opened(folder: Path, campaign: Campaign) -> Iterator[ResultFile]:
    """The folder's result file, new or continued, for this process alone.

    Raises CampaignError if the folder holds another campaign, if another process writes it, or if it is broken.
    """
    try:
        import fcntl  # Windows does not have it
    except ImportError as error:
        raise CampaignError(
            "this system cannot run a campaign: it cannot lock the folder against a second one", "run it on Linux"
        ) from error
    if folder.is_dir() and not (folder / META).exists() and any(folder.iterdir()):
        raise CampaignError(f"{folder}: is not empty, and not a campaign's folder", "choose another folder with --out")
    try:
        if (folder / META).exists():
            _same_campaign(folder, campaign)
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = open_plain(folder / RESULTS, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
    except OSError as error:
        raise CampaignError(
            f"{folder}: cannot be written: {error.strerror}", "choose another folder with --out"
        ) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise CampaignError(f"{folder}: another process runs this campaign", "wait until it ends") from error
        if (folder / META).exists():
            pass
        elif os.fstat(descriptor).st_size:
            raise CampaignError(f"{folder}: holds results without {META}", "choose another folder with --out")
        else:
            _begin(folder, campaign)
        whole = _whole_lines(folder / RESULTS)
        os.ftruncate(descriptor, len(whole))
        if not whole:
            os.write(descriptor, HEADER.encode())
        done = {int(number) for number in _parse(folder / RESULTS, whole)["number"]} if whole else set()
        yield ResultFile(folder, descriptor, done)
    finally:
        os.close(descriptor)


def read(folder: Path, experiments: int | None = None) -> Table:
    """The rows of a campaign folder as columns, in the order of their numbers.

    experiments  how many, from number 0; default: all
    Raises CampaignError if there are none, or if the file is broken.
    """
    path = folder / RESULTS
    try:
        whole = _whole_lines(path)
    except OSError as error:
        raise CampaignError(f"{path}: cannot be read: {error.strerror}", "give a campaign folder") from error
    return _table(row for row in _rows(path, whole) if experiments is None or int(row["number"]) < experiments)


# -- text ------------------------------------------------------------------------------------------------------------


def _line(row: Row) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerow([_field(row[name]) for name in COLUMNS])
    return out.getvalue()


def _field(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    return " ".join(str(value).split())  # a row is one line, whatever the text


def _whole_lines(path: Path) -> bytes:
    """The content up to its last line end. The rest is torn."""
    content = read_plain(path, _MOST_BYTES)
    return content[: content.rfind(b"\n") + 1]


def _rows(path: Path, whole: bytes) -> Iterator[Row]:
    lines = csv.reader(whole.decode("utf-8", errors="replace").splitlines())
    if next(lines, None) != list(COLUMNS):
        raise CampaignError(f"{path}:1: these are not the columns of a campaign", "start a new one in another folder")
    for number, fields in enumerate(lines, 2):
        try:
            yield {
                name: kind(text) if text or kind is not float else math.nan
                for (name, kind), text in zip(COLUMNS.items(), fields, strict=True)
            }
        except ValueError as error:
            raise CampaignError(f"{path}:{number}: is broken ({error})", "delete this line, and resume") from error


def _parse(path: Path, whole: bytes) -> Table:
    table = _table(_rows(path, whole))
    twice = table["number"][1:][np.diff(table["number"]) == 0]
    if twice.size:
        raise CampaignError(f"{path}: has experiment {twice[0]} twice", "delete one of the lines, and resume")
    return table


def _table(rows: Iterable[Row]) -> Table:
    ordered = sorted(rows, key=lambda row: int(row["number"]))
    return {name: np.array([row[name] for row in ordered], dtype=kind) for name, kind in COLUMNS.items()}


# -- what the rows belong to -----------------------------------------------------------------------------------------


def _begin(folder: Path, campaign: Campaign) -> None:
    write_whole(folder / CONFIG, dump(campaign))
    meta = {
        "name": campaign.name,
        "rig": VERSION,
        "started_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "config_sha256": config_hash(campaign),
        "program_sha256": program_hash(),
        "campaign": _keys(campaign),
    }
    write_whole(folder / META, json_text(meta))


def _same_campaign(folder: Path, campaign: Campaign) -> None:
    path = folder / META
    try:
        meta = read_object(path)
        config, program, there = meta["config_sha256"], meta["program_sha256"], meta["campaign"]
        if not isinstance(there, dict):
            raise TypeError("no keys of a campaign")
    except (RecordingError, KeyError, TypeError) as error:
        raise CampaignError(
            f"{path}: does not say which campaign this is", "choose another folder with --out"
        ) from error
    if config != config_hash(campaign):
        changed = _difference(there, _keys(campaign))
        raise CampaignError(
            f"{folder}: belongs to another campaign: {changed}", f"use its own {CONFIG}, or start a new one elsewhere"
        )
    if program != program_hash():
        raise CampaignError(
            f"{folder}: its rows come from another version of the models or estimators",
            "start a new campaign in another folder: rows of two versions do not mix",
        )


def _keys(campaign: Campaign) -> JsonObject:
    return cast(JsonObject, campaign.model_dump(mode="json", exclude=set(FREE)))


def _difference(there: JsonObject, here: JsonObject) -> str:
    """The first key that differs, as a sentence."""
    old, new = dict(_flat(there)), dict(_flat(here))
    key = next((k for k in (*new, *old) if old.get(k) != new.get(k)), "its meta.json")
    return f"{key} is {json.dumps(old.get(key))} there and {json.dumps(new.get(key))} here"


def _flat(section: JsonObject, above: str = "") -> Iterator[tuple[str, JsonValue]]:
    for key, value in section.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value
