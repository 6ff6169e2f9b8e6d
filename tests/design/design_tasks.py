"""Tasks of a design, for its tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rig.design.belief import Belief
from rig.design.outlook import Task
from rig.design.planned_test import Reading, Room

NOTHING = np.zeros((5, 5))  # no information
ROOM = Room(-0.55, 0.55, 3.0, 4.9)
READING = Reading(0.01, 0.003, 4.2 / 1024, 0.004)
DEMO = (0.17, 6.5, 0.48, -0.01)  # tau, K, fc, asym


def task(
    motor: tuple[float, float, float, float] = DEMO,
    doubt_percent: float = 20.0,
    room: Room | None = None,
    reading: Reading = READING,
    wanted_percent: float = 1.0,
) -> Task:
    """A motor that is believed to be so, of which only the break-away level is measured.

    room  default: ``ROOM`` with that level
    """
    if room is None:
        room = replace(ROOM, static_V=1.05 * (motor[2] + abs(motor[3])))
    return Task(Belief.within(motor, doubt_percent), NOTHING, room, reading, wanted_percent)
