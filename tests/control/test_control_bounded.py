"""The bounds of tests, and a law that something else ends."""

from __future__ import annotations

import math

import pytest

from rig.control.bounded import Bounded, Bounds
from rig.control.law import Constant
from rig.core.faults import Fault
from rig.core.signals import Sample


def sample(t_s: float, y_rad: float = 0.0) -> Sample:
    return Sample(t_s, y_rad, 512)


def test_time_counts_from_the_first_sample() -> None:
    bounds = Bounds(longest_s=2.0, most_cycles=60, least_rad=0.05)
    bounds.take(sample(7.0))
    bounds.take(sample(8.9))
    assert bounds.elapsed_s == pytest.approx(1.9) and bounds.reached == ""
    bounds.take(sample(9.0))
    assert bounds.reached == "relay.until.longest_s, 2 s, is over"


def test_swings_to_and_fro_count_whatever_drives_them() -> None:
    bounds = Bounds(longest_s=1e9, most_cycles=3, least_rad=0.05)
    for k in range(1000):
        bounds.take(sample(0.01 * k, 0.2 * math.sin(0.06 * k)))
        if bounds.reached:
            break
    assert bounds.cycles == 3 and 0.06 * k == pytest.approx(5.5 * math.pi, abs=0.9)
    assert "most_cycles, 3" in bounds.reached


class GivesUp:
    z_rad_s, yd_rad, finished = 0.1, 0.2, False

    def __init__(self, code: str) -> None:
        self.code = code

    def step(self, sample: Sample) -> float:
        raise Fault(self.code, "two strokes in a row")


def test_a_law_that_finds_no_cycle_ends_with_no_drive_and_its_reason() -> None:
    law = Bounded(GivesUp("NO_CYCLE"), None)
    assert law.step(sample(0.0)) == 0.0
    assert law.finished and law.failed == "two strokes in a row"


def test_any_other_fault_of_the_law_goes_through() -> None:
    with pytest.raises(Fault, match="SENSOR_STUCK"):
        Bounded(GivesUp("SENSOR_STUCK"), None).step(sample(0.0))


def test_a_law_ends_by_itself_or_from_outside() -> None:
    law = Bounded(Constant(0.5, 1.0), None)
    assert law.step(sample(0.0)) == 0.5 and not law.finished
    law.finished = True
    assert law.step(sample(0.5)) == 0.5 and law.finished  # the loop asks, and calls it no more
    other = Bounded(Constant(0.5, 1.0), None)
    other.step(sample(0.0))
    other.step(sample(1.0))
    assert other.finished
