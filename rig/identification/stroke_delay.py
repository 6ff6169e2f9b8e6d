"""The delay of a bench, bounded by the strokes of its breakaway check before any relay acts (docs/theory.md 10.3)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.preprocessing import from_recording
from rig.model.compiled import motion
from rig.model.step import Plant
from rig.run_folder.recording.errors import IdentifyError, RecordingError
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.recording.stage import StageKind

LONGEST_S = 0.15  # delay that is looked for: in the breakaway check a stroke and the pause after it last 0.16 s
STEP_S = 0.01  # between the first delays that are tried
FINE_S = 0.002  # between the last ones
STROKES = 24  # strokes that are used, the last ones: those before were too weak to move the shaft
CERTAIN = 9.0  # rise of chi-squared at both ends of the interval: three standard errors
MOVED = 30.0  # fall of chi-squared by which the strokes show motion at all
MODEL = 0.05  # of the motion of the strokes: no motor is a better model than that
FITS = 3.0  # chi-squared of a row, at most, where the reading is the motion of a motor
MOST_CALLS = 120  # of the residual, for each delay that is tried
TAU_S, SLOPE, EXCESS = 0.1, 40.0, 0.1  # first guesses: tau, s; K/tau, rad/s2/V; static friction over moving, less 1
SPREAD = 1.0  # of the logarithms of tau and of the excess, which short strokes hardly show


class StrokeDelay(NamedTuple):
    """Time from the recorded drive to the motion of the reading, s: its interval of three standard errors.

    high_s is about ``LONGEST_S`` where the strokes do not bound it.
    """

    low_s: float
    best_s: float
    high_s: float


def stroke_delay(series: TimeSeries, noise_rad: float) -> StrokeDelay | None:
    """The delay that explains best how the strokes moved the shaft; None where it did not move as a motor does.

    series     rows of the breakaway check, with the times at which each drive acted; without these times the delay
               counts from the samples at which the drives were decided
    noise_rad  standard deviation of the reading
    For each delay that is tried, tau, K and friction in each direction are fitted to the positions of each stroke.
    Steady creep, and whatever else moves the shaft between two strokes, stays outside.
    """
    strokes = _Strokes.of(series, noise_rad)
    if strokes is None:
        return None
    tried = strokes.fitted({}, np.arange(-STEP_S, LONGEST_S + 0.5 * STEP_S, STEP_S))
    around_s = min(tried, key=lambda delay_s: tried[delay_s].cost)
    tried = strokes.fitted(tried, around_s + np.arange(-STEP_S + FINE_S, STEP_S, FINE_S))
    best_s = min(tried, key=lambda delay_s: tried[delay_s].cost)
    least = tried[best_s].cost
    if strokes.still - least < MOVED or least > FITS * strokes.rows:
        return None
    allowed = CERTAIN * max(least / strokes.rows, 1.0)
    rises = {delay_s: (tried[delay_s].cost - least) / allowed for delay_s in sorted(tried)}
    below = {delay_s: rise for delay_s, rise in rises.items() if delay_s <= best_s}
    return StrokeDelay(
        _end(dict(reversed(below.items()))), best_s, _end({d: r for d, r in rises.items() if d >= best_s})
    )


def _end(rises: dict[float, float]) -> float:
    """Where the rise of chi-squared over the allowed one passes 1, s, away from the first delay; else the last one.

    Chi-squared is a parabola near its least value. So its root is straight there.
    """
    inside_s, inside = next(iter(rises.items()))
    for delay_s, rise in rises.items():
        if rise > 1.0:
            root, last = math.sqrt(rise), math.sqrt(max(inside, 0.0))
            return inside_s + (delay_s - inside_s) * (1.0 - last) / (root - last)
        inside_s, inside = delay_s, rise
    return inside_s


def strokes_delay(recording: Recording, noise_rad: float | None = None) -> StrokeDelay | None:
    """``stroke_delay`` of the breakaway check in a run; None without one.

    noise_rad  as there; default: that of the rows
    """
    try:
        series, _ = from_recording(recording, recording.stage_rows(str(StageKind.BREAKAWAY)), "breakaway")
    except (IdentifyError, RecordingError):
        return None
    return stroke_delay(series, series.noise_rad() if noise_rad is None else noise_rad)


class _Fit(NamedTuple):
    """Chi-squared with a delay, and the numbers of the motor there."""

    cost: float
    x: Array


class _Strokes(NamedTuple):
    """The last strokes as a problem of least squares.

    t_s, y_rad    samples
    edge_s, u_V   drive
    stroke        for each sample the number of its stroke, from 0; each has its own rest position
    samples       number of them in each stroke
    level_V       drive of the last stroke: about that of friction
    """

    t_s: Array
    y_rad: Array
    edge_s: Array
    u_V: Array
    stroke: NDArray[np.int64]
    samples: NDArray[np.int64]
    noise_rad: float
    level_V: float

    @classmethod
    def of(cls, series: TimeSeries, noise_rad: float) -> _Strokes | None:
        driven = series.u_V != 0.0
        begins = np.flatnonzero(driven & ~np.concatenate(([False], driven[:-1])))[-STROKES:]
        if begins.size == 0:
            return None
        first = int(begins[0])
        stroke = np.searchsorted(begins, np.arange(first, len(series)), side="right") - 1
        strokes = cls(
            series.t_s[first:],
            series.y_rad[first:],
            np.concatenate(([series.t_s[first] - 1.0], series.edge_s[first:])),
            np.concatenate(([0.0], series.u_V[first:])),
            stroke,
            np.bincount(stroke),
            1.0,
            float(np.abs(series.u_V).max()),
        )
        travel_rad = float(np.std(strokes._without_rest(strokes.y_rad)))
        return strokes._replace(noise_rad=math.hypot(noise_rad, MODEL * travel_rad)) if travel_rad > 0.0 else None

    @property
    def rows(self) -> int:
        """Number of samples."""
        return int(self.t_s.size)

    @property
    def still(self) -> float:
        """Chi-squared of a shaft that never moves."""
        left = self._without_rest(self.y_rad) / self.noise_rad
        return float(left @ left)

    def acting_s(self, delay_s: float) -> Array:
        """When each drive acts with that delay, s."""
        return np.asarray(self.edge_s + np.append(0.0, np.full(self.u_V.size - 1, delay_s)))

    def fitted(self, tried: dict[float, _Fit], delays_s: Array) -> dict[float, _Fit]:
        """Those tried before, and these delays, each from the motor of the nearest one before it."""
        found = dict(tried)
        level = math.log(0.6 * self.level_V)
        first = np.array([math.log(TAU_S), math.log(SLOPE), level, level, math.log(EXCESS)])
        for delay_s in map(float, delays_s):
            near_s = min(found, key=lambda known_s: abs(known_s - delay_s), default=None)
            starts = [] if near_s is None else [found[near_s].x]
            if near_s is None or abs(near_s - delay_s) > FINE_S:
                starts.append(first)
            found[delay_s] = min((self._solved(start, delay_s) for start in starts), key=lambda fit: fit.cost)
        return found

    def _solved(self, start: Array, delay_s: float) -> _Fit:
        from scipy.optimize import leastsq  # it loads slowly, and few records need it

        edge_s = self.acting_s(delay_s)
        answer = leastsq(
            self._residual,
            start,
            args=(edge_s,),
            maxfev=MOST_CALLS,
            ftol=1e-3,
            xtol=1e-3,
            epsfcn=1e-6,
            full_output=True,
        )
        left = self._residual(answer[0], edge_s)
        return _Fit(float(left @ left), answer[0])

    def _residual(self, x: Array, edge_s: Array) -> Array:
        """Whitened: of each sample, and of tau and static friction, which short strokes hardly show.

        x       logarithms of tau, K/tau, moving friction towards rising and falling positions, static friction's excess
        edge_s  when each drive acts
        """
        tau, slope, plus, minus, excess = np.exp(np.clip(x, -12.0, 12.0)).tolist()
        motor = Plant(tau, slope * tau, plus, minus, plus * (1.0 + excess), minus * (1.0 + excess), 0.0, 0.0)
        # without the checks of Motor.response: it is called a thousand times a run
        states = motion.states(motor, (0.0, 0.0, 0.0), (edge_s, self.u_V, 0.0), self.t_s)
        left = self._without_rest(self.y_rad - states[:, 1]) / self.noise_rad
        away = [(x[0] - math.log(TAU_S)) / SPREAD, (x[4] - math.log(EXCESS)) / SPREAD]
        return np.append(left, away)

    def _without_rest(self, y_rad: Array) -> Array:
        """Less the mean of each stroke."""
        return np.asarray(y_rad - (np.bincount(self.stroke, y_rad) / self.samples)[self.stroke])
