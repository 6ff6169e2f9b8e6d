"""Readings and holds on an emulated bench, and what happens if a device fails."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rig.backends.registry import Bench, connect
from rig.config import Experiment, load, ready
from rig.config.schema import DeviceSetup
from rig.config.yaml12 import parse
from rig.core.faults import Fault
from rig.run_folder.live.stop_flag import StopFlag
from rig.running.calibrate import hand_bench as module
from rig.running.calibrate.dialogue import Hold, Read, Refusal
from rig.running.calibrate.hand_bench import HandBench


@pytest.fixture(scope="module")
def simulated() -> Experiment:
    return load(parse(ready.text("simulated"), "config").data)


def test_a_hold_lasts_with_the_motor_off_and_ends_with_it_on(simulated: Experiment, tmp_path: Path) -> None:
    """A real motor that somebody left at the bridge turns by a few times ``motion_rad`` at most."""
    hold = Hold(simulated, 1.2, 0.5)
    with HandBench(simulated, tmp_path, StopFlag()) as hand:
        assert abs(hand.perform(hold)) < simulated.breakaway.motion_rad
    forgotten = module._hold(simulated, hold, StopFlag())
    assert simulated.breakaway.motion_rad < forgotten < 4.0 * simulated.breakaway.motion_rad


def test_a_stop_ends_a_hold_and_not_the_calibration(simulated: Experiment, tmp_path: Path) -> None:
    hold = Hold(simulated, 1.2, 1e6)
    with HandBench(simulated, tmp_path, StopFlag()) as hand:
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()
        with pytest.raises(Refusal, match="stopped: the drive is at 0 V"):
            hand.perform(hold)


def test_a_hand_turns_the_emulated_shaft(simulated: Experiment, tmp_path: Path) -> None:
    with HandBench(simulated, tmp_path, StopFlag()) as hand:
        counts = [hand.perform(Read(simulated, pose)).y_counts for pose in (-1.0, 0.0, 1.0, "high stop")]
    assert counts == pytest.approx([273, 517, 761, 1023], abs=2)


def test_a_device_that_fails_is_opened_anew(
    simulated: Experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fault becomes something to show; the next reading opens the bench again."""
    opened: list[bool] = []

    @contextmanager
    def failing_once(d: DeviceSetup) -> Iterator[Bench]:
        opened.append(True)
        if len(opened) == 1:
            raise Fault("LINK_LOST", "unplugged")
        with connect(d) as bench:
            yield bench

    monkeypatch.setattr(module, "connect", failing_once)
    with HandBench(simulated, tmp_path, StopFlag()) as hand:
        with pytest.raises(Refusal, match="LINK_LOST"):
            hand.perform(Read(simulated, 0.0))
        assert hand.perform(Read(simulated, 0.0)).y_counts == pytest.approx(517, abs=2)
    assert len(opened) == 2


def test_a_real_bench_is_opened_once_for_all_readings(
    simulated: Experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Opening a board resets it; an encoder's counts would be gone."""
    opened: list[bool] = []

    @contextmanager
    def once(d: DeviceSetup) -> Iterator[Bench]:
        opened.append(True)
        with connect(d) as bench:
            yield bench
        opened.append(False)

    monkeypatch.setattr(module, "connect", once)
    with HandBench(simulated, tmp_path, StopFlag()) as hand:
        hand._is_emulated = False
        for _ in range(3):
            hand.perform(Read(simulated, 0.0))
        assert opened == [True]
    assert opened == [True, False]
