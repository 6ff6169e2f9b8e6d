"""One defect: where it is anchored, what is written there instead, which tests are to find it."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

from mutants.functions import spans


class AnchorError(Exception):
    """The text that a mutant replaces is not there, not once, or its replacement changes nothing."""


@dataclass(frozen=True)
class Mutant:
    """A defect.

    name        what is wrong then, in words
    path        file, from the root of the tree
    function    in which it is anchored, qualified; empty: the whole file
    old, new    text in that function, and what stands there instead
    killers     tests that it meets first: pytest node ids, or ``firmware/tests/test_x.c::test_y``
    occurrence  which one of several ``old`` in the function; None: there must be exactly one
    others      tests that it meets only if it survives these; none named: all that there are
    """

    name: str
    path: str
    function: str
    old: str
    new: str
    killers: tuple[str, ...]
    occurrence: int | None = None
    others: tuple[str, ...] = ()

    @property
    def is_c(self) -> bool:
        """Whether it is in the firmware."""
        return self.path.endswith((".c", ".h"))

    def applied(self, text: str) -> str:
        """The file's text with the defect. Raises AnchorError."""
        at = [
            (place, span)
            for span in spans(text, self.function, is_c=self.is_c)
            for place in _places(text[slice(*span)], self.old, span[0])
        ]
        where = f"{self.path}, {self.function or 'anywhere'}"
        if self.occurrence is None and len(at) != 1:
            raise AnchorError(f"{where}: {len(at)} times, not once: {self.old!r}")
        number = self.occurrence or 0
        if number >= len(at):
            raise AnchorError(f"{where}: {len(at)} times, the mutant is of number {number + 1}: {self.old!r}")
        place, (start, end) = at[number]
        changed = text[:place] + self.new + text[place + len(self.old) :]
        if not self.is_c:
            after = changed[start : end + len(self.new) - len(self.old)]
            if _tree(after, where) == _tree(text[start:end], where):
                raise AnchorError(f"{where}: the change changes nothing: {self.old!r}")
        return changed

    def applied_in(self, root: Path) -> str:
        """As ``applied``, to the file in a tree; also where it is gone."""
        try:
            text = (root / self.path).read_text(encoding="utf-8")
        except FileNotFoundError as error:
            raise AnchorError(f"{self.path}: no such file") from error
        return self.applied(text)


def _places(text: str, what: str, offset: int) -> list[int]:
    found = []
    at = text.find(what)
    while at >= 0:
        found.append(offset + at)
        at = text.find(what, at + 1)
    return found


def _tree(text: str, where: str) -> str:
    try:
        return ast.dump(ast.parse(dedent(text)))
    except SyntaxError as error:
        raise AnchorError(f"{where}: that is no Python: {error}") from error
