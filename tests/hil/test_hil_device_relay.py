"""The relay in the device, and what holds of strokes too, in virtual time: at the pin, by the driver, in the loop."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from device_laws import (
    GAINS_V,
    RELAY,
    STROKES,
    DeviceBench,
    LawSetup,
    RelayBench,
    StrokesBench,
    armed_driver,
    kind_of,
    run_for,
    running_host,
    start_relay,
    start_strokes,
    told_blocks,
)
from evidence import evidence
from raised import fault_of
from simulated_bench import CALIBRATION, GUARD, LIMITS
from virtual_host import BENCH, HELD, LSB_RAD, SETUP, TICK_S

from rig.backends.driver import RelayDriver, RelayRow, StrokeDriver
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.firmware_laws import FirmwareRelay
from rig.backends.serial.frames import (
    STATUS_LAW,
    Block,
    Code,
    FrameReader,
    Kind,
    Packet,
    encode,
)
from rig.config import load
from rig.config.schema import RelayGainsSection, RelaySection
from rig.control.law import Constant
from rig.core.faults import Fault
from rig.model.bench import SensorWiring
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.run_folder.recording.reader import read_run
from rig.running.experiment import script

LAWS = pytest.mark.parametrize("law", [RELAY, STROKES], ids=["relay", "strokes"])
START = pytest.mark.parametrize("start", [start_relay, start_strokes], ids=["relay", "strokes"])


# ---------------------------------------------------------------------- at the pin


@pytest.mark.parametrize("watchdog_ms", [100, *evidence(30, 1000)])
@pytest.mark.parametrize("clock_error_ppm", [5000.0, *evidence(0.0, -5000.0)])
def test_a_silent_host_means_0_V_within_the_watchdog_time_and_a_tick(watchdog_ms: int, clock_error_ppm: float) -> None:
    rng = random.Random(watchdog_ms)
    rate = 1.0 + 1e-6 * clock_error_ppm
    for _ in range(20):
        host = running_host(
            RELAY,
            HELD,
            SETUP._replace(watchdog_ms=watchdog_ms),
            clock_error_ppm=clock_error_ppm,
            clock_start_us=rng.getrandbits(32),
        )
        for _ in range(5):
            host.wait(rng.uniform(0.0, 0.9e-3 * watchdog_ms))
            host.send(Kind.KEEP)
            host.board.sleep_until(host.heard_s)
            kept_s = host.heard_s
        host.send(Kind.READ)  # which does not count, nor does anything else
        host.send(Kind.HELLO)
        host.send(Kind.RELAY, RELAY.pack())
        early_s, latest_s = kept_s + 1e-3 * watchdog_ms / rate, kept_s + (1e-3 * watchdog_ms + TICK_S) / rate
        host.board.sleep_until(early_s - 2e-6)
        assert host.pin_V() != 0.0
        host.board.sleep_until(latest_s + 2e-6)
        assert host.pin_V() == 0.0
        assert early_s - 2e-6 <= host.board.truth().pin_changed_s <= latest_s + 2e-6
        for _ in range(3):
            host.send(Kind.KEEP)
            host.wait(0.1)
            assert host.pin_V() == 0.0
        assert host.board.truth().fault == Code.WATCHDOG


@LAWS
@pytest.mark.parametrize(
    ("happens", "code"),
    [("limit", Code.TRAVEL), ("broken_low", Code.SENSOR_RAIL), ("broken_high", Code.SENSOR_RAIL)],
)
def test_what_stops_a_drive_stops_the_law_within_two_ticks(
    happens: Literal["limit"] | SensorWiring, code: Code, law: LawSetup
) -> None:
    rng = random.Random(happens)
    for _ in range(40):
        host = running_host(law)
        host.wait(rng.uniform(0.02, 0.05))
        assert host.pin_V() != 0.0
        if happens == "limit":
            host.board.place((SETUP.hard_hi + 6 - 512) * LSB_RAD)
        else:
            host.board.rewire(sensor=happens)
        happened_s = host.board.now_s()
        host.board.sleep_until(happened_s + 2 * TICK_S)
        assert host.pin_V() == 0.0
        host.wait(0.05)
        numbers, blocks = zip(*told_blocks(host), strict=True)
        assert list(numbers) == list(range(len(numbers)))
        assert blocks[-1].fault == code and not blocks[-1].status & STATUS_LAW
        assert blocks[-1].rows[-1][1] == 0  # the row of the tick that stopped it
        assert all(b.status & STATUS_LAW and b.fault == 0 for b in blocks[:-1])
        assert host.pin_V() == 0.0


@LAWS
def test_garbage_on_the_line_neither_stops_nor_moves_it(law: LawSetup) -> None:
    """No byte of it makes a frame: the decisions are those of an undisturbed twin, to the last row."""
    rng = random.Random(5)
    told = []
    for disturbed in (False, True):
        host, reader, blocks = running_host(law, seed=3), FrameReader(), []
        for _ in range(60):
            host.send(Kind.KEEP)
            if disturbed:
                junk = rng.randbytes(rng.randint(1, 30))
                sent = rng.choice(((kind_of(law), 9, law.pack()), (Kind.DRIVE, 9, b"\x50\x00")))
                damaged = bytearray(encode(*sent))
                damaged[rng.randrange(len(damaged) - 1)] ^= 1 << rng.randrange(8)
                host.board.write(b"\0" + junk + b"\0" + bytes(damaged) + b"\0")
            host.wait(0.02)
            blocks += told_blocks(host, reader)
        told.append(blocks)
        assert host.board.truth().dropped == 0 if not disturbed else host.board.truth().dropped > 60
    assert told[0] == told[1] and len(told[0]) >= 118


def test_the_pin_does_what_the_rows_say() -> None:
    """Drive and position of each row against the truth; a clock that is off and wraps meanwhile."""
    quiet = replace(BENCH, noise_rad=0.0)
    host = running_host(RELAY, quiet, clock_error_ppm=4000.0, clock_start_us=2**32 - 300_000)
    truths = []
    for k in range(600):
        host.board.sleep_until((int(host.board.now_s() * 1004) + 1) / 1004 + 1e-5)  # just after the device's tick
        truths.append(host.board.truth())
        if k % 10 == 0:
            host.send(Kind.KEEP)
    blocks = told_blocks(host)
    rows = [
        ((block.t_first_us + i * block.period_us - 2**32 + 300_000) % 2**32, *row)
        for _, block in blocks
        for i, row in enumerate(block.rows)
    ]
    assert len(rows) > 580
    by_ms = {round(t.t_s * 1004): t for t in truths}
    matched = 0
    for t_us, counts, drive in rows:
        truth = by_ms.get(round(t_us / 1000))
        if truth is not None:
            matched += 1
            assert 12.0 * drive / 799 == pytest.approx(truth.pin_V)
            assert counts == pytest.approx(512 + truth.y_rad / LSB_RAD, abs=0.6)
    assert matched > 550
    assert {drive for _, _, drive in rows} == {-80, 30, -30, 80}


# ---------------------------------------------------------------------- through the driver


@START
def test_every_tick_comes_once_until_the_law_is_stopped(start: Callable[[SerialDriver], None]) -> None:
    board, driver = armed_driver()
    assert isinstance(driver, RelayDriver) and isinstance(driver, StrokeDriver)
    start(driver)
    rows = run_for(board, driver, 2.0)
    rows += driver.stop_relay()
    assert board.truth().pin_V == 0.0 and board.truth().armed
    assert np.diff([row.t_s for row in rows]) == pytest.approx(driver.tick_s, abs=3e-6)
    assert rows[-1].t_s == pytest.approx(board.now_s(), abs=0.01) and len(rows) > 1990
    assert all(row.t_u_s == row.t_s for row in rows)  # the emulated device decides in no time
    drives = [-1.25, -0.45, 0.45, 1.25] if start is start_relay else [-1.0, -0.7, 0.8, 0.9]
    assert sorted({row.u_V for row in rows}) == pytest.approx(drives, abs=0.01)
    assert driver.link_statistics["bad_frames"] == driver.link_statistics["stale_replies"] == 0
    start(driver)  # and again
    assert run_for(board, driver, 0.5)[0].block == 0
    assert driver.safe_stop() and board.truth().pin_V == 0.0


@START
def test_a_start_whose_confirmation_gets_lost_is_repeated(start: Callable[[SerialDriver], None]) -> None:
    board, driver = armed_driver()
    read = board.read
    lost: list[bytes] = []

    def lossy(timeout_s: float) -> bytes:
        data = read(timeout_s)
        if not lost and data:
            lost.append(data)
            return b""
        return data

    board.read = lossy  # type: ignore[method-assign]  # of this board alone
    start(driver)
    assert lost
    rows = run_for(board, driver, 0.3)
    assert rows[0].block == 0 and np.diff([row.t_s for row in rows]) == pytest.approx(driver.tick_s, abs=3e-6)


@pytest.mark.parametrize(
    ("start", "law", "field"),
    [(start_relay, RELAY, "z_bound"), (start_strokes, STROKES, "still_ticks")],
    ids=["relay", "strokes"],
)
def test_a_law_that_was_stored_otherwise_is_refused(
    start: Callable[[SerialDriver], None], law: LawSetup, field: str
) -> None:
    """Its confirmation repeats what was stored."""
    board, driver = armed_driver()
    read, reader = board.read, FrameReader()
    changed: dict[str, Any] = {field: 7}

    def another(timeout_s: float) -> bytes:
        packets = reader.feed(read(timeout_s))
        stored = [
            p._replace(body=law.unpack(p.body)._replace(**changed).pack()) if p.kind == kind_of(law) | 0x80 else p
            for p in packets
        ]
        return b"".join(encode(p.kind, p.seq, p.body) for p in stored)

    board.read = another  # type: ignore[method-assign]  # of this board alone
    fault = fault_of(lambda: start(driver))
    assert fault.code == "ARM_READBACK" and f"{field}=7" in fault.detail


def test_a_block_of_another_session_is_a_reset() -> None:
    """A device that was reset and set up anew by somebody else."""
    board, driver = armed_driver()
    start_relay(driver)
    run_for(board, driver, 0.1)
    feed = driver._exchange.reader.feed

    def another(data: bytes) -> list[Packet]:
        blocks = [(p, Block.unpack(p.body)) for p in feed(data) if p.kind == Kind.BLOCK]
        return [p._replace(body=b._replace(session=b.session ^ 1).pack()) for p, b in blocks]

    driver._exchange.reader.feed = another  # type: ignore[method-assign]  # of this driver alone
    assert fault_of(lambda: run_for(board, driver, 0.3)).code == "DEVICE_RESET"


@pytest.mark.parametrize("damage", ["lost", "a bit"])
def test_a_block_that_is_missing_is_a_fault(damage: str) -> None:
    board, driver = armed_driver()
    start_relay(driver)
    run_for(board, driver, 0.3)
    read = board.read
    seen: list[bytes] = []

    def damaging(timeout_s: float) -> bytes:
        data = read(timeout_s)
        if data and not seen:
            seen.append(data)
            return b"" if damage == "lost" else data[:20] + bytes([data[20] ^ 4]) + data[21:]
        return data

    board.read = damaging  # type: ignore[method-assign]  # of this board alone
    assert fault_of(lambda: run_for(board, driver, 0.3)).code == "LINK_GAP"
    assert driver.safe_stop()


def test_what_the_device_latches_is_told_after_its_last_row() -> None:
    board, driver = armed_driver()
    start_relay(driver)
    run_for(board, driver, 0.105)
    board.place(1.93)
    board.sleep_until(board.now_s() + 0.02)
    rows = driver.read_rows()
    assert rows[-1].y_rad > 1.9 and rows[-1].u_V == 0.0 and rows[-2].u_V != 0.0
    fault = fault_of(driver.read_rows)
    assert fault.code == "DEVICE_TRAVEL" and "limits" in fault.detail


def test_keeps_that_do_not_arrive_end_in_the_watchdog() -> None:
    board, driver = armed_driver()
    start_relay(driver)
    run_for(board, driver, 0.3)
    lost_s = board.now_s()
    write = board.write
    board.write = lambda data: None if len(data) == 8 else write(data)  # type: ignore[method-assign]  # of this board alone
    assert fault_of(lambda: run_for(board, driver, 0.3)).code == "DEVICE_WATCHDOG"
    on_the_wire_s = 8 * 11 / 115200  # the last one that did arrive
    assert board.truth().pin_changed_s - lost_s < on_the_wire_s + LIMITS.watchdog_s + TICK_S


def test_a_reset_a_hang_and_a_cable_while_it_runs() -> None:
    board, driver = armed_driver()
    start_relay(driver)
    run_for(board, driver, 0.3)
    board.reset(4)
    assert board.truth().pin_V == 0.0
    assert fault_of(lambda: run_for(board, driver, 0.3)).code == "DEVICE_RESET"

    board, driver = armed_driver()
    start_relay(driver)
    run_for(board, driver, 0.3)
    board.hang()
    assert fault_of(lambda: run_for(board, driver, 0.3)).code == "LINK_TIMEOUT"
    board.sleep_until(board.now_s() + 0.12)
    assert board.truth().pin_V == 0.0

    board, driver = armed_driver()
    start_relay(driver)
    run_for(board, driver, 0.3)
    board.unplug()
    assert fault_of(lambda: run_for(board, driver, 0.3)).code == "LINK_LOST"
    board.sleep_until(board.now_s() + LIMITS.watchdog_s + TICK_S)
    assert board.truth().pin_V == 0.0


def test_an_integral_that_does_not_fit_is_refused_in_words() -> None:
    _, driver = armed_driver()
    assert "use a shorter cycle" in fault_of(lambda: driver.relay_command(*GAINS_V, 1e6)).detail


# ---------------------------------------------------------------------- in the loop


def test_the_loop_records_every_tick_with_the_laws_own_integral() -> None:
    bench = RelayBench()
    bench.run()
    rows = [row for row in bench.record.rows if row["stage"] == "relay-1"]
    t_s, y_rad = np.array([row["t_s"] for row in rows]), np.array([row["y_rad"] for row in rows])
    assert np.diff(t_s) == pytest.approx(bench.driver.tick_s, abs=3e-6)
    assert all(row["flags"] == 0 for row in rows)
    z_rad_s = np.concatenate([[0.0], np.cumsum(0.5 * (y_rad[1:] + y_rad[:-1]) * np.diff(t_s))])
    # the device's centre is a sixteenth of a count off at most
    drift = CALIBRATION.lsb_rad / 32 * (t_s[-1] - t_s[0])
    assert [row["z_rad_s"] for row in rows] == pytest.approx(z_rad_s, abs=drift + 1e-4)
    assert bench.detector.settled and bench.detector.mean()[1] == pytest.approx(0.43, rel=0.1)
    assert {round(abs(row["u_V"]), 3) for row in rows} == {1.247, 0.451}
    summary = bench.loop.summary().as_json()
    assert summary["skipped"] == 0
    assert summary["device"] == {"period_s": bench.driver.tick_s, "ticks": len(rows), "missed": 0}
    assert bench.board.truth().pin_V == 0.0
    assert bench.record.events[-1]["confirmed"] is True


def test_the_record_tells_since_when_0_V_act_after_a_test() -> None:
    """One row more, of stage rest, whose drive began before its sample; so what follows finds the drive as it was."""
    bench = RelayBench()
    changed_s: list[float] = []
    stop_relay = bench.driver.stop_relay

    def stopping() -> list[RelayRow]:
        rows = stop_relay()
        changed_s.append(bench.loop.since_start_s(bench.board.truth().pin_changed_s))
        return rows

    bench.driver.stop_relay = stopping  # type: ignore[method-assign]  # of this driver alone
    bench.run()
    last, before = bench.record.rows[-1], bench.record.rows[-2]
    assert (last["stage"], last["u_V"], before["stage"]) == ("rest", 0.0, "relay-1") and before["u_V"] != 0.0
    assert last["t_u_s"] == pytest.approx(changed_s[0], abs=1e-4)
    assert before["t_u_s"] < last["t_u_s"] < last["t_s"] < last["t_u_s"] + 0.02


def test_one_test_follows_the_other_in_motion() -> None:
    bench = RelayBench()
    other = RelayBench(gains_V=(0.3, 0.75))
    with bench.loop.armed(LIMITS):
        bench.loop.run_in_device(bench.test, bench.command, "relay-1")
        bench.loop.run_in_device(other.test, other.command, "relay-2")
        bench.loop.run(Constant(0.0, 0.7), "rest")
    assert bench.board.truth().v_rad_per_s == 0.0
    stages = [row["stage"] for row in bench.record.rows]
    between_s = (
        bench.record.rows[stages.index("relay-2")]["t_s"] - bench.record.rows[stages.index("relay-2") - 1]["t_s"]
    )
    assert between_s < 0.02
    assert bench.loop.statistics.skipped <= 2


def test_the_guard_stops_what_it_would_not_let_out() -> None:
    """A motor too strong for its gains: stopped by the host before the device's own limit."""
    bench = RelayBench(motor=Motor(0.17, 14.0, coulomb(0.3)), gains_V=(0.4, 1.2))
    fault = fault_of(bench.run)
    assert fault.code in ("RELAY_STOPPED", "OVERSPEED")
    truth = bench.board.truth()
    assert truth.pin_V == 0.0 and truth.fault == 0
    bench.board.sleep_until(bench.board.now_s() + 1.0)
    assert abs(bench.board.truth().y_rad) < LIMITS.hard_rad[1]
    assert bench.record.rows[-1]["t_s"] == pytest.approx(bench.loop.now_s, abs=1.06)


def test_a_drive_that_the_guard_would_not_let_out_ends_the_run_though_nothing_is_too_fast() -> None:
    quick = replace(GUARD, max_speed_rad_s=30.0)
    bench = RelayBench(motor=Motor(0.17, 14.0, coulomb(0.3)), gains_V=(0.4, 1.2), guard=quick)
    fault = fault_of(bench.run)
    assert fault.code == "RELAY_STOPPED" and "predicted stop" in fault.detail
    assert bench.board.truth().pin_V == 0.0


def test_a_device_that_decides_otherwise_is_found_out() -> None:
    bench = RelayBench()
    assert isinstance(bench.command, FirmwareRelay)
    setup = bench.command.setup
    bench.command = replace(bench.command, setup=setup._replace(centre=setup.centre + 40))
    fault = fault_of(bench.run)
    assert fault.code == "DEVICE_RELAY"
    assert bench.board.truth().pin_V == 0.0


@pytest.mark.parametrize("made", [RelayBench, StrokesBench])
@pytest.mark.parametrize("end", ["signal", "exception", "broken wire", "reset"])
def test_however_it_ends_the_pin_is_at_zero(end: str, made: Callable[[], DeviceBench]) -> None:
    bench = made()

    def watch(t_s: float) -> None:
        if t_s > 0.5:
            assert bench.board.truth().pin_V != 0.0 or end in ("broken wire", "reset")
            if end == "signal":
                bench.stop.reason = "SIGTERM"
            elif end == "exception":
                raise ZeroDivisionError
            elif end == "reset":
                bench.board.reset(4)
            else:
                bench.board.rewire(sensor="broken_low")

    with pytest.raises((Fault, ZeroDivisionError)) as caught:
        bench.run(watch)
    assert getattr(caught.value, "code", "") == {
        "signal": "INTERRUPTED", "exception": "", "broken wire": "DEVICE_SENSOR", "reset": "DEVICE_RESET"
    }[end]  # fmt: skip
    assert bench.board.truth().pin_V == 0.0 and not bench.board.truth().armed


def test_a_test_that_never_settles_ends_and_keeps_its_rows() -> None:
    bench = RelayBench(motor=Motor(0.17, 6.5, coulomb(5.0)), guard=replace(GUARD, stuck_s=99.0))
    bench.test.timeout_s = 1.0
    assert fault_of(bench.run).code == "NO_CYCLE"
    assert bench.record.rows[-1]["t_s"] - bench.record.rows[0]["t_s"] > 1.0


# ---------------------------------------------------------------------- the whole experiment, by one key


@pytest.mark.parametrize("where", ["device", *evidence("host")])
def test_the_experiment_runs_either_way_by_one_key(where: Literal["host", "device"], tmp_path: Path) -> None:
    experiment = load(Path(__file__).parents[2] / "config" / "device-relay.yaml")
    relay = RelaySection(where=where, gains=(RelayGainsSection(h1_V=0.4, h2_V=0.85),), cycles=5)
    outcome = script.run_relay(experiment.model_copy(update={"relay": relay}), tmp_path)
    assert outcome.failure == ""
    recording = read_run(outcome.folder)
    rows = recording.stage_rows("relay-1")
    step_s = float(np.median(np.diff(recording.t_s[rows])))
    assert step_s == pytest.approx(0.01 if where == "host" else 0.001 / 1.004, rel=1e-3)
    estimate = outcome.result.estimates["sampled-data"].as_json()
    for name, truth in (("tau_s", 0.17), ("K_rad_s_V", 6.5), ("fc_V", 0.48)):
        assert estimate[name] == pytest.approx(truth, rel=0.02)
    assert math.isfinite(outcome.result.relays[0].period_s)
    told: dict[str, Any] = outcome.result.as_json()
    assert ("device" in told["loop"]) == (where == "device")


def received(board: VirtualBoard) -> list[int]:
    """Readings of all blocks that the host is given from now on, filled as they come."""
    counts: list[int] = []
    read, reader = board.read, FrameReader()

    def listening(timeout_s: float) -> bytes:
        data = read(timeout_s)
        for packet in reader.feed(data):
            if packet.kind == Kind.BLOCK:
                counts.extend(row[0] for row in Block.unpack(packet.body).rows)
        return data

    board.read = listening  # type: ignore[method-assign]  # of this board alone
    return counts


@pytest.mark.parametrize("cause", ["interrupted", "guard", "limit", "law"])
def test_whatever_ends_the_run_each_row_that_came_is_in_the_record(cause: str) -> None:
    bench = RelayBench()
    counts = received(bench.board)

    def end(t_s: float) -> None:
        if t_s > 1.2037:
            if cause == "interrupted":
                bench.stop.reason = "SIGINT"
            elif cause == "limit":
                bench.board.place(1.93)
            else:
                raise Fault("OVERSPEED" if cause == "guard" else "NO_CYCLE")

    with pytest.raises(Fault):
        bench.run(end)
    rows = bench.record.rows
    assert [row["y_rad"] for row in rows] == [CALIBRATION.to_rad(n) for n in counts]
    assert np.diff([row["t_s"] for row in rows]) == pytest.approx(bench.driver.tick_s, abs=3e-6)
    stopping = [row for row in rows if row["stage"] == "stopping"]
    assert bool(stopping) == (cause != "limit")  # of itself the device tells in the test's own rows
    assert all(math.isnan(row["z_rad_s"]) for row in stopping)
    assert rows[-1]["u_V"] == 0.0 or cause != "limit"


@pytest.mark.parametrize(("cause", "code"), [("the device", "DEVICE_RELAY"), ("the guard", "OVERSPEED")])
def test_what_is_wrong_with_the_last_ticks_ends_the_run_by_its_name(cause: str, code: str) -> None:
    """The relay was stopped before they are judged: nothing more can come of it, and nothing is lost."""
    bench = RelayBench()
    stop_relay, last = bench.driver.stop_relay, []

    def stopped() -> list[RelayRow]:
        first, *others = stop_relay()
        last.extend([first._replace(u_V=-first.u_V) if cause == "the device" else first, *others])
        return list(last)

    def judge(t_s: float) -> None:
        if last:
            raise Fault("OVERSPEED")

    bench.driver.stop_relay = stopped  # type: ignore[method-assign]  # of this driver alone
    assert fault_of(lambda: bench.run(judge)).code == code
    assert [row["y_rad"] for row in bench.record.rows[-len(last) :]] == [row.y_rad for row in last]
    assert {event["kind"] for event in bench.record.events} == {"stage", "stop"}
    assert bench.board.truth().pin_V == 0.0


class Wire:
    """Whole frames on their way to the host: ``passes`` says what becomes of each."""

    def __init__(self, board: VirtualBoard, passes: Callable[[bytes], list[bytes]]) -> None:
        self._read, self._pending, self._passes = board.read, b"", passes
        board.read = self.read  # type: ignore[method-assign]  # of this board alone

    def read(self, timeout_s: float) -> bytes:
        *frames, self._pending = (self._pending + self._read(timeout_s)).split(b"\0")
        return b"".join(out for frame in frames for out in self._passes(frame + b"\0"))


def test_blocks_before_the_one_that_is_missing_are_in_the_record() -> None:
    """Three come at once, the second one damaged."""
    bench = RelayBench()
    held: list[bytes] = []

    def three(frame: bytes) -> list[bytes]:
        if bench.loop.now_s < 1.5 or len(held) >= 3:
            return [frame]
        held.append(frame)
        return [held[0], held[1][:-9] + b"\0", held[2]] if len(held) == 3 else []

    Wire(bench.board, three)
    fault = fault_of(bench.run)
    assert fault.code == "LINK_GAP" and fault.detail.endswith("1 missing")
    (packet,) = FrameReader().feed(held[0])
    told = [CALIBRATION.to_rad(counts) for counts, _ in Block.unpack(packet.body).rows]
    assert [row["y_rad"] for row in bench.record.rows[-10:]] == told


def test_a_block_that_comes_twice_is_taken_once() -> None:
    board, driver = armed_driver()
    start_relay(driver)
    rows = run_for(board, driver, 0.2)
    Wire(board, lambda frame: [frame, frame])
    rows += run_for(board, driver, 0.3)
    assert np.diff([row.t_s for row in rows]) == pytest.approx(driver.tick_s, abs=3e-6)
    assert driver.link_statistics["stale_replies"] > 20
