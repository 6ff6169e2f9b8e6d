"""The strokes in the device, in virtual time: at the pin of the compiled firmware, through the driver, in the loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from device_laws import LEVELS_V, MOTION_RAD, STROKES, TIMES, StrokesBench, armed_driver, running_host
from raised import fault_of
from simulated_bench import GUARD, LIMITS
from virtual_host import BENCH, HELD, VirtualHost

from rig.backends.driver import StrokeTimes
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.firmware_laws import FirmwareStrokes
from rig.backends.serial.frames import (
    FEATURE_STROKES,
    Hello,
    Kind,
)
from rig.config import load
from rig.config.schema import RelaySection, UntilSection
from rig.control.law import Rest
from rig.control.strokes import Stroke
from rig.core.faults import Fault
from rig.design.advisor import Advice, AdvisorSettings
from rig.design.planned_test import Design, PlannedTest, Reach, RelayGains, Strokes
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.run_folder.recording.reader import read_run
from rig.run_folder.results import ScriptCall
from rig.running.experiment import script
from rig.running.experiment.script import BREAKAWAY_LAW
from rig.running.experiment.until import drive_until
from rig.running.replay import replay
from rig.running.session import record

# ---------------------------------------------------------------------- at the pin


def test_the_device_says_that_it_can() -> None:
    assert VirtualHost(VirtualBoard(BENCH)).hello().features & FEATURE_STROKES


@pytest.mark.parametrize("sensor", ["stuck", "dead drive"])
def test_a_shaft_that_does_not_show_its_motion_is_driven_for_two_strokes_at_most(sensor: str) -> None:
    """Whoever keeps the device alive: P12, at the pin."""
    times = STROKES._replace(stroke_ticks=250, still_ticks=120)
    bench = replace(HELD, noise_rad=0.0) if sensor == "dead drive" else replace(BENCH, noise_rad=0.0)
    host = running_host(times, bench)
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


# ---------------------------------------------------------------------- through the driver


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


def ends_at(bench: StrokesBench, t_s: float) -> Callable[[float], None]:
    """What ends the strokes after a time, s."""

    def after(now_s: float) -> None:
        bench.test.finished = bench.test.finished or now_s > t_s or bench.test.failed != ""

    return after


def test_the_loop_records_every_tick_and_the_laws_agree() -> None:
    bench = StrokesBench()
    bench.run(ends_at(bench, 4.0))
    rows = [row for row in bench.record.rows if row["stage"] == "strokes-1"]
    assert np.diff([row["t_s"] for row in rows]) == pytest.approx(bench.driver.tick_s, abs=3e-6)
    assert all(row["flags"] == 0 for row in rows) and bench.strokes.ended > 6
    assert (bench.record.rows[-1]["stage"], bench.record.rows[-1]["u_V"]) == ("rest", 0.0)
    assert bench.board.truth().pin_V == 0.0
    told: dict[str, Any] = bench.loop.summary().as_json()
    assert told["device"]["ticks"] == len(rows)


def test_a_device_that_decides_otherwise_is_found_out() -> None:
    bench = StrokesBench()
    assert isinstance(bench.command, FirmwareStrokes)
    (units, turn), *others = bench.command.setup.strokes
    setup = bench.command.setup._replace(strokes=((units, turn + 6), *others))
    bench.command = replace(bench.command, setup=setup)
    assert fault_of(lambda: bench.run(ends_at(bench, 9.0))).code == "DEVICE_RELAY"
    assert bench.board.truth().pin_V == 0.0


def test_a_device_that_stops_the_strokes_while_the_loop_ends_them_says_why() -> None:
    """Its last row has 0 V, which the law did not decide: that is no other law."""
    bench = StrokesBench()

    def after(now_s: float) -> None:
        if now_s > 2.0 and not bench.test.finished:
            bench.board.place(LIMITS.hard_rad[1] + 0.02)
            bench.test.finished = True

    assert fault_of(lambda: bench.run(after, then=Rest(0.2))).code == "DEVICE_TRAVEL"
    assert bench.board.truth().pin_V == 0.0


@pytest.mark.parametrize("guard_ends_run", [True, False])
def test_a_drive_that_the_guard_would_not_let_out(guard_ends_run: bool) -> None:
    """It ends the run, or the strokes alone: then the next law's drive is the guard's again, and brakes the shaft."""
    quick = replace(GUARD, max_speed_rad_s=30.0)
    bench = StrokesBench(quick, ((2.2, 1.0), (-2.2, -1.0)), motor=Motor(0.17, 14.0, coulomb(0.3)))

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
    bench = StrokesBench(motor=Motor(0.17, 0.15, coulomb(0.3)))
    bench.run(ends_at(bench, 20.0))
    assert "two strokes in a row did not come to their turning points" in bench.test.failed
    drives = [row["u_V"] for row in bench.record.rows if row["stage"] == "strokes-1"]
    assert 3000 < sum(drive != 0.0 for drive in drives) < 3030
    assert drives[-1] == 0.0 and bench.board.truth().pin_V == 0.0 and bench.board.truth().fault == 0


def test_a_stuck_sensor_ends_the_run() -> None:
    bench = StrokesBench(replace(GUARD, stuck_s=9.0))

    def after(t_s: float) -> None:
        if t_s > 0.6:
            bench.board.rewire(sensor="stuck")

    assert fault_of(lambda: bench.run(after)).code == "SENSOR_STUCK"
    assert bench.board.truth().pin_V == 0.0


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
        script.run_relay(config.model_copy(update={"relay": relay}), tmp_path)
    assert caught.value.code == "CONFIG_MISMATCH" and "rig flash" in str(caught.value)
    assert not list(tmp_path.iterdir())
