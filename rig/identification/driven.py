"""One estimate of everything driven: tests, and beside them breakaway check and gain search (docs/theory.md 7.11).

The tests' own estimate comes first. Where these hold a limit cycle, it is the surest start, and its covariance knows
what comes again in each cycle. The records beside them are then fitted as pieces, with that estimate as what is known
beforehand: so both together are the most likely motor. A piece that a motor of the tests cannot have made is left out,
with all that follows it in its record. If the records say another motor than the tests, the tests' estimate stays, and
says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.identification.chance import student_975
from rig.identification.departures.fit import (
    CORE,
    DELAY,
    POSITIVE,
    Fit,
    Known,
    Normal,
    Problem,
    limits_of,
    refitted,
    solve,
)
from rig.identification.departures.fit import start as begin
from rig.identification.departures.pieces import Cut
from rig.identification.estimate import PARAMETERS, Estimate, intervals
from rig.identification.motions import Motion, in_parts, motions
from rig.identification.noise import WHITE, Noise
from rig.identification.opinion import RecordingEstimate, agree, differences, mean_of
from rig.identification.output_error import refit
from rig.model.real_motor import Frame, RealMotor
from rig.model.sensitivity import Theta
from rig.run_folder.recording.series import TimeSeries, Window, noise_of_all_rad, spread_rad
from rig.run_folder.recording.stage import StageKind

PART_S = 3.0  # of a motion at first: over so little of it a fit finds its valley, and errors of the model do not add up
GROWN = 3.0  # standard deviations by which the squares may grow from parts to whole motions for these to be fitted
FEWEST_ROWS = 40  # in motion
STRANGE = 2.5  # RMS residual of a piece over that of the tests from which on the piece shows another motor
NOTICED = 1.05  # variance of the records' residual over that of the tests from which on they weigh less
VAGUE = 0.15  # standard error, relative, from which on records are not compared with the tests
EXPLAINED = 0.001  # probability from which on chance explains a difference
STAGE_ERROR = 0.005  # of each parameter: what a plain motor may leave out in one stage of a run
EXACT = 1e-6  # residual over the spread of positions below which there is no noise to weigh records by


class Together(NamedTuple):
    """What all records say.

    estimate    of all of them; of the tests alone where the others say another motor, or nothing
    remarks     which records count, up to which row
    objections  why the records do not belong together
    """

    estimate: Estimate
    remarks: tuple[str, ...] = ()
    objections: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Sensor:
    """Noise of a moving reading, and its step, rad; noise that wanders."""

    noise_rad: float
    lsb_rad: float
    wander: Noise

    @classmethod
    def of(cls, estimate: Estimate, tests: Sequence[TimeSeries]) -> _Sensor:
        """As the tests show it: their residual is noise, and all that a plain motor leaves out."""
        shown = noise_of_all_rad(tests)
        wander = WHITE if estimate.coloured is None else Noise(estimate.coloured[0], estimate.coloured[1] ** 2)
        white = estimate.rms_rad / math.sqrt(1.0 + wander.ratio)
        return cls(max(shown, white), max(test.resolution_rad() for test in tests), wander)


def together(estimate: Estimate, tests: Sequence[TimeSeries], beside: Sequence[TimeSeries]) -> Together:
    """The tests' ``estimate`` and the records ``beside`` them as one estimate.

    A gain search that stands for tests is itself cut into its motions: its estimate is only where the fit starts.
    """
    usable = estimate.verdict != "refused" and bool(np.all(np.isfinite(estimate.covariance)))
    if not usable or not estimate.fc_V > 0.0 or estimate.rms_rad < EXACT * spread_rad(_whole(tests)):
        return Together(estimate)
    latest_s = max(test.longest_delay_s for test in tests) if estimate.fits_delay else 0.0
    is_search = all(test.stage is not None and test.stage.kind is StageKind.SEARCH for test in tests)
    sensor = _Sensor.of(estimate, tests)
    series = [*tests, *beside] if is_search else beside
    windows = [one.predictable(latest_s) for one in series if _long_enough(one, latest_s)]
    found = [_parts(window, sensor) for window in windows]
    remarks: list[str] = []
    while sum(motion.stop - motion.first for each in found for motion in each) >= FEWEST_ROWS:
        windows, found = _moving(windows, found)
        fit = _fit(estimate, windows, found, sensor, known=False)
        others = None if is_search else _opinion(fit)
        if others is None and not is_search:  # they say too little by themselves
            fit = _fit(estimate, windows, found, sensor, known=True)
        strange = _strange(fit, windows, found, sensor)
        if strange is None:
            whole = [motions(window, sensor.noise_rad, sensor.lsb_rad, through=True) for window in windows]
            longer = None if remarks else _fit(estimate, windows, whole, sensor, known=fit.problem.known is not None)
            if longer is not None and bears(longer, fit):
                fit, found, others = longer, whole, None if others is None else _opinion(longer)
            if others is None:
                return Together(_joined(estimate, fit, tests), tuple(remarks))
            odd = _difference(estimate, others)
            if odd is not None:
                return Together(estimate, (*remarks, *odd.remarks), odd.objections)
            fit = _fit(estimate, windows, found, sensor, known=True)
            return Together(_joined(estimate, fit, tests), tuple(remarks))
        k, motion, rms_rad = strange
        row = windows[k].series.first_row + windows[k].first + motion.first
        remarks.append(
            f"{windows[k].series.name}: not in the plain motor's fit from row {row} on: there the residual is "
            f"{1e3 * rms_rad:.2g} mrad, of noise it would be {1e3 * sensor.noise_rad:.2g} mrad"
        )
        found[k] = [one for one in found[k] if one.stop <= motion.first]
    return Together(estimate, tuple(remarks))


def bears(longer: Fit, parts: Fit) -> bool:
    """Whether the motor bears the longer pieces: their squares are what the noise of the parts lets expect."""
    cost = parts.cost * (parts.problem.sigma_rad / longer.problem.sigma_rad) ** 2
    variance = max(cost / max(parts.problem.cut.freedom, 1), 1.0)
    added = longer.problem.cut.freedom - parts.problem.cut.freedom
    return longer.cost <= cost + variance * (added + GROWN * math.sqrt(2.0 * max(added, 1)))


def _whole(tests: Sequence[TimeSeries]) -> list[Window]:
    return [Window(test, 0, len(test)) for test in tests]


def _long_enough(series: TimeSeries, latest_s: float) -> bool:
    return len(series) - int(np.searchsorted(series.t_s, series.edge_s[0] + latest_s)) >= FEWEST_ROWS


def _moving(windows: Sequence[Window], found: Sequence[list[Motion]]) -> tuple[list[Window], list[list[Motion]]]:
    """Only the windows that have motions."""
    return [w for w, each in zip(windows, found, strict=True) if each], [each for each in found if each]


def _parts(window: Window, sensor: _Sensor) -> list[Motion]:
    rows = max(FEWEST_ROWS, round(PART_S / window.period_s))
    return in_parts(motions(window, sensor.noise_rad, sensor.lsb_rad), rows)


def _fit(
    estimate: Estimate,
    windows: Sequence[Window],
    found: Sequence[Sequence[Motion]],
    sensor: _Sensor,
    *,
    known: bool,
) -> Fit:
    """The records as pieces, from the tests' estimate on; ``known``: whether that is known beforehand."""
    free = (*CORE, DELAY) if estimate.fits_delay else CORE
    cut = Cut.of_motions(windows, [Frame()] * len(windows), found)
    values = [estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, estimate.delay_s][: len(free)]
    size = np.array([v if name in POSITIVE else 1.0 for name, v in zip(free, values, strict=True)])
    covariance = estimate.covariance[: len(free), : len(free)] / np.outer(size, size)
    mean = [math.log(v) if name in POSITIVE else v for name, v in zip(free, values, strict=True)]
    series = [window.series for window in windows]
    delay_s = (min(one.earliest_delay_s for one in series), max(one.longest_delay_s for one in series))
    problem = Problem(
        cut,
        free,
        limits_of(free, cut, delay_s),
        sensor.noise_rad,
        noise=sensor.wander,
        known=Known.of(free, mean, covariance) if known else None,
    )
    delay = estimate.delay_s if estimate.fits_delay else 0.0
    motor = RealMotor(estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, delay)
    fit = solve(begin(problem, motor))
    scatter = _own_unit(fit)
    if scatter > NOTICED:  # the records show more than the tests' noise, so they weigh less
        fit = solve(refitted(fit, replace(problem, sigma_rad=sensor.noise_rad * math.sqrt(scatter))))
    return fit


def _strange(
    fit: Fit, windows: Sequence[Window], found: Sequence[Sequence[Motion]], sensor: _Sensor
) -> tuple[int, Motion, float] | None:
    """The motion that fits worst, its window's number, and its RMS residual, rad; None if all fit."""
    at = 0
    worst: tuple[int, Motion, float] | None = None
    level_rad = max(STRANGE * sensor.noise_rad * math.sqrt(1.0 + sensor.wander.ratio), 0.0)
    for k, (window, each) in enumerate(zip(windows, found, strict=True)):
        for motion in each:
            residual = fit.residual_rad[at + motion.first : at + motion.stop]
            rms_rad = float(np.sqrt(np.mean(residual**2)))
            if rms_rad > level_rad:
                worst, level_rad = (k, motion, rms_rad), rms_rad
        at += window.t_s.size
    return worst


def _joined(estimate: Estimate, fit: Fit, tests: Sequence[TimeSeries]) -> Estimate:
    """The estimate with the motor of ``fit``, and the tests predicted with it."""
    problem, motor = fit.problem, fit.motor
    inverse = _covariance(fit)
    size = np.array([getattr(motor, name) if name in POSITIVE else 1.0 for name in problem.free])
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[: size.size, : size.size] = inverse * np.outer(size, size)
    fits_delay = DELAY in problem.free
    theta = Theta(motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V, motor.delay_s if fits_delay else 0.0)
    bounds = (theta.delay_s, max(test.longest_delay_s for test in tests)) if fits_delay else None
    predicted = refit(tests, theta, (), bounds)
    delay_s = motor.delay_s if fits_delay else estimate.delay_s
    values = (motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V, delay_s)
    quantile = student_975(max(1, predicted.residual.size + problem.cut.freedom - size.size))
    ci95 = intervals(values, np.sqrt(np.diag(covariance)).tolist(), quantile)
    if not fits_delay:
        ci95["delay_s"] = estimate.ci95["delay_s"]
        covariance[4, 4] = estimate.covariance[4, 4]
    return replace(
        estimate,
        tau_s=motor.tau_s,
        K_rad_s_V=motor.K_rad_s_V,
        fc_V=motor.fc_V,
        asym_V=motor.bias_V,
        delay_s=delay_s,
        ci95=ci95,
        covariance=covariance,
        rms_rad=predicted.rms_rad,
        iterations=estimate.iterations + len(fit.iterates),
        iterates=np.concatenate((estimate.iterates, fit.iterates)),
        residual_rad=-predicted.residual,
    )


def _own_unit(fit: Fit) -> float:
    """Variance of the whitened residual of the records beside the tests."""
    squares = fit.cost - fit.problem.surprise(fit.motor)
    return squares / max(fit.problem.cut.freedom, 1)


def _covariance(fit: Fit) -> Array:
    """Of the free numbers, with what is known beforehand, (m, m), of the logarithms of tau and K."""
    problem = fit.problem
    normal = Normal.of(replace(problem, known=None).rows(fit.motor, fit.starts), problem.cut)
    matrix = normal.matrix / max(1.0, _own_unit(fit))
    if problem.known is not None:
        at = [problem.free.index(name) for name in problem.known.names]
        matrix[np.ix_(at, at)] += problem.known.root.T @ problem.known.root
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse = np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return np.asarray(inverse * np.outer(scale, scale))


class _Opinion(NamedTuple):
    """What records say by themselves: ln tau, ln K, f_c in V, and their covariance by the noise alone."""

    names: str
    values: Array
    covariance: Array


def _opinion(fit: Fit) -> _Opinion | None:
    """What records say by themselves; None if that is too little to compare."""
    motor, covariance = fit.motor, _covariance(fit)
    names = " and ".join(dict.fromkeys(window.series.name for window in fit.problem.cut.windows))
    errors = np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0)) / [1.0, 1.0, max(motor.fc_V, 1e-12)]
    if not np.all(errors < VAGUE) or not fit.arrived:
        return None
    return _Opinion(names, np.array([math.log(motor.tau_s), math.log(motor.K_rad_s_V), motor.fc_V]), covariance[:3, :3])


class _Difference(NamedTuple):
    remarks: tuple[str, ...]
    objections: tuple[str, ...]


def _difference(estimate: Estimate, others: _Opinion) -> _Difference | None:
    """How records and tests differ, as a sentence; None if chance explains it.

    A plain motor leaves out a little: up to that, the records do not count, and nothing is wrong.
    """

    def both(model_error: float) -> list[RecordingEstimate]:
        tests = RecordingEstimate.of("the tests", estimate, model_error)
        return [] if tests is None else [tests, RecordingEstimate.at(*others, model_error)]

    if not both(0.0) or agree(both(0.0), EXPLAINED):
        return None
    tests, beside = both(STAGE_ERROR)
    said = f"in {others.names} {differences(beside, *mean_of([tests]))}"
    if agree([tests, beside]):
        return _Difference(
            (f"{said}: within what a plain motor leaves out, so the estimate is of the tests alone",), ()
        )
    return _Difference(
        (),
        (
            f"{others.names} and the tests do not agree: {said}; something that a plain motor has not moves the "
            "shaft, or it changed meanwhile: the estimate is of the tests alone",
        ),
    )
