"""The advice of a run whose only test is a stroke test, always the same: no design depends on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rig.control.strokes import Stroke
from rig.design.advisor import Advice, AdvisorSettings
from rig.design.planned_test import Design, Reach, Strokes
from rig.running.session import Session

STROKES = (Stroke(1.0, 0.4), Stroke(-1.0, -0.4))  # V, rad: about the limit cycle of the matrix
LONGEST_STROKE_S = 1.0
TEST_S = 8.0
_TEST = Design(Strokes(STROKES, LONGEST_STROKE_S), TEST_S, 1.0, Reach(-0.6, 0.6, 4.0))


class FixedAdvice:
    """Who advises, as ``Advisers`` of an experiment: the stroke test at once, and the end after a while."""

    trouble = last_words = ""

    def __init__(self) -> None:
        self._began_s: float | None = None
        self._drives = False

    def begin(self, settings: AdvisorSettings) -> None:
        """Nothing that the breakaway check has shown makes a difference."""

    def advice(self, row: int, t_s: float) -> Advice | None:
        """The test where none runs."""
        if not self._drives:
            self._drives = True
            self._began_s = t_s if self._began_s is None else self._began_s
            return Advice(None, _TEST)
        return Advice(None, stop="enough") if t_s > (self._began_s or 0.0) + TEST_S else None

    def braked(self) -> None:
        """The test was broken off."""
        self._drives = False


@contextmanager
def fixed_advice(session: Session) -> Iterator[FixedAdvice]:
    """In place of ``rig.running.experiment.advisers.advisers_of``."""
    yield FixedAdvice()
