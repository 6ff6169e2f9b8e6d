"""The next test: strokes or a relay, whichever should tell enough sooner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from rig.design.outlook import Task
from rig.design.planned_test import Design
from rig.design.relay_search import best_gains
from rig.design.stroke_search import best_strokes

Kind = Literal["strokes", "relay"]
KINDS: tuple[Kind, ...] = ("strokes", "relay")


def best_test(task: Task, kinds: Sequence[Kind] = KINDS) -> Design | None:
    """The test that should tell enough soonest, of these kinds, within the room for every motor that it may be.

    None where there is no such test: too little is known yet, or the room is too small. Deterministic. Strokes take
    about 0.3 s of one core, a relay 0.1 s.
    """
    found = [best_strokes(task) if "strokes" in kinds else None, best_gains(task) if "relay" in kinds else None]
    return min((one for one in found if one is not None), key=lambda one: one.seconds, default=None)
