"""`make emps`: identify the record that RIG_EMPS names, and write docs/evidence/emps.md with its picture."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from emps.found import every_other, whole
from emps.page import page
from emps.picture import picture
from emps.record import PUBLISHED_AT, read
from rig.run_folder.recording.folder import write_whole

DOCS = Path(__file__).resolve().parents[2] / "docs" / "evidence"


def main(docs: Path = DOCS) -> int:
    """Print the page and write it into ``docs``; exit status 2 without the record."""
    path = os.environ.get("RIG_EMPS", "")
    if not path or not Path(path).is_file():
        print(f"RIG_EMPS must name DATA_EMPS.mat. It is published: {PUBLISHED_AT}", file=sys.stderr)
        return 2
    try:
        record = read(Path(path))
    except ValueError as error:
        print(f"RIG_EMPS: {error}", file=sys.stderr)
        return 2
    all_of_it, half = whole(record), every_other(record)
    text = page(all_of_it, half)
    print(text)
    (docs / "figures").mkdir(exist_ok=True)
    write_whole(docs / "emps.md", text.encode("utf-8"))
    write_whole(docs / "figures" / "emps.svg", picture(half))
    return 0


if __name__ == "__main__":
    sys.exit(main())
