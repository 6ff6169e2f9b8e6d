"""What happens to the device in the pause between relay tests and tracking, where it is disarmed."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import rig
from evidence import evidence

from emulated_chips.opening import emulated_chip
from emulated_chips.virtual_chip import VirtualChip
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.serial.backend import SerialBackend
from rig.backends.simulated.driver import SimulatedDriver
from rig.config import load
from rig.config.schema import DeviceSetup
from rig.control.loop.pause_watch import PauseWatch
from rig.identification import identify
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recorder import Recorder
from rig.running import session
from rig.running.experiment import script, stages
from rig.running.session import Session
from rig.testing.line import on_device

ROOT = Path(__file__).resolve().parents[2]


def short(folder: Path, name: str, port: str) -> Path:
    """One relay test with given gains, then three seconds of tracking."""
    config = yaml.safe_load((ROOT / "config" / name).read_text(encoding="utf-8"))
    config["daq"]["port"] = port
    config["limits"]["max_speed_rad_s"] = 4.7
    config["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.85}], "cycles": 5}
    config["tracking"] |= {"duration_s": 3.0, "methods": ["sampled-data"]}
    path = folder / "short.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


def in_the_pause(monkeypatch: pytest.MonkeyPatch, happens: Callable[[Any], None]) -> list[Any]:
    """Let it happen to the device behind the bench, just after the record has been identified; the device."""
    devices: list[Any] = []

    identifies = stages.identify_recorded

    def identify_recorded(run: Session) -> None:
        identifies(run)
        devices.append(run.bench.clock)
        happens(run.bench.clock)

    monkeypatch.setattr(stages, "identify_recorded", identify_recorded)
    return devices


def assert_ended_in_the_pause(result: Any, code: str) -> None:
    """One fault, no row of tracking, a result, and a record that identifies by itself."""
    assert result.exit_code == 1
    outcome = json.loads(result.stdout)
    folder = Path(outcome["folder"])
    assert [fault["code"] for fault in outcome["faults"]] == [code]
    assert json.loads((folder / "result.json").read_text(encoding="utf-8"))["faults"][0]["code"] == code
    assert "relay-1" in read_run(folder).stages() and "track:sampled-data" not in read_run(folder).stages()
    estimate = identify([read_run(folder)]).estimates["sampled-data"]
    assert estimate.tau_s == pytest.approx(outcome["truth"]["tau_s"], rel=0.03)
    assert rig("identify", folder).exit_code == 0
    assert rig("export", folder, "--to", folder / "again.csv").exit_code == 0


def press(chip: VirtualChip) -> None:
    chip.contact("e_stop", is_open=True)
    chip.sleep_until(chip.now_s() + 0.3)
    chip.contact("e_stop", is_open=False)
    chip.sleep_until(chip.now_s() + 4.0)


@pytest.mark.evidence  # each whole run has such a pause, a shorter one
def test_without_anything_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_the_pause(monkeypatch, lambda chip: chip.sleep_until(chip.now_s() + 4.3))
    result = rig("run", short(tmp_path, "demo.yaml", "emulated-chip"), "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["tracking"]["sampled-data"]["rms_rad"] < 0.01


def test_an_e_stop_opened_and_closed_again_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    devices = in_the_pause(monkeypatch, press)
    result = rig("run", short(tmp_path, "demo.yaml", "emulated-chip"), "--out", tmp_path / "runs", "--json")
    assert_ended_in_the_pause(result, "DEVICE_ESTOP")
    assert devices[0].truth().pin_V == 0.0
    assert devices[0].truth().pin_changed_s < devices[0].now_s() - 4.0  # not since the relay test


@pytest.mark.parametrize("cause", [2, *evidence(4)])
def test_a_reset_or_a_brown_out_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cause: int) -> None:
    def reset(chip: VirtualChip) -> None:
        chip.reset(cause)
        chip.sleep_until(chip.now_s() + 2.0)

    devices = in_the_pause(monkeypatch, reset)
    result = rig("run", short(tmp_path, "demo.yaml", "emulated-chip"), "--out", tmp_path / "runs", "--json")
    assert_ended_in_the_pause(result, "DEVICE_RESET")
    assert devices[0].truth().pin_V == 0.0


def pressed_while_watched(monkeypatch: pytest.MonkeyPatch, for_s: float) -> None:
    """The e-stop of an I/O block is open for a while, somewhere in the pause after the relay test as it passes."""
    original = PauseWatch.end
    pauses = 0

    def end(watch: PauseWatch) -> None:
        nonlocal pauses
        block = watch._clock
        pauses += watch._is_pause
        if pauses == 2 and isinstance(block, VirtualIoBlock):  # the first one is after the breakaway check
            open_s, sleep_until = block.now_s() + 0.333, block.sleep_until

            def sleeping(t_s: float) -> float:
                block.block.e_stop_open = open_s <= t_s < open_s + for_s
                return sleep_until(t_s)

            monkeypatch.setattr(block, "sleep_until", sleeping)
        original(watch)

    monkeypatch.setattr(PauseWatch, "end", end)


def test_a_device_that_latches_no_e_stop_is_watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pressed_while_watched(monkeypatch, for_s=0.05)
    path = short(tmp_path, "modbus-rtu.yaml", "emulated")
    assert_ended_in_the_pause(rig("run", path, "--out", tmp_path / "runs", "--json"), "DEVICE_ESTOP")


def test_a_power_cycle_of_a_block_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its status is off before and after; what it was told at the first arming is gone."""
    devices = in_the_pause(monkeypatch, VirtualIoBlock.power_cycle)
    path = short(tmp_path, "modbus-rtu.yaml", "emulated")
    assert_ended_in_the_pause(rig("run", path, "--out", tmp_path / "runs", "--json"), "DEVICE_RESET")
    assert not devices[0].truth().armed and devices[0].block.drive == 0.0


def test_the_next_command_clears_it_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On one device, which no opening resets: pressed between two runs."""
    path = short(tmp_path, "demo.yaml", "emulated-chip")
    chip = emulated_chip(load(path).device)
    monkeypatch.setattr(chip, "close", lambda: None)  # the next command finds it as it is
    with on_device(chip):
        see_it_cleared(chip, path, tmp_path)


def see_it_cleared(chip: VirtualChip, path: Path, tmp_path: Path) -> None:
    assert rig("jog", path, "--u-V", 0.2, "--out", tmp_path / "runs").exit_code == 0
    press(chip)
    result = rig("jog", path, "--u-V", 0.2, "--out", tmp_path / "runs")
    assert result.exit_code == 0, result.stderr
    assert "e-stop pressed since the last run" in result.stderr
    assert "e-stop" not in rig("jog", path, "--u-V", 0.2, "--out", tmp_path / "runs").stderr
    press(chip)
    assert "e-stop pressed since the last run" in rig("doctor", path, "--seconds", 0.2).stdout
    chip.contact("e_stop", is_open=True)
    result = rig("jog", path, "--u-V", 0.2, "--out", tmp_path / "runs")
    assert result.exit_code == 1 and "DEVICE_ESTOP" in result.stderr


def test_one_command_of_several_runs_acknowledges_nothing_between_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a real bench: the device stays open, and an e-stop opened and closed between two runs ends the command."""
    chips: list[VirtualChip] = []
    conclude = session._conclude

    def made(d: DeviceSetup) -> VirtualChip:
        chips.append(emulated_chip(d))
        return chips[-1]

    monkeypatch.setattr(SerialBackend, "is_emulated", lambda *_: False)

    def pressed(*given: Any) -> Any:
        outcome = conclude(*given)
        press(chips[0])
        return outcome

    monkeypatch.setattr(session, "_conclude", pressed)
    path = short(tmp_path, "demo.yaml", "emulated-chip")
    with on_device(made):
        result = rig("run", path, "--repeat", 3, "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1 and len(chips) == 1
    first, second = json.loads(result.stdout)["runs"]
    assert first["ok"] and [fault["code"] for fault in second["faults"]] == ["DEVICE_ESTOP"]
    assert second["loop"]["ticks"] == 0


def test_a_signal_after_the_last_drive_ends_a_command_of_several_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = session._write_result

    def interrupted(*given: Any) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        written(*given)

    monkeypatch.setattr(session, "_write_result", interrupted)
    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    del config["tracking"]
    (tmp_path / "c.yaml").write_text(
        yaml.safe_dump(config | {"relay": {"gains": [{"h1_V": 0.42, "h2_V": 0.85}], "cycles": 4}}), encoding="utf-8"
    )
    result = rig("run", tmp_path / "c.yaml", "--repeat", 2, "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    (only,) = json.loads(result.stdout)["runs"]
    assert "SIGINT" in only["cause"]


@pytest.mark.parametrize("broken", ["close", "safe_stop", "progress", "recorder"])
def test_whatever_fails_around_the_loop_there_is_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise OSError(5, "Input/output error")

    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    del config["tracking"]
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    e = load(tmp_path / "c.yaml")
    if broken in ("close", "safe_stop"):
        monkeypatch.setattr(SimulatedDriver, broken, fails)
    elif broken == "recorder":
        close = Recorder.close

        def closes_and_fails(recorder: Recorder) -> None:
            close(recorder)
            fails()

        monkeypatch.setattr(Recorder, "close", closes_and_fails)
    on_start = fails if broken == "progress" else None
    outcome = script.jog(e, 0.2, 0.1, tmp_path / "runs", on_start)
    assert "Input/output error" in outcome.failure or outcome.fault is not None
    result = json.loads((outcome.folder / "result.json").read_text(encoding="utf-8"))
    assert result["schema"] == 1 and "loop" in result
