"""An encoder that loses counts one way: its log has a motor whose gain differs by direction.

Bridges do that, too. But a bridge differs by the sign of its drive, and a log by that of its motion. So the share is
looked for with which the plain motor explains pieces of the tests best, and put right where it says more with fewer
numbers than laws do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rig.identification.estimate import PARAMETERS, Estimate
from rig.identification.in_pieces import plain_residual_rad
from rig.identification.lowest import lowest
from rig.identification.motor_law import MotorLaw
from rig.identification.output_error import refit
from rig.model.sensitivity import Theta
from rig.run_folder.recording.series import TimeSeries, delays_of_all_s

LAWS = ("gain_by_sign", "viscous_by_direction")  # as which it shows
MOST, LEAST = 0.12, 0.003  # share of the counts
STEPS, BESIDE = 12, 0.003
NEARLY = 1.5  # of the squares that laws leave: as many may a share leave that is looked at more closely
# Residual with the counts over that with laws, at most: of 14 logs behind half bridges that are not alike it was 1.5 at
# least, of 11 that had lost counts 1.2 at most
AS_GOOD = 1.25
# The same of the plain motor alone, for each law beside the first, at most: of 8 logs behind half bridges with a noisy
# encoder, which were taken for lost counts, it was 1.02 to 1.15 with one law; of lost counts 1.03 with two
EACH_LAW = 1.05


def lost_share(tests: Sequence[TimeSeries], plain: Estimate, law: MotorLaw) -> float:
    """Which share of counts the encoder seems to lose forwards, > 0, or backwards, < 0; 0.0 where it does not.

    Raises IdentifyError if a test is too short for pieces.
    """
    is_asked = any(one.law.name in LAWS for one in law.found)
    if not is_asked or any(test.t_u_s is not None or test.reads in ("speed", "samples") for test in tests):
        return 0.0

    motor = Theta(plain.tau_s, plain.K_rad_s_V, plain.fc_V, plain.asym_V, plain.delay_s)

    def of_pieces(share: float) -> float:
        return plain_residual_rad([_with(test, share) for test in tests], plain)

    def of_whole(share: float) -> float:
        nonlocal motor  # of a share near by: from there on the way is short
        found = refit([_with(test, share) for test in tests], motor, PARAMETERS, delays_of_all_s(tests))
        motor = Theta(*found.fit.motor[: len(PARAMETERS)])
        return found.rms_rad**2 / laws_rad**2

    # a share is a number as a law has one: where laws explain more, all that follows would be in vain
    laws_rad = EACH_LAW ** (len(law.found) - 1) * law.growth[-1][1]
    near, _ = lowest(of_pieces, -MOST, MOST, STEPS)
    if not _least_near(of_whole, near, BESIDE) < NEARLY:
        return 0.0
    share, left = lowest(of_whole, near - BESIDE, near + BESIDE, STEPS)  # over the whole a small share adds up
    return share if left < 1.0 and abs(share) > LEAST else 0.0


def _least_near(of: Callable[[float], float], at: float, beside: float) -> float:
    """What is about the least between two shares that lie as far beside one: by the parabola through the three."""
    low, here, high = of(at - beside), of(at), of(at + beside)
    bend = low + high - 2.0 * here
    step = 0.5 * (low - high) / bend if bend > 0.0 else 0.0
    return min(low, here, high, of(at + beside * min(max(step, -1.0), 1.0)))


def with_counts(test: TimeSeries, share: float) -> TimeSeries:
    """The test with the counts that it lost, in the steps of its sensor; ``share`` as of ``lost_share``."""
    smooth, step_rad = _with(test, share), test.resolution_rad()
    if not step_rad > 0.0:
        return smooth
    return replace(test, y_rad=test.y_rad[0] + step_rad * np.round((smooth.y_rad - test.y_rad[0]) / step_rad))


def _with(test: TimeSeries, share: float) -> TimeSeries:
    steps_rad = np.diff(test.y_rad, prepend=test.y_rad[0])
    moved_rad = np.where(steps_rad * share > 0.0, steps_rad / (1.0 - abs(share)), steps_rad)
    return replace(test, y_rad=test.y_rad[0] + np.cumsum(moved_rad))


def explains_more(law: MotorLaw, without: MotorLaw) -> bool:
    """Whether a law of tests with their counts explains them, with fewer numbers, as well as one of tests without."""
    few, many = (sum(len(one.numbers) for one in each.found) for each in (law, without))
    goes_one_way = any(one.law.name in LAWS for one in law.found)
    return few < many and not goes_one_way and law.growth[-1][1] < AS_GOOD * without.growth[-1][1]
