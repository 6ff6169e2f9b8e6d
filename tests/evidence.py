"""Which cases of a test compute long and are evidence: `make evidence` runs them, `make test` those that stay."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from itertools import product
from typing import Any, TypeVar

import pytest
from hypothesis import settings

T = TypeVar("T")


def _case(case: object, *marks: pytest.MarkDecorator) -> Any:
    return pytest.param(*case if isinstance(case, tuple) else (case,), marks=marks)


def evidence(*cases: object) -> list[Any]:
    """Cases for a list of parameters, beside the one of their class that stays; a tuple is one case."""
    return [_case(case, pytest.mark.evidence) for case in cases]


def first_of_each(cases: Iterable[T], of_class: Callable[[T], Hashable]) -> list[Any]:
    """All these cases; the first of each class stays, the others are evidence."""
    found: dict[Hashable, list[T]] = {}
    for case in cases:
        found.setdefault(of_class(case), []).append(case)
    return [told for first, *others in found.values() for told in (_case(first), *evidence(*others))]


def one_of_each(*stay: tuple[Any, ...]) -> list[Any]:
    """All combinations of what stands in these cases, place by place; the cases themselves stay."""
    rest = product(*(dict.fromkeys(values) for values in zip(*stay, strict=True)))
    return [*stay, *evidence(*(case for case in rest if case not in stay))]


def examples(number: int, at_least: int = 4) -> int:
    """Of a property that computes long: `make search` tries so many, `make test` a sixth of them."""
    return number if settings.get_current_profile_name() == "search" else max(number // 6, at_least)
