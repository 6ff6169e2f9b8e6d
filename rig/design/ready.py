"""Loads the compiled loops of a design, and compiles those that are not on disk."""

from __future__ import annotations

import numpy as np

from rig.design.belief import Belief
from rig.design.outlook import Task, information_of, law_of, outcome, told
from rig.design.planned_test import RelayGains
from rig.design.room import Reading, Room


def make_ready() -> None:
    """Call each loop once."""
    belief = Belief.within((0.2, 5.0, 0.4, 0.0), 10.0)
    task = Task(belief, np.zeros((5, 5)), Room(-1.0, 1.0, 3.0, 5.0), Reading(0.01, 0.003), 10.0)
    law = law_of(RelayGains(0.4, 0.8))
    outcome(task, law, belief.fast((0.5,)), 0)
    task.percent(told(task, law, 1.0).information)
    information_of(task, law, 1.0)
