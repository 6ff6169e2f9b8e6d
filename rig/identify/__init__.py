"""From recordings to an estimate: cycles, one module per estimator, and whether to believe it.

identification        which rows, which methods: ``identify``
record                what estimators read
cycles                gains, edges, settled cycles, their average
sampled_data          the estimator to use: exact prediction under the recorded drive
triple_relay, describing_function   the references
breakaway             static friction both ways
friction_law, friction_fit   which friction law the data ask for
verdict               ok, doubtful or refused
"""

from rig.identify.estimate import Estimate
from rig.identify.identification import METHODS, Identification, identify
from rig.identify.mean_cycle import Cycle
from rig.recording.series import IdentifyError, Record

__all__ = ["METHODS", "Cycle", "Estimate", "Identification", "IdentifyError", "Record", "identify"]
