"""The friction map: the drive that a motor takes at each speed and at each position (docs/theory.md 13.3).

It comes from slow sweeps. Each sweep is weighed by windows that rise and fall smoothly. Integrated by parts against
such a window, the equation of the motor needs no derivative of the noisy position: acceleration and speed fall on the
window (modulating functions; Shinbrot 1957, Preisig and Rippin 1993). The result is linear in the readings, so their
noise gives its standard error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.model.real_inverse import drive_for
from rig.model.real_motor import FramedMotor
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.results import FrictionMapResult, MapPositionResult, MapSpeedResult

STEADY = 5e-3  # relative change of the reference's speed from row to row that is none
STRAIGHT = 2e-3  # of its way: the largest distance of a sweep's reference from a straight line
LEAST_WAY = 0.3  # of the reference's whole travel that a sweep passes
SETTLE_TURNS = 0.75  # of the time of a turn: the motion has settled then
POSITIONS = 24
WAYS = (-1.0, 1.0)
FEWEST_SAMPLES = 8  # of a window
LOCAL_SHARE = 0.15  # of a sweep's speed: noise of its local speed
STILL_SHARE = 0.25  # of a sweep's speed: slower counts as sticking
STICKS = 0.05  # of a sweep that sticks: its drive is not the drive of its speed
TAPER = 0.2  # of the travel, over which the weight of a whole sweep rises and falls
KNOWN = 5e-4  # of the drive: no bench knows its drive better
LEVELS_V = 2e-3  # sweeps that are known better than this count alike in the mean over the speeds
OVERLAP = 1.5  # windows of which neighbours share so much count for fewer


@dataclass(frozen=True)
class MapSpeed:
    """A sweep: its speed, rad/s, with its sign; the drive it took, V, with standard error; whether the shaft stuck.

    share  of the sweep in the mean over the speeds of its direction
    """

    speed_rad_s: float
    drive_V: float
    error_V: float
    sticks: bool
    share: float = 0.0


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
        low, high = self.travel_rad
        y_rad = np.linspace(low, high, 8 * POSITIONS + 1)
        weight = np.gradient(_window(y_rad - low, TAPER * (high - low), high - low)[0])
        drive_V = [_steady_V(self.motor, speed_rad_s, y) for y in y_rad.tolist()]
        return float(np.average(drive_V, weights=weight))

    def law_over_position(self, y_rad: float, way: float) -> float:
        """Drive of the law less v/K at a position, V, in the direction ``way``: the mean over the sweeps' speeds."""
        K = self.motor.motor.K_rad_s_V
        low, high = self.travel_rad
        step = (high - low) / (POSITIONS + 1)
        near = np.linspace(-step, step, 9)
        weight = np.gradient(_window(near + step, step, 2.0 * step)[0])
        taken = [one for one in self.speeds if one.share > 0.0 and one.speed_rad_s * way > 0.0]
        local = [
            np.average([_steady_V(self.motor, one.speed_rad_s, y) for y in (y_rad + near).tolist()], weights=weight)
            - one.speed_rad_s / K
            for one in taken
        ]
        return float(np.average(local, weights=[one.share for one in taken]))

    def notes(self) -> list[str]:
        """What there is to know, as sentences."""
        stuck = sorted(abs(one.speed_rad_s) for one in self.speeds if one.sticks)
        if not stuck:
            return []
        words = ", ".join(dict.fromkeys(f"{v:.2g}" for v in stuck))
        return [f"friction map: at {words} rad/s the shaft sticks and slips: the drive there is not of a steady speed"]

    def as_result(self) -> FrictionMapResult:
        """As in result.json."""
        return FrictionMapResult.of(
            self.motor.motor,
            laws=self.motor.parts,
            travel_rad=self.travel_rad,
            speeds=tuple(MapSpeedResult.of(one, law_V=self.law_over_speed(one.speed_rad_s)) for one in self.speeds),
            positions=tuple(
                MapPositionResult.of(
                    one,
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
    whole = _Weight(low, high, TAPER * (high - low))
    step = (high - low) / (POSITIONS + 1)
    parts = [_Weight(low + k * step, low + (k + 2) * step, step) for k in range(POSITIONS)]
    view = _View(whole, tuple(parts), motor, noise_rad)
    (minus, falling), (plus, rising) = (_of_way([s for s in sweeps if s.speed_rad_s * way > 0.0], view) for way in WAYS)
    positions: tuple[MapPosition, ...] = ()
    if minus is not None and plus is not None:
        centres = [0.5 * (part.low_rad + part.high_rad) for part in parts]
        positions = tuple(
            MapPosition(y, a, b, ea, eb)
            for y, a, b, ea, eb in zip(centres, plus[0], minus[0], plus[1], minus[1], strict=True)
        )
    return FrictionMap(motor, (low, high), tuple(sorted(falling + rising, key=lambda s: s.speed_rad_s)), positions)


@dataclass(frozen=True)
class _View:
    """How sweeps are looked at: the window of a whole sweep, those of its parts, the motor, and the noise, rad."""

    whole: _Weight
    parts: tuple[_Weight, ...]
    motor: FramedMotor
    noise_rad: float


def _of_way(sweeps: Sequence[_Sweep], view: _View) -> tuple[tuple[list[float], list[float]] | None, list[MapSpeed]]:
    """Of the sweeps one way: drive less v/K over position and its errors, None if all stuck; and the speeds."""
    K = view.motor.motor.K_rad_s_V
    stuck: list[MapSpeed] = []
    found: list[MapSpeed] = []
    local: list[list[tuple[float, float]]] = []
    for sweep in sweeps:
        speed, drive_V, scatter = sweep.weighed(view.whole, view.motor)
        error_V = math.hypot(view.noise_rad * scatter, KNOWN * drive_V)
        one = MapSpeed(speed, drive_V, error_V, sweep.sticks(view.noise_rad))
        if one.sticks:
            stuck.append(one)
        else:
            found.append(one)
            local.append([_of_part(sweep, part, view, drive_V - speed / K) for part in view.parts])
    if not found:
        return None, stuck
    profile = _profile(np.array(local))
    errors = np.hypot([one.error_V for one in found], profile.further_V)
    weight = 1.0 / (errors**2 + LEVELS_V**2)
    share = weight / weight.sum()
    level_V = float(share @ np.array([one.drive_V - one.speed_rad_s / K for one in found]))
    level_error_V = float(np.sqrt(share**2 @ errors**2))
    found = [
        replace(one, error_V=error, share=part)
        for one, error, part in zip(found, errors.tolist(), share.tolist(), strict=True)
    ]
    return ((level_V + profile.mean_V).tolist(), np.hypot(profile.error_V, level_error_V).tolist()), stuck + found


def _of_part(sweep: _Sweep, part: _Weight, view: _View, level_V: float) -> tuple[float, float]:
    """Drive less v/K in a part of a sweep about the whole sweep's, V, and its standard error.

    It is infinite where there are too few samples.
    """
    if sweep.samples_in(part) < FEWEST_SAMPLES:
        return 0.0, math.inf
    speed, drive_V, scatter = sweep.weighed(part, view.motor)
    error_V = math.hypot(view.noise_rad * scatter, KNOWN * drive_V)
    return drive_V - speed / view.motor.motor.K_rad_s_V - level_V, error_V


class _Profile(NamedTuple):
    """The mean profile over position, its standard errors, and what each sweep scatters about it beyond noise, V."""

    mean_V: Array
    error_V: Array
    further_V: Array


def _profile(local: Array) -> _Profile:
    """The mean of the sweeps' profiles; ``local`` is (sweeps, positions, 2): drive and standard error, V.

    Sweeps count by their noise. Where they scatter more than that, all errors grow by as much (Birge 1932).
    """
    values, weights = local[:, :, 0], 1.0 / local[:, :, 1] ** 2
    total = np.maximum(weights.sum(axis=0), 1e-12)
    mean = (weights * values).sum(axis=0) / total
    count, places = values.shape
    squares = float(np.sum(weights * (values - mean) ** 2))
    ratio = math.sqrt(max(1.0, squares / max(1.0, (count - 1) * places)))
    further = np.zeros(count)
    for k in range(count if count > 1 else 0):
        others = np.maximum(total - weights[k], 1e-12)
        seen = (weights[k] > 0.0) & (others > 1e-9)
        off = values[k] - (total * mean - weights[k] * values[k]) / others
        expected = (1.0 / np.maximum(weights[k], 1e-12) + 1.0 / others)[seen]
        precision = float(np.sum(expected**-2.0))
        if precision > 0.0:
            excess = float(np.sum((off[seen] ** 2 - expected) / expected**2)) / precision
            excess -= 3.0 * math.sqrt(2.0 * OVERLAP / precision)  # what noise alone may show
            further[k] = math.sqrt(max(excess, 0.0) * OVERLAP / expected.size)
    return _Profile(mean, ratio / np.sqrt(total), further)


def _sweeps(survey: TimeSeries, yd_rad: Array, delay_s: float) -> Iterator[_Sweep]:
    """The steady stretches of the reference, each without the time in which the motion settles."""
    t = survey.t_s
    edge_s = t + delay_s if survey.t_u_s is None else survey.t_u_s
    found = _straight(t, yd_rad)
    turns_s = [0.5 * float(t[after[0]] - t[before[1]]) for before, after in pairwise(found)]
    settle_s = SETTLE_TURNS * min(turns_s, default=0.0)
    for first, last in found:
        v = float((yd_rad[last] - yd_rad[first]) / (t[last] - t[first]))
        rows = slice(int(np.searchsorted(t, t[first] + settle_s)), last + 1)
        if rows.stop - rows.start > FEWEST_SAMPLES:
            error = survey.y_rad[rows] - yd_rad[rows]
            yield _Sweep(v, t[rows], error, yd_rad[rows], *_drive_in(survey, edge_s, rows))


def _straight(t_s: Array, yd_rad: Array) -> list[tuple[int, int]]:
    """First and last rows of the stretches in which the reference has a constant speed over much of its travel."""
    speed = np.diff(yd_rad) / np.diff(t_s)
    travel = float(np.ptp(yd_rad))
    steady = np.abs(np.diff(speed)) <= STEADY * np.abs(speed[1:]) + 1e-4 * np.abs(speed).max()
    cuts = np.flatnonzero(~steady) + 1
    found = []
    for first, last in zip(np.append(0, cuts).tolist(), np.append(cuts, t_s.size - 1).tolist(), strict=True):
        y, t = yd_rad[first : last + 1], t_s[first : last + 1]
        way = float(y[-1] - y[0])
        if last - first < FEWEST_SAMPLES or abs(way) < LEAST_WAY * travel:
            continue
        bent = np.abs(y - y[0] - way * (t - t[0]) / (t[-1] - t[0])).max()
        if bent <= STRAIGHT * abs(way):
            found.append((first, last))
    return found


def _drive_in(survey: TimeSeries, edge_s: Array, rows: slice) -> tuple[Array, Array]:
    """Edges and drives that act within the rows; the first one from the first row's time on."""
    begin_s, end_s = survey.t_s[rows.start], survey.t_s[rows.stop - 1]
    first = max(0, int(np.searchsorted(edge_s, begin_s, side="right")) - 1)
    stop = int(np.searchsorted(edge_s, end_s))
    edges = edge_s[first:stop].copy()
    edges[0] = min(max(edges[0], begin_s), end_s)
    return edges, survey.u_V[first:stop]
