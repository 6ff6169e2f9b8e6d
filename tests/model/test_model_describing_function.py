"""The describing function against python-control's, its inverse, and Properties 3.1 and 3.2."""

from __future__ import annotations

import math

import numpy as np
import pytest
from control.descfcn import describing_function, relay_hysteresis_nonlinearity
from hypothesis import given
from hypothesis import strategies as st

from rig.model.describing_function import Oscillation, gains_for, linear_part, predict
from rig.model.limit_cycle import NoLimitCycle, limit_cycle

parameters = st.tuples(
    st.floats(0.05, 1.0), st.floats(0.5, 20.0), st.floats(0.0, 0.8), st.floats(0.1, 2.0), st.floats(0.05, 2.0)
)  # tau, K, fc, h1, h2 - fc


def triple_relay(amplitude_rad: float, fc_V: float, h1_V: float, h2_V: float) -> complex:
    """N(A), V/rad: relay on position, on its integral, and friction as a relay on velocity."""
    return 4.0 / (math.pi * amplitude_rad) * complex(h1_V, fc_V - h2_V)


@pytest.mark.parametrize("amplitude", [0.1, 0.8, 3.0])
def test_each_relay_has_the_describing_function_that_python_control_gives(amplitude: float) -> None:
    relay = complex(describing_function(relay_hysteresis_nonlinearity(1.0, 0.0), amplitude))
    # velocity leads position by 90 degrees, its integral lags by 90; each relay sees a sine of its own
    fc, h1, h2 = 0.5, 0.8, 1.0
    assert triple_relay(amplitude, fc, h1, h2) == pytest.approx((h1 + 1j * fc - 1j * h2) * relay, rel=1e-9)


@given(parameters)
def test_the_prediction_solves_the_harmonic_balance(p: tuple[float, ...]) -> None:
    tau, K, fc, h1, beyond = p
    w, amplitude = predict(tau, K, fc, h1, fc + beyond)
    loop = K / (1j * w * (1j * w * tau + 1.0))
    assert 1.0 + loop * triple_relay(amplitude, fc, h1, fc + beyond) == pytest.approx(0.0, abs=1e-9)


@given(parameters)
def test_the_inverses_give_back_what_went_in(p: tuple[float, ...]) -> None:
    tau, K, fc, h1, beyond = p
    cycle = predict(tau, K, fc, h1, fc + beyond)
    assert linear_part(cycle, fc, h1, fc + beyond) == pytest.approx((tau, K), rel=1e-6)
    assert gains_for(cycle, tau, K, fc) == pytest.approx((h1, fc + beyond), rel=1e-9)


@given(parameters, st.floats(1.05, 3.0))
def test_property_3_2(p: tuple[float, ...], more: float) -> None:
    tau, K, fc, h1, beyond = p
    base = predict(tau, K, fc, h1, fc + beyond)
    h2_up = predict(tau, K, fc, h1, fc + beyond * more)
    h1_up = predict(tau, K, fc, h1 * more, fc + beyond)
    assert h2_up.amplitude_rad > base.amplitude_rad > h1_up.amplitude_rad
    assert h2_up.omega_rad_s < base.omega_rad_s < h1_up.omega_rad_s


def test_property_3_1() -> None:
    for h2 in (0.2, 0.5):
        with pytest.raises(NoLimitCycle, match=r"Property 3\.1"):
            predict(0.17, 6.5, 0.5, 0.8, h2)


def test_it_is_near_the_exact_cycle_and_not_equal_to_it() -> None:
    exact, sine = limit_cycle(0.17, 6.5, 0.5, 0.8, 1.0), predict(0.17, 6.5, 0.5, 0.8, 1.0)
    assert 0.02 < abs(sine.period_s / exact.period_s - 1.0) < 0.3
    assert sine.period_s == pytest.approx(2.0 * math.pi / sine.omega_rad_s)


def test_values_out_of_range_are_refused() -> None:
    for bad in ((0.0, 1, 0.1, 1, 1), (1, -1, 0.1, 1, 1), (1, 1, -0.1, 1, 1), (1, 1, 0.1, 0, 1)):
        with pytest.raises(ValueError, match="need"):
            predict(*bad)
    with pytest.raises(ValueError, match="h2 > f_c"):
        linear_part(Oscillation(1.0, 1.0), 1.0, 1.0, 0.5)
    assert np.isfinite(predict(0.17, 6.5, 0.0, 0.8, 1.0)).all()
