"""The whole experiment on the Pico's emulated chip as a user runs it: in virtual time, and behind a pseudo-terminal."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from emulated_run import finds_it_undisturbed, finds_the_truth, run_on
from processes import PATIENCE_S, rows, wait_until

from rig.backends.driver import Timeouts
from rig.backends.links.serial_port import SerialPort
from rig.backends.serial.driver import SerialDriver
from rig.running.preflight import check

pytestmark = pytest.mark.long

CONFIG = Path(__file__).resolve().parents[2] / "config"


def demo() -> dict[str, Any]:
    config: dict[str, Any] = yaml.safe_load((CONFIG / "demo-pico.yaml").read_text(encoding="utf-8"))
    return config


@pytest.mark.evidence
def test_the_whole_experiment_on_the_pico_finds_the_truth(tmp_path: Path) -> None:
    outcome = run_on("emulated-pico", tmp_path, demo())
    assert outcome["backend"].startswith("emulated-pico (emulated pico board, build pico ")
    finds_it_undisturbed(outcome, 0.01)
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.01


@pytest.mark.evidence
def test_the_relay_in_the_pico_finds_the_truth(tmp_path: Path) -> None:
    gains = [{"h1_V": 0.42, "h2_V": 0.84}]
    outcome = run_on("emulated-pico", tmp_path, demo(), target=None, where="device", gains=gains, cycles=7)
    finds_the_truth(outcome, 0.01)
    assert outcome["link"]["bad_frames"] == 0 and not outcome["faults"]
    assert outcome["loop"]["device"]["missed"] == 0


@pytest.mark.evidence
def test_the_whole_experiment_with_an_encoder_finds_the_truth_to_a_fifth_of_a_percent(tmp_path: Path) -> None:
    """The shortest one: quicker strokes, given gains, few cycles, one check of two seconds."""
    config = yaml.safe_load((CONFIG / "encoder.yaml").read_text(encoding="utf-8"))
    config["breakaway"]["ramp_V_s"] = 1.0
    config["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.84}, {"h1_V": 0.3, "h2_V": 0.76}], "cycles": 4}
    config["tracking"] |= {"methods": ["sampled-data"], "duration_s": 2.0, "with_law": False}
    outcome = run_on("emulated-pico", tmp_path, config)
    finds_it_undisturbed(outcome, 0.002)
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.005


def test_the_demo_on_the_pico_is_the_demo_with_twelve_bits() -> None:
    demo, pico = (yaml.safe_load((CONFIG / f"{name}.yaml").read_text("utf-8")) for name in ("demo", "demo-pico"))
    assert pico["daq"].pop("port") == "emulated-pico-realtime" and demo["daq"].pop("port") == "emulated"
    assert pico.pop("name") == "demo-pico" and demo.pop("name") == "demo"
    assert pico["sensor"].pop("counts_max") == 4095 and demo["sensor"].pop("counts_max") == 1023
    assert pico["sensor"].pop("rail_counts") == [20, 4075] and demo["sensor"].pop("rail_counts") == [5, 1018]
    for point in demo["sensor"]["calibration"]:
        point["counts"] *= 4
    assert pico == demo


@pytest.mark.realtime
def test_it_is_driven_as_a_board_would_be(tmp_path: Path) -> None:
    link, trace = tmp_path / "pico", tmp_path / "trace.csv"
    experiment, _ = check(CONFIG / "demo-pico.yaml")
    command = [sys.executable, "-m", "rig", "emulate", str(CONFIG / "demo-pico.yaml")]
    with subprocess.Popen(
        [*command, "--link", str(link), "--trace", str(trace)], stdout=subprocess.DEVNULL
    ) as emulated:
        try:
            wait_until(link.is_symlink)
            # a shared machine may hold a process up for long
            driver = SerialDriver(SerialPort(str(link)), experiment.device.scaling, Timeouts(2.0), emulated=True)
            info = driver.open()
            assert (info.board, info.emulated, info.reset_cause) == ("pico", True, "power-on")
            driver.arm(replace(experiment.device.arming, watchdog_s=1.0))
            start_rad = y_rad = driver.read().y_rad
            until_s = time.monotonic() + PATIENCE_S
            while abs(y_rad - start_rad) < 0.2:
                assert time.monotonic() < until_s, "the shaft does not move"
                driver.write(0.7)
                time.sleep(0.005)
                y_rad = driver.read().y_rad
            assert driver.safe_stop()
            assert driver.link_statistics["bad_frames"] == 0
            driver.close()
            wait_until(lambda: rows(trace)[-1]["drive_V"] == 0.0 and rows(trace)[-1]["led"] == 0.0)
        finally:
            emulated.send_signal(signal.SIGINT)
    assert emulated.returncode == 0 and not link.is_symlink()
    seen = rows(trace)
    driven = [row for row in seen if row["drive_V"] != 0.0]
    assert {round(row["drive_V"], 6) for row in driven} == {0.700_800}  # 365 of 6250 units of 12 V
    assert all(row["led"] == 1.0 for row in driven)
    assert seen[-1]["y_rad"] - seen[0]["y_rad"] > 0.9 * (y_rad - start_rad) > 0.0
    assert seen[-1]["t_s"] == max(row["t_s"] for row in seen)
