"""The emulated chips in real time behind a pseudo-terminal, as `rig emulate` starts them: a smoke test."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from evidence import evidence
from processes import PATIENCE_S, rows, wait_until

from emulated_chips.chip_board import ChipBoard
from rig.backends.driver import Timeouts
from rig.backends.emulated.errors import EmulationError
from rig.backends.links.serial_port import SerialPort
from rig.backends.serial.driver import SerialDriver
from rig.config.schema import Experiment
from rig.running.preflight import check

CONFIG = Path(__file__).resolve().parents[2] / "config"


def drive_until_it_moves(port: str, experiment: Experiment, chip: str) -> float:
    """Through the driver that a run uses; how far it says that the shaft has moved, rad."""
    transport = SerialPort(port)
    # a shared machine may hold a process up for long
    driver = SerialDriver(transport, experiment.device.scaling, Timeouts(2.0), emulated=True)
    info = driver.open()
    assert (info.board, info.emulated, info.reset_cause) == (chip, True, "power-on")
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
    return y_rad - start_rad


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("chip", "emulated", "drive_V"),  # 23 of 400 units of 12 V, and 365 of 6250
    [("uno", ("demo.yaml", "--chip"), 0.69), *evidence(("pico", ("demo-pico.yaml",), 0.7008))],
    ids=["uno", "pico"],
)
def test_it_is_driven_as_a_board_would_be(chip: str, emulated: tuple[str, ...], drive_V: float, tmp_path: Path) -> None:
    link, trace = tmp_path / "chip", tmp_path / "trace.csv"
    config, *options = emulated
    experiment, _ = check(CONFIG / config)
    command = [sys.executable, "-m", "rig", "emulate", str(CONFIG / config), *options]
    with subprocess.Popen([*command, "--link", str(link), "--trace", str(trace)], stdout=subprocess.DEVNULL) as process:
        try:
            wait_until(link.is_symlink)
            moved_rad = drive_until_it_moves(str(link), experiment, chip)
            wait_until(lambda: rows(trace)[-1]["drive_V"] == 0.0 and rows(trace)[-1]["led"] == 0.0)
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0 and not link.is_symlink()
    seen = rows(trace)
    driven = [row for row in seen if row["drive_V"] != 0.0]
    assert {round(row["drive_V"], 6) for row in driven} == {drive_V}
    assert all(row["led"] == 1.0 for row in driven)
    assert seen[-1]["y_rad"] - seen[0]["y_rad"] > 0.9 * moved_rad > 0.0
    assert seen[-1]["t_s"] == max(row["t_s"] for row in seen)


def test_the_demo_on_the_chip_is_the_demo_behind_another_port() -> None:
    demo, chip = (yaml.safe_load((CONFIG / f"{name}.yaml").read_text("utf-8")) for name in ("demo", "demo-chip"))
    assert chip["daq"].pop("port") == "emulated-chip-realtime" and demo["daq"].pop("port") == "emulated"
    assert chip.pop("name") == "demo-chip" and demo.pop("name") == "demo"
    assert chip == demo


def test_what_is_not_possible_is_said() -> None:
    experiment, _ = check(CONFIG / "demo.yaml")
    assert experiment.emulated is not None
    whole = experiment.emulated
    wide = whole.potentiometer.model_copy(update={"counts_max": 4095})
    with pytest.raises(EmulationError, match="0 to 1023"):
        ChipBoard().start(whole.model_copy(update={"potentiometer": wide}), 1)
    with pytest.raises(EmulationError, match="baud rate"):
        ChipBoard().start(whole, 1, baud=3_000_000)
