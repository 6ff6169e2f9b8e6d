"""The random experiments: the same whoever draws them, inside their ranges, of docs/theory.md 7.10's shape."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.campaign import random_motors
from rig.campaign.random_motors import CampaignError
from rig.config import Campaign
from rig.config.campaign import CampaignMotor, CampaignRelay, CampaignSampling, CampaignSensor, CorrelatedNoise
from rig.model.describing_function import predict

GRID = Campaign(name="grid", experiments=1)


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 10**7), st.integers(0, 2**31 - 1))
def test_every_draw_is_of_the_grid(number: int, seed: int) -> None:
    one = random_motors.draw(Campaign(name="grid", experiments=1, seed=seed), number)
    assert 0.08 <= one.tau_s <= 0.5
    assert 0.1 <= one.fc_V <= 0.5
    assert 0.3 <= one.h2_V - one.fc_V <= 1.0
    assert 0.4 <= one.h1_V / one.h2_V <= 1.0
    assert abs(one.asym_V) <= 0.05
    assert abs(one.offset_rad) <= 0.05
    assert 0.0005 <= one.delay_s <= 0.0095
    sine = predict(one.tau_s, one.K_rad_s_V, one.fc_V, one.h1_V, one.h2_V)
    assert sine.amplitude_rad == pytest.approx(0.8)
    assert sine.period_s == pytest.approx(one.period_s)
    assert sine.period_s >= 0.3


def test_draws_fill_the_grid() -> None:
    ones = [random_motors.draw(GRID, k) for k in range(400)]
    thirds = [np.histogram([one.fc_V for one in ones], 3, (0.1, 0.5))[0]]
    thirds += [np.histogram([math.log(one.tau_s) for one in ones], 3, (math.log(0.08), math.log(0.5)))[0]]
    assert np.min(thirds) > 60
    assert len({one.K_rad_s_V for one in ones}) == 400


def test_an_experiment_does_not_depend_on_the_others_or_on_what_disturbs_it() -> None:
    forwards = [random_motors.draw(GRID, k) for k in range(5)]
    backwards = [random_motors.draw(GRID, k) for k in reversed(range(5))]
    assert forwards == backwards[::-1]
    noisy = GRID.model_copy(update={"sensor": CampaignSensor(noise_rad=0.01, lsb_rad=0.0), "experiments": 99})
    assert [random_motors.draw(noisy, k) for k in range(5)] == forwards
    assert random_motors.draw(GRID.model_copy(update={"seed": 2}), 0) != forwards[0]


def test_streams_are_independent() -> None:
    names = random_motors.STREAMS
    draws = [random_motors.stream(GRID, k, name).standard_normal(4000) for k in range(3) for name in names]
    correlation = np.corrcoef(draws) - np.eye(len(draws))
    assert np.abs(correlation).max() < 5.0 / math.sqrt(4000)


def test_one_experiment_is_simulated_twice_alike_and_its_second_test_otherwise() -> None:
    campaign = GRID.model_copy(update={"relay": CampaignRelay(second={"amplitude_ratio": 0.75}, cycles=4)})
    one = random_motors.draw(campaign, 7)
    (first, rows), (again, _) = random_motors.simulate(campaign, one), random_motors.simulate(campaign, one)
    second, second_rows = random_motors.simulate(campaign, one, second=True)
    assert np.array_equal(first.y_rad, again.y_rad)
    assert np.array_equal(first.t_u_s, again.t_u_s)
    assert np.ptp(second.y_rad[second_rows]) == pytest.approx(0.75 * np.ptp(first.y_rad[rows]), rel=0.1)
    h1, h2 = one.second_gains(0.75)
    sine = predict(one.tau_s, one.K_rad_s_V, one.fc_V, h1, h2)
    assert (sine.period_s, sine.amplitude_rad) == pytest.approx((one.period_s, 0.6))


@pytest.mark.parametrize("number", range(6))
def test_the_record_holds_the_cycles_that_were_asked_for(number: int) -> None:
    campaign = Campaign(name="grid", experiments=1, relay=CampaignRelay(settling_cycles=5, cycles=8))
    test, rows = random_motors.simulate(campaign, random_motors.draw(campaign, number))
    edges = np.flatnonzero(np.diff(np.sign(test.z_rad_s[rows])) < 0.0)
    assert edges.size == 9
    assert edges[0] == 0
    assert edges[-1] == rows.stop - rows.start - 2
    before = np.flatnonzero(np.diff(np.sign(test.z_rad_s[: rows.start + 1])) < 0.0)
    assert before.size == 5


def test_rows_of_a_test_that_never_oscillates_are_all_of_it() -> None:
    campaign = GRID.model_copy(update={"motor": CampaignMotor(static_ratio=40.0)})
    test, rows = random_motors.simulate(campaign, random_motors.draw(campaign, 0))
    assert np.ptp(test.true_y_rad) == 0.0
    assert rows == slice(0, test.t_s.size)


def test_times_jitter_as_much_as_they_should() -> None:
    sampling = CampaignSampling(jitter_s=0.001, delay_s=(0.003, 0.004), delay_jitter_s=0.002)
    campaign = GRID.model_copy(update={"sampling": sampling})
    one = random_motors.draw(campaign, 1)
    test, _ = random_motors.simulate(campaign, one)
    late = test.t_s - 0.01 * np.arange(test.t_s.size)
    delays = test.t_u_s - test.t_s - one.delay_s
    for jitter, half in ((late, 0.001), (delays, 0.002)):
        assert np.abs(jitter).max() <= half * (1 + 1e-9)
        assert np.std(jitter) == pytest.approx(half / math.sqrt(3.0), rel=0.1)


def test_correlated_noise_is_stationary_and_forgets_as_it_should() -> None:
    white = np.random.default_rng(3).standard_normal((200, 300))
    x = np.array([random_motors.autoregressive(row, 0.9) for row in white])
    assert x[:, 0] == pytest.approx(white[:, 0])
    assert np.mean(x**2, axis=0)[[0, 1, 20, 299]] == pytest.approx([1.0] * 4, abs=0.35)
    assert np.mean(x**2) == pytest.approx(1.0, abs=0.06)
    later = x[:, 5:] * x[:, :-5]
    assert later.mean() == pytest.approx(0.9**5, abs=0.06)
    sensor = CampaignSensor(noise_rad=0.0, lsb_rad=0.0, correlated=CorrelatedNoise(coefficient=0.9, std_rad=0.004))
    campaign = GRID.model_copy(update={"sensor": sensor})
    one = random_motors.draw(campaign, 2)
    test, _ = random_motors.simulate(campaign, one)
    assert np.std(test.y_rad - test.true_y_rad - one.offset_rad) == pytest.approx(0.004, rel=0.3)


def test_ranges_without_a_slow_cycle_are_refused_in_two_lines() -> None:
    campaign = GRID.model_copy(update={"relay": CampaignRelay(least_samples=5000)})
    with pytest.raises(CampaignError, match="5000 samples") as caught:
        random_motors.draw(campaign, 0)
    again = pickle.loads(pickle.dumps(caught.value))  # as a worker hands it over: else its pool counts as killed
    assert (str(again), again.cause) == (str(caught.value), caught.value.cause)
    assert "widen" in again.cure
