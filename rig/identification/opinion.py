"""What one part of the recordings alone says of tau, K and friction, and whether several of them agree.

A chi-square test compares the estimates with their weighted mean (docs/theory.md 9).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.core.arrays import Array
from rig.identification.chance import chi_squared_beyond
from rig.identification.estimate import Estimate

CHANCE = 1e-4  # probability of a false alarm for recordings of one motor
MODEL_ERROR = 0.01  # of each parameter: effects outside a recording's interval, such as speed and temperature
NAMES = (("tau", "s"), ("K", "(rad/s)/V"), ("f_c", "V"))


@dataclass(frozen=True)
class RecordingEstimate:
    """The estimate from one recording alone.

    name        of the recording, as on the command line
    values      (3,): ln tau, ln K, f_c in V
    covariance  (3, 3) of these values, with a model error
    squares     sum of squares of its residual, rad^2, and its number of rows
    """

    name: str
    values: Array
    covariance: Array
    squares: tuple[float, int] = (0.0, 0)

    @classmethod
    def of(cls, name: str, estimate: Estimate, model_error: float = MODEL_ERROR) -> RecordingEstimate | None:
        """From a sampled-data estimate; None if that was refused or has no finite covariance.

        model_error   as ``at``
        """
        scale = np.array([1.0 / estimate.tau_s, 1.0 / estimate.K_rad_s_V, 1.0])
        values = np.array([math.log(estimate.tau_s), math.log(estimate.K_rad_s_V), estimate.fc_V])
        found = cls.at(name, values, estimate.covariance[:3, :3] * np.outer(scale, scale), model_error)
        if estimate.verdict == "refused" or not (np.all(np.isfinite(found.covariance)) and np.all(np.isfinite(values))):
            return None
        residual = estimate.residual_rad
        return replace(found, squares=(float(residual @ residual), residual.size))

    @classmethod
    def at(cls, name: str, values: Array, covariance: Array, model_error: float = MODEL_ERROR) -> RecordingEstimate:
        """From ``values``, (3,): ln tau, ln K, f_c in V; and from their covariance, (3, 3), by the noise alone.

        model_error   standard deviation of a further error of each parameter, relative, at least 0
        """
        return cls(name, values, covariance + np.diag(model_error * np.array([1.0, 1.0, float(values[2])])) ** 2)


def mean_of(found: Sequence[RecordingEstimate]) -> tuple[Array, Array]:
    """Weighted mean and its covariance."""
    weights = [np.linalg.inv(opinion.covariance) for opinion in found]
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    return covariance @ np.sum([w @ o.values for w, o in zip(weights, found, strict=True)], axis=0), covariance


def agree(found: Sequence[RecordingEstimate], chance: float = CHANCE) -> bool:
    """Whether chance explains how they differ; ``chance``: probability of a false alarm."""
    mean, _ = mean_of(found)
    square = sum(float((o.values - mean) @ np.linalg.solve(o.covariance, o.values - mean)) for o in found)
    return chi_squared_beyond(3 * (len(found) - 1), square) > chance


def differences(odd: RecordingEstimate, mean: Array, covariance: Array) -> str:
    """The parameters that differ by three standard errors or more, in words; at least the one that differs most.

    mean, covariance   of the others, as ``RecordingEstimate``: (3,) and (3, 3)
    """
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
