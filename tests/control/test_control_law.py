"""A law of a user's own, in its time."""

from __future__ import annotations

from rig.control.law import Timed
from rig.core.signals import Sample


class Pushes:
    """Drives until it has finished, at its third step; and asks for a drive even then."""

    def __init__(self) -> None:
        self.steps = 0
        self.finished = False

    def step(self, sample: Sample) -> float:
        self.steps += 1
        self.finished = self.steps == 3
        return 2.0


def drives_V(duration_s: float) -> list[float]:
    """Of each tick until the law has ended, 10 ms apart."""
    law = Timed(Pushes(), duration_s, "pushes")
    drives: list[float] = []
    while not law.finished and len(drives) < 10:
        drives.append(law.step(Sample(0.01 * len(drives), 0.0, 512)))
    return drives


def test_a_law_of_ones_own_drives_no_longer_than_its_time_nor_after_it_says_finished() -> None:
    assert drives_V(1.0) == [2.0, 2.0, 0.0]
    assert drives_V(0.01) == [2.0, 0.0]
