"""The triple-relay estimator: exact on exact data from bad guesses, and on recorded cycles as good as the record is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from evidence import evidence, examples
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import LSB_RAD, drawn, motor

from rig.identification import describing_function, triple_relay
from rig.identification.cycles import find_cycle
from rig.identification.identification import identify
from rig.identification.mean_cycle import Cycle, average
from rig.identification.starts import Start, ridge_starts
from rig.identification.triple_relay import Features, residuals, solve, solve_cycle
from rig.model.describing_function import predict
from rig.model.limit_cycle import limit_cycle
from rig.model.motor import State
from rig.model.sampled_relay import Disturbance, relay_test
from rig.run_folder.recording.csv_file import read_csv
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries

TRUTH = (0.17, 6.5, 0.5)
FINE_S = 2e-4
# the check rows of docs/theory.md 3.4: tau, K, fc, h1, h2
Check = tuple[float, float, float, float, float]
CHECKS: list[Check] = [
    (0.17, 6.5, 0.5, 0.8, 1.0),
    (1.0, 1.0, 0.5, 0.8, 1.0),
    (0.17, 6.5, 0.5, 0.5, 1.2),
    (0.35, 3.0, 0.4, 1.2, 1.35),
]


def exact(tau: float = 0.17, K: float = 6.5, fc: float = 0.5, h1: float = 0.8, h2: float = 1.0) -> Features:
    cycle = limit_cycle(tau, K, fc, h1, h2)
    return Features(*cycle.durations_s, float(cycle.states[1, 1]), float(cycle.states[0, 1]))


@cache
def recorded(
    check: Check = CHECKS[0],
    period_s: float = FINE_S,
    ticks: float = 0.0,
    known: bool = True,
    cycles: int = 18,
    asym_V: float = 0.0,
    noise_rad: float = 0.0,
    lsb_rad: float = 0.0,
    seed: int = 1,
) -> TimeSeries:
    """A sampled relay on the motor of a check row from 0.3 rad, its drive acting ``ticks`` sampling periods late."""
    tau, K, fc, h1, h2 = check
    t = np.arange(0.0, cycles * limit_cycle(*check).period_s, period_s)
    noise = noise_rad * np.random.default_rng(seed).standard_normal(t.size)
    test = relay_test(
        motor(tau, K, fc, asym_V),
        h1,
        h2,
        t,
        ticks * period_s,
        disturbance=Disturbance(noise, lsb_rad=lsb_rad),
        start=State(y=0.3),
    )
    return TimeSeries(test.t_s, test.y_rad, test.t_u_s if known else None, test.u_V, name="synthetic")


def ridge(cycle: Cycle) -> list[Start]:
    return ridge_starts(cycle.omega_rad_s, cycle.amplitude_rad, cycle.h1_V, cycle.h2_V)


def errors(theta: Sequence[float] | np.ndarray, truth: Sequence[float]) -> np.ndarray:
    off: np.ndarray = np.abs(np.array(theta) / np.array(truth[:3]) - 1.0)
    return off


# the paper's equations, on exact data


def test_the_truth_has_no_residual_and_anything_else_has() -> None:
    assert residuals(Start(*TRUTH), exact(), 0.8, 1.0) == pytest.approx(0.0, abs=1e-12)
    for k in range(3):
        wrong = list(TRUTH)
        wrong[k] *= 1.1
        assert np.abs(residuals(Start(*wrong), exact(), 0.8, 1.0)).max() > 1e-3


def plain_gauss_newton(start: tuple[float, float, float], steps: int = 30) -> np.ndarray:
    """As the paper has it: full steps in tau, K and fc themselves."""
    theta = np.array(start)

    def values(x: np.ndarray) -> np.ndarray:
        return residuals(Start(*x), exact(), 0.8, 1.0)

    for _ in range(steps):
        columns = [(values(theta + e) - values(theta - e)) / 2e-6 for e in 1e-6 * np.eye(3)]
        theta = theta - np.linalg.lstsq(np.column_stack(columns), values(theta), rcond=None)[0]
        if not np.isfinite(theta).all() or theta[0] <= 0.0 or theta[1] <= 0.0:
            return np.full(3, math.nan)
    return theta


def test_damping_arrives_where_plain_gauss_newton_diverges() -> None:
    assert plain_gauss_newton((0.1, 3.0, 0.2)) == pytest.approx(TRUTH, rel=1e-8)
    assert not np.allclose(plain_gauss_newton((0.3, 4.0, 0.3)), TRUTH, rtol=0.1)
    assert solve(exact(), 0.8, 1.0, [Start(0.3, 4.0, 0.3)]).theta == pytest.approx(TRUTH, rel=1e-8)


@pytest.mark.parametrize("guess", [(0.1, 3.0, 0.2), (0.3, 4.0, 0.3), (0.05, 20.0, 0.7), (0.5, 2.0, 0.0)])
def test_exact_data_give_the_motor_to_eight_digits_from_bad_guesses(guess: tuple[float, float, float]) -> None:
    fit = solve(exact(), 0.8, 1.0, [Start(*guess)])
    assert fit.theta == pytest.approx(TRUTH, rel=1e-8)
    assert fit.iterates[0] == pytest.approx(guess)
    assert fit.iterates[-1] == pytest.approx(TRUTH)
    assert len(fit.iterates) < 30
    assert fit.converged


factors = st.floats(0.3, 3.0)


@settings(max_examples=examples(60), deadline=None)
@given(
    st.floats(0.08, 0.5),
    st.floats(1.0, 20.0),
    st.floats(0.1, 0.5),
    st.floats(0.3, 1.0),
    st.floats(0.4, 1.0),
    factors,
    factors,
    st.floats(0.0, 0.95),
)
def test_any_motor_of_the_grid_is_found_whatever_is_tried_first(
    tau: float, K: float, fc: float, beyond: float, share: float, by_tau: float, by_K: float, first_fc: float
) -> None:
    h2 = fc + beyond
    h1 = share * h2
    cycle = limit_cycle(tau, K, fc, h1, h2)
    starts = [Start(by_tau * tau, by_K * K, first_fc * h2)]
    starts += ridge_starts(2.0 * np.pi / cycle.period_s, cycle.amplitude_rad, h1, h2)
    assert solve(exact(tau, K, fc, h1, h2), h1, h2, starts).theta == pytest.approx((tau, K, fc), rel=1e-7)


def test_single_random_starts_nearly_always_arrive() -> None:
    rng = np.random.default_rng(3)
    arrived = 0
    for _ in range(200):
        guess = Start(*(np.array(TRUTH) * np.exp(rng.uniform(-1.2, 1.2, 3))))
        arrived += bool(errors(solve(exact(), 0.8, 1.0, [guess]).theta, TRUTH).max() < 1e-7)
    assert arrived >= 180


def test_it_is_as_ill_conditioned_in_time_as_the_theory_says() -> None:
    features = exact()

    def wrong(**changed: float) -> np.ndarray:
        off: np.ndarray = np.array(solve(features._replace(**changed), 0.8, 1.0, [Start(*TRUTH)]).theta) / TRUTH - 1.0
        return off

    late = wrong(t1_s=features.t1_s + 1e-3, t2_s=features.t2_s - 1e-3)
    assert np.all((np.abs(late) > 0.07) & (np.abs(late) < 0.15))
    slightly = wrong(t1_s=features.t1_s + 1e-4, t2_s=features.t2_s - 1e-4)
    assert np.all((np.abs(slightly) > 0.007) & (np.abs(slightly) < 0.015))
    larger = features._replace(y_extremum_rad=1.03 * features.y_extremum_rad, y_rc_rad=1.03 * features.y_rc_rad)
    assert solve(larger, 0.8, 1.0, [Start(*TRUTH)]).theta == pytest.approx((0.17, 6.5 * 1.03, 0.5), rel=1e-6)


def test_edges_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(IdentifyError, match="order"):
        solve(exact()._replace(t1_s=-0.01), 0.8, 1.0, [Start(*TRUTH)])


# recorded cycles, finely sampled


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize(
    ("ticks", "known"), [(0.0, True), (1.5, False), *evidence((0.5, True), (1.5, True), (0.5, False))]
)
def test_a_relay_sampled_at_a_fifth_of_a_millisecond_gives_the_motor(check: Check, ticks: float, known: bool) -> None:
    cycle = find_cycle(recorded(check, ticks=ticks, known=known))
    found = solve_cycle(cycle, ridge(cycle))
    assert errors(found.theta, check).max() < 0.001
    assert abs(found.asym_V) < 0.001
    if known:
        assert math.isnan(found.delay_s)
    else:
        assert found.delay_s == pytest.approx(ticks * FINE_S, abs=0.05 * FINE_S)


@pytest.mark.evidence
@pytest.mark.parametrize("known", [*evidence(True), False])
def test_the_command_on_a_plain_csv_of_it_is_right(tmp_path: Path, known: bool) -> None:
    record = recorded(ticks=1.3, known=known)
    columns = [record.t_s, record.u_V, record.y_rad] + ([] if record.t_u_s is None else [record.t_u_s])
    path = tmp_path / "log.csv"
    np.savetxt(
        path,
        np.column_stack(columns),
        fmt="%.10g",
        delimiter=",",
        header=",".join(["t_s", "u_V", "y_rad", "t_u_s"][: len(columns)]),
        comments="",
    )
    found = identify([read_csv(path)], ["triple-relay"]).estimates["triple-relay"]
    assert errors((found.tau_s, found.K_rad_s_V, found.fc_V), TRUTH).max() < 0.015
    assert found.verdict == "ok", found.reasons


def test_asymmetry_comes_out_beside_the_rest() -> None:
    cycle = find_cycle(recorded(asym_V=0.05, ticks=0.7, known=False))
    found = triple_relay.fit(cycle)
    assert errors((found.tau_s, found.K_rad_s_V, found.fc_V), TRUTH).max() < 0.002
    assert found.asym_V == pytest.approx(0.05, abs=0.001)
    assert found.delay_s == pytest.approx(0.7 * FINE_S, abs=0.1 * FINE_S)


@pytest.mark.parametrize("check", [CHECKS[0], *evidence(*((check,) for check in CHECKS[1:]))])
@pytest.mark.parametrize("known", [True, False])
def test_noise_and_the_chatter_that_it_makes_cost_little(check: Check, known: bool) -> None:
    clean = find_cycle(recorded(check, ticks=0.5))
    record = recorded(check, ticks=0.5, known=known, noise_rad=0.003)
    switches = np.count_nonzero(np.diff(record.u_V)) / 18
    assert switches > 6.0  # a clean relay has four a cycle
    cycle = find_cycle(record)
    assert abs(cycle.cycles - clean.cycles) <= 2
    assert cycle.period_s == pytest.approx(clean.period_s, rel=0.005)
    assert errors(solve_cycle(cycle, ridge(cycle)).theta, check).max() < 0.015


def test_the_describing_functions_estimate_starts_it_well() -> None:
    other = (0.17, 6.5, 0.5, 1.04, 1.15)
    cycles = [find_cycle(recorded(noise_rad=0.001)), find_cycle(recorded(other, noise_rad=0.001))]
    first = describing_function.fit(cycles)
    start = Start(first.tau_s, first.K_rad_s_V, first.fc_V)
    two_stage, from_ridge = triple_relay.fit(cycles[0], start), triple_relay.fit(cycles[0])
    assert two_stage.iterates[0] == pytest.approx(start)  # Remark 3.3: the start that is reported
    assert two_stage.tau_s == pytest.approx(from_ridge.tau_s, rel=1e-6)
    assert two_stage.iterations < 12
    assert errors(start, TRUTH).max() > 10.0 * errors(two_stage.iterates[-1], TRUTH).max()


# at ten milliseconds


def grid(count: int) -> Iterator[tuple[Check, float, float]]:
    """Motors as in docs/theory.md 7.10: parameters, relay, delay in ticks, asymmetry."""
    rng = np.random.default_rng(12)
    while count:
        tau, K, fc, h1, h2 = drawn(rng)
        ticks, asym = rng.uniform(0.05, 0.95), rng.uniform(-0.05, 0.05)
        if predict(tau, K, fc, h1, h2).period_s >= 0.3:
            count -= 1
            yield (tau, K, fc, h1, h2), ticks, asym


@pytest.mark.parametrize("known", [True, *evidence(False)])
def test_at_ten_milliseconds_it_is_a_fair_reference_and_its_intervals_say_how_good(known: bool) -> None:
    off, covered = [], []
    for k, (check, ticks, asym) in enumerate(grid(40)):
        record = recorded(check, 0.01, ticks, known, 18, asym, 0.003, LSB_RAD, k)
        found = triple_relay.fit(find_cycle(record))
        off.append(errors((found.tau_s, found.K_rad_s_V, found.fc_V), check))
        bounds = np.array([found.ci95[name] for name in ("tau_s", "K_rad_s_V", "fc_V")])
        covered.append((bounds[:, 0] <= check[:3]) & (check[:3] <= bounds[:, 1]))
    assert np.all(np.median(off, axis=0) < [0.007, 0.006, 0.012])
    assert np.max(off) < 0.12
    assert np.mean(covered) > 0.85


def test_a_motor_that_waits_for_a_late_edge_is_no_worse() -> None:
    check = (0.1136, 29.83, 0.33, 0.5793, 0.6575)  # reverses 5 ms after RC, whose edge is up to 19 ms late
    cycle = find_cycle(recorded(check, 0.01, 0.91, asym_V=0.035))
    assert errors(solve_cycle(cycle, ridge(cycle)).theta, check).max() < 0.03


def test_the_interval_is_the_jackknife_over_cycles() -> None:
    cycle = find_cycle(recorded(period_s=0.01, ticks=0.4, noise_rad=0.003))
    found = triple_relay.fit(cycle)
    left = []
    for k in range(cycle.cycles):
        rest = average(cycle.waves[:k] + cycle.waves[k + 1 :], 0.8, 1.0, cycle.period_sampling_s, 0.0, cycle.rows)
        left.append(solve_cycle(rest, ridge(rest)).theta)
    n = len(left)
    covariance = (n - 1) ** 2 / n * np.cov(np.array(left).T)
    assert found.covariance[:3, :3] == pytest.approx(covariance, rel=1e-3)
