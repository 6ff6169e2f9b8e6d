"""A sensor's rounding scatters a fit as it does over all ways in which its steps may lie to the shaft."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import Bench, motor, record, simulate

from rig.identification import sampled_data
from rig.identification.departures.budget import TYPE_A
from rig.identification.departures.fit import CORE, Fit, Problem, limits_of, solve, start, unit
from rig.identification.departures.nuisances import OF
from rig.identification.departures.pieces import Cut
from rig.identification.departures.rounding import by_rounding
from rig.identification.motor_law import motor_law
from rig.model.real_motor import RealMotor
from rig.run_folder.recording.series import TimeSeries

STEP_RAD = 2.0 * math.pi / 1024
PHASES = 40
AT = [CORE.index(name) for name in OF]


def square() -> TimeSeries:
    """Cycles of a whole number of rows."""
    drawn = simulate(motor(), lambda t_s, _y, _z: 1.2 if t_s % 1.2 < 0.6 else -1.2, 1080, Bench())
    return record(drawn, True, 120)


def rounded(test: TimeSeries, phase: float) -> np.ndarray:
    return np.asarray((np.round(test.y_rad / STEP_RAD + phase) - phase) * STEP_RAD)


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
    test = square()
    fits = [fitted(test, rounded(test, phase)) for phase in np.arange(PHASES) / PHASES]
    numbers = np.array([[math.log(f.motor.tau_s), math.log(f.motor.K_rad_s_V), f.motor.fc_V] for f in fits])
    seen = numbers.var(axis=0)
    as_new = np.mean([variances(fit) for fit in fits], axis=0)
    told = np.mean([by_rounding(fit, STEP_RAD)[AT] for fit in fits], axis=0)
    assert np.sqrt(told) == pytest.approx(np.sqrt(np.maximum(seen / as_new, 1.0)), rel=0.25)
    assert math.sqrt(told.max()) > 2.0


def test_noise_of_half_a_step_leaves_nothing_of_it_and_so_does_a_step_that_is_not_known() -> None:
    test = square()
    noise_rad = 0.6 * STEP_RAD * np.random.default_rng(1).standard_normal(test.y_rad.size)
    fit = fitted(test, rounded(replace(test, y_rad=test.y_rad + noise_rad), 0.3))
    assert by_rounding(fit, STEP_RAD) == pytest.approx(1.0, abs=0.05)
    assert np.all(by_rounding(fit, 0.0) == 1.0)


def test_the_answer_counts_it(monkeypatch: pytest.MonkeyPatch) -> None:
    test = square()
    test = replace(test, y_rad=rounded(test, 0.3))
    plain = sampled_data.fit([test])

    def scatter() -> list[float]:
        (line,) = (one for one in motor_law([test], plain, [None]).budget.entries if one.source == TYPE_A)
        return [getattr(line, name) for name in OF]

    told = scatter()
    monkeypatch.setattr("rig.identification.motor_law.by_rounding", lambda fit, _: np.ones(len(fit.problem.free)))
    assert max(np.divide(told, scatter())) > 1.5
