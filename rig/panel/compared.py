"""Whether runs are of one motor: ``python -m rig.panel.compared FOLDER FOLDER...`` prints `rig compare` as JSON."""

from __future__ import annotations

from pathlib import Path

from rig.output.compare.comparison import CompareError, compare
from rig.panel.aside import give
from rig.panel.messages import Compared


def compared(*folders: Path) -> Compared:
    """What `rig compare` says of these runs. Raises RecordingError."""
    try:
        return {"comparison": compare(folders).result.as_json(), "why": ""}
    except CompareError as error:
        return {"comparison": None, "why": f"{error.cause}: {error.cure}"}


if __name__ == "__main__":
    give(compared)
