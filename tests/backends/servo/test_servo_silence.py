"""The host falls silent at any phase: the duty is 0 soon after the watchdog's time, and the next run says so.

Where there is no watchdog the keeper stops the servo, and puts it back once the host is gone.
"""

from __future__ import annotations

import math
import os
import random
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace

import pytest
from evidence import evidence
from servo_bench import PERIOD_S, PROTOCOLS, Bench, Keeper

from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.keeper import stop_orders
from rig.core import heartbeat
from rig.core.heartbeat import SIZE, Heartbeat
from rig.core.memory_file import create_file
from rig.running.keeper.silence import keep

KEEPERS_S = 0.08  # after the last that the host did: then the keeper has stopped the servo
SILENCE_S = 0.06  # that it waits for a host that hangs
LATER_S = 0.02  # after the watchdog's time: its unit, and a step
PHASES = 200


def silent_at(phase: int) -> None:
    rng = random.Random(phase)
    bench = Bench(
        watchdog_fed_by=rng.choice(["any", "own"]),
        stopped_by_watchdog=rng.choice(["brake", "coast"]),
        resumes=rng.random() < 0.5,
    )
    bench.armed()
    driver = bench.driver
    for _ in range(rng.randrange(1, 30)):
        bench.tick(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, bench.limits.max_u_V))
    if rng.random() < 0.5:  # within a tick: behind its reading, or behind its drive
        driver.read()
        bench.bus.sleep_until(bench.bus.now_s() + rng.uniform(0.0, 0.5) * PERIOD_S)
    if rng.random() < 0.5:
        driver.write(rng.choice([-1.0, 1.0]) * bench.limits.max_u_V)
    silent_s = bench.bus.now_s()
    bench.bus.sleep_until(silent_s + bench.limits.watchdog_s + LATER_S)
    truth = bench.servo.truth()
    assert truth.duty == 0.0, phase
    bench.bus.sleep_until(silent_s + 1.0)
    assert not any(volts for t_s, volts in bench.bus.outputs[0] if t_s > silent_s + bench.limits.watchdog_s + LATER_S)
    info = bench.another().open()
    assert info.acknowledged == ("DEVICE_WATCHDOG",), phase
    assert any("without putting" in remark for remark in info.remarks)
    bench.driver.arm(bench.limits)
    bench.tick(0.3)
    bench.driver.safe_stop()
    bench.driver.close()
    assert bench.wrong() == []


@pytest.mark.parametrize(("first", "end"), [(0, 8), *evidence((8, 20), *((k, k + 20) for k in range(20, PHASES, 20)))])
def test_the_duty_is_0_after_the_watchdogs_time_and_the_next_run_says_so(first: int, end: int) -> None:
    for phase in range(first, end):
        silent_at(phase)


def test_a_host_that_comes_back_after_the_watchdog_has_acted_ends_with_its_name() -> None:
    bench = Bench()
    bench.armed()
    for _ in range(5):
        bench.tick(0.5)
    bench.bus.sleep_until(bench.bus.now_s() + 0.2)
    fault = bench.fault_within(1, 0.5)
    assert fault is not None and fault.code == "DEVICE_WATCHDOG"
    assert bench.driver.safe_stop()
    assert not bench.servo.is_on and bench.servo.truth().duty == 0.0
    assert bench.wrong() == []


class Hearing(Keeper):
    """A keeper that hears its host."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        memory = create_file(SIZE)
        self.heart = Heartbeat(memory)
        os.close(memory)

    def beat(self) -> None:
        self.heart.beat()

    def waits(self) -> None:
        self.heart.waits()


def driving(bench: Bench, keeper: Hearing, rng: random.Random) -> Iterator[None]:
    """What a host does, step by step, until it dies or hangs: anywhere in a tick, or with a drive on the wire."""
    driver, bus, volts = bench.driver, bench.bus, bench.limits.max_u_V
    for _ in range(rng.randrange(1, 20)):
        next_s = bus.now_s() + PERIOD_S
        driver.write(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, volts))
        yield
        bus.sleep_until(next_s)
        yield
        driver.read()
    bus.sleep_until(bus.now_s() + rng.choice([0.0, rng.uniform(0.0, PERIOD_S)]))
    if rng.random() < 0.5:
        keeper.beat()
        bus.write(driver._writing_drive(driver.drive_map.to_units(volts)).data)
    # of its orders the servo may miss one, or answer none
    kinds = (None, ReplyFault("lost", times=rng.randrange(1, 9)), ReplyFault("deaf", times=1))
    bus.bus.reply_fault = rng.choice(kinds)


def stopped_by_keeper(protocol: str, phase: int, monkeypatch: pytest.MonkeyPatch, *, hangs: bool) -> None:
    rng = random.Random(phase)
    bench = Bench(protocol, watchdog_defect=True)
    bus, before = bench.bus, bench.registers()
    monkeypatch.setattr(heartbeat, "time", SimpleNamespace(monotonic=bus.now_s))
    keeper = bench.driver._start_guardian = Hearing(bench)
    bench.armed()
    host, ended_s, hangs_s = driving(bench, keeper, rng), math.inf, rng.choice([0.2, 1.2]) if hangs else 0.0
    next(host)

    def told(wait_s: float | None) -> bytes | None:
        nonlocal ended_s
        until_s = bus.now_s() + (math.inf if wait_s is None else wait_s)
        for _ in host:
            if bus.now_s() >= until_s:
                return None
        ended_s = min(ended_s, bus.now_s())
        bus.sleep_until(min(until_s, ended_s + hangs_s))
        return b"" if bus.now_s() >= ended_s + hangs_s else None

    assert not keep(told, keeper.heart, SILENCE_S, keeper)
    assert keeper.outlive() == (True, True), phase
    keeper.heart.close()
    bus.sleep_until(bus.now_s() + 0.2)
    off = stop_orders(bench.driver._link)[-1].data
    off_s = [t_s for t_s, frame in bus.bus.log if t_s > ended_s and frame.encode() == off]
    driven_s = [ends_s for (_, volts), (ends_s, _) in pairwise(bus.outputs[0]) if volts]
    assert max(driven_s) <= ended_s + KEEPERS_S and off_s[0] <= ended_s + KEEPERS_S, phase
    assert bus.outputs[0][-1][1] == 0.0 and bench.registers() == before and bench.wrong() == [], phase


@pytest.mark.parametrize("hangs", [False, True])
@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(("first", "end"), [(0, 4), *evidence((4, 20), *((k, k + 20) for k in range(20, PHASES, 20)))])
def test_a_host_that_dies_or_hangs_is_outlived_by_a_stop_in_time(
    first: int, end: int, protocol: str, hangs: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for phase in range(first, end):
        stopped_by_keeper(protocol, phase, monkeypatch, hangs=hangs)


class Last(Keeper):
    """A keeper that rests when its host says so, and whose host may end without having put the servo back."""

    drives = False

    def beat(self) -> None:
        self.drives = True

    def rest(self) -> None:
        self.drives = False

    def end(self, *, restored: bool) -> None:
        assert restored or self.outlive() == (True, True)


def stands_still_in_the_end(protocol: str, at: int, *, is_behind: bool) -> bool:
    """Of a run that ends LATE, at that packet of the end. Whether there was such a packet."""
    bench = Bench(protocol)
    bus, before, real, packets = bench.bus, bench.registers(), bench.bus.write, 0
    keeper = bench.driver._start_guardian = Last(bench)
    bench.armed()
    faults = []
    for _ in range(5):
        faults.append(bench.fault_within(1, 1.0))
        bus.sleep_until(bus.now_s() + 0.045)
    assert any(fault is not None and fault.code == "LATE" for fault in faults)

    def write(data: bytes) -> None:
        nonlocal packets
        packets += 1
        if packets == at and is_behind:
            real(data)
        if packets == at:
            bus.write = real  # type: ignore[method-assign]  # of this bus alone
            bus.sleep_until(bus.now_s() + SILENCE_S)
            assert not keeper.drives or keeper.stop()
            bus.sleep_until(bus.now_s() + 1.0)
            bus.write = write  # type: ignore[method-assign]
        if packets != at or not is_behind:
            real(data)

    ends_s, bus.write = bus.now_s(), write  # type: ignore[method-assign]
    bench.driver.safe_stop()
    bench.driver.close()
    bus.write = real  # type: ignore[method-assign]
    assert not any(volts for t_s, volts in bus.outputs[0] if t_s > ends_s + KEEPERS_S), at
    assert not bench.servo.is_on and bench.servo.truth().duty == 0.0, at
    assert bench.registers() == before and bench.wrong() == [], at
    return packets >= at


@pytest.mark.parametrize("step", [7, *evidence(1)])
@pytest.mark.parametrize("is_behind", [False, True])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_host_that_stands_still_anywhere_in_the_end_of_a_late_run_leaves_the_servo_off_and_as_it_was(
    protocol: str, is_behind: bool, step: int
) -> None:
    """As by SIGSTOP: its keeper stops the servo meanwhile; behind it the host goes on."""
    at = 1
    while stands_still_in_the_end(protocol, at, is_behind=is_behind):
        at += step
    assert at > 10
