"""The dual-channel relay: its sign rule, its integral, its bound, and the cycle that theory predicts for it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.relay import DualChannelRelay, keep_sign
from rig.core.signals import Sample


def at(t_s: float, y_rad: float) -> Sample:
    return Sample(t_s=t_s, y_rad=y_rad, y_counts=0)


def test_zero_keeps_the_previous_state() -> None:
    assert [keep_sign(0.0, previous) for previous in (1, -1)] == [1, -1]
    assert [keep_sign(value, 1) for value in (1e-300, -1e-300)] == [1, -1]


@given(
    st.lists(st.tuples(st.floats(1e-4, 0.1), st.floats(-2, 2)), min_size=2, max_size=60),
    st.floats(0.1, 2),
    st.floats(0.1, 2),
)
def test_drive_is_one_of_four_levels_and_z_is_the_trapezoidal_integral(
    steps: list[tuple[float, float]], h1: float, h2: float
) -> None:
    relay = DualChannelRelay(h1, h2, z_bound_rad_s=1e6)
    t, z, last = 0.0, 0.0, None
    for dt, y in steps:
        t += dt
        u = relay.step(at(t, y))
        if last is not None:
            z += (t - last[0]) * 0.5 * (y + last[1])
        last = (t, y)
        assert min(abs(u - level) for level in (h1 + h2, h1 - h2, h2 - h1, -h1 - h2)) < 1e-12
        assert relay.z_rad_s == pytest.approx(z, abs=1e-12)
        if y > 0 and z > 1e-12:
            assert u == pytest.approx(-h1 - h2)


def test_a_start_far_from_centre_does_not_wind_the_integral_up() -> None:
    relay = DualChannelRelay(0.5, 0.8, z_bound_rad_s=0.3)
    for k in range(1000):
        relay.step(at(0.01 * k, 1.0))
    assert relay.z_rad_s == 0.3
    assert relay.bound_reached
    # it lets go at once when the position returns
    relay.step(at(10.0, -1.0))
    relay.step(at(10.1, -1.0))
    assert relay.z_rad_s == pytest.approx(0.2)


def test_both_relays_start_inward() -> None:
    assert DualChannelRelay(0.5, 0.8, 1.0).step(at(0.0, 0.7)) == pytest.approx(-1.3)
    assert DualChannelRelay(0.5, 0.8, 1.0).step(at(0.0, -0.7)) == pytest.approx(1.3)


@pytest.mark.parametrize("gains", [(-0.1, 1.0, 1.0), (1.0, math.nan, 1.0), (1.0, 1.0, 0.0)])
def test_senseless_gains_are_refused(gains: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="gains"):
        DualChannelRelay(*gains)
