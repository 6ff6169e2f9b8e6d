"""A copy of a run folder whose record can be changed by hand, row by row."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rig.run_folder.recording.sample_columns import COLUMNS
from rig.running.replay import Replay, replay

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


class RunCopy:
    """Rows as {column: text}, events, meta; ``replay`` writes them and replays the copy."""

    def __init__(self, source: Path, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True)
        shutil.copyfile(source / "config.yaml", folder / "config.yaml")
        lines = (source / "samples.csv").read_text(encoding="ascii").splitlines()
        assert lines[0] == ",".join(COLUMNS)
        self.rows = [dict(zip(COLUMNS, line.split(","), strict=True)) for line in lines[1:]]
        events = (source / "events.jsonl").read_text(encoding="ascii").splitlines()
        self.events: list[dict[str, Any]] = [json.loads(line) for line in events]
        self.meta: dict[str, Any] = json.loads((source / "meta.json").read_text(encoding="utf-8"))

    def number_of(self, stage: str, nth: int = 0) -> int:
        """Number of the nth row of a stage; -1: its last."""
        return [k for k, row in enumerate(self.rows) if row["stage"] == stage][nth]

    def tick(self, row: int) -> int:
        return int(self.rows[row]["tick"])

    def write(self) -> Path:
        text = [",".join(COLUMNS), *(",".join(row.values()) for row in self.rows)]
        (self.folder / "samples.csv").write_text("\n".join(text) + "\n", encoding="ascii")
        (self.folder / "events.jsonl").write_text(
            "".join(json.dumps(event) + "\n" for event in self.events), encoding="ascii"
        )
        (self.folder / "meta.json").write_text(json.dumps(self.meta), encoding="utf-8")
        return self.folder

    def replay(self) -> Replay:
        return replay(self.write())

    def changed(self, change: Callable[[], None], row: int) -> Replay:
        """Replay with a change that concerns one row; afterwards that row is as it was."""
        before = dict(self.rows[row])
        change()
        try:
            return self.replay()
        finally:
            self.rows[row] = before

    def without(self, row: int) -> Replay:
        """Replay without one row; afterwards it is there again."""
        gone = self.rows.pop(row)
        try:
            return self.replay()
        finally:
            self.rows.insert(row, gone)
