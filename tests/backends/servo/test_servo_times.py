"""When a drive acts, and when a position was sampled, as the driver says it and as the emulated servo did it."""

from __future__ import annotations

import itertools
import random
import statistics

import pytest
from servo_bench import PROTOCOLS, Bench

WINDOW_S = 0.0045  # around a drive's time: within it the ramp of the fastest slope is over
LARGEST_MEAN_S = 1e-4
LEAST_CHANGE_V = 0.3


def acted_s(outputs: list[tuple[float, float]], about_s: float) -> float | None:
    """The time of a step that gives what the motor got around then; None where hardly anything changed."""
    from_s, to_s = about_s - WINDOW_S, about_s + WINDOW_S
    before_V = [volts for t_s, volts in outputs if t_s <= from_s][-1]
    after_V = [volts for t_s, volts in outputs if t_s <= to_s][-1]
    if abs(after_V - before_V) < LEAST_CHANGE_V:
        return None
    inside = [(from_s, before_V), *((t_s, volts) for t_s, volts in outputs if from_s < t_s <= to_s)]
    ends = [*(t_s for t_s, _ in inside[1:]), to_s]
    area = sum(volts * (end_s - t_s) for (t_s, volts), end_s in zip(inside, ends, strict=True))
    return (area - after_V * to_s + before_V * from_s) / (before_V - after_V)


@pytest.mark.parametrize("phase_s", [0.0, 0.0004])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_drive_acts_when_the_sample_says_in_the_mean(protocol: str, phase_s: float) -> None:
    """Wherever within the servo's step the loop's ticks are; a servo that tells its clock is known in each tick."""
    bench, rng = Bench(protocol, setup={"fastest_slope": True}), random.Random(1)
    bench.armed()
    bench.bus.sleep_until(bench.bus.now_s() + phase_s)
    told = [bench.tick(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)).t_u_s for _ in range(300)][2:]
    seen = [(t_u_s, acted_s(bench.bus.outputs[0], t_u_s)) for t_u_s in told]
    errors_s = [t_u_s - at_s for t_u_s, at_s in seen if at_s is not None]
    assert len(errors_s) > 150
    assert abs(statistics.mean(errors_s)) < LARGEST_MEAN_S
    assert statistics.pstdev(errors_s) < (LARGEST_MEAN_S if protocol == "dynamixel" else 4e-4)


@pytest.mark.parametrize("phase_s", [0.0, 0.0004])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_position_was_sampled_when_the_sample_says_in_the_mean(protocol: str, phase_s: float) -> None:
    """Of a shaft that turns at a known speed."""
    bench, speed = Bench(protocol), 1.2
    bench.armed()
    bench.bus.sleep_until(bench.bus.now_s() + phase_s)
    began_s, errors_s = bench.bus.now_s(), []
    real = bench.servo._tick

    def tick() -> None:
        bench.servo.place(-1.0 + speed * (bench.servo.t_s - began_s))
        real()

    bench.servo._tick = tick  # type: ignore[method-assign]  # of this one
    for _ in range(150):
        sample = bench.tick(0.0)
        errors_s.append((sample.y_rad + 1.0) / speed + began_s - sample.t_s)
    assert abs(statistics.mean(errors_s[5:])) < 2.0 * LARGEST_MEAN_S


@pytest.mark.parametrize(
    ("protocol", "period_s", "ticks", "fastest"),
    [("dynamixel", 0.002, 5, True), ("dynamixel", 0.003, 4, False), ("feetech", 0.0015, 1, True)],
)
def test_a_ramp_longer_than_a_period_is_no_fault_and_no_step_back_in_time(
    protocol: str, period_s: float, ticks: int, fastest: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Full drive to and fro, and once for a single tick alone: the ramp to it is ended early."""
    monkeypatch.setattr("servo_bench.PERIOD_S", period_s)
    bench = Bench(protocol, setup={"fastest_slope": fastest})
    bench.armed()
    drives = [1.6 * (-1.0) ** (k // ticks + (k == 70)) for k in range(120)]
    times = [bench.tick(u_V).t_u_s for u_V in drives][2:]
    assert all(after >= before for before, after in itertools.pairwise(times))
