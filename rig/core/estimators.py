"""The estimators, the most trusted first. To add one, write one file in rig/identification/, and one line here.

Commands, configs, results and reports take from this list what they know of an estimator. The list imports none of
them: they load slowly.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class EstimatorEntry(NamedTuple):
    """One estimator.

    name         in commands, configs, results and reports; as the class has it
    short        in figures
    place        where the class is: "module:class"
    finds_motor  whether it finds tau and K; False: friction alone
    """

    name: str
    short: str
    place: str
    finds_motor: bool = True


ESTIMATORS: Final = [
    EstimatorEntry("sampled-data", "SD", "rig.identification.sampled_data:SampledData"),
    EstimatorEntry("triple-relay", "TR", "rig.identification.triple_relay:TripleRelay"),
    EstimatorEntry("describing-function", "DF", "rig.identification.describing_function:DescribingFunction"),
    EstimatorEntry("least-squares", "LS", "rig.identification.least_squares:LeastSquares", finds_motor=False),
]
MAIN: Final = ("tau_s", "K_rad_s_V", "fc_V")
"""The numbers of an answer that each table, picture and comparison has."""
LEADING: Final = ESTIMATORS[0].name
"""The estimator that decides: it needs the least data, and the laws of real motors extend its model."""
