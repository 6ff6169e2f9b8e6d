"""Whether several recordings are of one motor, and which one is not: each is identified alone, and they are compared.

Chi-square of their sampled-data estimates about the weighted mean, then once more with each left out in turn
(docs/theory.md 9). A recording is named where the others agree without it, and where leaving out none of the others
would do that, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from shlex import quote

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from rig.identify import sampled_data
from rig.identify.estimate import Estimate
from rig.recording.errors import IdentifyError
from rig.recording.series import TimeSeries

Array = NDArray[np.float64]

CHANCE = 1e-4  # probability by which recordings of one motor are said not to agree
MODEL_ERROR = 0.01  # of each parameter: what a recording's interval does not show, such as speed and temperature
NAMES = (("tau", "s"), ("K", "(rad/s)/V"), ("f_c", "V"))


@dataclass(frozen=True)
class RecordingEstimate:
    """What one recording says alone.

    name        as it was given on the command line
    values      (3,): ln tau, ln K, f_c in V
    covariance  (3, 3) of them, with the model's error
    """

    name: str
    values: Array
    covariance: Array

    @classmethod
    def of(cls, name: str, estimate: Estimate) -> RecordingEstimate | None:
        """An estimate as an opinion; None where it knows nothing."""
        scale = np.array([1.0 / estimate.tau_s, 1.0 / estimate.K_rad_s_V, 1.0])
        covariance = estimate.covariance[:3, :3] * np.outer(scale, scale)
        covariance = covariance + np.diag([MODEL_ERROR, MODEL_ERROR, MODEL_ERROR * estimate.fc_V]) ** 2
        values = np.array([math.log(estimate.tau_s), math.log(estimate.K_rad_s_V), estimate.fc_V])
        if estimate.verdict == "refused" or not (np.all(np.isfinite(covariance)) and np.all(np.isfinite(values))):
            return None
        return cls(name, values, covariance)


def estimates_of_each(recordings: Sequence[tuple[str, Sequence[TimeSeries]]]) -> list[RecordingEstimate]:
    """Each recording, a name and its tests, identified alone; those that cannot be are left out."""
    found = []
    for name, tests in recordings:
        try:
            opinion = RecordingEstimate.of(name, sampled_data.fit(tests)) if tests else None
        except IdentifyError:
            continue
        if opinion is not None:
            found.append(opinion)
    return found


def disagreement(found: Sequence[RecordingEstimate]) -> str | None:
    """Which recording does not belong with the others, in words, and what to do; None where all agree."""
    if len(found) < 2 or _agree(found):
        return None
    if len(found) == 2:
        first, second = found
        return (
            f"{first.name} and {second.name} do not agree: {_differences(second, *_mean([first]))} in {second.name}, "
            "against the other; are they of one motor, supply and calibration? "
            f"Identify each alone, {_command([first])} and {_command([second])}; with a third one rig names the odd one"
        )
    without = [[other for other in found if other is not odd] for odd in found]
    consistent = [k for k, others in enumerate(without) if _agree(others)]
    if len(consistent) != 1:
        reason = "more than one differs" if not consistent else "which one is odd, they do not tell"
        return (
            f"the {len(found)} recordings do not agree, and {reason}: are they of one motor, supply and calibration? "
            "Identify each alone, such as " + _command(found[:1])
        )
    odd, others = found[consistent[0]], without[consistent[0]]
    return (
        f"{odd.name} does not belong with the others, which agree: {_differences(odd, *_mean(others))}; "
        f"another motor, supply or calibration? Leave it out: {_command(others)}"
    )


def _mean(found: Sequence[RecordingEstimate]) -> tuple[Array, Array]:
    """Weighted mean and its covariance."""
    weights = [np.linalg.inv(opinion.covariance) for opinion in found]
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    return covariance @ np.sum([w @ o.values for w, o in zip(weights, found, strict=True)], axis=0), covariance


def _agree(found: Sequence[RecordingEstimate]) -> bool:
    mean, _ = _mean(found)
    square = sum(float((o.values - mean) @ np.linalg.solve(o.covariance, o.values - mean)) for o in found)
    return bool(chi2.sf(square, 3 * (len(found) - 1)) > CHANCE)


def _differences(odd: RecordingEstimate, mean: Array, covariance: Array) -> str:
    """The parameters by which it differs by three standard errors and more, at least the one that differs most."""
    errors = np.sqrt(np.diag(odd.covariance + covariance))
    distances = np.abs(odd.values - mean) / errors
    told: list[str] = []
    for k in np.argsort(-distances):
        if told and distances[k] < 3.0:
            break
        own, other = (float(math.exp(v[k]) if k < 2 else v[k]) for v in (odd.values, mean))
        name, unit = NAMES[k]
        told.append(f"{name} is {own:.4g} {unit}, not {other:.4g} ({distances[k]:.0f} standard errors)")
    return ", ".join(told)


def _command(found: Sequence[RecordingEstimate]) -> str:
    return "`rig identify " + " ".join(quote(opinion.name) for opinion in found) + "`"
