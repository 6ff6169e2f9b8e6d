"""Puts what a calibration has found into the config file: in one step, with a dated backup beside it."""

from __future__ import annotations

import stat
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote

from rig.config.edit import EditError, Value, with_values
from rig.config.problems import Path as Keys
from rig.run_folder.recording.folder import write_whole

_BOM = "\ufeff"


def read_text(file: Path) -> str:
    """The text of a config, with its own line breaks. Raises OSError, UnicodeDecodeError."""
    return file.read_bytes().decode()


def require_writable(file: Path) -> None:
    """Raise EditError if the file is marked read-only, for to replace it needs no right to write it. Raises OSError."""
    if not file.stat().st_mode & stat.S_IWUSR:
        raise EditError(
            f"{file} is marked read-only", f"nothing is written: calibrate a copy, or type chmod u+w {quote(str(file))}"
        )


def save(file: Path, text: str, values: Mapping[Keys, Value]) -> Path:
    """Put the values into the file. Returns the backup: ``bench.yaml.20261123T123000Z``, the file as it was.

    text  the file's text when the values were chosen (``read_text``)
    Raises EditError, also where the file has changed meanwhile or is marked read-only; ConfigError; OSError;
    RecordingError for a full disk.
    """
    require_writable(file)
    target = file.resolve()  # a link stays a link
    if read_text(target) != text:
        raise EditError(
            f"{file} has changed since it was read", "nothing is written: look at the file, and start again"
        )
    new = with_values(text.removeprefix(_BOM), values)
    mode = target.stat().st_mode
    backup = _free_name(target)
    write_whole(backup, text.encode())
    write_whole(target, (_BOM + new if text.startswith(_BOM) else new).encode())
    for copy in (backup, target):
        copy.chmod(mode)
    return backup


def _free_name(file: Path) -> Path:
    name = f"{file.name}.{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    backup, number = file.with_name(name), 1
    while backup.exists():
        number += 1
        backup = file.with_name(f"{name}-{number}")
    return backup
