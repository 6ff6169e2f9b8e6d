"""The rows of a campaign on disk: one line of JSON each, so that a campaign goes on where it was interrupted."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
from collections.abc import Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from rig.run_folder.recording.folder import write_whole

ROOT = Path(__file__).resolve().parents[2]


class RowsFile:
    """``runs/NAME-CODE/rows.jsonl``: rows belong to the code that made them; rows of another code start anew.

    name     of the campaign, with its seed
    made_by  files and folders, from the root of the project, whose Python code makes the rows
    kept     a packed copy that a commit holds, ``docs/evidence/campaigns/NAME.jsonl.gz``: a fresh clone goes on from it
    """

    def __init__(self, name: str, made_by: Sequence[str]) -> None:
        self.code = sha256(b"".join(_content(ROOT / part) for part in made_by)).hexdigest()[:8]
        self.path = ROOT / "runs" / f"{name}-{self.code}" / "rows.jsonl"
        self.kept = ROOT / "docs" / "evidence" / "campaigns" / f"{name}.jsonl.gz"
        self.of_other_code: list[str] = []  # kept lines that other code made
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.exists():
            text = self.path.read_text(encoding="utf-8")
            if text and not text.endswith("\n"):  # torn: the next row is a line of its own
                self.path.write_text(text + "\n", encoding="utf-8")
        elif self.kept.exists():
            head, *lines = gzip.decompress(self.kept.read_bytes()).decode("utf-8").splitlines(keepends=True)
            if json.loads(head)["code"] == self.code:
                self.path.write_text("".join(lines), encoding="utf-8")
            else:
                self.of_other_code = lines
                print(f"{self.kept} holds rows of other code: they are not used", file=sys.stderr)

    def read(self) -> list[dict[str, Any]]:
        """Every whole row; a list of JSON is a tuple here. What an interruption tore is left out."""
        return _rows(self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else ())

    def read_other(self) -> list[dict[str, Any]]:
        """The kept rows that other code made."""
        return _rows(self.of_other_code)

    def take_over(self) -> None:
        """The kept rows of other code count as this code's from now on. Whoever calls this has compared some."""
        self.path.write_text("".join(self.of_other_code), encoding="utf-8")
        self.of_other_code = []

    def add(self, row: dict[str, Any]) -> None:
        """Write one row; it is with the operating system when this returns."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def keep(self) -> None:
        """Write the packed copy, whole or not at all. The same rows give the same bytes."""
        lines = "".join(json.dumps(row) + "\n" for row in [{"code": self.code}, *self.read()])
        self.kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(self.kept, gzip.compress(lines.encode("utf-8"), mtime=0))


def commit(made_by: Sequence[str]) -> str:
    """The commit that is checked out, for a page; with a + where the code that makes the rows was changed since."""
    return _git("rev-parse", "--short", "HEAD") + ("+" if _git("status", "--porcelain", "--", *made_by) else "")


def _rows(lines: Iterable[str]) -> list[dict[str, Any]]:
    rows = []
    for line in lines:
        try:
            rows.append({key: _tuples(value) for key, value in json.loads(line).items()})
        except ValueError:
            continue  # torn
    return rows


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _content(path: Path) -> bytes:
    files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
    return b"".join(file.read_bytes() for file in files)


def _git(*words: str) -> str:
    return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True).stdout.strip()
