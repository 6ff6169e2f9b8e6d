"""The run folder: its name, and its small files, each written in one piece.

``recorder`` writes samples.csv and events.jsonl.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from rig.core.plain_file import NotPlainError, open_folder
from rig.run_folder.recording.errors import CannotWriteError, RecordingError
from rig.run_folder.results.part import Part

CONFIG: Final = "config.yaml"
META: Final = "meta.json"
RESULT: Final = "result.json"
CURVES: Final = "curves.json"
# Windows does not have the last two flags
_NEW: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


def create_run(parent: Path, name: str, now_utc: datetime) -> Path:
    """Create and return a new folder ``parent/<utc>-<name>``, e.g. ``runs/20250131T093000Z-demo``.

    A folder that exists is never used again: the next one of this second ends in ``-2``, ``-3``, ...
    ``now_utc``: without a time zone it counts as UTC. Raises RecordingError if the folder cannot be created.
    """
    utc = now_utc.replace(tzinfo=UTC) if now_utc.tzinfo is None else now_utc.astimezone(UTC)
    stem = f"{utc:%Y%m%dT%H%M%SZ}-{name}"
    attempt = 1
    while True:
        folder = parent / (stem if attempt == 1 else f"{stem}-{attempt}")
        try:
            parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir()
        except FileExistsError as error:
            if not parent.is_dir():
                raise RecordingError(parent, *_cannot_write(error)) from error
            attempt += 1
        except OSError as error:
            raise RecordingError(folder, *_cannot_write(error)) from error
        else:
            return folder


def write_whole(path: Path, content: bytes | str, *, follows_links: bool = True) -> None:
    """Write the whole file, or leave the old one. A reader never sees half a file, whatever ends this process.

    The new file gets a random name beside the old one, and replaces it at the end. It must not exist before, so a link
    in the folder cannot lead the bytes elsewhere.

    follows_links  whether its folder may be a link: not that of a run that goes on, which somebody may have swapped
    Raises CannotWriteError if the disk does not take the file. Then nothing is left behind.
    """
    with contextlib.ExitStack() as stack:
        try:
            folder = None if follows_links else open_folder(path.parent)
            if folder is not None:
                stack.callback(os.close, folder)
            last = path if folder is None else Path(path.name)
            temporary = last.with_name(f".{path.name}.{secrets.token_hex(8)}")
            descriptor = os.open(temporary, _NEW, 0o666, dir_fd=folder)
        except OSError as error:
            raise CannotWriteError(path, *_cannot_write(error)) from error
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, last, src_dir_fd=folder, dst_dir_fd=folder)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.unlink(temporary, dir_fd=folder)
            raise CannotWriteError(path, *_cannot_write(error)) from error


def json_text(value: Part | Mapping[str, object]) -> str:
    """Strict JSON: numbers that are not finite become null. Raises TypeError for a value that JSON does not have."""
    plain = value.as_json() if isinstance(value, Part) else value
    return json.dumps(_strict(plain), indent=2, allow_nan=False) + "\n"


def _strict(value: object) -> object:
    if hasattr(value, "tolist"):  # a numpy scalar or array
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"JSON keys are strings, not {key!r}")
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    return value


def _cannot_write(error: OSError) -> tuple[str, str]:
    """Cause and cure."""
    if isinstance(error, NotPlainError):
        return f"cannot be written: its folder {error.cause}", error.cure
    return f"cannot be written: {error.strerror}", "check the disk's free space and the permissions of the folder"
