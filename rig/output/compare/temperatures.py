"""The temperature of each run, from a table that somebody wrote by hand."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path

from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.text_file import content_of, lines_of

RUN, TEMPERATURE = "run", "temperature_C"
_MOST_BYTES = 2**20
ABSOLUTE_ZERO_C = -273.15
HEAD = f"{RUN},{TEMPERATURE}"


def read_temperatures(path: Path) -> dict[str, float]:
    """Temperatures in degrees Celsius by the name of the run's folder.

    The CSV file has a line of names, ``run`` and ``temperature_C``, and may have other columns. Raises RecordingError.
    """
    try:
        lines = csv.DictReader(lines_of(path, content_of(path, _MOST_BYTES)), skipinitialspace=True)
        if not {RUN, TEMPERATURE} <= set(lines.fieldnames or ()):
            raise RecordingError(path, f"has no columns {RUN} and {TEMPERATURE}", f"begin it with {HEAD}", 1)
        return _by_name(path, dict(enumerate(lines, 2)))
    except csv.Error as error:
        raise RecordingError(path, f"cannot be read: {error}", f"give a CSV file that begins with {HEAD}") from error


def _by_name(path: Path, lines: Mapping[int, Mapping[str, str | None]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for number, line in lines.items():
        name = Path((line[RUN] or "").strip()).name
        text = (line[TEMPERATURE] or "").strip()
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (name and math.isfinite(value) and value > ABSOLUTE_ZERO_C):
            raise RecordingError(
                path, f"{text!r} is no temperature of a run", "write RUN,DEGREES, such as r1,23.5", number
            )
        if name in found:
            raise RecordingError(path, f"names {name} twice", "leave one line", number)
        found[name] = value
    return found
