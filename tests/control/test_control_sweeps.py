"""The slow sweeps of a survey: the shaft follows them, within its limits, and what hinders it is found."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from evidence import evidence
from simulated_bench import GUARD, LIMITS, PERIOD_S, RAD_PER_COUNT, BenchModel, break_away, simulated_bench

from rig.control.sweep_plan import Room, SweepPlan, sweep_plan
from rig.control.sweeps import CrudeMotor, SweepLoop, Sweeps, loop_bandwidth_1_s, scatter
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.model.real_motor import Frame, RealMotor

NOISE_RAD = math.hypot(0.003, RAD_PER_COUNT / math.sqrt(12.0))
CRUDE = CrudeMotor(0.16, 6.8, 0.54, 0.50)
LOOP = SweepLoop(PERIOD_S, 0.0012, LIMITS.max_u_V, 0.11, RAD_PER_COUNT)
PLAN = sweep_plan(Room(LIMITS.soft_rad, GUARD.max_speed_rad_s, 0.2, loop_bandwidth_1_s(CRUDE, LOOP, NOISE_RAD), 60.0))


def swept(
    bench: BenchModel, motor: CrudeMotor = CRUDE, plan: SweepPlan = PLAN
) -> tuple[np.ndarray, np.ndarray, Fault | None]:
    """The true positions in the sweeps, the wanted ones, and the fault that ended them."""
    law, true_rad, wanted_rad = Sweeps(motor, plan, LOOP), [], []

    def watch(_: float) -> None:
        true_rad.append(bench.driver.bench.state.y)
        wanted_rad.append(law.yd_rad)

    fault = None
    try:
        with bench.loop.armed(GUARD.limits):
            break_away(bench.loop)
            bench.loop.run(law, "survey", watch)
    except Fault as seen:
        fault = seen
    return np.array(true_rad), np.array(wanted_rad), fault


@pytest.mark.parametrize(
    ("tau_share", "K_share"),
    [
        *((0.7, 1.3), (1.3, 0.75)),
        *evidence((1.0, 1.0), (0.7, 0.75), (0.7, 1.0), (1.0, 0.75), (1.0, 1.3), (1.3, 1.0), (1.3, 1.3)),
    ],
)
def test_the_shaft_follows_though_the_motor_is_only_known_crudely(tau_share: float, K_share: float) -> None:
    crude = replace(CRUDE, tau_s=0.17 * tau_share, K_rad_s_V=6.5 * K_share)
    true, wanted, fault = swept(simulated_bench(offset_rad=0.0), crude)
    assert fault is None
    assert float(np.sqrt(np.mean((true - wanted) ** 2))) < 0.01
    assert np.all(true > LIMITS.soft_rad[0]) and np.all(true < LIMITS.soft_rad[1])
    low, high = PLAN.low_rad, PLAN.high_rad
    assert true.min() == pytest.approx(low, abs=0.05) and true.max() == pytest.approx(high, abs=0.05)


@pytest.mark.parametrize(
    "parts",
    [
        {"stribeck_V": 0.08, "stribeck_rad_s": 0.3},
        *evidence(
            {"backlash_rad": 0.015},
            {"force_sin_V": 0.15},
            {"cogging_sin_V": 0.05, "cogging_per_rad": 10.0},
            {"dead_band_V": 0.08},
        ),
    ],
    ids=lambda parts: next(iter(parts)),
)
def test_the_shaft_of_a_real_motor_follows_too(parts: dict[str, float]) -> None:
    real = RealMotor(0.17, 6.5, 0.48)._replace(**parts)
    true, wanted, fault = swept(simulated_bench(real=real, frame=Frame(0.0, 1.1), offset_rad=0.0))
    assert fault is None
    assert float(np.sqrt(np.mean((true - wanted) ** 2))) < 0.02
    assert np.all(true > LIMITS.soft_rad[0]) and np.all(true < LIMITS.soft_rad[1])


@pytest.mark.parametrize("every", [8, *evidence(1)])
@pytest.mark.parametrize("wiring", [{"sensor": "stuck"}, {"drive": "dead"}], ids=["reading freezes", "drive dies"])
def test_what_hinders_the_shaft_is_found_before_it_leaves_the_hard_limits(wiring: dict[str, str], every: int) -> None:
    """Whenever it happens; a reading that freezes hides how far the shaft runs under the growing drive."""
    codes = set()
    for k in range(0, 40, every):
        after_s = 8.0 + 1.31 * k
        bench = simulated_bench(fault_after_s=after_s, seed=k, **wiring)  # type: ignore[arg-type]
        true, _, fault = swept(bench)
        assert fault is not None, f"not found: {wiring} after {after_s:.1f} s"
        codes.add(fault.code)
        for _ in range(60):
            bench.clock.sleep_until(bench.clock.now_s() + PERIOD_S)
            bench.driver.read()
            y = bench.driver.bench.state.y
            assert LIMITS.hard_rad[0] < y < LIMITS.hard_rad[1], f"{wiring} after {after_s:.1f} s: {y:.2f} rad"
        assert true.min() > LIMITS.hard_rad[0] and true.max() < LIMITS.hard_rad[1]
    assert codes <= {"NOT_FOLLOWING", "SENSOR_STUCK"}


@pytest.mark.parametrize(("noise_rad", "every"), [(0.003, 4), *evidence((0.0, 4), (0.0, 1), (0.003, 1))])
def test_in_slow_sweeps_a_frozen_reading_is_found_before_the_shaft_leaves_the_hard_limits(
    noise_rad: float, every: int
) -> None:
    """At 0.05 rad/s the reference is lost only after two seconds: by then the shaft would be at its stop."""
    bandwidth = loop_bandwidth_1_s(CRUDE, LOOP, NOISE_RAD)
    slow = sweep_plan(Room(LIMITS.soft_rad, GUARD.max_speed_rad_s, 0.05, bandwidth, 200.0), [0.1, 0.05])
    for k in range(1, 8, every):
        after_s = 12.0 + 15.4 * k
        bench = simulated_bench(sensor="stuck", fault_after_s=after_s, seed=k, noise_rad=noise_rad, offset_rad=0.0)
        _, _, fault = swept(bench, plan=slow)
        assert fault is not None and fault.code == "SENSOR_STUCK", f"frozen after {after_s:.1f} s: {fault}"
        for _ in range(100):
            bench.clock.sleep_until(bench.clock.now_s() + PERIOD_S)
            bench.driver.read()
        y = bench.driver.bench.state.y
        assert LIMITS.hard_rad[0] < y < LIMITS.hard_rad[1], f"frozen after {after_s:.1f} s: {y:.2f} rad"


def test_a_shaft_that_stands_is_a_fault_that_says_where() -> None:
    law = Sweeps(CRUDE, PLAN, replace(LOOP, lsb_rad=0.0))  # of a sensor that flickers
    with pytest.raises(Fault, match=r"NOT_FOLLOWING.*at 0\.000 rad instead of -0\.\d+ rad"):
        for k in range(1000):
            law.step(Sample(0.01 * k, 0.0, 512, t_u_s=0.01 * k - 0.009, u_V=0.0))


def test_the_drive_is_bounded_by_what_the_shaft_has_needed() -> None:
    law = Sweeps(CRUDE, PLAN, replace(LOOP, lost_rad=math.inf, lsb_rad=0.0))
    drives = [law.step(Sample(0.01 * k, 0.0, 512, t_u_s=0.01 * k - 0.009, u_V=0.0)) for k in range(3000)]
    fastest_V = max(PLAN.speeds_rad_s) / CRUDE.K_rad_s_V
    assert (
        -1.5 * CRUDE.minus_V - fastest_V - 1e-9 <= min(drives) and max(drives) <= 1.5 * CRUDE.plus_V + fastest_V + 1e-9
    )
    assert law.largest_u_V == max(map(abs, drives))


def test_the_scatter_of_the_loop_is_as_computed() -> None:
    """Of a motor without friction, whose loop is linear; its first second, in which it learns that, does not count."""
    noise_rad, bandwidth = 0.002, 8.0
    crude = CrudeMotor(0.17, 6.5, 5.0, 5.0)
    expected = scatter(crude, PERIOD_S, bandwidth)
    plan = SweepPlan(-1.0, 1.0, (0.05, 0.04), bandwidth)
    law = Sweeps(crude, plan, SweepLoop(PERIOD_S, 0.0, 10.0, math.inf, 0.0))
    motor, random = Motor(0.17, 6.5, Friction()), np.random.default_rng(1)
    state, u, speeds, drives = State(0.0, -1.0), 0.0, [], []
    for k in range(4000):
        reading = state.y + noise_rad * float(random.standard_normal())
        u = law.step(Sample(PERIOD_S * k, reading, 0, t_u_s=PERIOD_S * (k - 1) if k else math.nan, u_V=u))
        if k > 300:
            speeds.append(state.v)
            drives.append(u)
        state = motor.advance(state, u, PERIOD_S)
    assert float(np.std(speeds)) == pytest.approx(noise_rad * expected.speed_rad_s, rel=0.15)
    assert float(np.std(drives)) == pytest.approx(noise_rad * expected.drive_V, rel=0.15)
