"""A load that hangs on a gear: what a record of it needs together, and a search for one law after the other misses.

The friction of such a gear grows with what it bears, and what it bears is the load. Where the load takes a good part of
the drive, the plain motor beside a force alone is so far from the record that laws which stand in for the gear's
friction gain more at first. What they lead to predicts nothing, and without them nothing is left. So where the choice
predicts badly, it is made once more from both together, and the better one by what it predicts is taken
(docs/theory.md 12.7).
"""

from __future__ import annotations

import math
from dataclasses import replace

from rig.identification.departures.blocks import Blocks, held_out_error
from rig.identification.departures.choice import CYCLES, Choice, Chooser
from rig.identification.departures.pieces import Cut
from rig.identification.in_pieces import LOADED, LONGEST_TAU_S, POOR, best_of_starts

TOGETHER = ("force_over_position", "load_friction")
OF_GEARS = (*TOGETHER, "static", "stribeck")
FIRST = {"load_friction": 0.2, "viscous_share": 0.1, "load_outside": 0.5}  # of a gear of several stages


def behind_a_gear(choice: Choice, chooser: Chooser, whole: Cut, cycle_s: float) -> Choice:
    """The choice, or the one that begins with a hanging load and the friction of its gear, if it predicts far better.

    choice   of these tests by ``chooser``, ``whole`` and ``cycle_s``
    """
    fit = choice.fit
    blocks = Blocks.of(whole, fit.motor.tau_s)
    laws = tuple(law for law in chooser.candidates if law.name in TOGETHER)
    if len(laws) < len(TOGETHER) or blocks.error(fit.motor, fit.problem) <= POOR:
        return choice
    problem = chooser.problem(whole.every(CYCLES[1] * cycle_s), laws, math.inf)
    tau_s = problem.limits["tau_s"][0], LONGEST_TAU_S
    longest_s = max(window.duration_s for window in whole.windows)
    begun = best_of_starts(
        replace(problem, limits={**problem.limits, "tau_s": tau_s}), (), longest_s, fit.motor.delay_s, FIRST
    )
    of_gears = replace(chooser, candidates=[law for law in chooser.candidates if law.name in OF_GEARS])
    other = of_gears.choose(whole, begun.motor, cycle_s)

    def error(one: Choice) -> float:
        return held_out_error(blocks, chooser.problem(blocks.cut, one.laws, math.inf), one.fit.motor)

    return other if other.laws and error(other) < LOADED * error(choice) else choice
