"""The whole experiment on the Uno's emulated chip, in virtual time, as a user runs it; and beside the host board."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from emulated_run import finds_it_undisturbed, finds_the_truth, run_on
from simulated_bench import CALIBRATION, DEMO, GUARD, LIMITS, SCALING, ListSink, break_away

from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.control.excitation import RelayTest
from rig.control.guard import Guard
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.relay import DualChannelRelay
from rig.model.cycle_detector import CycleDetector

pytestmark = pytest.mark.long

UNO_FULL = 400


def demo() -> dict[str, Any]:
    """config/demo.yaml."""
    path = Path(__file__).parents[2] / "config/demo.yaml"
    config: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return config


@pytest.mark.evidence
def test_the_whole_experiment_on_the_chip_finds_the_truth(tmp_path: Path) -> None:
    config = demo()
    config["relay"]["cycles"] = 6
    config["tracking"]["methods"] = ["sampled-data"]
    outcome = run_on("emulated-chip", tmp_path, config)
    assert outcome["backend"].startswith("emulated-chip (emulated uno board, build uno ")
    finds_it_undisturbed(outcome, 0.02)
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.01
    assert set(outcome["estimates"]) == {"sampled-data", "triple-relay", "describing-function"}


@pytest.mark.evidence
def test_the_relay_in_the_chip_finds_the_truth(tmp_path: Path) -> None:
    gains = [{"h1_V": 0.42, "h2_V": 0.84}]
    outcome = run_on("emulated-chip", tmp_path, demo(), where="device", target=None, gains=gains, cycles=7)
    finds_the_truth(outcome, 0.02)
    assert outcome["link"]["bad_frames"] == 0 and not outcome["faults"]


@pytest.mark.evidence
def test_behind_an_unos_usb_chip_it_identifies_as_ever(tmp_path: Path) -> None:
    """Replies wait for up to 4 ms, each another time: the device's own stamps say when all was, at 10 ms as without."""
    gains = [{"h1_V": 0.43, "h2_V": 0.80}, {"h1_V": 0.75, "h2_V": 0.80}]  # the second excludes a dead band
    daq = {"adapter": "16u2", "baud": 1_000_000}
    outcome = run_on("emulated-chip", tmp_path, demo(), daq, target=None, gains=gains, cycles=8)
    finds_it_undisturbed(outcome, 0.02)
    assert outcome["loop"]["io_us"]["max"] > 4000, "it did wait"


def cycle(board: VirtualBoard | VirtualChip, period_s: float) -> tuple[float, float]:
    """Mean period and amplitude of twenty cycles of the host's relay."""
    driver = SerialDriver(board, SCALING, emulated=True)
    driver.open()
    record = ListSink()
    loop = Loop(driver, board, Guard(GUARD), record, period_s, StopRequest())
    detector = CycleDetector(0.2, 20 * CALIBRATION.lsb_rad)
    relay = DualChannelRelay(0.0, 0.0, 0.7)
    with loop.armed(LIMITS):
        break_away(loop)
        loop.run(RelayTest(relay, detector, (0.6, 0.9), 20, 60.0), "relay-1")
    rows = [row for row in record.rows if row["stage"] == "relay-1"]
    t_s = np.array([row["t_s"] for row in rows])
    y_rad = np.array([row["y_rad"] for row in rows])
    tail = t_s > t_s[-1] - 15.0  # 20 cycles or so, settled
    t_s, y_rad = t_s[tail], y_rad[tail] - y_rad[tail].mean()
    spectrum = np.fft.rfft(y_rad * np.hanning(len(y_rad)), 16 * len(y_rad))
    line = int(np.argmax(np.abs(spectrum)))
    return 16 * len(y_rad) * period_s / line, float(np.sqrt(2.0) * y_rad.std())


@pytest.mark.evidence
def test_the_chips_limit_cycle_is_the_host_boards() -> None:
    """At 500 Hz, so that where a sample falls in the cycle matters little; drives alike to the unit.

    The host board answers at once: its slower wire makes its drive as late as the chip's, 2.98 ms after the sample.
    """
    period_s = 0.002
    bench = replace(DEMO, drive_counts=UNO_FULL, noise_rad=0.0)
    host_period_s, host_rad = cycle(VirtualBoard(bench, 1, baud=430_000, bits_per_byte=10), period_s)
    chip_period_s, chip_rad = cycle(VirtualChip(bench, 1, options=Variant(baud=1_000_000)), period_s)
    assert chip_period_s == pytest.approx(host_period_s, rel=0.005)
    assert chip_rad == pytest.approx(host_rad, rel=0.02)


def test_virtual_time_is_ten_times_as_fast_as_real_time() -> None:
    """In the processor's own seconds, the best of a few: the machine may be busy with something else."""
    board = VirtualChip(DEMO)
    spent_s = []
    for k in range(5):
        began_s = time.process_time()
        board.sleep_until(2.0 * (k + 1))
        spent_s.append(time.process_time() - began_s)
    assert min(spent_s) < 0.1 * 2.0
