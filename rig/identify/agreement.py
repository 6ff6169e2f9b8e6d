"""Whether several recordings are of one motor, and which one is not.

Each recording is identified alone. A chi-square test compares the sampled-data estimates with their weighted mean, for
all of them, and for all but one in turn (docs/theory.md 9). rig names a recording if the others agree without it, and
if this is true of no other recording.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from shlex import quote

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from rig.identify import sampled_data
from rig.identify.estimate import Estimate
from rig.recording.errors import IdentifyError
from rig.recording.series import TimeSeries

Array = NDArray[np.float64]

CHANCE = 1e-4  # probability of a false alarm for recordings of one motor
MODEL_ERROR = 0.01  # of each parameter: effects outside a recording's interval, such as speed and temperature
NAMES = (("tau", "s"), ("K", "(rad/s)/V"), ("f_c", "V"))


@dataclass(frozen=True)
class RecordingEstimate:
    """The estimate from one recording alone.

    name        of the recording, as on the command line
    values      (3,): ln tau, ln K, f_c in V
    covariance  (3, 3) of these values, with ``MODEL_ERROR``
    squares     sum of squares of its residual, rad^2, and its number of rows
    """

    name: str
    values: Array
    covariance: Array
    squares: tuple[float, int] = (0.0, 0)

    @classmethod
    def of(cls, name: str, estimate: Estimate) -> RecordingEstimate | None:
        """From a sampled-data estimate; None if that was refused or has no finite covariance."""
        scale = np.array([1.0 / estimate.tau_s, 1.0 / estimate.K_rad_s_V, 1.0])
        values = np.array([math.log(estimate.tau_s), math.log(estimate.K_rad_s_V), estimate.fc_V])
        found = cls.at(name, values, estimate.covariance[:3, :3] * np.outer(scale, scale))
        if estimate.verdict == "refused" or not (np.all(np.isfinite(found.covariance)) and np.all(np.isfinite(values))):
            return None
        residual = estimate.residual_rad
        return replace(found, squares=(float(residual @ residual), residual.size))

    @classmethod
    def at(cls, name: str, values: Array, covariance: Array) -> RecordingEstimate:
        """From ``values``, (3,): ln tau, ln K, f_c in V; and from their covariance, (3, 3), by the noise alone."""
        return cls(name, values, covariance + np.diag([MODEL_ERROR, MODEL_ERROR, MODEL_ERROR * float(values[2])]) ** 2)


def estimates_of_each(recordings: Sequence[tuple[str, Sequence[TimeSeries]]]) -> list[RecordingEstimate]:
    """The estimate of each recording (name, tests) alone, without those that cannot be identified."""
    found = []
    for name, tests in recordings:
        try:
            one = RecordingEstimate.of(name, sampled_data.fit(tests)) if tests else None
        except IdentifyError:
            continue
        if one is not None:
            found.append(one)
    return found


def are_one_motor(found: Sequence[RecordingEstimate], rms_rad: float, numbers: int) -> bool:
    """Whether one motor with laws explains the recordings better than a plain motor for each.

    rms_rad   RMS residual of the one motor, rad
    numbers   of its laws: each must be worth its price in BIC. That plain motors have more numbers counts for nothing,
              else another supply or calibration between two recordings is taken for a law
    """
    squares, rows = (sum(one.squares[k] for one in found) for k in range(2))
    return rows > 0 and rows * (rms_rad**2 * rows - squares) + numbers * math.log(rows) * squares < 0.0


def disagreement(found: Sequence[RecordingEstimate]) -> str | None:
    """Which recording does not belong with the others, and what to do, as a sentence; None if all agree."""
    if len(found) < 2 or _agree(found):
        return None
    if len(found) == 2:
        first, second = found
        return (
            f"{first.name} and {second.name} do not agree: in {second.name} {_differences(second, *_mean([first]))}; "
            "are they of one motor, supply and calibration? "
            f"Identify each alone, {_command([first])} and {_command([second])}; with a third one rig names the odd one"
        )
    without = [[other for other in found if other is not odd] for odd in found]
    consistent = [k for k, others in enumerate(without) if _agree(others)]
    if len(consistent) != 1:
        reason = "more than one differs" if not consistent else "rig cannot see which one is odd"
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
    """The parameters that differ by three standard errors or more; at least the one that differs most."""
    errors = np.sqrt(np.diag(odd.covariance + covariance))
    distances = np.abs(odd.values - mean) / errors
    differences: list[str] = []
    for k in np.argsort(-distances):
        if differences and distances[k] < 3.0:
            break
        own, other = (float(math.exp(v[k]) if k < 2 else v[k]) for v in (odd.values, mean))
        name, unit = NAMES[k]
        differences.append(f"{name} is {own:.4g} {unit}, not {other:.4g} ({distances[k]:.0f} standard errors)")
    return ", ".join(differences)


def _command(found: Sequence[RecordingEstimate]) -> str:
    return "`rig identify " + " ".join(quote(opinion.name) for opinion in found) + "`"
