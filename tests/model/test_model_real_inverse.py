"""The inverse of a real motor, and of its sensor, against the motor itself."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rig.core.motor_numbers import Frame, RealMotor, State
from rig.model import real_step
from rig.model.real_inverse import SOFT_SHARE, drive_before_stage, drive_for
from rig.model.real_motor import FramedMotor
from rig.model.real_step import reading
from shared.physics import level_at_rest, staged, target

FRAME = Frame(0.1, 0.6, 0.0, 30.0)
STAGES = st.fixed_dictionaries(
    {
        "tau_s": st.just(0.17),
        "K_rad_s_V": st.just(6.5),
        "fc_V": st.just(0.48),
        "dead_band_V": st.floats(0.0, 0.3),
        "gain_by_sign": st.floats(-0.2, 0.2),
        "sag_per_V": st.floats(0.0, 0.06),
    }
).map(lambda numbers: RealMotor(**numbers))
MOTORS = st.fixed_dictionaries(
    {
        "tau_s": st.floats(0.05, 0.5),
        "K_rad_s_V": st.floats(1.0, 10.0),
        "fc_V": st.floats(0.05, 1.0),
        "bias_V": st.floats(-0.1, 0.1),
        "dead_band_V": st.floats(0.0, 0.2),
        "gain_by_sign": st.floats(-0.1, 0.1),
        "sag_per_V": st.floats(0.0, 0.03),
        "viscous_by_direction_V_s_rad": st.floats(-0.02, 0.02),
        "static_V": st.floats(0.0, 0.3),
        "stribeck_V": st.floats(0.0, 0.3),
        "stribeck_rad_s": st.floats(0.1, 1.0),
        "drag_V_s2_rad2": st.floats(0.0, 0.02),
        "force_sin_V": st.floats(-0.2, 0.2),
        "force_cos_V": st.floats(-0.2, 0.2),
        "friction_sin_V": st.floats(-0.02, 0.02),
        "cogging_sin_V": st.floats(-0.1, 0.1),
        "cogging_per_rad": st.floats(1.0, 20.0),
        "load_friction": st.floats(0.0, 0.4),
        "load_outside": st.floats(0.0, 1.0),
        "viscous_share": st.floats(0.0, 0.5),
        "source_per_V2": st.floats(0.0, 1e-3),
        "no_brake": st.sampled_from([0.0, 0.5]),
        "free_between": st.sampled_from([0.0, 0.6, 1.0]),
        "full_drive_V": st.floats(3.0, 30.0),
    }
).map(lambda numbers: RealMotor(**numbers))


@given(STAGES, st.floats(-3.0, 3.0))
def test_the_stage_gives_what_is_wanted_of_it(m: RealMotor, wanted_V: float) -> None:
    assume(abs(wanted_V) >= SOFT_SHARE * m.fc_V)
    assert staged(m, drive_before_stage(m, wanted_V)) == pytest.approx(wanted_V, abs=1e-9)


@given(STAGES, st.floats(-0.1, 0.1))
def test_around_zero_the_drive_crosses_the_dead_band_without_a_jump(m: RealMotor, wanted_V: float) -> None:
    """Noise of 1 mV changes the drive by no more than the slope of the crossing: at rest it does not chatter."""
    slope = 1.3 + m.dead_band_V / (SOFT_SHARE * m.fc_V)
    step_V = abs(drive_before_stage(m, wanted_V + 1e-3) - drive_before_stage(m, wanted_V))
    assert step_V <= 1.2e-3 * slope


def test_of_a_stage_that_sags_too_much_it_asks_for_the_most_that_there_is() -> None:
    m = RealMotor(0.17, 6.5, 0.48, sag_per_V=0.1)
    assert drive_before_stage(m, 99.0) == pytest.approx(5.0) == -drive_before_stage(m, -99.0)
    assert staged(m, 5.0) == max(staged(m, 0.01 * k) for k in range(1000))


@given(MOTORS, st.floats(0.3, 4.0), st.sampled_from([1.0, -1.0]), st.floats(-1.0, 1.0), st.floats(-20.0, 20.0))
def test_the_drive_gives_the_acceleration_against_all_forces(
    m: RealMotor, speed: float, sign: float, y: float, acceleration: float
) -> None:
    v = sign * speed
    u_V = drive_for(m, FRAME, (v, y), acceleration, sign)
    w_V = staged(m, u_V)
    assume(abs(w_V) >= SOFT_SHARE * m.fc_V and 4.0 * m.sag_per_V * abs(w_V) < 0.99)
    given_rad_s2 = (target(m, FRAME, sign, State(v, y, 0.0, w_V, y), 0.0) - v) / m.tau_s
    assert given_rad_s2 == pytest.approx(acceleration, abs=1e-6)


@given(MOTORS, st.floats(-1.0, 1.0), st.sampled_from([1.0, -1.0]))
def test_a_shaft_that_stands_gets_more_than_what_holds_it(m: RealMotor, y: float, way: float) -> None:
    u_V = drive_for(m, FRAME, (0.0, y), way * 1.0, way)
    w_V, force_V = staged(m, u_V), real_step.force(m, FRAME, y)
    torque_V = w_V / (1.0 + m.source_per_V2 * w_V**2)
    held = level_at_rest(m, FRAME, y) + m.load_friction * abs(torque_V + m.load_outside * force_V)
    assume(abs(w_V) >= SOFT_SHARE * m.fc_V)
    assert way * (torque_V + m.bias_V - force_V) > held


@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-0.5, 0.7))
def test_a_reading_means_the_position_that_shows_it(sine: float, cosine: float, x: float) -> None:
    m = RealMotor(0.17, 6.5, 0.48, linearity_sin1_rad=sine, linearity_cos2_rad=cosine)
    assert FramedMotor(m, FRAME).position(reading(m, FRAME, x)) == pytest.approx(x, abs=1e-8)


def test_beyond_the_travel_the_sensors_error_stays_as_at_its_end() -> None:
    m = RealMotor(0.17, 6.5, 0.48, linearity_cos1_rad=0.02)
    assert FramedMotor(m, FRAME).position(1.5) == pytest.approx(1.52, abs=1e-6)
