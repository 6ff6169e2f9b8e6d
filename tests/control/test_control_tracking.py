"""Tracking: the algebra of (33)-(35), the reference, the observer, and who wins on the simulated bench."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from simulated_bench import DEMO_MOTOR, LIMITS, PERIOD_S, simulated_bench

from rig.config.schema import TrackingSection
from rig.control.known_motor import KnownMotor
from rig.control.observer import MotorObserver
from rig.control.tracking import Tracking, linearising_drive, tracking_error
from rig.control.trajectory import Reference, SumOfSines
from rig.core.signals import Sample
from rig.model.error_decay import K1_1_S, K2_1_S2, ErrorDecay
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.model.real_motor import Frame, FramedMotor, plain

YD = [(0.5, 1.5), (0.2, 3.1)]


def framed(motor: Motor) -> FramedMotor:
    return FramedMotor(plain(motor), Frame())


@given(
    st.floats(0.05, 0.5), st.floats(1, 10), st.floats(0, 1), st.floats(-0.1, 0.1),
    st.floats(-3, 3), st.floats(-1, 1), st.floats(-3, 3), st.floats(-1, 1), st.floats(-10, 10),
)  # fmt: skip
def test_the_drive_makes_the_error_obey_35(
    tau: float, K: float, fc: float, bias: float, v: float, y: float, vd: float, yd: float, ad: float
) -> None:
    """Substitute (33), (34) into the plant: e'' + k1 e' + k2 e = 0 exactly, friction and bias cancelled."""
    motor = Motor(tau, K, coulomb(fc), bias)
    known = KnownMotor(framed(motor))
    u = linearising_drive(known, known.moved(known.at_rest(0.0), v, y), Reference(yd, vd, ad), (12.0, 36.0), v)
    friction = fc * math.copysign(1.0, v) if v else 0.0
    acceleration = (K * (u + bias - friction) - v) / tau
    residual = (ad - acceleration) + 12.0 * (vd - v) + 36.0 * (yd - y)
    assert residual == pytest.approx(0.0, abs=1e-9 * (1 + abs(acceleration)))


def test_reference_derivatives_match_its_positions_and_it_starts_at_rest() -> None:
    yd = SumOfSines(YD, start_rad=-0.4, fade_s=1.5)
    assert yd.at(0.0) == pytest.approx((-0.4, 0.0, 0.0), abs=1e-12)
    h = 1e-5
    for t in np.linspace(0.01, 4.0, 57):
        before, here, after = yd.at(t - h), yd.at(t), yd.at(t + h)
        assert here.v_rad_s == pytest.approx((after.y_rad - before.y_rad) / (2 * h), abs=1e-6)
        assert here.a_rad_s2 == pytest.approx((after.v_rad_s - before.v_rad_s) / (2 * h), abs=1e-5)


def track(model: Motor, sign: Literal["reference", "estimate"] = "reference", seed: int = 1) -> float:
    bench = simulated_bench(seed=seed)
    bench.guard.sign_proven = True
    observer = MotorObserver(framed(model), PERIOD_S, 0.003)
    law = Tracking(framed(model), observer, SumOfSines(YD), 12.0, 36.0, 8.0, sign)
    truth: list[float] = []
    reference: list[float] = []
    times: list[float] = []

    def watch(t_s: float) -> None:
        # what the shaft really does, not what the noisy sensor says
        truth.append(bench.driver.bench.state.y + 0.02)
        reference.append(law.yd_rad)
        times.append(t_s)

    with bench.loop.armed(LIMITS):
        bench.loop.run(law, "track", watch)
    return tracking_error(np.array(times), np.array(truth), np.array(reference), after_s=1.5)[0]


def test_the_true_model_tracks_best_and_the_reference_sign_beats_the_estimates() -> None:
    exact = track(DEMO_MOTOR)
    one_percent = track(Motor(0.17 * 1.01, 6.5 * 0.99, coulomb(0.48 * 1.01), DEMO_MOTOR.asym_V))
    biased = track(Motor(0.17 * 0.7, 6.5 * 0.75, coulomb(0.48 * 0.4)))
    assert exact < 0.02
    assert one_percent < 0.02
    assert biased > 2.0 * one_percent
    assert track(DEMO_MOTOR, "estimate") > exact


@pytest.mark.parametrize(("k1", "k2"), [(12.0, 36.0), (12.0, 20.0), (6.0, 36.0), (12.0, 36.0 + 1e-9)])
def test_the_errors_decay_solves_its_equation(k1: float, k2: float) -> None:
    designed = ErrorDecay(0.1, k1, k2)
    t = np.linspace(0.0, 1.5, 31)
    peer = solve_ivp(
        lambda _, x: [x[1], -k1 * x[1] - k2 * x[0]], (0.0, 1.5), [0.1, 0.0], t_eval=t, rtol=1e-10, atol=1e-13
    )
    found = np.array([designed.at(one) for one in t.tolist()]).T
    assert found == pytest.approx(peer.y, abs=1e-8)


def test_from_an_offset_the_true_models_error_dies_away_as_designed() -> None:
    """A wrong model's does not: its gain is a third too high."""

    def farthest_rad(model: Motor) -> float:
        bench = simulated_bench(seed=1)
        bench.guard.sign_proven = True
        known = framed(model)
        law = Tracking(known, MotorObserver(known, PERIOD_S, 0.003), SumOfSines(YD), 12.0, 36.0, 1.5, offset_rad=0.1)
        off: list[float] = []

        def watch(t_s: float) -> None:
            error = law.yd_rad - bench.driver.bench.state.y - 0.02
            off.append(abs(error - law.decay.at(t_s)[0]))

        with bench.loop.armed(LIMITS):
            bench.loop.run(law, "track", watch)
        return max(off)

    assert farthest_rad(DEMO_MOTOR) < 0.01
    assert farthest_rad(Motor(0.17, 6.5 / 1.5, coulomb(0.3))) > 2.0 * farthest_rad(DEMO_MOTOR)


def test_tracking_error_is_the_rms_and_the_largest_after_the_fade() -> None:
    t = np.arange(100, dtype=float) * 0.1
    y, yd = np.zeros(100), np.where(t < 5.0, 9.0, 0.3)
    yd[80] = -0.5
    rms, largest = tracking_error(t, y, yd, after_s=4.95)
    assert rms == pytest.approx(math.sqrt((49 * 0.09 + 0.25) / 50))
    assert largest == pytest.approx(0.5)
    with pytest.raises(ValueError, match="no sample"):
        tracking_error(t, y, yd, after_s=99.0)


@pytest.mark.parametrize("tachometer", [None, 0.05])
def test_the_observer_sees_velocity_through_noise_and_predicts_over_the_delay(tachometer: float | None) -> None:
    bench = simulated_bench(tachometer_rad_s_per_count=None if tachometer is None else 0.05)
    observer = MotorObserver(framed(DEMO_MOTOR), PERIOD_S, 0.003, tachometer_noise_rad_s=tachometer)
    errors: list[float] = []
    held = [0.0]
    rng = np.random.default_rng(3)

    class Wiggle:
        finished, z_rad_s, yd_rad, n = False, math.nan, math.nan, 0

        def step(self, sample: Sample) -> float:
            state = observer.step(sample)
            truth = bench.driver.bench
            ahead = truth.parameters.motor.advance(truth.state, truth.motor_V, observer.latency_s)
            errors.append(state.v - ahead.v)
            self.n += 1
            self.finished = self.n > 400
            u = float(rng.choice([-1.0, 1.0])) if self.n % 20 == 0 else held[-1]
            observer.drive(u)
            held.append(u)
            return u

    with bench.loop.armed(LIMITS):
        bench.loop.run(Wiggle(), "wiggle")
    assert float(np.sqrt(np.mean(np.square(errors[50:])))) < 0.12


@pytest.mark.parametrize(
    ("waits_s", "further_s"), [(0.035, 0.0), (0.1, 0.0), (0.0012, 0.035), (0.035, 0.06), (0.0503, 0.0)]
)
@pytest.mark.parametrize("reports", [True, False])
def test_the_observer_predicts_over_any_number_of_ticks(waits_s: float, further_s: float, reports: bool) -> None:
    """Its state is the true one at the time when the drive decided now comes to the motor."""
    observer, rng = MotorObserver(framed(DEMO_MOTOR), PERIOD_S, 0.003), np.random.default_rng(3)
    observer.latency_s, observer.further_s = waits_s, further_s
    asked = [(k * PERIOD_S, float(rng.choice([-1.0, 1.0]))) for k in range(300)]
    acts_s, drives_V = np.array([(t_s + waits_s + further_s, u_V) for t_s, u_V in asked]).T

    def true(t_s: float) -> State:
        edges_s, u_V = np.append(-1.0, acts_s), np.append(0.0, drives_V)
        v, y, _ = DEMO_MOTOR.response(State(), np.array([0.0, t_s]), edges_s, u_V)[-1]
        return State(float(v), float(y))

    for k, (t_s, u_V) in enumerate(asked):
        begun = [one for one in asked[:k] if one[0] + waits_s <= t_s]
        seen = (begun[-1][0] + waits_s, begun[-1][1]) if begun and reports else (math.nan, 0.0)
        state = observer.step(Sample(t_s, true(t_s).y if k else 0.0, 512, math.nan, *seen))
        if k > 20:
            ahead = true(t_s + waits_s + further_s)
            assert state.v == pytest.approx(ahead.v, abs=1e-3)
            assert state.y == pytest.approx(ahead.y, abs=1e-4)
        observer.drive(u_V)


def test_one_time_of_effect_in_the_future_does_not_hold_back_the_drives_after_it() -> None:
    """A drive cannot act after the sample that reports it: such a time is wrong."""
    period_s = PERIOD_S
    states = []
    for wrong_s in (0.0, 1000.0):
        motor = Motor(0.17, 6.5, coulomb(0.0))
        observer = MotorObserver(framed(motor), PERIOD_S, 0.003)
        shaft, u_V = State(), 0.0
        for k in range(200):
            t_u_s = period_s * (k - 0.9) + (wrong_s if k == 50 else 0.0)
            state = observer.step(Sample(period_s * k, shaft.y, 0, t_u_s=t_u_s if k else math.nan, u_V=u_V))
            asked_V = math.sin(0.1 * k)
            observer.drive(asked_V)
            shaft = motor.advance(motor.advance(shaft, u_V, 0.1 * period_s), asked_V, 0.9 * period_s)
            u_V = asked_V
        states.append(state)
    assert states[1].v == pytest.approx(states[0].v, abs=0.01)
    assert states[1].y == pytest.approx(states[0].y, abs=0.001)


def test_a_report_takes_the_gains_that_a_config_leaves_out_as_the_schema_does() -> None:
    fields = TrackingSection.model_fields
    assert (fields["k1_1_s"].default, fields["k2_1_s2"].default) == (K1_1_S, K2_1_S2)
