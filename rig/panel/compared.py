"""Whether runs are of one motor: ``python -m rig.panel.compared FOLDER FOLDER...`` prints `rig compare` as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.compare.comparison import CompareError, compare
from rig.panel.aside import give
from rig.recording.errors import RecordingError


def compared(*folders: Path) -> dict[str, Any]:
    """The ``comparison``; null with ``why`` where fewer than two can be compared."""
    try:
        return {"comparison": compare(folders).result.as_json(), "why": ""}
    except CompareError as error:
        return {"comparison": None, "why": f"{error.cause}: {error.cure}"}
    except RecordingError as error:
        return {"error": {"what": f"{error.path}: {error.cause}", "cure": error.cure}}


if __name__ == "__main__":
    give(compared)
