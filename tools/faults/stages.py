"""When something goes wrong: the stages of an experiment, and which experiment has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Course = Literal["relay", "search", "run"]  # an experiment: see ``backends.Backend.config``


@dataclass(frozen=True)
class Stage:
    """One stage.

    key, title  short, and as the table has it
    course      the experiment that has it
    phases      of it that are tried, unless more are asked for
    at_zero     the drive is 0 there: a bound counts from the first drive after the fault
    """

    key: str
    title: str
    course: Course
    phases: int = 1
    at_zero: bool = False

    def traits(self, device: Sequence[str]) -> tuple[str, ...]:
        """By which rows tell where they are: those of a device, the stage, and each of the device in this stage."""
        return (*device, self.key, *(f"{trait}, {self.key}" for trait in device))


START = Stage("start", "from the start", "relay", at_zero=True)
CYCLE = Stage("cycle", "relay cycle", "relay")
SEARCH = Stage("search", "gain search", "search")
REST = Stage("rest", "at rest", "run", at_zero=True)
PAUSE = Stage("pause", "pause", "run", at_zero=True)
ARMING = Stage("arming", "re-arming", "run", phases=2, at_zero=True)
TRACKING = Stage("tracking", "tracking", "run")
OTHER_STAGES = (SEARCH, REST, PAUSE, ARMING, TRACKING)  # than the one that ``rows`` are written for
STAGES = (START, CYCLE, *OTHER_STAGES)
BY_KEY = {stage.key: stage for stage in STAGES}
