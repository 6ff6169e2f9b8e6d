"""The table of a board's registers in docs/evidence, and whether the source and the tests bear it out."""

from __future__ import annotations

import re
from collections.abc import Set
from pathlib import Path

TESTS = Path(__file__).parents[1]


def table(page: str, heading: str) -> list[list[str]]:
    """The rows of the first table after a heading of a page of docs/evidence."""
    text = (TESTS.parent / "docs" / "evidence" / page).read_text(encoding="utf-8")
    rows = text.split(heading)[1].split("|---", 1)[1].split("\n\n")[0].splitlines()[1:]
    return [[cell.strip() for cell in row.strip("|").split(" | ")] for row in rows]


def rules(page: str) -> list[list[str]]:
    """Rule, section, what keeps it, test; a line of C may have the mark between two cells."""
    rows = table(page, "## Registers against the data sheet")
    return [[row[0], row[1], " | ".join(row[2:-1]), row[-1]] for row in rows]


def kept_by(cell: str) -> list[tuple[str, str]]:
    """Files and lines that a cell names."""
    places, where = [], ""
    for quoted in re.findall(r"`([^`]+)`", cell):
        if quoted.endswith((".c", ".h", ".S")):
            where = quoted
        else:
            places.append((where, quoted))
    return places


def check_rules(page: str, board: Path, section: str, defects: Set[str]) -> None:
    """Each row has a section of that pattern, lines of the board's source and tests or defects; all defects have a row.

    Raises AssertionError for the first that has not.
    """
    paths = [*(TESTS / "hil").glob("test_*.py"), TESTS / "doctor" / "test_doctor_loopback.py"]
    tests = "".join(path.read_text(encoding="utf-8") for path in paths)
    named: set[str] = set()
    for rule, told, kept, test in rules(page):
        assert re.fullmatch(section, told), rule
        for where, line in kept_by(kept):
            assert line in (board / where).resolve().read_text(), f"{rule}: {line!r} is not in {where}"
        names = re.findall(r"`([^`]+)`", test)
        assert names or test.startswith("by reading"), rule
        for name in names:
            assert name in defects or f"def {name}(" in tests, f"{rule}: no test {name}"
        named |= set(names)
    assert defects <= named
