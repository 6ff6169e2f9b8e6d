"""The strokes in the device, in virtual time: at the pin of the compiled firmware, through the driver, in the loop."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np
import pytest
from raised import fault_of
from simulated_bench import DEMO, GUARD, LIMITS, PERIOD_S, SCALING, ListSink
from virtual_host import BENCH, HELD, LSB_RAD, SETUP, TICK_S, BoardOptions, VirtualHost, armed_host

import rig.running.experiment
from rig.backends.driver import RelayRow, StrokeDriver, StrokesCommand, StrokeTimes
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.firmware_laws import FirmwareStrokes
from rig.backends.serial.frames import (
    FEATURE_STROKES,
    STATUS_LAW,
    Block,
    Code,
    FrameReader,
    Hello,
    Kind,
    Nack,
    Setup,
    StrokesSetup,
    encode,
)
from rig.config import load
from rig.config.schema import RelaySection, UntilSection
from rig.control.bounded import Bounded
from rig.control.guard import Guard, GuardSettings
from rig.control.law import Law, Rest
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.strokes import Stroke
from rig.control.strokes_on_counts import CountedTimes, StrokesOnCounts
from rig.core.faults import Fault
from rig.design.advisor import Advice, AdvisorSettings
from rig.design.planned_test import Design, PlannedTest, Reach, RelayGains, Strokes
from rig.model.bench import BenchParameters, SensorWiring
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.run_folder.recording.reader import read_run
from rig.run_folder.results import ScriptCall
from rig.running.experiment.script import BREAKAWAY_LAW
from rig.running.experiment.until import drive_until
from rig.running.replay import replay
from rig.running.session import record

STROKES = StrokesSetup(((80, 600), (-90, 420), (60, 560), (-70, 470)), 2000, 2000, 5, 10)
LEVELS_V = ((0.9, 0.35), (-1.0, -0.35), (0.8, 0.2), (-0.7, -0.2))  # drive, V; turning point, rad
TIMES = StrokeTimes(1.5, 0.3)
MOTION_RAD = 0.02


def running_host(
    bench: BenchParameters = BENCH, setup: Setup = SETUP, strokes: StrokesSetup = STROKES, **board: Unpack[BoardOptions]
) -> VirtualHost:
    host = armed_host(bench, setup, **board)
    packet = host.ask(Kind.STROKES, strokes.pack())
    assert packet.kind == Kind.STROKES_REPLY and StrokesSetup.unpack(packet.body) == strokes
    return host


def told_blocks(host: VirtualHost, reader: FrameReader | None = None) -> list[tuple[int, Block]]:
    """Every block that has arrived by now, and not been read before."""
    reader = reader or FrameReader()
    packets = []
    while data := host.board.read(0.0):
        packets += reader.feed(data)
    return [(p.seq, Block.unpack(p.body)) for p in packets if p.kind == Kind.BLOCK]


# ---------------------------------------------------------------------- at the pin


def test_the_device_says_that_it_can() -> None:
    assert VirtualHost(VirtualBoard(BENCH)).hello().features & FEATURE_STROKES


@pytest.mark.parametrize(
    ("happens", "code"),
    [("limit", Code.TRAVEL), ("broken_low", Code.SENSOR_RAIL), ("broken_high", Code.SENSOR_RAIL)],
)
def test_what_stops_a_drive_stops_the_strokes_within_two_ticks(
    happens: Literal["limit"] | SensorWiring, code: Code
) -> None:
    rng = random.Random(happens)
    for _ in range(40):
        host = running_host()
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
        assert host.pin_V() == 0.0


@pytest.mark.parametrize("sensor", ["stuck", "dead drive"])
def test_a_shaft_that_does_not_show_its_motion_is_driven_for_two_strokes_at_most(sensor: str) -> None:
    """Whoever keeps the device alive: P12, at the pin."""
    times = STROKES._replace(stroke_ticks=250, still_ticks=120)
    bench = replace(HELD, noise_rad=0.0) if sensor == "dead drive" else replace(BENCH, noise_rad=0.0)
    host = running_host(bench, strokes=times)
    if sensor == "stuck":
        host.board.rewire(sensor="stuck")
    started_s = host.board.now_s()
    seen: list[float] = []
    while host.board.now_s() < started_s + 1.0:
        host.send(Kind.KEEP)
        host.wait(0.005)
        seen.append(host.pin_V())
        if host.board.now_s() > started_s + 2 * 0.123:
            assert host.pin_V() == 0.0
    assert min(seen) < 0.0 < max(seen)  # one stroke each way
    assert host.board.truth().armed and host.board.truth().fault == 0


def test_garbage_on_the_line_neither_stops_nor_moves_them() -> None:
    """No byte of it makes a frame: the decisions are those of an undisturbed twin, to the last row."""
    rng = random.Random(5)
    told = []
    for disturbed in (False, True):
        host, reader, blocks = running_host(seed=3), FrameReader(), []
        for _ in range(60):
            host.send(Kind.KEEP)
            if disturbed:
                junk = rng.randbytes(rng.randint(1, 30))
                damaged = bytearray(encode(Kind.STROKES, 9, STROKES.pack()))
                damaged[rng.randrange(len(damaged) - 1)] ^= 1 << rng.randrange(8)
                host.board.write(b"\0" + junk + b"\0" + bytes(damaged) + b"\0")
            host.wait(0.02)
            blocks += told_blocks(host, reader)
        told.append(blocks)
        assert host.board.truth().dropped == 0 if not disturbed else host.board.truth().dropped > 60
    assert told[0] == told[1] and len(told[0]) >= 118


def test_they_are_refused_before_arming_beyond_a_limit_and_with_wrong_numbers() -> None:
    def refusal(host: VirtualHost, strokes: StrokesSetup = STROKES) -> Code:
        packet = host.ask(Kind.STROKES, strokes.pack())
        assert packet.kind == Kind.NACK
        host.wait(0.01)
        assert host.pin_V() == 0.0
        return Code(Nack.unpack(packet.body).code)

    fresh = VirtualHost(VirtualBoard(BENCH))
    assert refusal(fresh) == Code.RESET
    fresh.acknowledge(Code.RESET)
    assert refusal(fresh) == Code.NOT_ARMED
    host = armed_host(replace(BENCH, start_rad=1.95))
    assert refusal(host) == Code.TRAVEL
    host = armed_host()
    assert refusal(host, STROKES._replace(strokes=((201, 600), (-90, 420)))) == Code.DRIVE_RANGE
    assert refusal(host, STROKES._replace(strokes=((80, 976), (-90, 420)))) == Code.SETUP_INVALID
    assert refusal(host, STROKES._replace(strokes=((80, 600), (90, 420)))) == Code.SETUP_INVALID
    assert refusal(host, STROKES._replace(stroke_ticks=0)) == Code.SETUP_INVALID


# ---------------------------------------------------------------------- through the driver


def armed_driver(**bench: Any) -> tuple[VirtualBoard, SerialDriver]:
    board = VirtualBoard(replace(DEMO, **bench), clock_error_ppm=4000)
    driver = SerialDriver(board, SCALING)
    driver.open()
    driver.arm(LIMITS)
    return board, driver


def run_for(board: VirtualBoard, driver: SerialDriver, time_s: float) -> list[RelayRow]:
    rows = []
    until_s = board.now_s() + time_s
    while board.now_s() < until_s:
        board.sleep_until(board.now_s() + PERIOD_S)
        driver.keep()
        rows += driver.read_rows()
    return rows


def start(board: VirtualBoard, driver: SerialDriver) -> StrokesCommand:
    command = driver.strokes_command(LEVELS_V, TIMES, MOTION_RAD)
    driver.start_strokes(command)
    return command


def test_every_tick_comes_once_until_the_strokes_are_stopped() -> None:
    board, driver = armed_driver()
    assert isinstance(driver, StrokeDriver)
    start(board, driver)
    rows = run_for(board, driver, 2.0)
    rows += driver.stop_relay()
    assert board.truth().pin_V == 0.0 and board.truth().armed
    assert np.diff([row.t_s for row in rows]) == pytest.approx(driver.tick_s, abs=3e-6)
    assert len(rows) > 1990 and {round(row.u_V, 1) for row in rows} == {0.9, -1.0, 0.8, -0.7}
    assert max(row.y_rad for row in rows) > 0.35 and min(row.y_rad for row in rows) < -0.35
    assert driver.link_statistics["bad_frames"] == driver.link_statistics["stale_replies"] == 0
    start(board, driver)  # and again
    assert run_for(board, driver, 0.5)[0].block == 0
    assert driver.safe_stop() and board.truth().pin_V == 0.0


def test_a_start_whose_confirmation_gets_lost_is_repeated() -> None:
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
    start(board, driver)
    assert lost
    rows = run_for(board, driver, 0.3)
    assert rows[0].block == 0 and np.diff([row.t_s for row in rows]) == pytest.approx(driver.tick_s, abs=3e-6)


def test_strokes_that_were_stored_otherwise_are_refused() -> None:
    """Their confirmation repeats what was stored."""
    board, driver = armed_driver()
    read, reader = board.read, FrameReader()

    def another(timeout_s: float) -> bytes:
        packets = reader.feed(read(timeout_s))
        stored = [
            p._replace(body=StrokesSetup.unpack(p.body)._replace(still_ticks=7).pack())
            if p.kind == Kind.STROKES_REPLY
            else p
            for p in packets
        ]
        return b"".join(encode(p.kind, p.seq, p.body) for p in stored)

    board.read = another  # type: ignore[method-assign]  # of this board alone
    fault = fault_of(lambda: start(board, driver))
    assert fault.code == "ARM_READBACK" and "still_ticks=7" in fault.detail


def test_strokes_that_do_not_fit_are_refused_in_words() -> None:
    _, driver = armed_driver()
    many = fault_of(lambda: driver.strokes_command(5 * LEVELS_V, TIMES, MOTION_RAD))
    assert many.code == "CONFIG_MISMATCH" and "the device takes 8 strokes, not 20" in many.detail
    with pytest.raises(ValueError, match="less than the drive's smallest step"):
        driver.strokes_command(((1.0, 0.3), (-0.001, -0.3)), TIMES, MOTION_RAD)
    with pytest.raises(ValueError, match="beyond the"):
        driver.strokes_command(((99.0, 0.3), (-1.0, -0.3)), TIMES, MOTION_RAD)
    longest = driver.strokes_command(LEVELS_V, StrokeTimes(60.0, 0.3), MOTION_RAD)
    assert longest.stroke_ticks == 10_000  # given up sooner than asked for


# ---------------------------------------------------------------------- in the loop


class DeviceBench:
    """The loop on the compiled firmware, and strokes for its own stroke test."""

    def __init__(self, guard: GuardSettings = GUARD, levels: Any = LEVELS_V, **bench: Any) -> None:
        self.board = VirtualBoard(replace(DEMO, **bench), clock_error_ppm=4000)
        self.driver = SerialDriver(self.board, SCALING)
        self.driver.open()
        self.guard, self.record, self.stop = Guard(guard), ListSink(), StopRequest()
        self.guard.sign_proven = True
        self.loop = Loop(self.driver, self.board, self.guard, self.record, PERIOD_S, self.stop)
        self.command = c = self.driver.strokes_command(levels, TIMES, MOTION_RAD)
        self.strokes = StrokesOnCounts(
            c.strokes, c.centre_counts, c.direction, CountedTimes(c.stroke_ticks, c.still_ticks), c.still_counts
        )
        self.law = Bounded(self.strokes, None)

    def run(self, after: Callable[[float], None], *, then: Law | None = None, guard_ends_run: bool = True) -> None:
        with self.loop.armed(LIMITS):
            self.loop.run_in_device(self.law, self.command, "strokes-1", after, guard_ends_run=guard_ends_run)
            if then is not None:
                self.loop.run(then, "rest")

    def ends_at(self, t_s: float) -> Callable[[float], None]:
        """What ends the strokes after a time, s."""

        def after(now_s: float) -> None:
            self.law.finished = self.law.finished or now_s > t_s or self.law.failed != ""

        return after


def test_the_loop_records_every_tick_and_the_laws_agree() -> None:
    bench = DeviceBench()
    bench.run(bench.ends_at(4.0))
    rows = [row for row in bench.record.rows if row["stage"] == "strokes-1"]
    assert np.diff([row["t_s"] for row in rows]) == pytest.approx(bench.driver.tick_s, abs=3e-6)
    assert all(row["flags"] == 0 for row in rows) and bench.strokes.ended > 6
    assert (bench.record.rows[-1]["stage"], bench.record.rows[-1]["u_V"]) == ("rest", 0.0)
    assert bench.board.truth().pin_V == 0.0
    told: dict[str, Any] = bench.loop.statistics.summary().as_json()
    assert told["device"]["ticks"] == len(rows)


def test_a_device_that_decides_otherwise_is_found_out() -> None:
    bench = DeviceBench()
    assert isinstance(bench.command, FirmwareStrokes)
    (units, turn), *others = bench.command.setup.strokes
    setup = bench.command.setup._replace(strokes=((units, turn + 6), *others))
    bench.command = replace(bench.command, setup=setup)
    assert fault_of(lambda: bench.run(bench.ends_at(9.0))).code == "DEVICE_RELAY"
    assert bench.board.truth().pin_V == 0.0


def test_a_device_that_stops_the_strokes_while_the_loop_ends_them_says_why() -> None:
    """Its last row has 0 V, which the law did not decide: that is no other law."""
    bench = DeviceBench()

    def after(now_s: float) -> None:
        if now_s > 2.0 and not bench.law.finished:
            bench.board.place(LIMITS.hard_rad[1] + 0.02)
            bench.law.finished = True

    assert fault_of(lambda: bench.run(after, then=Rest(0.2))).code == "DEVICE_TRAVEL"
    assert bench.board.truth().pin_V == 0.0


@pytest.mark.parametrize("guard_ends_run", [True, False])
def test_a_drive_that_the_guard_would_not_let_out(guard_ends_run: bool) -> None:
    """It ends the run, or the strokes alone: then the next law's drive is the guard's again, and brakes the shaft."""
    quick = replace(GUARD, max_speed_rad_s=30.0)
    bench = DeviceBench(quick, ((2.2, 1.0), (-2.2, -1.0)), motor=Motor(0.17, 14.0, coulomb(0.3)))

    def run() -> None:
        bench.run(lambda t_s: None, then=Rest(0.7), guard_ends_run=guard_ends_run)

    if guard_ends_run:
        fault = fault_of(run)
        assert fault.code == "RELAY_STOPPED" and "predicted stop" in fault.detail
    else:
        run()
        assert bench.guard.fault is None
        rest = [row for row in bench.record.rows if row["stage"] == "rest"]
        assert any(row["u_V"] != 0.0 for row in rest)  # the guard's own
        assert bench.board.truth().v_rad_per_s == 0.0
    truth = bench.board.truth()
    assert truth.pin_V == 0.0 and truth.fault == 0
    bench.board.sleep_until(bench.board.now_s() + 1.0)
    assert abs(bench.board.truth().y_rad) < LIMITS.hard_rad[1]


def test_strokes_that_fail_end_alike_in_host_and_device() -> None:
    """A shaft too slow for its strokes: two fail, the device drives nothing from that tick on, and the law says why."""
    bench = DeviceBench(motor=Motor(0.17, 0.15, coulomb(0.3)))
    bench.run(bench.ends_at(20.0))
    assert "two strokes in a row did not come to their turning points" in bench.law.failed
    drives = [row["u_V"] for row in bench.record.rows if row["stage"] == "strokes-1"]
    assert 3000 < sum(drive != 0.0 for drive in drives) < 3030
    assert drives[-1] == 0.0 and bench.board.truth().pin_V == 0.0 and bench.board.truth().fault == 0


def test_a_stuck_sensor_ends_the_run() -> None:
    bench = DeviceBench(replace(GUARD, stuck_s=9.0))

    def after(t_s: float) -> None:
        if t_s > 0.6:
            bench.board.rewire(sensor="stuck")

    assert fault_of(lambda: bench.run(after)).code == "SENSOR_STUCK"
    assert bench.board.truth().pin_V == 0.0


@pytest.mark.parametrize("end", ["signal", "exception", "broken wire", "reset"])
def test_however_it_ends_the_pin_is_at_zero(end: str) -> None:
    bench = DeviceBench()

    def after(t_s: float) -> None:
        if t_s > 0.5:
            if end == "signal":
                bench.stop.reason = "SIGTERM"
            elif end == "exception":
                raise ZeroDivisionError
            elif end == "reset":
                bench.board.reset(4)
            else:
                bench.board.rewire(sensor="broken_low")

    with pytest.raises((Fault, ZeroDivisionError)) as caught:
        bench.run(after)
    assert getattr(caught.value, "code", "") == {
        "signal": "INTERRUPTED", "exception": "", "broken wire": "DEVICE_SENSOR", "reset": "DEVICE_RESET"
    }[end]  # fmt: skip
    assert bench.board.truth().pin_V == 0.0 and not bench.board.truth().armed


# ---------------------------------------------------------------------- tests until the motor is known


class Scripted:
    """An adviser that gives designs at fixed times of the tests, whatever the rows say."""

    trouble = last_words = ""

    def __init__(self, script: Sequence[tuple[float, PlannedTest | str]]) -> None:
        self._script = list(script)
        self._began_s = math.nan
        self.braked_tests = 0

    def begin(self, settings: AdvisorSettings) -> None:
        pass

    def advice(self, row: int, t_s: float) -> Advice | None:
        if math.isnan(self._began_s):
            self._began_s = t_s
        if not self._script or t_s - self._began_s < self._script[0][0]:
            return None
        _, what = self._script.pop(0)
        if isinstance(what, str):
            return Advice(None, stop=what)
        return Advice(None, Design(what, math.nan, math.nan, Reach(math.nan, math.nan, math.nan)))

    def braked(self) -> None:
        self.braked_tests += 1


PLAN = Strokes(tuple(Stroke(*level) for level in LEVELS_V), 1.5)
TOO_FAR = Strokes((Stroke(0.6, 1.0), Stroke(-0.6, -1.0)), 0.2)  # no stroke gets there in time
HARD = Strokes((Stroke(1.16, 0.9), Stroke(-1.16, -0.9)), 1.5)  # the guard has to brake in the first one
IN_TURN: tuple[tuple[float, PlannedTest | str], ...] = (
    (0.5, PLAN), (2.0, RelayGains(0.4, 0.85)), (3.5, PLAN), (4.0, TOO_FAR), (6.0, HARD), (8.0, PLAN), (9.0, "enough"),
)  # fmt: skip


def test_tests_that_are_designed_on_the_way_run_in_the_device_and_replay_tick_for_tick(tmp_path: Path) -> None:
    config = load(Path(__file__).parents[2] / "config" / "device-relay.yaml")
    relay = RelaySection(where="device", until=UntilSection(interval_percent=1.0))
    experiment = config.model_copy(update={"relay": relay})
    who = Scripted(IN_TURN)
    what = ScriptCall(name="relay", breakaway=BREAKAWAY_LAW)
    outcome = record(experiment, tmp_path, what, lambda session: drive_until(session, advisers=who), None)
    assert outcome.fault is None
    run = read_run(outcome.folder)
    tests = [stage for stage in run.stages() if stage.startswith(("strokes", "relay"))]
    assert tests == ["strokes-1", "relay-2", "strokes-3", "strokes-4", "strokes-5", "strokes-6", "strokes-7"]
    pushes = tests.pop(4)  # they prove the sensor after strokes that did not get anywhere; the host drives them
    assert np.diff(run.t_s[run.stage_rows(pushes)]) == pytest.approx(experiment.period_s, rel=0.01)
    for stage in tests:
        step_s = np.diff(run.t_s[run.stage_rows(stage)])
        assert step_s == pytest.approx(0.001 / 1.004, abs=3e-6)
    assert {round(abs(u_V), 2) for u_V in run.u_V[run.stage_rows("relay-2")]} == {0.45, 1.25}
    broken = [note for note in outcome.result.notes if "broken off" in note]
    assert who.braked_tests == len(broken) == 2
    assert "two strokes in a row did not come to their turning points" in broken[0] and "guard" in broken[1]
    assert np.abs(run.y_rad).max() < experiment.limits.soft_rad[1]
    assert outcome.result.stopped is not None and outcome.result.stopped.why == "enough"
    again = replay(outcome.folder)
    assert again.is_same and again.compared > 6000, again.difference


def test_old_firmware_is_refused_before_anything_is_driven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load(Path(__file__).parents[2] / "config" / "device-relay.yaml")
    relay = RelaySection(where="device", until=UntilSection(interval_percent=1.0))
    unpack = Hello.unpack
    monkeypatch.setattr(Hello, "unpack", lambda body: unpack(body)._replace(features=0))
    with pytest.raises(Fault) as caught:
        rig.running.experiment.run_relay(config.model_copy(update={"relay": relay}), tmp_path)
    assert caught.value.code == "CONFIG_MISMATCH" and "rig flash" in str(caught.value)
    assert not list(tmp_path.iterdir())
