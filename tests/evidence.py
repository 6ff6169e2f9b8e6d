"""Which cases of a test compute long and are evidence: `make evidence` runs them, `make test` those that stay."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import settings


def evidence(*cases: object) -> list[Any]:
    """Cases for a list of parameters, beside the one of their class that stays; a tuple is one case."""
    return [pytest.param(*case if isinstance(case, tuple) else (case,), marks=pytest.mark.evidence) for case in cases]


def examples(number: int) -> int:
    """Of a property that computes long: `make search` tries so many, `make test` a sixth of them."""
    return number if settings.get_current_profile_name() == "search" else max(number // 6, 4)
