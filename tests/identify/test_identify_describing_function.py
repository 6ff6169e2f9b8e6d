"""The describing-function estimator: exact for sines, off by their error for real cycles, and refusing nonsense."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic import Bench, dcr, motor, record, simulate

from rig.identify import describing_function
from rig.identify.cycles import Cycle, find_cycle
from rig.identify.record import IdentifyError
from rig.model.describing_function import predict


def cycle_of(h1: float, h2: float, rows: int = 1600, **bench) -> Cycle:
    return find_cycle(record(simulate(motor(), dcr(h1, h2), rows, Bench(**bench))))


@given(st.floats(0.05, 1.0), st.floats(0.5, 20.0), st.floats(0.0, 0.5), st.floats(1.1, 3.0))
def test_two_sines_give_the_motor_that_makes_them(tau, K, fc, ratio):
    gains = [(0.5, fc + 0.4), (0.8, fc + 0.4 * ratio)]
    sines = [predict(tau, K, fc, *pair) for pair in gains]
    found = describing_function.solve(
        *(np.array(column) for column in zip(*sines, strict=True)),
        *(np.array(column) for column in zip(*gains, strict=True)),
    )
    assert found == pytest.approx((tau, K, fc), rel=1e-7, abs=1e-9)


def test_real_cycles_carry_the_error_of_a_sine():
    fine = {"period_s": 0.001, "delay_s": 0.0}
    found = describing_function.fit([cycle_of(0.8, 1.0, 12_000, **fine), cycle_of(0.5, 1.2, 24_000, **fine)])
    error = np.array([found.tau_s / 0.17, found.K_rad_s_V / 6.5, found.fc_V / 0.5]) - 1.0
    assert np.all(np.abs(error) < 0.4)
    assert np.abs(error).max() > 0.01
    assert found.verdict == "ok"
    low, high = found.ci95["tau_s"]
    assert low < found.tau_s < high


def test_one_test_or_two_alike_are_not_enough():
    one = cycle_of(0.8, 1.0)
    with pytest.raises(IdentifyError, match="needs two"):
        describing_function.fit([one])
    with pytest.raises(IdentifyError, match="within 5 %"):
        describing_function.fit([one, one])


def test_oscillations_of_no_motor_are_refused():
    one = cycle_of(0.8, 1.0)
    other = replace(one, h2_V=1.4, amplitude_rad=0.5 * one.amplitude_rad)
    found = describing_function.fit([one, other])
    assert found.verdict == "refused"
    assert "no motor" in found.reasons[0]
