"""First guesses of a motor: from a limit cycle by the describing function, or from a grid for any drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rig.run_folder.recording.series import Window


class Start(NamedTuple):
    """A first guess: time constant, s, gain, (rad/s)/V, Coulomb friction, V."""

    tau_s: float
    K_rad_s_V: float
    fc_V: float


def ridge_starts(omega_rad_s: float, amplitude_rad: float, h1_V: float, h2_V: float) -> list[Start]:
    """Starts along the ridge of the describing function (docs/theory.md 4.1): fc as fractions of h2, then tau, K."""
    starts = []
    for fraction in (0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
        beyond = h2_V * (1.0 - fraction)
        starts.append(
            Start(
                h1_V / (omega_rad_s * beyond), math.pi * amplitude_rad * omega_rad_s / (4.0 * beyond), fraction * h2_V
            )
        )
    return starts


def grid_starts(windows: Sequence[Window]) -> list[Start]:
    """A coarse grid over tau and fc for any drive. The linear part of the score finds K."""
    largest = max(float(np.abs(window.steps.u_V).max()) for window in windows)
    period = min(window.period_s for window in windows)
    duration = max(window.duration_s for window in windows)
    taus = np.geomspace(2.0 * period, min(0.3 * duration, 200.0 * period), 7)
    return [
        Start(float(tau), math.nan, fraction * largest)
        for tau in taus
        for fraction in (0.02, 0.15, 0.3, 0.45, 0.6, 0.8)
    ]
