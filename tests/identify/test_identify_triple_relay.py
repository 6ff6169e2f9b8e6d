"""The triple-relay estimator: exact on exact data from bad guesses, and as good as sampling lets it be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import LSB_RAD, Bench, dcr, motor, record, simulate

from rig.identify import triple_relay
from rig.identify.cycles import find_cycle
from rig.identify.record import IdentifyError
from rig.identify.sampled_data import Start, ridge_starts
from rig.identify.triple_relay import Features, residuals, solve
from rig.model.limit_cycle import limit_cycle

TRUTH = (0.17, 6.5, 0.5)


def exact(tau=0.17, K=6.5, fc=0.5, h1=0.8, h2=1.0) -> Features:
    cycle = limit_cycle(tau, K, fc, h1, h2)
    return Features(*cycle.durations_s, float(cycle.states[1, 1]), float(cycle.states[0, 1]))


def test_the_truth_has_no_residual_and_anything_else_has():
    assert residuals(Start(*TRUTH), exact(), 0.8, 1.0) == pytest.approx(0.0, abs=1e-12)
    for k in range(3):
        wrong = list(TRUTH)
        wrong[k] *= 1.1
        assert np.abs(residuals(Start(*wrong), exact(), 0.8, 1.0)).max() > 1e-3


@pytest.mark.parametrize("guess", [(0.1, 3.0, 0.2), (0.3, 4.0, 0.3), (0.05, 20.0, 0.7), (0.5, 2.0, 0.0)])
def test_exact_data_give_the_motor_to_eight_digits_from_bad_guesses(guess):
    fit = solve(exact(), 0.8, 1.0, [Start(*guess)])
    assert fit.theta == pytest.approx(TRUTH, rel=1e-8)
    assert fit.iterates[0] == pytest.approx(guess)
    assert fit.iterates[-1] == pytest.approx(TRUTH)
    assert len(fit.iterates) < 30


@settings(max_examples=25, deadline=None)
@given(st.floats(0.08, 0.5), st.floats(1.0, 20.0), st.floats(0.1, 0.5), st.floats(0.3, 1.0), st.floats(0.4, 1.0))
def test_the_ridge_of_the_describing_function_starts_it_everywhere_on_the_grid(tau, K, fc, beyond, share):
    h2 = fc + beyond
    h1 = share * h2
    cycle = limit_cycle(tau, K, fc, h1, h2)
    starts = ridge_starts(2.0 * np.pi / cycle.period_s, cycle.amplitude_rad, h1, h2)
    assert solve(exact(tau, K, fc, h1, h2), h1, h2, starts).theta == pytest.approx((tau, K, fc), rel=1e-7)


def test_it_is_as_ill_conditioned_in_time_as_the_theory_says():
    features = exact()
    late = features._replace(t1_s=features.t1_s + 0.001, t2_s=features.t2_s - 0.001)
    wrong = np.array(solve(late, 0.8, 1.0, [Start(*TRUTH)]).theta) / TRUTH - 1.0
    assert np.all((np.abs(wrong) > 0.07) & (np.abs(wrong) < 0.15))
    larger = features._replace(y_extremum_rad=1.03 * features.y_extremum_rad, y_rc_rad=1.03 * features.y_rc_rad)
    assert solve(larger, 0.8, 1.0, [Start(*TRUTH)]).theta == pytest.approx((0.17, 6.5 * 1.03, 0.5), rel=1e-6)


def test_edges_in_the_wrong_order_are_refused():
    with pytest.raises(IdentifyError, match="order"):
        solve(exact()._replace(t1_s=-0.01), 0.8, 1.0, [Start(*TRUTH)])


def test_sampled_at_a_fifth_of_a_millisecond_it_is_good_to_about_a_percent():
    cycle = find_cycle(record(simulate(motor(), dcr(0.8, 1.0), 50_000, Bench(period_s=0.0002, delay_s=0.0))))
    found = triple_relay.fit(cycle)
    error = np.array([found.tau_s, found.K_rad_s_V, found.fc_V]) / TRUTH - 1.0
    assert np.abs(error).max() < 0.02


def test_at_ten_milliseconds_it_is_a_reference_and_no_more_and_its_scatter_says_so():
    errors, halves = [], []
    for seed in range(6):
        bench = Bench(delay_s=0.004, noise_rad=0.003, lsb_rad=LSB_RAD, seed=seed)
        cycle = find_cycle(record(simulate(motor(), dcr(0.5, 1.2), 2500, bench)))
        found = triple_relay.fit(cycle)
        errors.append(abs(found.tau_s / 0.17 - 1.0))
        low, high = found.ci95["tau_s"]
        halves.append(0.5 * (high - low) / 0.17)
        assert found.rows == cycle.rows
        assert found.iterates.shape[1] == 3
    assert 1e-4 < np.median(errors) < 0.25
    assert 0.005 < np.median(halves) < 0.5
