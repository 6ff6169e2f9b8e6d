"""Whether the tests were read behind a soft coupling, and how fast it swings.

The motor's model has none: the reading is filtered behind the model (``Cut.coupling``), which is exact where the
friction is the motor's and its back-EMF small. That damps the swing of a load, m of the whole mass, by a ratio of
m / (2 (1 - m) tau w). So the damping is looked for with the frequency, and what it lets lag counts as unsure in tau. A
coupling is looked for where a fit with its laws leaves more than noise, and it counts as any law does: by the share of
the error in blocks that it takes away.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rig.identification.departures.blocks import Blocks, share_cut
from rig.identification.departures.budget import Entry
from rig.identification.departures.choice import LAW_BLOCK, Choice, Chooser, Columns
from rig.identification.departures.fit import solve
from rig.identification.departures.fit import start as begin
from rig.identification.departures.laws import DAMPINGS, FREQUENCIES_RAD_S
from rig.identification.departures.outside import by_coupling
from rig.identification.departures.pieces import Coupling, Cut
from rig.identification.lowest import lowest

LEAVES = 1.1  # residual over the sensor's noise from which on a coupling is looked for
ITERATIONS, FINER = 6, 8
PROMISING = 0.5  # of what it must take from the squares beyond noise: what a coupling promises to first order, at least
DAMPED = (0.03, 0.6)  # damping ratios that are looked through
NEAR = 0.01  # of a bound, for a search in so many steps
ROWS_OF_SWING = 2.5  # at least so many rows show a swing


def coupling_of(choice: Choice, whole: Cut, chooser: Chooser) -> Coupling | None:
    """The coupling with which the chosen laws explain blocks best; None where none takes enough."""
    fit = choice.fit
    if fit.rms_rad < LEAVES * fit.noise_rad:
        return None
    blocks = Blocks.of(whole, fit.motor.tau_s, LAW_BLOCK)
    problem = chooser.problem(blocks.cut, choice.laws, math.inf)

    def cost(coupling: Coupling) -> float:
        behind = replace(problem, cut=replace(blocks.cut, coupling=coupling))
        return solve(begin(behind, fit.motor), ITERATIONS).cost

    fastest = 2.0 * math.pi / (ROWS_OF_SWING * max(window.period_s for window in whole.windows))
    steps = [rad_s for rad_s in FREQUENCIES_RAD_S if rad_s < fastest]
    tried = [Coupling(rad_s, damping) for rad_s in steps for damping in DAMPINGS]
    stiff = solve(begin(problem, fit.motor), ITERATIONS)
    columns = Columns(stiff)
    gains = {one: columns.gain(columns.of_change(by_coupling(stiff, one)))[0] for one in tried}
    noise = min(float(blocks.cut.freedom), stiff.cost)
    needed = noise + (1.0 - chooser.asked.cuts) ** 2 * (stiff.cost - noise)
    promising = [one for one, gain in gains.items() if gain > PROMISING * (stiff.cost - needed)]  # false for nan
    if not promising:
        return None
    best = min(promising, key=cost)
    at = steps.index(best.rad_s)
    low, high = math.log(steps[max(at - 1, 0)]), math.log(steps[min(at + 1, len(steps) - 1)])
    fine, left = lowest(lambda x: cost(best._replace(rad_s=math.exp(x))), low, high, FINER)
    best = best._replace(rad_s=math.exp(fine))
    damping, left = lowest(lambda x: cost(best._replace(damping=x)), *DAMPED, FINER)
    return best._replace(damping=damping) if left < needed else None


def lag_line(coupling: Coupling) -> Entry:
    """The budget's line for the lag of the swing, 2 z / w: what of it is the motor's own belongs to tau."""
    return Entry("lag of the soft coupling", 2.0 * coupling.damping / coupling.rad_s, 0.0, 0.0)


def damped_at_bound(coupling: Coupling) -> tuple[str, ...]:
    """A sentence where the damping is the most that is looked through: the record may ask for more, and lag more."""
    if coupling.damping < DAMPED[1] - NEAR:
        return ()
    return (f"the damping of the soft coupling is at its bound, {DAMPED[1]:g}: the record may ask for more",)


def takes_enough(stiff: Choice, soft: Choice, whole: Cut, chooser: Chooser) -> bool:
    """Whether the choice behind a coupling takes as much of the error in blocks as a law must."""
    blocks = Blocks.of(whole, stiff.fit.motor.tau_s, LAW_BLOCK)
    noise = np.array(blocks.cut.lengths) * chooser.sigma_rad**2
    left = []
    for one in (soft, stiff):
        cut = replace(blocks.cut, coupling=one.fit.problem.cut.coupling)
        fit = solve(begin(chooser.problem(cut, one.laws, math.inf), one.fit.motor), FINER)
        left.append(np.maximum(blocks.squares(fit.residual_rad) - noise, 0.0))
    return share_cut(left[0], left[1], noise) >= chooser.asked.cuts
