"""The one table of every page that a tool writes, and how numbers stand in it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from rig.output.report.words import percent

Whose = Literal["", "paper", "bad"]


class Cell(NamedTuple):
    """One entry of a table: its text (Markdown or HTML), the exact number behind it, and whose number it is."""

    text: str
    exact: float | None = None
    whose: Whose = ""


@dataclass(frozen=True)
class Table:
    """A table with a caption; the first cell of each row names the row. Raises ValueError where a cell is missing."""

    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.head) for row in self.rows):
            raise ValueError(f"a row of the table {self.caption[:40]!r} has not {len(self.head)} cells")


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]] = ()) -> str:
    """A table in Markdown, without the last line's end."""
    rule = f"|{'---|' * len(head)}"
    return "\n".join([_line(head), rule, *(_line(row) for row in rows)])


def _line(cells: Sequence[object]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def number(value: float, digits: int = 4, *, whose: Whose = "") -> Cell:
    """A number to so many significant digits, exact behind it."""
    if not math.isfinite(value):
        return Cell("–")
    return Cell(significant(value, digits), value, whose)


def significant(value: float, digits: int = 4) -> str:
    """So many significant digits, trailing zeros kept; in powers of ten where that is shorter to read."""
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if -5 <= size < 6:
        text = f"{value:.{max(0, digits - 1 - size)}f}"
    else:
        mantissa = f"{value / 10.0**size:.{min(digits, 2) - 1}f}"
        text = f"{mantissa}·10<sup>{size}</sup>"
    return text.replace("-", "−")


def fixed(value: float, decimals: int, *, whose: Whose = "") -> Cell:
    """A number to so many decimals, exact behind it."""
    return Cell(f"{value:.{decimals}f}".replace("-", "−"), value, whose) if math.isfinite(value) else Cell("–")


def share(value: float) -> Cell:
    """A ratio in per cent with its sign; what is below a thousandth of a per cent is 0."""
    return Cell("0", 0.0) if abs(value) < 1e-5 else Cell(percent(value), value)


def words(*texts: str) -> tuple[Cell, ...]:
    """Cells of text."""
    return tuple(Cell(text) for text in texts)
