"""From recordings to an estimate: gather the tests, fit and judge each estimator, choose the friction law.

identification   ``identify``, and the list of estimators
measurements     the tests and cycles in some recordings; preprocessing: clock, missing times
estimator        what an estimator is: a file of its own, and one entry of the list
sampled_data     the one to use: exact prediction under the recorded drive, by output_error (from starts)
triple_relay, describing_function, least_squares   the references
cycles, mean_cycle   gains, edges, settled cycles, their average
friction_law     which law the data ask for, of laws/; friction_fit fits one, breakaway shows static friction
noise, repetition    what is left over: white, coloured, the same in each cycle
verdict          ok, doubtful or refused: what all share; plausibility: units and columns; agreement: one motor
"""

from rig.identify.estimate import Estimate
from rig.identify.identification import METHODS, Identification, identify
from rig.identify.mean_cycle import Cycle
from rig.recording.errors import IdentifyError
from rig.recording.series import TimeSeries

__all__ = ["METHODS", "Cycle", "Estimate", "Identification", "IdentifyError", "TimeSeries", "identify"]
