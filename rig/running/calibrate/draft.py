"""A config with what a calibration has found so far."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rig.config.edit import Value, changed
from rig.config.load import load
from rig.config.problems import ConfigError, Path, key_of
from rig.config.schema import Experiment
from rig.run_folder.results import JsonObject
from rig.running.calibrate.refusal import Refusal


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
    changes: Mapping[Path, Value] = field(default_factory=dict)
    board: str = ""
    follows: bool = False

    @property
    def experiment(self) -> Experiment:
        """The config with the changes; an emulated bench stays the one that it was before them, at its pace."""
        e = load(changed(self.data, self.changes))
        return e.at_pace(self.original.loop.pace).model_copy(update={"emulated": self.original.emulated})

    def with_changes(self, changes: Mapping[Path, Value]) -> Draft:
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


def _at(e: Experiment, path: Path) -> Any:
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
