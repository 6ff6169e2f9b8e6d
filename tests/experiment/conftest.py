"""What tests of whole experiments share."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _no_figures(undrawn: None) -> None:
    """The figures of a report take longer than the run in virtual time, and are tested elsewhere."""
