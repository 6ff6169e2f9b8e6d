"""What stops a drive from outside, at any instant: the drive at the pin of the compiled firmware and of the chip.

In virtual time. The bound for the stop flag is the one of docs/panel.md: two periods of the loop and a frame.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import pytest
from evidence import evidence
from simulated_bench import CALIBRATION, DEMO, GUARD, LIMITS, PERIOD_S, SCALING, ListSink

from emulated_chips.opening import emulated_chip
from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.config import Experiment, load, ready
from rig.config.yaml12 import parse
from rig.control.bounded import Bounded, Bounds
from rig.control.excitation import RelayTest
from rig.control.guard import Guard
from rig.control.law import Constant, Law
from rig.control.leased_jog import LeasedDrive
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.relay import DualChannelRelay, RelayOnCounts
from rig.control.strokes import Stroke, StrokeTest, StrokeTiming
from rig.control.sweep_plan import Room, sweep_plan
from rig.control.sweeps import CrudeMotor, SweepLoop, Sweeps
from rig.core.faults import Fault
from rig.model.cycle_detector import CycleDetector
from rig.model.friction import coulomb
from rig.panel import bench as panel_bench
from rig.panel.bench import Bench as PanelBench
from rig.panel.past_runs import Runs
from rig.panel.watch import Watch
from rig.run_folder.live.lease import LONGEST_NS, HeldLease, Leaser
from rig.run_folder.live.running import told
from rig.run_folder.live.stop_flag import StopFlag, request_stop
from rig.running.calibrate.dialogue import ALONE, Hold, Refusal, Strokes, StrokesSeen
from rig.running.calibrate.hand_bench import HandBench
from rig.running.experiment import zero
from rig.testing.line import on_device

FRAME_S = 0.0025  # of 14 bytes on the wire with the time until the program has acted on it
GAINS_V = (0.4, 0.85)
ROOM = Room(LIMITS.soft_rad, GUARD.max_speed_rad_s, slowest_rad_s=0.2, bandwidth_1_s=8.0, longest_s=60.0)
SWEPT = SweepLoop(PERIOD_S, 0.003, LIMITS.max_u_V, 0.11, CALIBRATION.lsb_rad)
Device = VirtualBoard | VirtualChip


HELD = replace(DEMO, motor=replace(DEMO.motor, friction=coulomb(9.0)))  # as a bridge with no motor at it


class Bench(NamedTuple):
    """A loop on a device of which another process has the flag."""

    device: Device
    driver: SerialDriver
    loop: Loop
    record: ListSink


def bench_of(device: Device, flag: StopFlag) -> Bench:
    driver = SerialDriver(device, SCALING, emulated=True)
    driver.open()
    guard, record = Guard(GUARD), ListSink()
    guard.sign_proven = True
    return Bench(device, driver, Loop(driver, device, guard, record, PERIOD_S, StopRequest(flag)), record)


def at(device: Device, t_s: float, do: Callable[[], object]) -> list[float]:
    """Do something at that time after now, between what the loop does. Returns when it was done, s, once it is."""
    done: list[float] = []
    sleep, when_s = device.sleep_until, device.now_s() + t_s

    def until(due_s: float) -> float:
        if not done and due_s >= when_s:
            sleep(when_s)
            do()
            done.append(device.now_s())
        return sleep(due_s)

    device.sleep_until = until  # type: ignore[assignment,method-assign]  # of this device alone
    return done


def drive_until_stopped(bench: Bench, where: str) -> None:
    with bench.loop.armed(LIMITS):
        if where == "host":
            bench.loop.run(Constant(0.62, 5.0), "jog")
            return
        c = bench.driver.relay_command(*GAINS_V, 0.7)
        relay = RelayOnCounts(c, GAINS_V)
        test = RelayTest(relay, CycleDetector(30 * PERIOD_S, 20 * CALIBRATION.lsb_rad), GAINS_V, 50, 60.0)
        bench.loop.run_in_device(test, c, "relay-1")


@pytest.mark.parametrize("where", ["host", "device"])
@pytest.mark.parametrize("device", [VirtualBoard, VirtualChip])
@pytest.mark.parametrize("in_tick", [0.05, 0.95])
def test_a_stop_is_0_V_at_the_pin_within_two_periods_and_a_frame(
    tmp_path: Path, device: type[Device], where: str, in_tick: float
) -> None:
    with StopFlag() as flag:
        flag.begin(tmp_path)
        bench = bench_of(device(DEMO, 3), flag)
        asked = at(bench.device, (60 + in_tick) * PERIOD_S, lambda: request_stop(tmp_path, "test"))
        with pytest.raises(Fault, match="Stop by test") as caught:
            drive_until_stopped(bench, where)
    assert caught.value.code == "INTERRUPTED"
    truth = bench.device.truth()
    assert truth.pin_V == 0.0
    assert 0.0 < truth.pin_changed_s - asked[0] <= 2 * PERIOD_S + FRAME_S
    assert any(row["u_V"] != 0.0 for row in bench.record.rows)
    assert bench.record.events[-1]["confirmed"] is True


@pytest.mark.parametrize("phase", [0.41, *evidence(0.03, 0.97)])
@pytest.mark.parametrize("test", ["strokes", "relay", "survey"])
def test_an_e_stop_in_a_designed_test_of_the_host_is_0_V_at_the_pin_within_a_tick_of_the_device(
    test: str, phase: float
) -> None:
    """In the middle of a swing; the firmware's interrupt does it, whatever the host asks for."""
    chip = VirtualChip(DEMO, 3)
    bench = bench_of(chip, StopFlag())
    law: Law
    if test == "strokes":
        law = StrokeTest((Stroke(1.2, 0.3), Stroke(-0.9, -0.4)), StrokeTiming(3600.0, 1.0), 0.02)
    elif test == "survey":
        law = Sweeps(CrudeMotor(0.17, 6.5, 0.54, 0.50), sweep_plan(ROOM), SWEPT)
    else:
        detector = CycleDetector(30 * PERIOD_S, 20 * CALIBRATION.lsb_rad)
        law = RelayTest(DualChannelRelay(*GAINS_V, 0.7), detector, GAINS_V, 10**9, 3600.0)
    opened = at(chip, (60 + phase) * PERIOD_S, lambda: chip.contact("e_stop", is_open=True))
    driven_V: list[float] = []

    def watch(t_s: float) -> None:
        driven_V.append(chip.truth().pin_V)

    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(Bounded(law, Bounds(60.0, 60, 0.08)), f"{test}-1", watch)
    assert caught.value.code == "DEVICE_ESTOP"
    assert driven_V[58] != 0.0
    assert 0.0 < chip.truth().pin_changed_s - opened[0] <= 0.001
    assert chip.truth().pin_V == 0.0
    assert bench.record.rows[-1]["stage"] == f"{test}-1"


@pytest.mark.parametrize("device", [VirtualBoard, VirtualChip])
def test_a_jog_whose_leases_end_is_0_V_at_the_pin_within_the_lease_and_two_periods(
    tmp_path: Path, device: type[Device]
) -> None:
    """Who jogs dies right after its last lease, the longest that there is: nobody tells the loop."""
    bench = bench_of(device(DEMO, 3), StopFlag())

    def now_ns() -> int:
        return round(bench.device.now_s() * 1e9)

    with HeldLease(tmp_path, now_ns) as held:
        lease = Leaser(tmp_path, now_ns)
        given = at(bench.device, 20.3 * PERIOD_S, lambda: lease.drive(0.62))
        with bench.loop.armed(LIMITS):
            bench.loop.run(LeasedDrive(held.u_V, lambda _: None, longest_s=1.0), "jog")
            driven = [row["t_s"] for row in bench.record.rows if row["u_V"] != 0.0]
            off_s = bench.device.truth().pin_changed_s
    lease.close()
    assert len(driven) in (14, 15)  # as the lease begins in a tick
    assert LONGEST_NS * 1e-9 < off_s - given[0] <= LONGEST_NS * 1e-9 + 2 * PERIOD_S + FRAME_S
    assert bench.device.truth().pin_V == 0.0


def test_stop_in_the_panel_is_0_V_at_the_pin_while_a_page_holds_the_jog(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hold is renewed until Stop comes, and never let go: by the panel's own code, its clock is the board's."""
    with StopFlag() as flag:
        folder = tmp_path / "jog"
        folder.mkdir()
        flag.begin(folder)
        bench = bench_of(VirtualBoard(DEMO, 3), flag)

        def now_ns() -> int:
            return round(bench.device.now_s() * 1e9)

        monkeypatch.setattr(panel_bench, "Leaser", partial(Leaser, now_ns=now_ns))
        monkeypatch.setattr(panel_bench, "time", SimpleNamespace(monotonic=bench.device.now_s))
        panel = PanelBench(None, tmp_path)
        panel._jog_V = 0.62
        panel.look()
        ticks: list[float] = []

        def renew(t_s: float) -> None:
            ticks.append(t_s)
            if len(ticks) % 5 == 0:
                panel.jog("page", 1.0)

        asked = at(bench.device, 24.4 * PERIOD_S, panel.stop)
        with (
            HeldLease(folder, now_ns) as held,
            pytest.raises(Fault, match="Stop by panel"),
            bench.loop.armed(LIMITS),
        ):
            bench.loop.run(LeasedDrive(held.u_V, lambda _: None, longest_s=1.0), "jog", renew)
    truth = bench.device.truth()
    assert bench.record.rows[-2]["u_V"] == pytest.approx(0.62, abs=0.02)
    assert truth.pin_V == 0.0
    assert 0.0 < truth.pin_changed_s - asked[0] <= 2 * PERIOD_S + FRAME_S


def demo() -> Experiment:
    return load(parse(ready.text("demo"), "config").data)


class Pin:
    """When the pin of a device drove, looked at whenever the loop waits; ``do`` is done in the middle of a drive."""

    def __init__(self, device: Device, do: Callable[[], object] = lambda: None, after_ticks: float = 3.4) -> None:
        self.driven_s: list[float] = []
        self.done_s = float("nan")
        sleep = device.sleep_until

        def until(due_s: float) -> float:
            if device.truth().pin_V != 0.0:
                self.driven_s.append(device.now_s())
                when_s = self.driven_s[0] + after_ticks * PERIOD_S
                if not self.done_s > 0.0 and due_s >= when_s:
                    sleep(when_s)
                    do()
                    self.done_s = device.now_s()
            return sleep(due_s)

        device.sleep_until = until  # type: ignore[assignment,method-assign]  # of this device alone


def kept_plugged(device: Device) -> Device:
    """The device behind a cable that nobody pulls: it can be opened again."""
    device.close = lambda: None  # type: ignore[method-assign]  # of this device alone
    return device


class OtherPanel:
    """A panel that was opened only to stop: what its Stop is answered, and what its pages are told."""

    def __init__(self, runs: Path) -> None:
        self._bench = PanelBench(None, runs)
        self._watch = Watch(self._bench, Runs(runs))
        self.answers: list[bool | None] = []

    def stop(self) -> None:
        self.answers.append(self._watch.stop_asked(self._bench.stop())["drive_zero"])

    def told(self) -> list[bool | None]:
        """Of each message about a Stop whether the drive is at 0."""
        self._watch.look()
        return [message["drive_zero"] for _, message in self._watch.scene.news if message["type"] == "stop"]


@pytest.mark.parametrize("device", [VirtualBoard, VirtualChip])
@pytest.mark.parametrize("how", ["signal", "other panel"])
def test_stop_in_a_calibrations_hold_is_0_V_at_the_pin(tmp_path: Path, device: type[Device], how: str) -> None:
    """By its own panel: a signal; and by another one, which knows it from its flag."""
    held, panel = kept_plugged(device(HELD, 3)), OtherPanel(tmp_path)
    pin = Pin(held, panel.stop if how == "other panel" else lambda: os.kill(os.getpid(), signal.SIGTERM))
    with on_device(held), told(tmp_path, "calibrate") as flag, HandBench(demo(), tmp_path, flag) as hand:
        with pytest.raises(Refusal, match="stopped: the drive is at 0 V"):
            hand.perform(Hold(demo(), 1.2, 5.0))
        assert held.truth().pin_V == 0.0
        assert 0.0 < held.truth().pin_changed_s - pin.done_s <= 2 * PERIOD_S + FRAME_S
        if how == "other panel":
            assert panel.answers == [None], "it drove then"
            assert panel.told() == [True]
        assert abs(hand.perform(Hold(demo(), 1.2, 0.1))) < 0.01, "who says yes again drives again"
    assert list(tmp_path.glob(".*-*")) == []


@pytest.mark.parametrize("motion", [Hold(demo(), 1.2, 5.0), Strokes(demo())])
def test_a_stop_while_a_calibration_asks_refuses_the_next_drive_once(tmp_path: Path, motion: Hold | Strokes) -> None:
    """Whoever stopped was told that the drive is at 0: an answer that is on its way must not change that."""
    board, panel = kept_plugged(VirtualBoard(HELD, 3)), OtherPanel(tmp_path)
    pin = Pin(board)
    with on_device(board), told(tmp_path, "calibrate") as flag, HandBench(demo(), tmp_path, flag) as hand:
        panel.stop()
        assert (panel.answers, panel.told()) == ([None], [True])
        with pytest.raises(Refusal, match="stopped: the drive is at 0 V"):
            hand.perform(motion)
        assert pin.driven_s == []
        hand.perform(Hold(demo(), 1.2, 0.1))
        assert pin.driven_s != []


@pytest.mark.parametrize("phase", [100.9, *evidence(5.4, 180.2)])
def test_stop_by_another_panel_while_it_homes_is_0_V_at_the_pin(tmp_path: Path, phase: float) -> None:
    """On the way to the switch, on the way back, and on the way there again."""
    encoder = {"counts_per_turn": 64, "gear": 50, "home": {"end": "high", "at_rad": 1.5, "u_V": 0.9}}
    data = load(parse(ready.text("encoder"), "config").data).model_dump(mode="json", exclude_none=True)
    data["sensor"]["encoder"] |= encoder
    data["emulated"]["encoder"] = {"end_rad": [-1.5, 1.5]}
    e = Experiment.model_validate(data)
    chip, panel = emulated_chip(e.device), OtherPanel(tmp_path)
    pin = Pin(chip, panel.stop, phase)
    with on_device(chip), pytest.raises(Fault, match="Stop by panel"):
        zero.by_switch(e, tmp_path)
    assert 0.0 < chip.truth().pin_changed_s - pin.done_s <= 2 * PERIOD_S + FRAME_S
    assert chip.truth().pin_V == 0.0
    assert panel.answers == [None]
    assert panel.told() == [True]
    assert list(tmp_path.glob(".*-*")) == []


def test_stop_in_a_calibrations_strokes_is_0_V_at_the_pin(tmp_path: Path) -> None:
    """As the panel stops a run: it finds the folder, and sets its flag."""
    board, panel = VirtualBoard(DEMO, 3), PanelBench(None, tmp_path)
    pin = Pin(board, panel.stop)
    with on_device(board), HandBench(demo(), tmp_path, StopFlag()) as hand:
        seen = hand.perform(Strokes(demo()))
    assert isinstance(seen, StrokesSeen) and seen.fault is not None
    assert (seen.fault.code, seen.fault.detail) == ("INTERRUPTED", "Stop by panel")
    assert board.truth().pin_V == 0.0
    assert 0.0 < board.truth().pin_changed_s - pin.done_s <= 2 * PERIOD_S + FRAME_S


@pytest.mark.parametrize(("what", "device"), [("hold", VirtualBoard), ("hold", VirtualChip), ("strokes", VirtualBoard)])
def test_what_a_calibration_drives_is_0_V_at_the_pin_within_the_lease_of_a_dead_panel_and_two_periods(
    tmp_path: Path, what: str, device: type[Device]
) -> None:
    """The panel promises every 50 ms to be there, and dies in the middle of a drive. Nobody tells the loop."""
    one = device(HELD if what == "hold" else DEMO, 3)

    def now_ns() -> int:
        return round(one.now_s() * 1e9)

    given_s: list[float] = []
    pin = Pin(one)
    with HeldLease(tmp_path, now_ns) as held, on_device(one):
        lease = Leaser(tmp_path, now_ns)

        def gone() -> str:
            lives = not pin.driven_s or one.now_s() < pin.driven_s[0] + 0.3
            if lives and (not given_s or one.now_s() - given_s[-1] >= 0.05):
                lease.stay()
                given_s.append(one.now_s())
            return "" if held.holds() else ALONE

        with HandBench(demo(), tmp_path / "runs", StopFlag(), gone) as hand:
            if what == "hold":
                with pytest.raises(Refusal, match="the panel fell silent: the drive is at 0 V"):
                    hand.perform(Hold(demo(), 1.2, 5.0))
            else:
                seen = hand.perform(Strokes(demo()))
                assert seen.fault is not None and seen.fault.detail == ALONE
        lease.close()
    within_s = LONGEST_NS * 1e-9 + 2 * PERIOD_S + FRAME_S
    assert one.truth().pin_V == 0.0
    assert pin.driven_s[-1] > given_s[-1], "it drove when the panel died"
    assert max(one.truth().pin_changed_s, pin.driven_s[-1]) - given_s[-1] <= within_s
