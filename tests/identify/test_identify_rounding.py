"""A sensor's rounding scatters a fit as it does over all ways in which its steps may lie to the shaft."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import Bench, dcr, motor, record, simulate

from rig.identification.departures.fit import CORE, Fit, Problem, limits_of, solve, start, unit
from rig.identification.departures.nuisances import OF
from rig.identification.departures.pieces import Cut
from rig.identification.departures.rounding import by_rounding
from rig.model.real_motor import RealMotor
from rig.run_folder.recording.series import TimeSeries

STEP_RAD = 2.0 * math.pi / 1024
PHASES = 40
AT = [CORE.index(name) for name in OF]


def fitted(test: TimeSeries, y_rad: np.ndarray) -> Fit:
    cut = Cut.whole([replace(test, y_rad=y_rad)], 0.01).every(1.1)
    problem = Problem(cut, CORE, limits_of(CORE, cut, (0.0, 0.0)), STEP_RAD / math.sqrt(12.0))
    return solve(start(problem, RealMotor(0.17, 6.5, 0.5)))


def variances(fit: Fit) -> np.ndarray:
    """Of the three numbers, for noise that is new in each row."""
    rows = fit.problem.rows(fit.motor, fit.starts)
    left = rows.by_number.copy()
    begins = fit.problem.cut.begins.tolist()
    for first, stop in zip(begins, [*begins[1:], len(left)], strict=True):
        own = rows.by_start[first:stop]
        left[first:stop] -= own @ np.linalg.lstsq(own, left[first:stop], rcond=None)[0]
    return np.asarray(np.diag(np.linalg.inv(left.T @ left))[AT] * unit(fit))


def test_the_scatter_by_rounding_is_that_over_all_places_of_the_steps() -> None:
    """Cycles that come again: to take each row for new makes the intervals much too narrow."""
    square = simulate(motor(), lambda t_s, _y, _z: 1.2 if t_s % 1.2 < 0.6 else -1.2, 1080, Bench())
    test = record(square, True, 120)
    fits = []
    for phase in np.arange(PHASES) / PHASES:
        y_rad = (np.round(test.y_rad / STEP_RAD + phase) - phase) * STEP_RAD
        fits.append(fitted(test, y_rad))
    numbers = np.array([[math.log(f.motor.tau_s), math.log(f.motor.K_rad_s_V), f.motor.fc_V] for f in fits])
    seen = numbers.var(axis=0)
    as_new = np.mean([variances(fit) for fit in fits], axis=0)
    told = np.mean([by_rounding(fit, STEP_RAD)[AT] for fit in fits], axis=0)
    assert np.sqrt(told) == pytest.approx(np.sqrt(np.maximum(seen / as_new, 1.0)), rel=0.25)
    assert math.sqrt(told.max()) > 2.0


def test_noise_of_half_a_step_leaves_nothing_of_it_and_so_does_a_step_that_is_not_known() -> None:
    test = record(simulate(motor(), dcr(0.8, 1.0), 500, Bench(noise_rad=0.6 * STEP_RAD, lsb_rad=STEP_RAD)), True, 100)
    fit = fitted(test, test.y_rad)
    assert by_rounding(fit, STEP_RAD) == pytest.approx(1.0, abs=0.05)
    assert np.all(by_rounding(fit, 0.0) == 1.0)
