"""Whether the bridge lets the motor run free while PWM is low, by the strokes of the breakaway check.

Behind a bridge that brakes a plain motor slows down by v / tau, whatever drives it (docs/theory.md 2). Behind one that
lets it run free it does so for the share of the time alone for which PWM is high, a tenth in these strokes
(``rig.model.bench.coasting``). From strokes that share cannot be told from a longer tau. But the data sheet's no-load
speed bounds K, and the strokes show K / tau: so tau has a bound. Strokes that fit only without any such braking are
those of a bridge that does not brake. Most are too short and too slow to say so: then nothing is said.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import leastsq

from rig.core.arrays import Array

# Private there: the rows of `make campaign-real` belong to the text of rig/identification, so a name there stays as it
# is.
from rig.identification.stroke_delay import EXCESS, SLOPE
from rig.identification.stroke_delay import _Strokes as Strokes
from rig.run_folder.recording.series import TimeSeries

_TauOf = Callable[[float, float], float]  # tau, s, of K / tau and friction, V

CERTAIN = 36.0  # fall of chi-squared without the braking: six standard errors
LEAST_ROW = 0.1  # chi-squared of a row that is believed: steps of an encoder are no white noise
FITS = 2.0  # chi-squared of a row, at most, without it: else the motion is not that of a plain motor
TIMES_FASTER = 2.0  # than its data sheet says may the motor be
STEP_NOISE = 0.29  # of a step of the sensor: standard deviation of a rounding, 1 / sqrt(12)
FREE_TAU_S = 1e3  # of a motor that nothing but friction brakes
FIRST_FRICTION = (0.6, 0.35)  # guesses, of the last level
MOST_CALLS = 150


class Free(NamedTuple):
    """What the strokes show.

    evidence    fall of chi-squared, over that of a row, if the motor is taken to run free; negative: it brakes
    row         chi-squared of a row of the motor that runs free
    tau_s       longest tau that the data sheet allows, by the K / tau of the strokes
    """

    evidence: float
    row: float
    tau_s: float

    @property
    def is_certain(self) -> bool:
        """Whether the bridge lets the motor run free beyond doubt."""
        return self.evidence > CERTAIN and self.row < FITS


def free_running(
    series: TimeSeries, noise_rad: float, lsb_rad: float, full_V: float, no_load_rad_s: float, delay_s: float = 0.0
) -> Free | None:
    """What the strokes of a breakaway check show; None where nothing was driven.

    series         its rows, with the times at which each drive acted
    noise_rad      standard deviation of the reading; lsb_rad: a step of the sensor
    full_V         at the motor at full duty; no_load_rad_s: its speed then, by the data sheet
    delay_s        from that time to the motion of the reading
    """
    of_noise_rad = math.hypot(noise_rad, STEP_NOISE * abs(lsb_rad))
    strokes = Strokes.of(series, of_noise_rad) if of_noise_rad > 0.0 else None
    if strokes is None:
        return None
    strokes = strokes._replace(noise_rad=of_noise_rad)  # not that of a model: whether the model fits is asked here

    def braking_tau_s(slope: float, friction_V: float) -> float:
        K_rad_s_V = TIMES_FASTER * no_load_rad_s / max(full_V - friction_V, 0.1 * full_V)
        return min(max(K_rad_s_V / slope, 1e-3), FREE_TAU_S)

    free, x = _fitted(strokes, delay_s, lambda slope, friction_V: FREE_TAU_S)
    braking, _ = _fitted(strokes, delay_s, braking_tau_s, x)
    slope, plus_V, minus_V, _ = np.exp(x)
    row = free / strokes.rows
    evidence = (braking - free) / max(row, LEAST_ROW)
    return Free(evidence, row, braking_tau_s(float(slope), 0.5 * float(plus_V + minus_V)))


def _fitted(strokes: Strokes, delay_s: float, tau_s: _TauOf, *near: Array) -> tuple[float, Array]:
    """Chi-squared of the best motor, and the logarithms of its K / tau, moving frictions and static excess.

    near  such logarithms to begin with, besides the first guesses
    """
    edge_s = strokes.acting_s(delay_s)

    def residual(x: Array) -> Array:
        slope, plus_V, minus_V, _ = np.exp(np.clip(x, -12.0, 12.0)).tolist()
        tau = math.log(tau_s(slope, 0.5 * (plus_V + minus_V)))
        left = strokes._residual(np.concatenate(([tau], x)), edge_s)
        return np.delete(left, -2)  # tau comes from the data sheet: no guess of it counts

    frictions = [math.log(share * strokes.level_V) for share in FIRST_FRICTION]
    guesses = [np.array([math.log(SLOPE), f, f, math.log(EXCESS)]) for f in frictions]
    found = []
    for first in (*guesses, *near):
        answer = leastsq(residual, first, maxfev=MOST_CALLS, ftol=1e-4, xtol=1e-4, epsfcn=1e-6, full_output=True)
        left = residual(answer[0])
        found.append((float(left @ left), np.asarray(answer[0])))
    return min(found, key=lambda one: one[0])
