"""The bench around the motor: a drive that comes to the motor later than to the pin."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from simulated_bench import DEMO

from rig.model.bench import BenchModel, BenchParameters
from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.model.real_motor import Frame, MovingMotor, plain


def drives(bench: BenchModel, shift_s: float = 0.0, step_s: float = 0.003) -> list[tuple[float, float]]:
    """State after each 3 ms for 0.6 s, under drives that change at the pin every 0.1 s, from ``shift_s`` on."""
    states = []
    for k in range(round((0.6 + shift_s) / step_s)):
        t_s = k * step_s - shift_s
        bench.pin_counts = 0.0 if t_s < -1e-9 else (80.0, -120.0, 0.0)[int(t_s / 0.1 + 1e-9) % 3]
        bench.advance(step_s)
        states.append((bench.state.v, bench.state.y))
    return states


def test_behind_a_coasting_bridge_friction_alone_stops_the_motor() -> None:
    """At 0 V it runs v^2 tau / (2 K fc) on; at full drive it is the motor that it is."""
    motor = Motor(0.17, 6.5, Friction(0.5, 0.5, 0.5, 0.5))
    for coasts in (False, True):
        bench = BenchModel(BenchParameters(motor, coasting=coasts, stop_rad=(-1e3, 1e3)), 1)
        bench.state = State(v=10.0)
        bench.advance(2.0)
        braked_rad = 0.17 * (10.0 - 3.25 * math.log1p(10.0 / 3.25))
        assert bench.state == pytest.approx(
            (0.0, 10.0**2 * 0.17 / 6.5 if coasts else braked_rad, bench.state.z), rel=1e-5
        )
        bench.pin_counts = 799.0
        bench.advance(5.0)
        assert bench.state.v == pytest.approx(6.5 * 11.5)


def test_such_a_bench_is_a_motor_whose_bridge_lets_it_run_free_between_pulses() -> None:
    motor = Motor(0.17, 6.5, Friction(0.5, 0.5, 0.5, 0.5), bias_V=0.05)
    bench = BenchModel(BenchParameters(motor, coasting=True, stop_rad=(-1e3, 1e3)), 1)
    law = MovingMotor(plain(motor)._replace(free_between=1.0, full_drive_V=12.0), Frame(), 0.0)
    for counts in (250.0, 799.0, 120.0, 0.0, -300.0, 90.0, 0.0):
        bench.pin_counts = counts
        bench.advance(0.3)
        law.advance(bench.motor_V, 0.0, 0.3)
        # the bench is connected for a millionth of the time at least
        assert law.state[:2] == pytest.approx((bench.state.v, bench.state.y), abs=2e-4)


@pytest.mark.parametrize("delay_s", [0.006, 0.036, 0.12])
def test_a_delay_behind_the_pin_is_the_same_motion_later(delay_s: float) -> None:
    late = drives(BenchModel(replace(DEMO, drive_delay_s=delay_s), 1))
    shifted = drives(BenchModel(DEMO, 1), delay_s)
    for (v, y), (v_then, y_then) in zip(late, shifted, strict=False):
        assert v == pytest.approx(v_then, abs=1e-9)
        assert y == pytest.approx(y_then, abs=1e-9)
    assert max(abs(v) for v, _ in late) > 0.5


def test_changes_between_two_steps_of_the_bench_come_one_after_the_other() -> None:
    fine, coarse = (BenchModel(replace(DEMO, drive_delay_s=0.01), 1) for _ in range(2))
    for bench, steps in ((fine, 10), (coarse, 1)):
        for counts in (90.0, 0.0, -70.0):
            bench.pin_counts = counts
            bench.advance(0.004)
        for _ in range(steps):
            bench.advance(0.1 / steps)
    assert fine.state.y == pytest.approx(coarse.state.y, abs=1e-12)
    assert fine.acting_counts == coarse.acting_counts == -70.0
