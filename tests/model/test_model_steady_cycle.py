"""The steady cycle under given edges: the exact motor's, symmetric or not, stopping or not, and its derivatives."""

from __future__ import annotations

import math
from ctypes import byref

import numpy as np
import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.model.compiled import steady_cycle
from rig.model.friction import coulomb
from rig.model.library import LIBRARY, numbers
from rig.model.limit_cycle import limit_cycle, stage_states
from rig.model.motor import Motor, State

GAINS = (0.8, 1.0)
SAMPLES = 60
Vector = list[float] | np.ndarray


def curve(
    theta: Vector, edges: list[float], gains: tuple[float, float] = GAINS
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position at the RC edge 0; both halves, at times from each one's edge on; and the derivatives."""
    t = np.concatenate([np.linspace(0.0, edges[1], SAMPLES), np.linspace(0.0, edges[3], SAMPLES)])
    return t, *steady_cycle.curve(np.array(theta), gains, np.array(edges), (SAMPLES, SAMPLES), t)


def reversal_times(theta: Vector, edges: list[float], gains: tuple[float, float] = GAINS) -> tuple[float, ...]:
    """t1 of both halves, s; 0 where the motor stops before the RC edge."""
    times = numbers(0.0, 0.0)
    cycle = byref(steady_cycle._cycle(gains, np.array(edges)))
    LIBRARY.cycle_reversal_times(numbers(*theta), cycle, times)
    return tuple(times)


def settled(theta: Vector, edges: list[float], gains: tuple[float, float] = GAINS, periods: int = 80) -> np.ndarray:
    """Folded positions of the exact motor that has run under these edges for a long time, less what it has drifted."""
    tau, K = math.exp(theta[0]), math.exp(theta[1])
    fc, asym, offset, delay = theta[2:]
    high, low = sum(gains), gains[1] - gains[0]
    one = np.array([0.0, edges[0], edges[1], edges[1] + edges[2]])
    period = edges[1] + edges[3]
    times = np.concatenate([k * period + one for k in range(periods)]) + delay
    drives = np.tile([high, low, -high, -low], periods)
    up = (periods - 1) * period + np.linspace(0.0, edges[1], SAMPLES)
    down = (periods - 1) * period + edges[1] + np.linspace(0.0, edges[3], SAMPLES)
    motor = Motor(tau, K, coulomb(fc), asym)
    start = (periods - 1) * period + delay  # where the model's position is the offset
    t = np.unique(np.concatenate([[0.0, delay, start], up, down]))
    y = motor.response(State(), t, np.r_[0.0, times], np.r_[-low, drives])[:, 1]
    at = dict(zip(t.tolist(), y.tolist(), strict=True))
    physical = np.array([at[x] for x in np.concatenate([up, down]).tolist()]) - at[start] + offset
    return np.concatenate([physical[:SAMPLES], -physical[SAMPLES:]])


def test_under_its_own_edges_it_is_the_limit_cycle() -> None:
    cycle = limit_cycle(0.17, 6.5, 0.5, *GAINS)
    half, inner = 0.5 * cycle.period_s, sum(cycle.durations_s[:2])
    theta = [math.log(0.17), math.log(6.5), 0.5, 0.0, cycle.states[0, 1], 0.0]
    t, y, _ = curve(theta, [inner, half, inner, half])
    path = Motor(0.17, 6.5, coulomb(0.5)).response(State(*cycle.states[0]), t[:SAMPLES], [0.0, inner], [1.8, 0.2])
    assert y == pytest.approx(np.tile(path[:, 1], 2), abs=1e-12)
    assert reversal_times(theta, [inner, half, inner, half]) == pytest.approx((cycle.durations_s[0],) * 2)


CASES = {
    "symmetric": ([math.log(0.17), math.log(6.5), 0.5, 0.0, -0.4, 0.0], [0.15, 0.31, 0.15, 0.31]),
    "asymmetric": ([math.log(0.2), math.log(6.0), 0.4, 0.05, -0.4, 0.0], [0.15, 0.33, 0.16, 0.30]),
    "delayed": ([math.log(0.2), math.log(6.0), 0.4, -0.03, 0.1, 0.013], [0.15, 0.33, 0.16, 0.30]),
    "stops after one half": ([math.log(0.1), math.log(20.0), 0.45, -0.03, -0.4, 0.01], [0.14, 0.30, 0.145, 0.22]),
    "stops after both": ([math.log(0.1), math.log(20.0), 0.45, 0.02, -0.4, 0.01], [0.12, 0.35, 0.125, 0.36]),
}


@pytest.mark.parametrize("case", CASES)
def test_it_is_what_the_exact_motor_settles_to(case: str) -> None:
    theta, edges = CASES[case]
    assert curve(theta, edges)[1] == pytest.approx(settled(theta, edges), abs=1e-9)
    stops = sum(t == 0.0 for t in reversal_times(theta, edges))
    assert stops == {"stops after one half": 1, "stops after both": 2}.get(case, 0)


@pytest.mark.parametrize("case", CASES)
def test_its_derivatives_are_those_of_central_differences(case: str) -> None:
    theta, edges = CASES[case]
    _, _, jacobian = curve(theta, edges)
    for k, step in enumerate(1e-6 * np.eye(6)):
        if case in ("symmetric", "asymmetric") and k == 5:
            continue  # at a delay of 0 the first sample lies on the edge
        numeric = (curve(theta + step, edges)[1] - curve(theta - step, edges)[1]) / 2e-6
        assert jacobian[:, k] == pytest.approx(numeric, abs=1e-7)


@settings(max_examples=examples(50), deadline=None)
@given(st.floats(0.05, 0.5), st.floats(0.5, 20.0), st.floats(0.0, 0.6), st.floats(0.7, 1.4), st.floats(0.7, 1.4))
def test_the_five_conditions_are_those_of_the_exact_stages_and_so_are_their_derivatives(
    tau: float, K: float, fc: float, early: float, late: float
) -> None:
    durations = (0.1 * early * tau, 0.8 * tau, 0.9 * late * tau)
    theta = np.array([math.log(tau), math.log(K), fc])

    def conditions(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return steady_cycle.switching_conditions(x, GAINS, durations)

    values, jacobian = conditions(theta)
    inputs = (1.8 + fc, 1.8 - fc, 0.2 - fc)
    states = stage_states(tau, K, durations, inputs)
    exact = [states[0, 2], states[1, 0], states[2, 1], states[1, 1], states[0, 1]]
    assert values == pytest.approx(exact, rel=1e-9, abs=1e-9 * K)
    numeric = [(conditions(theta + e)[0] - conditions(theta - e)[0]) / 2e-6 for e in 1e-6 * np.eye(3)]
    assert jacobian == pytest.approx(np.column_stack(numeric), abs=1e-8 * K)
