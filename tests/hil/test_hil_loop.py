"""The real loop on the compiled firmware, both in virtual time: relay experiment, and every end measured at the pin."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_bench import CALIBRATION, DEMO, GUARD, LIMITS, PERIOD_S, SCALING, ListSink, break_away

from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.control.excitation import CycleTarget, GainSearch, RelayTest, SearchRange
from rig.control.guard import Guard
from rig.control.law import Constant, Rest
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.relay import DualChannelRelay
from rig.core.faults import Fault
from rig.model.cycle_detector import CycleDetector


@dataclass
class ChipBench:
    """The compiled firmware, and the loop that drives it through frames."""

    board: VirtualBoard
    guard: Guard
    loop: Loop
    record: ListSink
    stop: StopRequest


def chip_bench(seed: int = 1, **changes: Any) -> ChipBench:
    board = VirtualBoard(replace(DEMO, **changes), seed, clock_error_ppm=4000)
    driver = SerialDriver(board, SCALING)
    driver.open()
    guard, record, stop = Guard(GUARD), ListSink(), StopRequest()
    return ChipBench(board, guard, Loop(driver, board, guard, record, PERIOD_S, stop), record, stop)


def test_breakaway_search_and_relay_on_the_compiled_firmware() -> None:
    bench = chip_bench()
    detector = CycleDetector(30 * PERIOD_S, 20 * CALIBRATION.lsb_rad)
    relay = DualChannelRelay(0.0, 0.0, 0.7)
    with bench.loop.armed(LIMITS):
        check = break_away(bench.loop)
        search = GainSearch(
            relay,
            detector,
            CycleTarget(0.6, 1.0, 0.15),
            SearchRange(0.3, 0.1, 0.15, 0.6, 3.0, 3.0, 60.0),
            0.45 * (check.plus_V + check.minus_V),
            0.99,
        )
        bench.loop.run(search, "search")
        bench.loop.run(RelayTest(relay, detector, (relay.h1_V, relay.h2_V), 5, 60.0), "relay-1")
    assert detector.mean()[1] == pytest.approx(0.6, rel=0.2)
    assert bench.loop.statistics.skipped == 0
    assert bench.board.truth().pin_V == 0.0
    rows = bench.record.rows
    # one round trip at 115200 baud, 4.2 ms of wire, from sample to effect; the same in every row
    latencies = [row["t_u_s"] - row["t_s"] for row in rows]
    assert 0.0005 < min(latencies) <= max(latencies) < 0.006
    assert max(latencies) - min(latencies) < 0.0005


@settings(max_examples=25)
@given(
    st.floats(-1.87, 1.87), st.sampled_from([-3.0, 3.0]), st.booleans(), st.sampled_from([0.0, 0.4]), st.integers(0, 99)
)
def test_full_drive_from_anywhere_inside_the_hard_limits_stays_inside_them(
    start_rad: float, u_V: float, sign_proven: bool, dwell_s: float, seed: int
) -> None:
    """A shaft faster than the config says is a fault that ends it; whatever ends it, it coasts to its stop inside."""
    bench = chip_bench(seed, start_rad=start_rad)
    bench.guard.sign_proven = sign_proven
    reached: list[float] = []

    def watch(t_s: float) -> None:
        reached.append(bench.board.truth().y_rad)

    codes: list[str] = []
    try:
        with bench.loop.armed(LIMITS):
            bench.loop.run(Rest(dwell_s), "rest", watch)
            bench.loop.run(Constant(u_V, 2.0), "jog", watch)
    except Fault as fault:
        codes.append(fault.code)
    assert set(codes) <= {"OVERSPEED"}
    assert bench.board.truth().pin_V == 0.0
    for _ in range(200):
        bench.board.sleep_until(bench.board.now_s() + 0.01)
        reached.append(bench.board.truth().y_rad)
    assert LIMITS.hard_rad[0] < min(reached) and max(reached) < LIMITS.hard_rad[1]


@pytest.mark.parametrize("end", ["fault", "exception", "signal"])
def test_however_the_block_ends_the_pin_is_at_zero_and_the_device_disarmed(end: str) -> None:
    bench = chip_bench()

    def watch(t_s: float) -> None:
        if t_s > 1.5:
            assert bench.board.truth().pin_V != 0.0
            if end == "signal":
                bench.stop.reason = "SIGTERM"
            elif end == "fault":
                raise Fault("NO_CYCLE")
            else:
                raise ZeroDivisionError

    with pytest.raises((Fault, ZeroDivisionError)), bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.6, 3.0), "jog", watch)
    assert bench.board.truth().pin_V == 0.0
    assert bench.record.events[-1] == {"t_s": pytest.approx(bench.loop.now_s), "kind": "stop", "confirmed": True}


def test_an_unplugged_cable_is_a_fault_and_the_watchdog_stops_the_motor_inside_the_limits() -> None:
    bench = chip_bench(start_rad=-0.8)
    unplugged_s: list[float] = []

    def watch(t_s: float) -> None:
        if t_s > 1.4:
            unplugged_s.append(bench.board.now_s())
            bench.board.unplug()

    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.7, 5.0), "jog", watch)
    assert caught.value.code == "LINK_LOST"
    assert bench.record.events[-1]["confirmed"] is False  # nobody answered: it says so
    assert bench.board.truth().pin_V != 0.0
    off_s = math.nan
    while bench.board.now_s() < unplugged_s[0] + 1.5:
        bench.board.sleep_until(bench.board.now_s() + 0.0005)
        if math.isnan(off_s) and bench.board.truth().pin_V == 0.0:
            off_s = bench.board.now_s()
    assert off_s - unplugged_s[0] < LIMITS.watchdog_s + 0.0025
    assert bench.board.truth().y_rad < LIMITS.hard_rad[1]


def test_drives_that_never_arrive_end_the_run_within_the_watchdog_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """READ alone must not keep an old drive alive: the device hears the host, but not what it wants."""
    bench = chip_bench(start_rad=-0.8)
    lost_s: list[float] = []
    original = bench.board.write

    def lossy(data: bytes) -> None:
        if not (lost_s and len(data) == 10):  # a DRIVE frame, COBS and delimiter included
            original(data)

    bench.board.write = lossy  # type: ignore[method-assign]  # of this board alone

    def watch(t_s: float) -> None:
        if t_s > 1.4 and not lost_s:
            lost_s.append(bench.board.now_s())

    with pytest.raises(Fault, match="in a row were not accepted"), bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.7, 5.0), "jog", watch)
    assert bench.board.truth().pin_V == 0.0
    assert bench.board.truth().pin_changed_s - lost_s[0] < LIMITS.watchdog_s
