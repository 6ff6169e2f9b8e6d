"""The page: sections of paragraphs, tables, figures and remarks, and the summary that the report begins with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import rig
from paper import literals
from rig.output.report.style import Picture
from shared import page
from shared.table import Table

TEMPLATE = Path(__file__).with_name("report.html.j2")
BACKEND = "computed on the exact model of the motor, no device"

Agreement = Literal["agrees", "differs", "not comparable"]
RemarkKind = Literal["agrees", "differs", "chosen", "ours"]


class Claim(NamedTuple):
    """Something that the computed numbers say or do not say; every verdict on the page is made from one.

    The words that follow it are chosen by ``says``, so that no sentence can contradict its verdict.
    """

    holds: bool

    @property
    def agreement(self) -> Literal["agrees", "differs"]:
        """The verdict."""
        return "agrees" if self.holds else "differs"

    def says(self, yes: str, no: str) -> str:
        """The words for what was computed."""
        return yes if self.holds else no


@dataclass(frozen=True)
class Paragraph:
    """Plain text (HTML)."""

    text: str


@dataclass(frozen=True)
class Remark:
    """A sentence that stands out: where the paper and we agree or differ, what was chosen, what is our addition."""

    kind: RemarkKind
    text: str


@dataclass(frozen=True)
class Heading:
    """A heading within a section."""

    text: str


Block = Paragraph | Heading | Remark | Table | Picture


@dataclass(frozen=True)
class Comparison:
    """One line of the summary: a surviving number or statement of the paper beside ours."""

    place: str
    quantity: str
    paper: str
    ours: str
    agreement: Agreement
    why: str


@dataclass(frozen=True)
class Section:
    """One example: its blocks in order, and its lines of the summary."""

    key: str
    short: str
    title: str
    blocks: tuple[Block, ...]
    comparisons: tuple[Comparison, ...] = ()

    def tables(self) -> list[Table]:
        """Its tables, in order."""
        return [block for block in self.blocks if isinstance(block, Table)]

    def pictures(self) -> list[Picture]:
        """Its figures, in order."""
        return [block for block in self.blocks if isinstance(block, Picture)]


@dataclass(frozen=True)
class Report:
    """All of the report."""

    sections: tuple[Section, ...]

    @property
    def chosen(self) -> list[tuple[str, str]]:
        """What was chosen because it did not survive: (section, sentence)."""
        return [
            (section.short, block.text)
            for section in self.sections
            for block in section.blocks
            if isinstance(block, Remark) and block.kind == "chosen"
        ]

    @property
    def comparisons(self) -> list[Comparison]:
        """The summary, in the order of the sections."""
        return [line for section in self.sections for line in section.comparisons]


def render_page(report: Report) -> str:
    """The whole page as text, self-contained."""
    return page.render(TEMPLATE, report=report, version=rig.__version__, provenance=provenance(report))


def provenance(report: Report) -> str:
    """Where the numbers come from: those of the tables counted, and the text searched for typed ones."""
    cells = [cell for section in report.sections for table in section.tables() for row in table.rows for cell in row]
    numbers = [cell for cell in cells if cell.exact is not None]
    theirs = sum(cell.whose == "paper" for cell in numbers)
    numbers_typed, verdicts_typed = len(literals.typed_numbers()), len(literals.typed_verdicts())
    return (
        f"The tables hold {len(numbers)} numbers: {theirs} of the paper, the others as the run that wrote this page "
        "had "
        f"them. Of {literals.texts()} pieces of text {numbers_typed or 'none'} "
        f"{'has' if numbers_typed == 1 else 'have'} a number typed in instead of taken from the run, a setting or the "
        f"paper, and {verdicts_typed or 'no'} verdict{'' if verdicts_typed == 1 else 's'} "
        f"{'is' if verdicts_typed == 1 else 'are'} typed in instead of computed."
    )
