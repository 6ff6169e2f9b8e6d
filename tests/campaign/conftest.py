"""What tests of campaigns share."""

from __future__ import annotations

import pytest

from rig.campaign import report


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page takes a second to draw; it is tested elsewhere."""
    monkeypatch.setattr(report, "write_report", lambda *_: None)
