"""What survived of the paper's own numbers, and what was chosen where a parameter did not.

The formulas and most of the numbers of the copy at hand are lost. Here stands what is compared with; whatever else
survived of the text is not claimed to be here. Every other number of the report is computed in the run or is a setting
that the report names as chosen (``paper.literals`` holds the text to that).
"""

from __future__ import annotations

from typing import NamedTuple

from rig.model.describing_function import RelayGains

# Examples 4.1 and 4.2
FC_V = 0.5
GAINS = (RelayGains(0.8, 1.0), RelayGains(0.5, 1.2))
SEGMENT_EIGENVALUE = 1.4823  # of one segment of the first cycle, which is stable all the same
LEAST_SQUARES_RUNS = ((0.5, 0.8), (0.3, 1.0))  # hysteresis eps and level d of the single relay
LEAST_SQUARES_FC_V = (0.4921, 0.4988)  # where the estimate of fc lies after LEAST_SQUARES_SAMPLES
LEAST_SQUARES_SAMPLES = 1000

# Example 4.2 (d): "only need two iterations instead of five"
TWO_STAGE_ITERATIONS = 2
ONE_STAGE_ITERATIONS = 5
AVERAGED_PERIODS = (5, 20)  # Remark 3.1

# Example 4.3
TUSTIN_ITERATIONS = 4
TUSTIN_DURATIONS_S = (0.0080, 0.1400, 0.1566)
TUSTIN_POSITION_RAD = 0.3871

# Section V
BENCH_GAINS = (RelayGains(1.0, 1.25), RelayGains(1.2, 1.35))
BENCH_PERIODS_SHOWN = (8, 10)  # of both cycles, in Fig. 20; how many were averaged did not survive
BENCH_PERIOD_S = 0.010
BENCH_GEAR_RATIO = 9.0
BENCH_ITERATIONS = 4
BENCH_RMS_TR = 0.0602
BENCH_RMS_DF = 0.1027


class MotorValues(NamedTuple):
    """Time constant, s, gain, (rad/s)/V, and Coulomb friction, V."""

    tau_s: float
    K_rad_s_V: float
    fc_V: float


# Chosen: with these, Example 4.1's durations lie close to the surviving ones of Example 4.3.
MOTOR = MotorValues(0.17, 6.5, FC_V)
