"""When a drive acts, and when a position was sampled, as the driver says it and as the emulated servo did it."""

from __future__ import annotations

import itertools
import random
import statistics
from collections.abc import Callable, Sequence

import pytest
from servo_bench import PROTOCOLS, Bench

from rig.backends.links.usb_adapters import Adapter, adapter_delay_s
from rig.backends.registers.map import RegisterSpan
from rig.backends.servo.dynamixel import Instruction
from rig.backends.servo.steps import STEP_S

pytestmark = pytest.mark.every_id  # its bounds hold where the servo's milliseconds lie so

WINDOW_S = 0.0045  # around a drive's time: within it the ramp of the fastest slope is over
LARGEST_MEAN_S = 1e-4
LEAST_CHANGE_V = 0.3
SHORT_RAMP_V = 0.6  # behind a smaller change the ramp is over before it can be looked at
LARGEST_S = STEP_S + LARGEST_MEAN_S  # which of two steps a duty began with, nothing tells
INSTRUCTION_AT, REPLY_TO_WRITE_BYTES = 7, 11  # of a Dynamixel's packets
HELD_UP_SHARE, HELD_UP_S = 0.03, (0.002, 0.009)  # of the exchanges, each way, and for how long


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
    bench = Bench(protocol)
    bench.armed()
    bench.bus.sleep_until(bench.bus.now_s() + phase_s)
    is_at_s = turning(bench)
    errors_s = [is_at_s(sample.y_rad) - sample.t_s for sample in (bench.tick(0.0) for _ in range(150))]
    assert abs(statistics.mean(errors_s[5:])) < 2.0 * LARGEST_MEAN_S


def turning(bench: Bench, speed_rad_s: float = 1.2) -> Callable[[float], float]:
    """Have the shaft turn at this speed, whatever drives it; when it is where, s."""
    began_s, real = bench.bus.now_s(), bench.servo._tick

    def tick() -> None:
        bench.servo.place(-1.0 + speed_rad_s * (bench.servo.t_s - began_s))
        real()

    bench.servo._tick = tick  # type: ignore[method-assign]  # of this one
    return lambda y_rad: (y_rad + 1.0) / speed_rad_s + began_s


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("held_up", ["before it sends", "before it reads", "readings", "drives"])
def test_who_is_held_up_between_asking_and_reading_shifts_no_time(
    held_up: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The host, or what is on its way from it to the servo, wherever within its step that is.

    Where that is a drive whose ramp nobody has seen, all that took long is taken for its answer's way back.
    """
    # whatever is held up in a tick, the next one is on time; and no two are at the same place within a step
    monkeypatch.setattr("servo_bench.PERIOD_S", 0.030037)
    bench, rng = Bench(setup={"fastest_slope": True}), random.Random(seed)
    bench.armed()
    send = bench.bus.write

    def waits_s(who: str) -> float:
        return rng.uniform(*HELD_UP_S) if held_up == who and rng.random() < HELD_UP_SHARE else 0.0

    def late(_: str, data: bytes, __: float) -> list[tuple[float, bytes]]:
        who: dict[int, str] = {Instruction.READ: "readings", Instruction.WRITE: "drives"}
        return [(waits_s(who.get(data[INSTRUCTION_AT], "")), data)]

    def write(data: bytes) -> None:
        bench.bus.sleep_until(bench.bus.now_s() + waits_s("before it sends"))
        send(data)
        bench.bus.sleep_until(bench.bus.now_s() + waits_s("before it reads"))

    monkeypatch.setattr(bench.bus, "write", write)
    bench.bus.bus.disturbance, is_at_s = late, turning(bench)
    drives_V = [rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5) for _ in range(300)]
    samples = [bench.tick(u_V) for u_V in drives_V]
    changes_V = [abs(after_V - before_V) for before_V, after_V in itertools.pairwise(drives_V)]
    seen = [(s.t_u_s, acted_s(bench.bus.outputs[0], s.t_u_s), V) for s, V in zip(samples[2:], changes_V, strict=False)]
    drives_s = [(t_u_s - at_s, change_V) for t_u_s, at_s, change_V in seen if at_s is not None]
    readings_s = [is_at_s(s.y_rad) - s.t_s for s in samples[5:]]
    assert abs(statistics.mean(readings_s)) < 2.0 * LARGEST_MEAN_S and max(map(abs, readings_s)) < STEP_S
    assert abs(statistics.mean(off_s for off_s, _ in drives_s)) < LARGEST_MEAN_S
    for off_s, change_V in drives_s:
        assert abs(off_s) < (LARGEST_S if change_V > SHORT_RAMP_V else HELD_UP_S[1])


@pytest.mark.parametrize("on_its_way", ["there", "back", "neither"])
def test_by_how_much_all_drives_of_a_servo_without_a_clock_may_be_off_is_told(on_its_way: str) -> None:
    """As behind an adapter, or a machine, that has slept since the last tick: readings wait longer than drives."""
    bench, rng, asks = Bench("feetech"), random.Random(1), b""
    bench.armed()

    def waits(direction: str, data: bytes, _: float) -> list[tuple[float, bytes]]:
        nonlocal asks
        asks = data if direction == "request" else asks
        if on_its_way != ("there" if direction == "request" else "back"):
            return [(0.0, data)]
        mean_s = 3e-4 if asks == bench.driver._sampling.data else 1e-4
        return [(rng.uniform(0.5, 1.5) * mean_s, data)]

    bench.bus.bus.disturbance, is_at_s = waits, turning(bench)
    samples = [bench.tick(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)) for _ in range(300)][5:]
    seen = [(s.t_u_s, acted_s(bench.bus.outputs[0], s.t_u_s)) for s in samples]
    drives_s = statistics.mean(t_u_s - at_s for t_u_s, at_s in seen if at_s is not None)
    off_s = drives_s - statistics.mean(s.t_s - is_at_s(s.y_rad) for s in samples)
    told_s = bench.driver.times_shift_s
    assert abs(off_s) <= told_s + LARGEST_MEAN_S
    assert (told_s > 1e-4) == (on_its_way != "neither") and (on_its_way != "there" or off_s > LARGEST_MEAN_S)


@pytest.mark.parametrize("adapter", ["cp210x", "ch340"])
def test_answers_as_late_as_their_adapter_makes_them_cost_no_further_reading(
    adapter: Adapter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each further one takes a tick's time: of 3,000 ticks 74 were skipped."""
    monkeypatch.setattr("servo_bench.PERIOD_S", 0.05)
    longest_s = adapter_delay_s(adapter)
    bench, rng, reads = Bench(setup={"fastest_slope": True, "adapter_s": longest_s}), random.Random(1), 0
    bench.armed()

    def late(direction: str, data: bytes, _: float) -> list[tuple[float, bytes]]:
        nonlocal reads
        reads += direction == "request" and data[INSTRUCTION_AT] == Instruction.READ
        return [(rng.uniform(0.0, longest_s) if direction == "reply" else 0.0, data)]

    bench.bus.bus.disturbance = late
    for _ in range(50):
        bench.tick(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5))
    assert reads == 50


def test_a_late_answer_to_a_drive_that_did_not_change_costs_no_further_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has no ramp to look at, and the look made the tick late: 196 of 215 missed ones on a busy machine."""
    monkeypatch.setattr("servo_bench.PERIOD_S", 0.03)
    bench, reads = Bench(setup={"fastest_slope": True}), 0
    bench.armed()
    for _ in range(3):
        bench.tick(1.0)

    def late(direction: str, data: bytes, _: float) -> list[tuple[float, bytes]]:
        nonlocal reads
        reads += direction == "request" and data[INSTRUCTION_AT] == Instruction.READ
        return [(HELD_UP_S[1] if direction == "reply" and len(data) == REPLY_TO_WRITE_BYTES else 0.0, data)]

    bench.bus.bus.disturbance = late
    for _ in range(20):
        bench.tick(1.0)
    assert reads == 20
    bench.tick(-1.0)
    assert reads == 22


def test_a_duty_that_reads_a_step_less_than_was_written_is_no_ramp_behind_a_late_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("servo_bench.PERIOD_S", 0.03)
    numbers = RegisterSpan.numbers

    def a_step_less(span: RegisterSpan, data: bytes) -> Sequence[int]:
        told, at = list(numbers(span, data)), span.names.index("applied")
        told[at] -= (told[at] > 0) - (told[at] < 0)
        return told

    monkeypatch.setattr(RegisterSpan, "numbers", a_step_less)
    bench, rng = Bench(setup={"fastest_slope": True}), random.Random(1)
    bench.armed()

    def late(direction: str, data: bytes, _: float) -> list[tuple[float, bytes]]:
        is_late = direction == "reply" and len(data) == REPLY_TO_WRITE_BYTES and rng.random() < 0.1
        return [(rng.uniform(*HELD_UP_S) if is_late else 0.0, data)]

    bench.bus.bus.disturbance = late
    samples = [bench.tick(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)) for _ in range(200)]
    seen = [(s.t_u_s, acted_s(bench.bus.outputs[0], s.t_u_s)) for s in samples[2:]]
    assert max(abs(t_u_s - at_s) for t_u_s, at_s in seen if at_s is not None) < STEP_S


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


@pytest.mark.parametrize("spoilt", ["lost", "damaged", "later still"])
def test_a_further_reading_that_is_lost_ends_nothing_and_is_not_taken_for_the_next(
    spoilt: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next tick reads anyway, and sees the ramp of a drive that began late."""
    monkeypatch.setattr("servo_bench.PERIOD_S", 0.03)
    bench, rng = Bench(), random.Random(1)
    bench.armed()
    further = bench.driver._reading(bench.driver._glance)
    timeout_s, further_replies = bench.driver._timeout_s, 0

    def late(direction: str, data: bytes, _: float) -> list[tuple[float, bytes]]:
        nonlocal further_replies
        if direction == "reply" and len(data) == further.length:
            further_replies += 1
            spoils: dict[str, list[tuple[float, bytes]]] = {
                "lost": [], "damaged": [(0.0, data[:-1])], "later still": [(1.5 * timeout_s, data)]
            }  # fmt: skip
            return spoils[spoilt]
        is_drive = direction == "request" and data[INSTRUCTION_AT] == Instruction.WRITE
        return [(rng.uniform(*HELD_UP_S) if is_drive and rng.random() < 0.1 else 0.0, data)]

    bench.bus.bus.disturbance, is_at_s = late, turning(bench)
    samples = [bench.tick(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)) for _ in range(100)]
    assert further_replies > 5 and max(abs(is_at_s(s.y_rad) - s.t_s) for s in samples[5:]) < STEP_S


@pytest.mark.parametrize("held_up", ["request", "reply"])
def test_packets_held_up_while_a_duty_is_ramped_look_like_no_overload(
    held_up: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reading tells the duty of when it was read, not of when its answer came."""
    monkeypatch.setattr("servo_bench.PERIOD_S", 0.005)
    bench, rng = Bench(setup={"fastest_slope": False}), random.Random(1)
    bench.armed()

    def late(direction: str, data: bytes, _: float) -> list[tuple[float, bytes]]:
        return [(rng.uniform(*HELD_UP_S) if direction == held_up and rng.random() < 0.2 else 0.0, data)]

    bench.bus.bus.disturbance = late
    assert all(bench.fault_within(1, rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)) is None for _ in range(300))
