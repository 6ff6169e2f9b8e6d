"""Which cases of a test compute long and are evidence: `make evidence` runs them, `make test` those that stay."""

from __future__ import annotations

from typing import Any

import pytest


def evidence(*cases: object) -> list[Any]:
    """Cases for a list of parameters, beside the one of their class that stays; a tuple is one case."""
    return [pytest.param(*case if isinstance(case, tuple) else (case,), marks=pytest.mark.evidence) for case in cases]
