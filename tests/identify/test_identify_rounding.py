"""A sensor's rounding scatters a fit as it does over all ways in which its steps may lie to the shaft."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import Bench, motor, record, simulate

from rig.identification import sampled_data
from rig.identification.departures.budget import TYPE_A
from rig.identification.departures.choice import WITHIN_STEP
from rig.identification.departures.fit import CORE, Fit, Problem, limits_of, solve, start, unit
from rig.identification.departures.nuisances import OF
from rig.identification.departures.pieces import Cut
from rig.identification.departures.rounding import by_neighbours, by_rounding
from rig.identification.motions import repeats
from rig.identification.motor_law import motor_law
from rig.identification.noise import Noise
from rig.model.real_motor import Frame, RealMotor
from rig.run_folder.recording.series import TimeSeries, Window
from shared.pieces import Pieces, response

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
    rows = fit.rows
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


def test_the_rounding_of_cycles_of_a_whole_number_of_rows_is_no_law() -> None:
    """It repeats in each cycle as a wave would: it asked for a cogging and a drag, and tau was 17 % off."""
    rows = np.arange(2400)
    t_s: np.ndarray = 0.01 * rows
    u_V: np.ndarray = np.where(rows < 1200, 1.6, 1.1) * np.where(rows // 40 % 2, -1.0, 1.0)
    y_rad = response(RealMotor(0.17, 6.5, 0.5), Frame(duration_s=24.0), (t_s + 0.002, u_V), t_s, Pieces.one())
    step_rad = 2.0 * math.pi / 256
    test = TimeSeries(t_s, step_rad * np.floor(y_rad / step_rad + 0.3), None, u_V)
    assert motor_law([test], sampled_data.fit([test]), [None]).found == ()


ROWS = np.arange(600)
T_S = np.asarray(0.005 * np.arange(2400), dtype=np.float64)


def seen(true_rad: np.ndarray, noise_steps: float = 0.0) -> Window:
    """A shaft at 5 ms behind the sensor."""
    noise = noise_steps * np.random.default_rng(1).standard_normal(true_rad.size)
    y_rad = STEP_RAD * np.round(true_rad / STEP_RAD + noise)
    return Window(TimeSeries(T_S[:600], y_rad, T_S[:600], np.zeros(600)), 0, 600)


def test_of_a_reading_at_rest_the_first_row_and_the_last_count() -> None:
    """The shaft turns, rests for 400 rows, and turns on."""
    turned = STEP_RAD * np.interp(ROWS, [0, 100, 500, 599], [0.0, 50.2, 50.2, 99.7])
    window = seen(turned)
    rests = np.flatnonzero(repeats(window))
    assert rests.size >= 396 and np.all(np.diff(rests) == 1)
    assert np.ptp(window.y_rad[rests[0] - 1 : rests[-1] + 2]) == 0.0
    assert not repeats(seen(turned, 0.5)).any()  # noise dithers the steps: there each row says more
    slow = STEP_RAD * ROWS / 60.0  # the shaft slides: 60 rows, 0.3 s, in each step
    assert not repeats(seen(slow)).any()


def test_rows_that_do_not_count_change_no_fit_and_no_noise() -> None:
    window = seen(STEP_RAD * np.interp(ROWS, [0, 100, 500, 599], [0.0, 50.2, 50.2, 99.7]))
    cut = Cut.whole([window.series], 0.0).rests_once().every(1.0)
    assert cut.weight is not None and cut.freedom < 250
    problem = Problem(cut, CORE, {}, 0.001, noise=Noise(0.1, 4.0))
    off = np.random.default_rng(2).standard_normal(600)
    wild = np.where(cut.weight > 0.0, off, 1e3)
    assert np.array_equal(problem.whitened(off), problem.whitened(wild))
    assert cut.noise_of(off) == cut.noise_of(wild)
    for one in (problem, replace(problem, noise=Noise(), robust_rad=1.0)):
        assert one.cost(off, RealMotor(0.1, 5.0, 0.5)) == one.cost(wild, RealMotor(0.1, 5.0, 0.5))


def test_rests_that_are_one_chance_scatter_a_fit_less_and_leave_it_within_the_steps() -> None:
    """Each rest of 150 rows repeats one error of rounding: as so many rows they asked for a cogging of 18 mV."""
    u_V = np.repeat([0.0, 3.0, 0.0, 6.0, 0.0, 9.0, 0.0, -3.0, 0.0, -6.0, 0.0, -9.0], 200)
    true = RealMotor(0.12, 4.2, 0.9)
    y_rad = response(true, Frame(duration_s=12.0), (T_S, u_V), T_S, Pieces.one())
    test = TimeSeries(T_S, y_rad, T_S, u_V)
    cuts = [Cut.whole([replace(test, y_rad=rounded(test, phase))], 0.0).rests_once() for phase in np.arange(8) / 8]

    def fits(cuts: list[Cut]) -> list[Fit]:
        limits, sigma_rad = limits_of(CORE, cuts[0], (0.0, 0.0)), STEP_RAD / math.sqrt(12.0)
        return [solve(start(Problem(cut, CORE, limits, sigma_rad), true)) for cut in cuts]

    once, as_rows = fits(cuts), fits([replace(cut, weight=None) for cut in cuts])
    for name in ("tau_s", "K_rad_s_V", "fc_V", "bias_V"):
        of_once, of_rows = (np.std([getattr(fit.motor, name) for fit in every]) for every in (once, as_rows))
        assert of_once < 0.75 * of_rows, name
    assert max(float(np.abs(fit.residual_rad).max()) for fit in once) < WITHIN_STEP * STEP_RAD
    assert max(float(np.abs(fit.residual_rad).max()) for fit in as_rows) > WITHIN_STEP * STEP_RAD


def test_the_sum_of_noisy_velocities_scatters_a_fit_as_is_said() -> None:
    """Each sample's noise is in two steps of the sum: tau of a tachometer's log scattered by 1.5 times its interval."""
    test = square()
    cut = Cut.whole([test], 0.01)
    fits = []
    for seed in range(PHASES):
        noise = 0.1 * np.random.default_rng(seed).standard_normal(test.y_rad.size)
        walk_rad = 0.5 * test.period_s * np.cumsum(noise + np.append(0.0, noise[:-1]))
        given = Cut.whole([replace(test, y_rad=test.y_rad + walk_rad)], 0.01)
        problem = Problem(given, CORE, limits_of(CORE, cut, (0.0, 0.0)), 1e-3, noise=Noise(1e3, 1e6))
        fits.append(solve(start(problem, RealMotor(0.17, 6.5, 0.5))))
    numbers = np.array([[math.log(f.motor.tau_s), math.log(f.motor.K_rad_s_V), f.motor.fc_V] for f in fits])
    as_white = np.mean([variances(fit) for fit in fits], axis=0)
    told = np.mean([by_neighbours(fit)[AT] for fit in fits], axis=0)
    assert np.sqrt(told) == pytest.approx(np.sqrt(numbers.var(axis=0) / as_white), rel=0.25)
    assert told.min() > 1.5
    assert np.all(by_neighbours(fitted(test, rounded(test, 0.3))) == 1.0)
