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
from numpy.typing import NDArray
from scipy.optimize import leastsq

from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.recording.series import TimeSeries

Array = NDArray[np.float64]
_TauOf = Callable[[float, float], float]  # tau, s, of K / tau and friction, V

STROKES = 24  # that are used, the last ones: those before were too weak to move the shaft
CERTAIN = 36.0  # fall of chi-squared without the braking: six standard errors
LEAST_ROW = 0.1  # chi-squared of a row that is believed: steps of an encoder are no white noise
FITS = 2.0  # chi-squared of a row, at most, without it: else the motion is not that of a plain motor
TIMES_FASTER = 2.0  # than its data sheet says may the motor be
STEP_NOISE = 0.29  # of a step of the sensor: standard deviation of a rounding, 1 / sqrt(12)
FREE_TAU_S = 1e3  # of a motor that nothing but friction brakes
FIRST_SLOPE, FIRST_FRICTION, FIRST_EXCESS = 40.0, (0.6, 0.35), 0.1  # guesses: rad/s2/V; of the last level; static
SPREAD = 1.0  # of the logarithm of the excess, which short strokes hardly show
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
    strokes = _Strokes.of(series, math.hypot(noise_rad, STEP_NOISE * abs(lsb_rad)), delay_s)
    if strokes is None:
        return None

    def braking_tau_s(slope: float, friction_V: float) -> float:
        K_rad_s_V = TIMES_FASTER * no_load_rad_s / max(full_V - friction_V, 0.1 * full_V)
        return min(max(K_rad_s_V / slope, 1e-3), FREE_TAU_S)

    free, x = strokes.fitted(lambda slope, friction_V: FREE_TAU_S)
    braking, _ = strokes.fitted(braking_tau_s, x)
    slope, plus_V, minus_V, _ = np.exp(x)
    row = free / len(strokes.t_s)
    evidence = (braking - free) / max(row, LEAST_ROW)
    return Free(evidence, row, braking_tau_s(float(slope), 0.5 * float(plus_V + minus_V)))


class _Strokes(NamedTuple):
    """The last strokes as a problem of least squares.

    stroke   for each sample the number of its stroke, from 0; each has its own rest position
    level_V  drive of the last stroke: about that of friction
    """

    t_s: Array
    y_rad: Array
    edge_s: Array
    u_V: Array
    stroke: NDArray[np.int64]
    noise_rad: float
    level_V: float

    @classmethod
    def of(cls, series: TimeSeries, noise_rad: float, delay_s: float) -> _Strokes | None:
        driven = series.u_V != 0.0
        begins = np.flatnonzero(driven & ~np.concatenate(([False], driven[:-1])))[-STROKES:]
        if begins.size == 0 or not noise_rad > 0.0:
            return None
        first = int(begins[0])
        return cls(
            series.t_s[first:],
            series.y_rad[first:],
            np.concatenate(([series.t_s[first] - 1.0], series.edge_s[first:] + delay_s)),
            np.concatenate(([0.0], series.u_V[first:])),
            np.searchsorted(begins, np.arange(first, len(series)), side="right") - 1,
            noise_rad,
            float(np.abs(series.u_V).max()),
        )

    def fitted(self, tau_s: _TauOf, *near: Array) -> tuple[float, Array]:
        """Chi-squared of the best motor, and the logarithms of its K / tau, moving frictions and static excess.

        near  such logarithms to begin with, besides the first guesses
        """
        frictions = [math.log(share * self.level_V) for share in FIRST_FRICTION]
        guesses = [np.array([math.log(FIRST_SLOPE), f, f, math.log(FIRST_EXCESS)]) for f in frictions]
        found = []
        for first in (*guesses, *near):
            answer = leastsq(
                self._residual,
                first,
                args=(tau_s,),
                maxfev=MOST_CALLS,
                ftol=1e-4,
                xtol=1e-4,
                epsfcn=1e-6,
                full_output=True,
            )
            left = self._residual(answer[0], tau_s)
            found.append((float(left @ left), np.asarray(answer[0])))
        return min(found, key=lambda one: one[0])

    def _residual(self, x: Array, tau_s: _TauOf) -> Array:
        slope, plus, minus, excess = np.exp(np.clip(x, -12.0, 12.0)).tolist()
        tau = tau_s(slope, 0.5 * (plus + minus))
        motor = Motor(tau, slope * tau, Friction(plus, minus, plus * (1.0 + excess), minus * (1.0 + excess)))
        y = motor.response(State(), self.t_s, self.edge_s, self.u_V)[:, 1]
        count = np.bincount(self.stroke)
        left = self.y_rad - y
        left = left - (np.bincount(self.stroke, left) / count)[self.stroke]
        return np.append(left / self.noise_rad, (x[3] - math.log(FIRST_EXCESS)) / SPREAD)
