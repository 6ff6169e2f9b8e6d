"""A config with what a calibration has found so far; it gets into the file in one step, with a dated backup."""

from __future__ import annotations

import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import Any

from rig.config.edit import EditError, Value, changed, with_values
from rig.config.load import load
from rig.config.problems import ConfigError, key_of
from rig.config.problems import Path as Keys
from rig.config.schema import Experiment
from rig.run_folder.recording.folder import write_whole
from rig.run_folder.results import JsonObject
from rig.running.calibrate.dialogue import Refusal


@dataclass(frozen=True)
class Draft:
    """The config as it was read, and the values to change.

    original  the experiment of the file
    data      the keys of the file
    changes   new values by path
    board     name of the device's board, once it is known
    follows   the strokes have shown that the sensor follows the drive
    """

    original: Experiment
    data: JsonObject
    changes: Mapping[Keys, Value] = field(default_factory=dict)
    board: str = ""
    follows: bool = False

    @property
    def experiment(self) -> Experiment:
        """The config with the changes; an emulated bench stays the one that it was before them, at its pace."""
        e = load(changed(self.data, self.changes))
        return e.at_pace(self.original.loop.pace).model_copy(update={"emulated": self.original.emulated})

    def with_changes(self, changes: Mapping[Keys, Value]) -> Draft:
        """With these values, too. Raises Refusal if they make no config."""
        new = replace(self, changes={**self.changes, **changes})
        try:
            e = new.experiment
        except ConfigError as error:
            raise Refusal(str(error.problems[0]), "measure again") from error
        return replace(
            new, changes={path: v for path, v in new.changes.items() if _at(e, path) != _at(self.original, path)}
        )

    def lines(self) -> Iterator[str]:
        """Each change, for people: key, value before, value now."""
        e = self.experiment
        for path in self.changes:
            yield f"{key_of(path)}: {_words(_at(self.original, path))} -> {_words(_at(e, path))}"


def _at(e: Experiment, path: Keys) -> Any:
    """The value of a key, defaults filled in."""
    found: Any = e
    for key in path:
        found = getattr(found, str(key))
    return found


def _words(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_words, value)) + "]"
    if hasattr(value, "model_dump"):
        return "{" + ", ".join(f"{key}: {_words(inner)}" for key, inner in value.model_dump().items()) + "}"
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, int | float) else str(value)


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
    write_whole(backup, text)
    write_whole(target, _BOM + new if text.startswith(_BOM) else new)
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
