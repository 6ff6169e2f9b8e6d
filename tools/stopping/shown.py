"""How much of its one law the tests of a run show: the fall of BIC that is to be expected from it.

``campaign_real.shown`` does so for two relay tests. A run that ended soon shows less.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.core.estimators import LEADING
from rig.identification import IdentifyError, identify
from rig.identification.departures import DEPARTURES
from rig.identification.departures.fit import solve, start
from rig.identification.measurements import measurements
from rig.identification.motor_law import Beginning
from rig.run_folder.recording.recording import Recording


def expected_gain(recording: Recording, ideal_rad: NDArray[np.float64], name: str, sigma_rad: float) -> float | None:
    """Expected gain in BIC of having this law; None if rig has no such law, inf where no plain estimate can be made.

    recording  of a run with its tests
    ideal_rad  for each of its rows what the sensor would have read without noise and steps
    sigma_rad  the noise that it has with both
    """
    law = next((one for one in DEPARTURES if one.name == name), None)
    if law is None:
        return None
    clean = replace(recording, y_rad=ideal_rad)
    try:
        plain = identify([clean], (LEADING,), choose_law=False).estimates[LEADING]
    except IdentifyError:
        return math.inf
    data = measurements([clean], with_cycles=True, plain_is_hysteretic=False)
    begun = Beginning.of(data.tests, plain, data.periods_s)
    problem = begun.chooser.problem(begun.whole, [], math.inf)
    left_over = float(np.sum(solve(start(problem, begun.motor)).residual_rad ** 2)) / sigma_rad**2
    samples = sum(window.t_s.size for window in begun.whole.windows)
    return left_over - len(law.numbers + law.shape) * math.log(samples)
