"""The guard, each promise on the moving bench: limits, brake, polarity, sensor faults; measured at the pin."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_bench import CALIBRATION, DEMO, GUARD, LIMITS, PERIOD_S, simulated_bench

from rig.backends.simulated.driver import SimulatedLatency
from rig.control.guard import Gain, Guard, VelocityWindow
from rig.control.law import Constant, Timed
from rig.control.relay import DualChannelRelay
from rig.core.faults import Fault
from rig.core.signals import FLAG_GUARD_BRAKED, FLAG_GUARD_CLIPPED, Limits, Sample
from rig.model.bench import DriveWiring
from rig.model.friction import coulomb
from rig.model.motor import Motor


def reading(t_s: float, y_rad: float, counts: int | None = None) -> Sample:
    return Sample(t_s, y_rad, round(CALIBRATION.to_counts(y_rad)) if counts is None else counts)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.2, 1.3), st.integers(0, 10**6))
def test_it_stops_inside_the_hard_limit_even_if_the_host_dies_at_any_instant(die_s: float, seed: int) -> None:
    """The predicted stop counts the watchdog time: after it, the device's own 0 V still stops inside."""
    bench = simulated_bench(seed=seed, start_rad=-1.0)
    bench.guard.sign_proven = True
    with pytest.raises(Fault, match="WATCHDOG"), bench.loop.armed(LIMITS):
        bench.loop.run(Constant(1.2, die_s), "jog")
        bench.driver.write(1.2)  # the last thing the host does is to drive on
        bench.clock.sleep_until(bench.clock.now_s() + 3.0)
        bench.driver.read()
    assert bench.driver.bench.pin_counts == 0
    assert bench.driver.bench.state.y < LIMITS.hard_rad[1]
    assert abs(bench.driver.bench.state.v) < 1e-3


@pytest.mark.parametrize("reported", [True, False])
@pytest.mark.parametrize("delay_s", [0.035, 0.1])
@pytest.mark.parametrize("u_V", [0.8, 1.2, 3.0])
def test_a_bench_that_acts_late_stays_inside_the_hard_limits(u_V: float, delay_s: float, reported: bool) -> None:
    """The true shaft, whether drives wait in the device or behind its output; it may end as too fast, but inside."""
    late = SimulatedLatency(delay_s, 0.0003) if reported else SimulatedLatency(0.0012, 0.0003)
    guard = replace(GUARD, delay_s=delay_s, max_speed_rad_s=4.0)
    bench = simulated_bench(guard=guard, latency=late, start_rad=-1.0, drive_delay_s=0.0 if reported else delay_s)
    bench.guard.sign_proven = True
    reached: list[float] = []
    with contextlib.suppress(Fault), bench.loop.armed(LIMITS):
        bench.loop.run(Constant(u_V, 1.5), "jog", lambda _: reached.append(bench.driver.bench.state.y))
    bench.driver.bench.advance(3.0)  # it coasts
    reached.append(bench.driver.bench.state.y)
    assert max(reached) < LIMITS.hard_rad[1]
    assert max(reached) > -0.5


def test_a_delay_is_added_to_each_time_that_the_guard_waits_for_an_effect() -> None:
    """A shaft that goes on outward for as long as the delay is no wrong polarity; for longer it is."""
    guard = Guard(GUARD)
    guard.learn(replace(GUARD, delay_s=0.1))
    guard.sign_proven = True
    guard.allow(reading(0.0, 1.15), -1.0)
    assert guard.predicted_stop_rad == pytest.approx(1.15)
    with pytest.raises(Fault, match="POLARITY"):
        for k in range(1, 60):
            t_s = k * PERIOD_S
            guard.allow(reading(t_s, 1.15 + 3.0 * t_s**2), -1.0)
    assert 0.18 < t_s < 0.21
    assert guard.predicted_stop_rad == pytest.approx(
        1.15 + 3.0 * t_s**2 + guard.velocity_rad_s * (GUARD.reaction_s + 0.1 + GUARD.coast_tau_s), abs=0.01
    )


@given(st.integers(0, 10**6), st.floats(-4.0, 4.0))
def test_samples_at_another_pace_do_not_jolt_the_velocity(seed: int, v_rad_s: float) -> None:
    """Ten times as many samples, each as noisy: over the same time the slope is no worse, from the first on."""
    guard, noise = Guard(GUARD), np.random.default_rng(seed).normal(0.0, 0.003, 200)
    for k in range(5):
        guard.allow(reading(k * PERIOD_S, -0.5 + v_rad_s * k * PERIOD_S), 0.0)
    guard.pace(1e-3)
    for k in range(1, 160):
        t_s = 0.04 + 1e-3 * k
        guard.allow(reading(t_s, -0.5 + v_rad_s * t_s + noise[k]), 0.0)
        assert guard.velocity_rad_s == pytest.approx(v_rad_s, abs=0.7)


def test_a_new_guard_takes_the_shaft_to_stand_until_it_has_seen_it_move() -> None:
    guard = Guard(GUARD)
    guard.pace(PERIOD_S)
    for k in range(2):
        guard.allow(reading(0.01 * k, 0.5 + 0.01 * k), 0.0)
        assert guard.velocity_rad_s == 0.0
    guard.allow(reading(0.02, 0.52), 0.0)
    assert guard.velocity_rad_s == pytest.approx(1.0)


def test_at_1_khz_ten_bits_do_not_pass_for_overspeed() -> None:
    """Steps of 4 mrad and 3 mrad of noise: over five samples of 1 ms the slope is off by several rad/s."""
    lsb_rad, noise = 4.2 / 1024, np.random.default_rng(1).normal(0.0, 0.003, 2000)
    y_rad = np.round((np.sin(4.0 * np.arange(2000) * 1e-3) + noise) / lsb_rad) * lsb_rad
    guard, five = Guard(GUARD), VelocityWindow()
    guard.pace(1e-3)
    by_five = [five.step(1e-3 * k, float(y)) for k, y in enumerate(y_rad)]
    by_time = []
    for k, y in enumerate(y_rad):
        guard.allow(reading(1e-3 * k, float(y)), 0.0)
        by_time.append(guard.velocity_rad_s)
    true = 4.0 * np.cos(4.0 * np.arange(2000) * 1e-3)
    assert np.std((by_five - true)[50:]) > 10.0 * np.std(by_time[50:] - true[30:-20])  # which lags by 20 ms
    assert max(map(abs, by_five)) > GUARD.max_speed_rad_s > max(map(abs, by_time))


@pytest.mark.parametrize("side", [1, -1])
def test_between_soft_and_hard_only_inward_drive_passes(side: int) -> None:
    guard = Guard(GUARD)
    for k in range(20):
        y = 1.2 * side
        assert guard.allow(reading(0.01 * k, y), 1.0 * side) == (0.0, FLAG_GUARD_CLIPPED)
        assert guard.allow(reading(0.01 * k + 0.005, y), -0.3 * side) == (-0.3 * side, 0)
    assert guard.clipped_ticks == 20


@pytest.mark.parametrize("side", [1, -1])
def test_it_brakes_inward_on_the_predicted_stop_only_once_the_sign_is_proven(side: int) -> None:
    for proven, expected_V in ((False, 0.0), (True, -side * LIMITS.max_u_V)):
        guard = Guard(GUARD)
        if proven:
            guard.sign_proven = True
        u_V, flags = 0.0, 0
        for k in range(10):
            u_V, flags = guard.allow(reading(0.01 * k, side * (0.5 + 0.05 * k)), side * 1.0)
        assert side * guard.predicted_stop_rad > LIMITS.hard_rad[1]
        assert u_V == expected_V
        assert flags & FLAG_GUARD_BRAKED


@pytest.mark.parametrize("seed", range(4))
def test_the_brake_does_not_throw_a_light_motor_to_and_fro(seed: int) -> None:
    """A tick of its largest drive gives this one twice its largest speed: motor 48 of `make stalls`, without stalls."""
    limits, motor = Limits((-0.55, 0.55), (-1.95, 1.95), 3.0, 0.25), Motor(0.11, 29.7, coulomb(0.419))
    known = replace(
        GUARD, limits=limits, max_speed_rad_s=4.64, coast_tau_s=0.11, reaction_s=0.31, free_rad_s=3.0 * motor.K_rad_s_V
    )
    bench = simulated_bench(seed=seed, guard=known, start_rad=0.0, motor=motor)
    bench.guard.sign_proven = True
    fastest = 0.0

    def look(_: float) -> None:
        nonlocal fastest
        fastest = max(fastest, abs(bench.driver.bench.state.v))

    with bench.loop.armed(limits):
        bench.loop.run(Timed(DualChannelRelay(0.154, 0.59, 0.7), 6.0, "relay"), "relay-1", look)
    assert bench.guard.braked_ticks > 0 and fastest < 1.4 * known.max_speed_rad_s


def test_the_predicted_stop_counts_the_reaction_watchdog_and_all_and_the_way_that_the_shaft_coasts() -> None:
    """Exactly: the random runs above stop inside without either, by friction."""
    guard = Guard(GUARD)
    guard.sign_proven = True
    step_rad = 0.03  # 3 rad/s
    way_rad = 3.0 * (GUARD.reaction_s + GUARD.coast_tau_s)
    first_rad = LIMITS.hard_rad[1] - way_rad - 7.5 * step_rad
    drives = [guard.allow(reading(0.01 * k, first_rad + step_rad * k), 0.5)[0] for k in range(10)]
    assert guard.predicted_stop_rad == pytest.approx(first_rad + 9 * step_rad + way_rad)
    assert drives == [0.5] * 8 + [-LIMITS.max_u_V] * 2 and guard.braked_ticks == 2


def test_more_than_the_largest_drive_is_cut_and_flagged() -> None:
    u_V, flags = Guard(GUARD).allow(reading(0.0, 0.0), 7.0)
    assert (u_V, flags) == (LIMITS.max_u_V, FLAG_GUARD_CLIPPED)


@pytest.mark.parametrize(
    ("code", "samples"),
    [
        ("SENSOR_RAIL", [reading(0.0, 0.0, counts=5)]),
        ("SENSOR_RAIL", [reading(0.0, 0.0, counts=1018)]),
        ("SENSOR_JUMP", [reading(0.0, 0.0), reading(0.01, 0.4)]),
        ("TRAVEL_HARD", [reading(0.0, 1.95)]),
        ("OVERSPEED", [reading(0.01 * k, 0.08 * k - 0.5) for k in range(8)]),
        ("OVERSPEED", [reading(0.01 * k, 0.5 - 0.08 * k) for k in range(8)]),
        ("TRAVEL_HARD", [reading(0.0, -1.95)]),
        ("SAMPLE_STALE", [reading(0.01 * min(k, 4), 0.001 * k) for k in range(7)]),
        ("SAMPLE_STALE", [reading(0.5, 0.0) for _ in range(3)]),
    ],
)
def test_sensor_and_travel_faults_have_their_code_and_latch(code: str, samples: list[Sample]) -> None:
    guard = Guard(GUARD)
    with pytest.raises(Fault) as caught:
        for sample in samples:
            guard.allow(sample, 0.0)
    assert caught.value.code == code
    assert caught.value.cure
    with pytest.raises(Fault) as again:
        guard.allow(reading(1.0, 0.0), 0.0)
    assert again.value is caught.value


@pytest.mark.parametrize("asked_V", [math.nan, math.inf, -math.inf])
def test_a_drive_that_is_no_number_is_the_laws_failure(asked_V: float) -> None:
    guard = Guard(GUARD)
    with pytest.raises(Fault, match="LAW_FAILED"):
        guard.allow(reading(0.0, 0.0), asked_V)
    assert guard.fault is not None


def test_what_was_seen_before_a_pause_says_nothing_after_it() -> None:
    """A shaft that was moved by hand in the pause has not jumped, and a stand before it is over."""
    guard = Guard(GUARD)
    guard.static_V = 0.5
    for k in range(25):
        guard.allow(reading(0.01 * k, 0.01 * k), 1.0)
    assert guard.velocity_rad_s == pytest.approx(1.0)
    guard.rearm()
    for k in range(25):
        guard.allow(reading(0.26 + 0.01 * k, -0.9), 1.0)
        assert guard.velocity_rad_s == 0.0 or k < 4


def test_a_sample_may_come_twice_where_the_loop_is_as_quick_as_the_device() -> None:
    guard = Guard(GUARD)
    for k in range(200):
        guard.allow(reading(0.001 * (k - k % 2), 0.0), 0.1)
    assert math.isfinite(guard.velocity_rad_s)


def test_a_stuck_sensor_is_found_while_driven_and_not_while_at_rest() -> None:
    guard = Guard(GUARD)
    guard.static_V = 0.5
    for k in range(100):
        guard.allow(reading(0.01 * k, 0.1), 0.5)  # below what moves it: it may stand still
    with pytest.raises(Fault, match="SENSOR_STUCK"):
        for k in range(100, 200):
            guard.allow(reading(0.01 * k, 0.1), 1.0)


def test_a_shaft_that_moves_in_ever_rarer_jerks_is_stuck_in_the_end() -> None:
    """What it has needed so far is allowed twice, but not for ever: four times the stuck time at most."""
    guard = Guard(GUARD)
    guard.static_V = 0.5
    k, y_rad = 0, 0.0
    with pytest.raises(Fault, match="SENSOR_STUCK") as caught:
        for stand_s in (0.28, 0.5, 0.9, 1.15, 2.0):
            y_rad += 0.03
            for _ in range(round(stand_s / PERIOD_S)):
                guard.allow(reading(PERIOD_S * k, y_rad), 1.0)
                k += 1
    assert "for 1.20 s" in caught.value.detail


@pytest.mark.parametrize("side", [1, -1])
def test_drive_outward_of_soft_that_persists_while_inward_is_commanded_is_a_polarity_fault(side: int) -> None:
    """Wires swapped after the start: the bench accelerates outward although the guard brakes."""
    wide = replace(GUARD, limits=replace(LIMITS, soft_rad=(-0.3, 0.3), hard_rad=(-2.0, 2.0)))
    bench = simulated_bench(DEMO, guard=wide, drive="reversed", start_rad=0.35 * side)
    bench.guard.sign_proven = True
    with pytest.raises(Fault) as caught, bench.loop.armed(wide.limits):
        bench.loop.run(Constant(-1.0 * side, 2.0), "jog")
    assert caught.value.code == "POLARITY"
    assert bench.driver.bench.pin_counts == 0
    assert side * bench.driver.bench.state.y < 2.0


def test_an_obedient_shaft_is_never_accused() -> None:
    for start in (-1.3, 1.3):
        bench = simulated_bench(start_rad=start)
        bench.guard.sign_proven = True
        with bench.loop.armed(LIMITS):
            bench.loop.run(Constant(-math.copysign(1.0, start), 0.5), "jog")


@pytest.mark.parametrize("side", [1, -1])
def test_recovering_ends_inside_the_soft_limits_where_the_hard_ones_hold_again(side: int) -> None:
    guard = Guard(GUARD)
    guard.recovering = True
    inward_rad = [1.95, 1.85, 1.5, 1.11]
    for k, y in enumerate(inward_rad):
        assert guard.allow(reading(0.1 * k, side * y), -0.5 * side) == (-0.5 * side, 0)
        assert guard.recovering
    guard.allow(reading(0.5, side * 1.09), -0.5 * side)
    assert not guard.recovering
    with pytest.raises(Fault, match="TRAVEL_HARD"):
        guard.allow(reading(1.0, side * 1.91), 0.0)


@pytest.mark.parametrize(("wiring", "side"), [("reversed", 1.0), ("reversed", -1.0), ("stuck_on", 1.0)])
@pytest.mark.parametrize("start_rad", [1.2, 1.95])
def test_a_recovery_that_creeps_outward_is_ended_by_its_distance(
    wiring: DriveWiring, side: float, start_rad: float
) -> None:
    """Slower than 5 % of the speed limit, which the other rule on polarity takes no notice of."""
    motor = Motor(0.17, 0.2 if wiring == "reversed" else 0.035, coulomb(0.3))
    bench = simulated_bench(motor=motor, drive=wiring, start_rad=side * start_rad, offset_rad=0.0, noise_rad=0.001)
    bench.guard.recovering = True
    begin_rad = bench.driver.bench.state.y
    speeds: list[float] = []
    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(Constant(-0.8 * side, 20.0), "jog", lambda _: speeds.append(abs(bench.driver.bench.state.v)))
    assert max(speeds) < 0.05 * GUARD.max_speed_rad_s
    assert caught.value.code == "POLARITY" and "crept outward" in caught.value.detail
    assert bench.driver.bench.pin_counts == 0
    crept_rad = side * (bench.driver.bench.state.y - begin_rad)
    assert 0.0 < crept_rad < 12.0 * GUARD.noise_rad + 0.03


@pytest.mark.parametrize("outside_rad", [1.95, -1.95])
def test_jog_recovers_inward_from_beyond_the_hard_limit_and_not_outward(outside_rad: float) -> None:
    inward = -math.copysign(1.0, outside_rad)
    bench = simulated_bench(start_rad=outside_rad, offset_rad=0.0)
    bench.guard.recovering = True
    with bench.loop.armed(LIMITS):
        bench.loop.run(Constant(inward, 0.8), "jog")
    assert abs(bench.driver.bench.state.y) < abs(outside_rad) - 0.3
    bench = simulated_bench(start_rad=outside_rad, offset_rad=0.0)
    bench.guard.recovering = True
    with bench.loop.armed(LIMITS):
        bench.loop.run(Constant(-inward, 0.8), "jog")
    assert bench.driver.bench.state.y == pytest.approx(outside_rad, abs=1e-6)
    assert PERIOD_S == 0.01


def test_after_a_gap_the_velocity_is_of_the_readings_after_it() -> None:
    window = VelocityWindow()
    for k in range(6):
        window.step(0.01 * k, 0.02 * k)
    assert window.step(0.25, 0.5) == pytest.approx(2.0)  # until they tell it: the mean over the gap
    window.step(0.26, 0.45)
    assert window.step(0.27, 0.4) == pytest.approx(-5.0)


def test_a_shaft_that_a_gap_made_too_fast_is_braked_and_is_a_fault_only_if_it_stays_so() -> None:
    def after_gap(left: float) -> Guard:
        """A gap in which the shaft has come to 9 rad/s; it keeps ``left`` of that from tick to tick."""
        guard = Guard(replace(GUARD, free_rad_s=20.0, reaction_s=0.0, coast_tau_s=0.02))
        guard.sign_proven = True
        for k in range(6):
            guard.allow(reading(0.01 * k, -1.5), 0.0)
        y_rad, v_rad_s = -0.5, 9.0
        for k in range(12):
            u_V, flags = guard.allow(reading(0.2 + 0.01 * k, y_rad), 3.0)
            if k in (3, 4):
                assert u_V == pytest.approx(-LIMITS.max_u_V * guard.velocity_rad_s / 20.0) and flags & FLAG_GUARD_BRAKED
            y_rad, v_rad_s = y_rad + 0.01 * v_rad_s, left * v_rad_s
        return guard

    assert after_gap(0.95).fault is None
    with pytest.raises(Fault, match="OVERSPEED"):
        after_gap(1.0)


def test_what_is_too_fast_without_a_gap_is_a_fault_at_once() -> None:
    guard = Guard(GUARD)
    with pytest.raises(Fault, match="OVERSPEED"):
        for k in range(6):
            guard.allow(reading(0.01 * k, -0.5 + 0.075 * k), 0.0)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.05, 0.6),
    st.floats(0.5, 12.0),
    st.floats(-6.0, 6.0),
    st.lists(st.floats(0.71, 3.0), min_size=1, max_size=4),
)
def test_a_drive_never_takes_back_a_quarter_of_the_speed_that_it_gave(
    tau_s: float, K: float, v_rad_s: float, drives_V: list[float]
) -> None:
    """Any motor, any speed at the start, any row of drives more than 1.4 times its friction of 0.5 V."""
    gain = Gain(0.06)
    for k in range(200):
        u_V = drives_V[min(k // 50, len(drives_V) - 1)]
        friction_V = math.copysign(0.5, v_rad_s) if v_rad_s else 0.5
        given_rad_s = gain.step(0.01 * k, v_rad_s, u_V)
        assert given_rad_s == 0.0 or v_rad_s >= 0.7 * given_rad_s
        v_rad_s += 0.01 / tau_s * (K * (u_V - friction_V) - v_rad_s)
