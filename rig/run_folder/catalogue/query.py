"""Which runs of a list, and in which order."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from rig.core.errors import CauseError
from rig.run_folder.results.listed import ListedRun

FIELDS: Final = tuple(ListedRun.model_fields)
_COMPARED: Final[dict[str, Callable[[float, float], bool]]] = {
    "<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt,
}  # fmt: skip
_WHERE: Final = re.compile(r"\s*(\w+)\s*(!=|<=|>=|=|<|>|~)\s*(.*?)\s*")


class QueryError(CauseError):
    """A filter or an order that cannot be."""


@dataclass(frozen=True)
class Condition:
    """``field operator value``, such as ``fc_V > 0.5``, ``verdict = ok`` or ``name ~ demo``.

    = and != compare numbers as numbers, and texts without regard to case; = with nothing finds what is not known; ~
    looks for a part of the text. A number that is not known is neither less nor more.
    """

    field: str
    operator: str
    value: str

    @classmethod
    def of(cls, text: str) -> Condition:
        """From its text. Raises QueryError."""
        match = _WHERE.fullmatch(text)
        if match is None:
            raise QueryError(
                f"{text!r} is no condition", "write FIELD, one of = != < <= > >= ~, and a value, such as fc_V>0.5"
            )
        found = cls(*match.groups())
        require_field(found.field)
        if found.operator in _COMPARED and _number(found.value) is None:
            raise QueryError(f"{text!r}: {found.value!r} is no number", f"{found.operator} compares numbers")
        return found

    def holds(self, run: ListedRun) -> bool:
        """Whether a run meets it."""
        value = getattr(run, self.field)
        if self.operator in _COMPARED:
            wanted = _number(self.value)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            return is_number and wanted is not None and _COMPARED[self.operator](value, wanted)
        text = "" if value is None else str(value).lower()
        if self.operator == "~":
            return self.value.lower() in text
        numbers = _number(text), _number(self.value)
        same = text == self.value.lower() or (None not in numbers and numbers[0] == numbers[1])
        return same == (self.operator == "=")


def selected(runs: Sequence[ListedRun], where: Sequence[str] = (), sort: Sequence[str] = ()) -> list[ListedRun]:
    """The runs that meet all conditions, in order.

    sort   fields, the first counts most; ``-`` before one turns its order round. What is not known comes last
    Raises QueryError.
    """
    conditions = [Condition.of(text) for text in where]
    for key in sort:
        require_field(key.removeprefix("-"))
    found = [run for run in runs if all(condition.holds(run) for condition in conditions)]
    for key in reversed(sort):
        field = key.removeprefix("-")
        there = [run for run in found if getattr(run, field) is not None]
        there.sort(key=operator.attrgetter(field), reverse=key.startswith("-"))
        found = there + [run for run in found if getattr(run, field) is None]
    return found


def require_field(name: str) -> None:
    """Raise QueryError if runs have no such field."""
    if name not in FIELDS:
        raise QueryError(f"runs have no field {name!r}", f"they have {', '.join(FIELDS)}")


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
