"""Whether the tests were read behind a soft coupling, and how fast it swings.

The motor's model has none: the reading is filtered behind the model (``Cut.coupling_rad_s``), which is exact where the
friction is the motor's and viscous friction small. It is looked for where a fit with its laws leaves more than noise,
and it counts as any law does: by the share of the error in blocks that it takes away.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.identification.departures.blocks import Blocks, share_cut
from rig.identification.departures.choice import LAW_BLOCK, Choice, Chooser, Columns
from rig.identification.departures.fit import solve
from rig.identification.departures.fit import start as begin
from rig.identification.departures.laws import FREQUENCIES_RAD_S
from rig.identification.departures.outside import by_coupling
from rig.identification.departures.pieces import Cut
from rig.identification.lowest import lowest

Array = NDArray[np.float64]

LEAVES = 3.0  # residual over the sensor's noise from which on a coupling is looked for
ITERATIONS, FINER = 6, 8
PROMISING = 0.5  # of what a coupling must take from the squares: what it promises to first order, at least
ROWS_OF_SWING = 2.5  # at least so many rows show a swing


def coupling_rad_s(choice: Choice, whole: Cut, chooser: Chooser) -> float:
    """Frequency of the coupling with which the chosen laws explain blocks best, rad/s; 0.0 where none takes enough."""
    fit = choice.fit
    if fit.rms_rad < LEAVES * chooser.sigma_rad:
        return 0.0
    blocks = Blocks.of(whole, fit.motor.tau_s, LAW_BLOCK)
    problem = chooser.problem(blocks.cut, choice.laws, math.inf)

    def cost(rad_s: float) -> float:
        behind = replace(problem, cut=replace(blocks.cut, coupling_rad_s=rad_s))
        return solve(begin(behind, fit.motor), ITERATIONS).cost

    fastest = 2.0 * math.pi / (ROWS_OF_SWING * max(window.period_s for window in whole.windows))
    tried = [rad_s for rad_s in FREQUENCIES_RAD_S if rad_s < fastest]
    stiff = solve(begin(problem, fit.motor), ITERATIONS)
    columns = Columns(stiff)
    gains = [columns.gain(columns.of_change(by_coupling(stiff, rad_s)))[0] for rad_s in tried]
    needed = (1.0 - chooser.asked.cuts) ** 2 * stiff.cost
    if not max(gains, default=0.0) > PROMISING * (stiff.cost - needed):  # false for nan
        return 0.0
    costs = [cost(rad_s) for rad_s in tried]
    best = int(np.argmin(costs))
    low, high = math.log(tried[max(best - 1, 0)]), math.log(tried[min(best + 1, len(tried) - 1)])
    fine, left = lowest(lambda x: cost(math.exp(x)), low, high, FINER)
    return math.exp(fine) if left < needed else 0.0


def takes_enough(stiff: Choice, soft: Choice, whole: Cut, chooser: Chooser) -> bool:
    """Whether the choice behind a coupling takes as much of the error in blocks as a law must."""
    blocks = Blocks.of(whole, stiff.fit.motor.tau_s, LAW_BLOCK)
    noise = np.array(blocks.cut.lengths) * chooser.sigma_rad**2
    left = []
    for one in (soft, stiff):
        cut = replace(blocks.cut, coupling_rad_s=one.fit.problem.cut.coupling_rad_s)
        fit = solve(begin(chooser.problem(cut, one.laws, math.inf), one.fit.motor), FINER)
        left.append(np.maximum(blocks.squares(fit.residual_rad) - noise, 0.0))
    return share_cut(left[0], left[1], noise) >= chooser.asked.cuts
