"""The soak (`make soak`) for a few minutes of a device's time, and its own measures."""

from dataclasses import replace

import pytest
from evidence import evidence

from faults import soak
from faults.backends import PLAIN

pytestmark = pytest.mark.long

KEYS = [backend.key for backend in PLAIN]


@pytest.mark.parametrize("key", ["board", *evidence(*(key for key in KEYS if key != "board"))])
def test_runs_on_one_powered_device_with_faults_at_random(key: str) -> None:
    hours = 0.01 if key == "board" else 0.015  # there the first run ends early
    day = soak.spend(key, hours, 3)
    assert day.hours >= hours
    assert day.runs >= 2
    assert sum(day.rows.values()) == day.runs == len(day.memory_MB)
    assert day.trouble == []


def test_what_is_unexplained_is_trouble(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault that the row does not know: here a run in which nothing should happen is told to stop."""
    unexplained = replace(soak.NOTHING, act=lambda injector: injector.device.rewire(drive="dead"))
    monkeypatch.setattr(soak, "FAULTY", 0.0)
    monkeypatch.setattr(soak, "NOTHING", unexplained)
    day = soak.spend("board", 0.001, 1)
    assert any("SENSOR_STUCK" in words for words in day.trouble)


def test_growth_is_from_the_first_third_to_the_last() -> None:
    day = soak.Day("chip", memory_MB=[100.0, 103.0, 101.0, 110.0, 104.0, 104.0, 105.0, 107.0, 106.0])
    assert day.growth_MB == pytest.approx(5.0)


def test_rows_that_need_their_own_process_are_left_out() -> None:
    for backend in PLAIN:
        rows = soak.rows_for(backend)
        assert len(rows) >= 20
        assert not any(row.alone or row.early for row in rows)
