"""What holds for every test of servos."""

import pytest

from rig.backends.servo import opening


@pytest.fixture(autouse=True)
def _few_ids(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """To ask nobody takes a third of the time: an opening asks the ids up to 8, in tests marked ``every_id`` all."""
    if request.node.get_closest_marker("every_id") is None:
        monkeypatch.setattr(opening, "LAST_ID", 8)
