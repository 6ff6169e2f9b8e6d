"""From recordings to estimates: gather the tests, run and judge each estimator, choose the law of the motor.

identification       ``identify``, and the list of estimators
measurements         the tests and cycles in some recordings
preprocessing        corrects the clock, fills in missing times
estimator            the interface of an estimator: one file, and one entry of the list
sampled_data         the estimator to use: exact prediction under the recorded drive
output_error, starts     its least-squares fit, and first guesses for it
triple_relay, describing_function, least_squares   the reference estimators
cycles, mean_cycle   gains, edges, settled cycles, their average
motor_law            what the motor has beyond tau, K and friction: laws of departures/; breakaway shows static friction
noise, repetition    the residual: white, coloured, repeated in each cycle
verdict              ok, doubtful or refused: rules that all estimators share
plausibility         rules about units and columns
agreement            whether several recordings are of one motor
"""

from rig.identification.estimate import Estimate
from rig.identification.identification import METHODS, Identification, identify
from rig.identification.mean_cycle import Cycle
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries

__all__ = ["METHODS", "Cycle", "Estimate", "Identification", "IdentifyError", "TimeSeries", "identify"]
