"""The motor of an identification, with its uncertainty."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rig.design.tune.tuning import TuneError
from rig.design.tune.uncertain import OF, UncertainMotor
from rig.identification.known_model import model_of
from rig.run_folder.results import Answer, EstimateResult

_OF_ESTIMATE: Final = {"bias_V": "asym_V"}  # what the estimate calls what the motor calls otherwise


def motor_of(answer: Answer | None) -> UncertainMotor:
    """The motor of an answer with its laws, and how well it is known.

    Half widths are u95 where there is one, else those of its scatter. The laws' own sizes count as known:
    what they leave open is in u95 of tau, K and f_c. Raises TuneError without an answer that was not refused, or
    without intervals of tau and K.
    """
    try:
        framed = model_of(answer)
    except ValueError as error:
        raise TuneError(f"the result holds a model that no motor has: {error}", "give another run") from error
    if framed is None or answer is None:
        raise TuneError("there is no motor that was not refused", "see why: `rig identify RUN`")
    half = tuple(_half_95(answer.at_95(_OF_ESTIMATE.get(name, name))) for name in OF)
    if not half[0] > 0.0 or not half[1] > 0.0:
        raise TuneError("tau and K have no intervals, so no worst case is known", "identify the run anew")
    return UncertainMotor(framed, max(answer.delay_s or 0.0, 0.0), half, _correlation(answer))


def _half_95(interval: tuple[float, float] | None) -> float:
    """Half the 95 % interval of a number; 0 if it is not known to have one."""
    return 0.0 if interval is None else 0.5 * (interval[1] - interval[0])


def _correlation(estimate: EstimateResult) -> NDArray[np.float64]:
    """Of ``OF``; numbers that the estimate does not have are independent."""
    found = np.eye(len(OF))
    if estimate.correlation is None:
        return found
    names = estimate.covariance_of
    for i, a in enumerate(OF):
        for j, b in enumerate(OF):
            a_name, b_name = _OF_ESTIMATE.get(a, a), _OF_ESTIMATE.get(b, b)
            if i != j and a_name in names and b_name in names:
                value = estimate.correlation[names.index(a_name)][names.index(b_name)]
                found[i, j] = value if value is not None and math.isfinite(value) else 0.0
    return found
