"""The friction map: what drive the motor takes at each speed and at each position, from slow sweeps (docs/theory.md 13.3).

Each sweep is weighed by windows that rise and fall smoothly. Integrated by parts against such a window, the equation of
the motor needs no derivative of the noisy position: acceleration and speed fall on the window (modulating functions;
Shinbrot 1957, Preisig and Rippin 1993). The result is linear in the readings, so their noise gives its standard error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.model.real_inverse import drive_for
from rig.model.real_motor import FramedMotor
from rig.recording.errors import IdentifyError
from rig.recording.series import TimeSeries
from rig.results import FrictionMapResult, MapPositionResult, MapSpeedResult

Array = NDArray[np.float64]

STEADY = 5e-3  # relative change of the reference's speed from row to row that is none
STRAIGHT = 2e-3  # of its way: the largest distance of a sweep's reference from a straight line
LEAST_WAY = 0.3  # of the reference's whole travel that a sweep passes
SETTLE_TURNS = 0.75  # of the time of a turn: the motion has settled then
POSITIONS = 24
FEWEST_SAMPLES = 8  # of a window
LOCAL_SHARE = 0.15  # of a sweep's speed: noise of its local speed
STILL_SHARE = 0.25  # of a sweep's speed: slower counts as sticking
STICKS = 0.05  # of a sweep that sticks: its drive is not the drive of its speed
OVERLAP = 1.5  # windows of which neighbours share so much count for fewer


@dataclass(frozen=True)
class MapSpeed:
    """A sweep: its speed, rad/s, with its sign; the drive it took, V, with standard error; whether the shaft stuck."""

    speed_rad_s: float
    drive_V: float
    error_V: float
    sticks: bool


@dataclass(frozen=True)
class MapPosition:
    """A position, rad: the drive there towards rising and falling positions less v/K, V, with standard errors."""

    y_rad: float
    plus_V: float
    minus_V: float
    plus_error_V: float
    minus_error_V: float

    @property
    def force_V(self) -> float:
        """Half sum: force over position, less the bias, V."""
        return 0.5 * (self.plus_V + self.minus_V)

    @property
    def friction_V(self) -> float:
        """Half difference: friction over position, V."""
        return 0.5 * (self.plus_V - self.minus_V)

    @property
    def error_V(self) -> float:
        """Standard error of both, V."""
        return 0.5 * math.hypot(self.plus_error_V, self.minus_error_V)


@dataclass(frozen=True)
class FrictionMap:
    """The drive over speed and over position.

    motor      what the speed and the acceleration were corrected with, and the law beside the map
    travel_rad the part of the travel that every sweep passed at a steady speed, (low, high), rad
    speeds     falling and rising sweeps, by speed
    positions  by position; empty if every sweep stuck
    """

    motor: FramedMotor
    travel_rad: tuple[float, float]
    speeds: tuple[MapSpeed, ...]
    positions: tuple[MapPosition, ...]

    def law_over_speed(self, speed_rad_s: float) -> float:
        """Drive of the law at a steady speed, V: the mean over the travel."""
        return float(np.mean([_steady_V(self.motor, speed_rad_s, y) for y in self._grid()]))

    def law_over_position(self, y_rad: float, way: float) -> float:
        """Drive of the law less v/K at a position, V, in the direction ``way``: the mean over the sweeps' speeds."""
        speeds = [one.speed_rad_s for one in self.speeds if not one.sticks and one.speed_rad_s * way > 0.0]
        K = self.motor.motor.K_rad_s_V
        return float(np.mean([_steady_V(self.motor, v, y_rad) - v / K for v in speeds]))

    def _grid(self) -> Array:
        return np.linspace(*self.travel_rad, POSITIONS + 1)

    def notes(self) -> list[str]:
        """What there is to know, as sentences."""
        stuck = sorted({abs(one.speed_rad_s) for one in self.speeds if one.sticks})
        if not stuck:
            return []
        words = ", ".join(f"{v:.3g}" for v in stuck)
        return [
            f"friction map: at {words} rad/s the shaft sticks and slips, so the drive there is not that of a steady speed"
        ]

    def as_result(self) -> FrictionMapResult:
        """As in result.json."""
        return FrictionMapResult(
            tau_s=self.motor.motor.tau_s,
            K_rad_s_V=self.motor.motor.K_rad_s_V,
            laws=self.motor.parts,
            travel_rad=self.travel_rad,
            speeds=tuple(
                MapSpeedResult(
                    speed_rad_s=one.speed_rad_s,
                    drive_V=one.drive_V,
                    error_V=one.error_V,
                    sticks=one.sticks,
                    law_V=self.law_over_speed(one.speed_rad_s),
                )
                for one in self.speeds
            ),
            positions=tuple(
                MapPositionResult(
                    y_rad=one.y_rad,
                    plus_V=one.plus_V,
                    minus_V=one.minus_V,
                    plus_error_V=one.plus_error_V,
                    minus_error_V=one.minus_error_V,
                    force_V=one.force_V,
                    friction_V=one.friction_V,
                    error_V=one.error_V,
                    law_plus_V=self.law_over_position(one.y_rad, 1.0),
                    law_minus_V=self.law_over_position(one.y_rad, -1.0),
                )
                for one in self.positions
            ),
        )


def _steady_V(motor: FramedMotor, speed_rad_s: float, y_rad: float) -> float:
    return drive_for(motor.motor, motor.frame, (speed_rad_s, y_rad), 0.0, speed_rad_s)


@dataclass(frozen=True)
class _Weight:
    """A window of the reference's position: it rises over ``rise_rad``, is 1, and falls over ``rise_rad`` again."""

    low_rad: float
    high_rad: float
    rise_rad: float


@dataclass(frozen=True, eq=False)
class _Sweep:
    """Rows of a sweep at a steady speed: times, deviations from the reference, and the drive's edges."""

    speed_rad_s: float
    t_s: Array
    error_rad: Array
    yd_rad: Array
    edge_s: Array
    u_V: Array

    def weighed(self, weight: _Weight, motor: FramedMotor) -> tuple[float, float, float]:
        """Mean speed, rad/s; mean drive less what acceleration takes, V; its scatter by 1 rad of noise, V."""
        v = abs(self.speed_rad_s)
        rise_s, length_s = weight.rise_rad / v, (weight.high_rad - weight.low_rad) / v
        entry = weight.low_rad if self.speed_rad_s > 0.0 else weight.high_rad
        start_s = float(self.t_s[0]) + (entry - float(self.yd_rad[0])) / self.speed_rad_s
        _, slope, bend = _window(self.t_s - start_s, rise_s, length_s)
        area, _, _ = _window(np.append(self.edge_s, self.t_s[-1]) - start_s, rise_s, length_s)
        whole = length_s - rise_s
        step = np.gradient(self.t_s)
        tau, K = motor.motor.tau_s, motor.motor.K_rad_s_V
        speed = self.speed_rad_s - float(np.sum(slope * self.error_rad * step)) / whole
        taken = tau / K * bend * step / whole
        drive_V = float(np.sum(self.u_V * np.diff(area))) / whole - float(np.sum(taken * self.error_rad))
        return speed, drive_V, float(np.sqrt(np.sum((taken - slope * step / (K * whole)) ** 2)))

    def samples_in(self, weight: _Weight) -> int:
        """Number of samples in the window."""
        return int(np.count_nonzero((self.yd_rad > weight.low_rad) & (self.yd_rad < weight.high_rad)))

    def sticks(self, noise_rad: float) -> bool:
        """Whether the shaft stands for more than a twentieth of the sweep, as far as the noise lets it be seen."""
        v, period = abs(self.speed_rad_s), float(np.median(np.diff(self.t_s)))
        half_s = max((noise_rad * math.sqrt(3.0 * period) / (LOCAL_SHARE * v)) ** (2.0 / 3.0), 4.0 * period)
        half = max(4, round(half_s / period))
        if self.t_s.size < 4 * half:
            return False
        at = np.arange(-half, half + 1) * period + half * period
        _, slope, _ = _window(at, half * period, 2.0 * half * period)
        kernel = slope * period / (half * period)
        local = np.sign(self.speed_rad_s) * (self.speed_rad_s - np.correlate(self.error_rad, kernel, "valid"))
        return bool(np.mean(local < STILL_SHARE * v) > STICKS)


def _window(t: Array, rise_s: float, length_s: float) -> tuple[Array, Array, Array]:
    """A window from 0 to ``length_s``: its integral from 0, its slope, and its second derivative at the times ``t``.

    It rises as s - sin(2 pi s)/(2 pi), is 1, and falls likewise: slope and second derivative are continuous.
    """
    up, down = np.clip(t / rise_s, 0.0, 1.0), np.clip((length_s - t) / rise_s, 0.0, 1.0)

    def area(s: Array) -> Array:
        return 0.5 * s * s + (np.cos(2.0 * np.pi * s) - 1.0) / (4.0 * np.pi**2)

    flat = np.clip(t - rise_s, 0.0, length_s - 2.0 * rise_s)
    integral = rise_s * (area(up) + 0.5 - area(down)) + flat
    slope = ((1.0 - np.cos(2.0 * np.pi * up)) - (1.0 - np.cos(2.0 * np.pi * down))) / rise_s
    bend = 2.0 * np.pi * (np.sin(2.0 * np.pi * up) + np.sin(2.0 * np.pi * down)) / rise_s**2
    return integral, slope, bend


def friction_map(survey: TimeSeries, yd_rad: Array, motor: FramedMotor) -> FrictionMap:
    """The map from the rows of a survey.

    yd_rad  the reference at each row, rad
    motor   the identified motor; its delay is used where the survey does not say when its drive acted
    Raises IdentifyError if there is no steady sweep in both directions.
    """
    sweeps = list(_sweeps(survey, yd_rad, motor.motor.delay_s))
    ways = {np.sign(sweep.speed_rad_s) for sweep in sweeps}
    low = max((float(sweep.yd_rad.min()) for sweep in sweeps), default=0.0)
    high = min((float(sweep.yd_rad.max()) for sweep in sweeps), default=0.0)
    if len(ways) < 2 or not high > low:
        raise IdentifyError(
            f"{survey.name}: there are no steady sweeps to and fro, so there is no friction map",
            "record the whole survey: `rig survey CONFIG`",
        )
    noise_rad = survey.noise_rad()
    step = (high - low) / (POSITIONS + 1)
    whole = _Weight(low, high, step)
    K = motor.motor.K_rad_s_V
    parts = [_Weight(low + k * step, low + (k + 2) * step, step) for k in range(POSITIONS)]
    speeds: list[MapSpeed] = []
    profiles: dict[float, list[tuple[Array, Array]]] = {1.0: [], -1.0: []}
    levels: dict[float, list[float]] = {1.0: [], -1.0: []}
    for sweep in sweeps:
        way = float(np.sign(sweep.speed_rad_s))
        speed, drive_V, scatter = sweep.weighed(whole, motor)
        sticks = sweep.sticks(noise_rad)
        speeds.append(MapSpeed(speed, drive_V, noise_rad * scatter, sticks))
        if not sticks:
            local = [_of_part(sweep, part, motor, noise_rad) for part in parts]
            level = drive_V - speed / K
            profiles[way].append((np.array([f - level for f, _ in local]), np.array([e for _, e in local])))
            levels[way].append(level)
    positions: tuple[MapPosition, ...] = ()
    if levels[1.0] and levels[-1.0]:
        centres = [0.5 * (part.low_rad + part.high_rad) for part in parts]
        plus, minus = (_over_position(profiles[way], float(np.mean(levels[way]))) for way in (1.0, -1.0))
        positions = tuple(
            MapPosition(y, a, b, ea, eb)
            for y, a, b, ea, eb in zip(centres, plus[0], minus[0], plus[1], minus[1], strict=True)
        )
        speeds = _with_scatter(speeds, profiles, {1.0: plus[2], -1.0: minus[2]})
    return FrictionMap(motor, (low, high), tuple(sorted(speeds, key=lambda one: one.speed_rad_s)), positions)


def _of_part(sweep: _Sweep, part: _Weight, motor: FramedMotor, noise_rad: float) -> tuple[float, float]:
    """Drive less v/K in a part of a sweep, V, and its standard error; infinite where there are too few samples."""
    if sweep.samples_in(part) < FEWEST_SAMPLES:
        return 0.0, math.inf
    speed, drive_V, scatter = sweep.weighed(part, motor)
    return drive_V - speed / motor.motor.K_rad_s_V, max(noise_rad * scatter, 1e-9)


def _over_position(profiles: Sequence[tuple[Array, Array]], level_V: float) -> tuple[list[float], list[float], Array]:
    """The mean profile about ``level_V``, its standard errors, and the profile alone.

    Sweeps count by their noise. Where they scatter more than that, all errors grow by as much (Birge 1932).
    """
    values = np.array([profile for profile, _ in profiles])
    weights = np.array([1.0 / errors**2 for _, errors in profiles])
    total = weights.sum(axis=0)
    if not np.all(total > 0.0):
        total = np.where(total > 0.0, total, math.nan)
    mean = (weights * values).sum(axis=0) / total
    freedom = max(1.0, (len(profiles) - 1) * values.shape[1] / OVERLAP)
    ratio = max(1.0, math.sqrt(float(np.nansum(weights * (values - mean) ** 2)) / OVERLAP / freedom))
    return (level_V + mean).tolist(), (ratio / np.sqrt(total)).tolist(), mean


def _with_scatter(
    speeds: Sequence[MapSpeed], profiles: dict[float, list[tuple[Array, Array]]], means: dict[float, Array]
) -> list[MapSpeed]:
    """Errors of the sweeps with what their parts scatter about the mean profile beyond the noise."""
    left = {way: list(found) for way, found in profiles.items()}
    out = []
    for one in speeds:
        if one.sticks:
            out.append(one)
            continue
        way = math.copysign(1.0, one.speed_rad_s)
        values, errors = left[way].pop(0)
        known = np.isfinite(errors)
        excess = float(np.mean((values - means[way])[known] ** 2 - errors[known] ** 2)) if known.any() else 0.0
        further = max(excess, 0.0) * OVERLAP / max(1, int(known.sum()))
        out.append(MapSpeed(one.speed_rad_s, one.drive_V, math.sqrt(one.error_V**2 + further), False))
    return out


def _sweeps(survey: TimeSeries, yd_rad: Array, delay_s: float) -> Iterator[_Sweep]:
    """The steady stretches of the reference, each without the time in which the motion settles."""
    t = survey.t_s
    edge_s = t + delay_s if survey.t_u_s is None else survey.t_u_s
    speed = np.diff(yd_rad) / np.diff(t)
    travel = float(np.ptp(yd_rad))
    steady = np.abs(np.diff(speed)) <= STEADY * np.abs(speed[1:]) + 1e-4 * np.abs(speed).max()
    cuts = np.flatnonzero(~steady) + 1
    before_s = float(t[0])
    for first, stop in zip(np.append(0, cuts + 1), np.append(cuts, t.size - 1), strict=True):
        if stop - first < FEWEST_SAMPLES:
            continue
        rows = slice(int(first), int(stop) + 1)
        way = yd_rad[rows][-1] - yd_rad[rows][0]
        v = way / (t[stop] - t[first])
        bent = np.abs(yd_rad[rows] - yd_rad[first] - v * (t[rows] - t[first])).max()
        if abs(way) < LEAST_WAY * travel or bent > STRAIGHT * abs(way):
            continue
        turn_s = 0.5 * (float(t[first]) - before_s)
        before_s = float(t[stop])
        begin = (
            int(np.searchsorted(t, t[first] + SETTLE_TURNS * turn_s)) if turn_s < 0.3 * (t[stop] - t[first]) else first
        )
        rows = slice(int(begin), int(stop) + 1)
        yield _Sweep(
            float(v), t[rows], survey.y_rad[rows] - yd_rad[rows], yd_rad[rows], *_drive_in(survey, edge_s, rows)
        )


def _drive_in(survey: TimeSeries, edge_s: Array, rows: slice) -> tuple[Array, Array]:
    """Edges and drives that act within the rows; the first one from the first row's time on."""
    begin_s, end_s = survey.t_s[rows.start], survey.t_s[rows.stop - 1]
    first = max(0, int(np.searchsorted(edge_s, begin_s, side="right")) - 1)
    stop = int(np.searchsorted(edge_s, end_s))
    edges = edge_s[first:stop].copy()
    edges[0] = min(max(edges[0], begin_s), end_s)
    return edges, survey.u_V[first:stop]
