"""Every command that drives leaves a flag before its device is opened, so that every panel of its folder can stop it.

The list of commands is the CLI's own: a new one has to be put into one of the two tables.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from command_line import rig
from evidence import evidence
from tuned_run import GOLDEN, few_draws, tuned_run

from rig.backends.driver import DeviceInfo
from rig.backends.serial import loopback
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.exchange import Exchange
from rig.backends.serial.frames import Hello
from rig.backends.simulated.driver import SimulatedDriver
from rig.cli import main
from rig.config import ready
from rig.core.faults import Fault
from rig.panel import processes
from rig.panel.bench import Bench
from rig.run_folder.live.running import BusyError, Running, running, told
from rig.run_folder.live.stop_flag import NAME, StopFlag, command_of, is_recorded, runner_of

# What of each command that drives is tried: its arguments, and how many armings of its device are looked at
DRIVES: dict[str, tuple[int, str]] = {
    "run": (2, "{simulated}"),
    "rehearse": (1, "{simulated}"),
    "relay": (1, "{simulated}"),
    "survey": (1, "{simulated}"),
    "track": (1, "{simulated} --model {golden}"),
    "jog": (1, "{simulated} --u-V 0.3"),
    "home": (3, "{homes}"),
    "calibrate": (2, "{simulated} strokes dead-band --answers {answers}"),
    "tune": (1, "{tuned} --try {simulated} --draws 39"),
    "doctor": (1, "--loopback emulated-chip"),
}
# Each other command opens no device, or reads one without arming it, or starts one of those above; `servo facts`, which
# turns a horn, is tried with the others of `servo`
DRIVES_NOT = {
    "campaign", "check", "compare", "config", "design", "emulate", "export", "flash", "identify", "init", "list",
    "newton-metres", "panel", "predict", "predict-run", "replay", "report", "schema", "servo",
}  # fmt: skip
TRIED = [
    *((name, *tried) for name, tried in DRIVES.items() if name != "tune"),
    *evidence(("tune", *DRIVES["tune"])),  # it takes the bench as `rig track` does
]


def test_each_command_is_known_to_drive_or_not_to() -> None:
    assert set(main.commands) == set(DRIVES) | DRIVES_NOT
    assert not set(DRIVES) & DRIVES_NOT


class Armings:
    """Looks at the flags below a folder whenever a device is armed, and ends the command with the ``last`` arming."""

    def __init__(self, runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.last = 0
        self.seen: list[list[Running]] = []
        self.stops_at_opening = False
        self._runs = runs
        for driver in (SimulatedDriver, SerialDriver):
            arm, opens = driver.arm, driver.open

            def armed(driver: SerialDriver, limits: object, arm: object = arm) -> None:
                self._look()
                arm(driver, limits)  # type: ignore[operator]  # of the class

            def opened(driver: SerialDriver, opens: object = opens) -> DeviceInfo:
                if self.stops_at_opening:
                    assert Bench(None, runs).stop().runs, "nothing is known here to be stopped"
                return opens(driver)  # type: ignore[operator,no-any-return]

            monkeypatch.setattr(driver, "arm", armed)
            monkeypatch.setattr(driver, "open", opened)
        stops = self

        class LookedAt(Exchange):
            """The exchanges of a board in loop-back."""

            def arm(self, session: int) -> int:
                stops._look()
                return super().arm(session)

            def meet(self, timeout_s: float) -> Hello:
                if stops.stops_at_opening:
                    assert Bench(None, runs).stop().runs, "nothing is known here to be stopped"
                return super().meet(timeout_s)

        monkeypatch.setattr(loopback, "Exchange", LookedAt)

    def _look(self) -> None:
        self.last -= 1
        self.seen.append([one for one in running(self._runs) if one.runner.pid == os.getpid()])
        if self.last == 0:
            raise Fault("INTERRUPTED", "by the test")


@pytest.fixture
def given(tmp_path: Path) -> dict[str, Path]:
    """What the arguments name."""
    data = yaml.safe_load(ready.text("encoder"))
    data["sensor"]["encoder"] |= {"home": {"end": "high", "at_rad": 1.5, "u_V": 0.9}}
    data["emulated"]["encoder"] = {"end_rad": [-1.5, 1.5]}
    files = {"homes": yaml.safe_dump(data), "simulated": ready.text("simulated"), "answers": "yes\nyes\nyes\n"}
    for name, text in files.items():
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
    return {name: tmp_path / f"{name}.yaml" for name in files} | {"golden": GOLDEN, "tuned": tuned_run(tmp_path)}


@pytest.mark.parametrize(("command", "armed", "arguments"), TRIED)
def test_what_drives_has_a_flag_when_it_arms(
    command: str, armed: int, arguments: str, given: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = tmp_path / "runs"
    armings = Armings(runs, monkeypatch)
    few_draws(monkeypatch)
    armings.last = armed
    result = rig(command, *arguments.format(**given).split(), "--out", runs)
    assert len(armings.seen) >= armed, f"it did not arm as often: {result.output}"
    assert all(armings.seen), "no panel knows of what drives now"
    assert all(any(one.runner.drives for one in seen) for seen in armings.seen), "a panel would take it to be at 0 V"
    assert result.exit_code == 1
    assert running(runs) == [] and list(runs.glob(".*-*")) == [], "it has left a flag"


# these open their device as `rig run` does
ALIKE = ("rehearse", "relay", "survey", "track", "tune")


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        *((name, arguments) for name, (_, arguments) in DRIVES.items() if name not in ALIKE),
        *evidence(*((name, DRIVES[name][1]) for name in ALIKE)),
    ],
)
def test_a_stop_while_a_device_is_opened_lets_nothing_drive(
    command: str, arguments: str, given: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a command that was typed in a terminal, which no panel has started."""
    runs = tmp_path / "runs"
    armings = Armings(runs, monkeypatch)
    armings.stops_at_opening = True
    result = rig(command, *arguments.format(**given).split(), "--out", runs)
    assert (armings.last, result.exit_code) == (0, 1), result.output
    assert "Stop by panel" in result.output or "stopped: the drive is at 0 V" in result.output, result.output


# ---------------------------------------------------------------------- what is left, and what is in the way

_DIES = """
import os, sys
from pathlib import Path
from rig.run_folder.live.stop_flag import StopFlag
flag = StopFlag()
flag.open(Path(sys.argv[1]), "home")
flag.tell_drive(is_on=True)
print("drives", flush=True)
sys.stdin.read()
"""


def test_the_flag_of_a_killed_command_stands_in_nobodys_way_and_is_cleared(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _DIES, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "drives\n"
        bench = Bench(None, tmp_path)
        bench.look()
        assert [command_of(one.folder) for one in bench.unrecorded] == ["rig home"]
        with pytest.raises(BusyError, match="rig home goes on in"), told(tmp_path, "calibrate"):
            pass
        other.kill()
    (left,) = tmp_path.glob(".home-*")
    assert (left / NAME).exists() and runner_of(left) is None
    bench.look()
    assert bench.unrecorded == []
    with told(tmp_path, "calibrate") as flag:
        assert not left.exists()
        (mine,) = running(tmp_path)
        assert not is_recorded(mine.folder) and mine.folder.stat().st_mode & 0o777 == 0o700
        with StopFlag() as another:
            another.open(tmp_path, "run")  # clears only what is dead
            assert flag.asked_by() == "" and len(running(tmp_path)) == 2


def test_a_command_that_records_nothing_begins_beside_nothing_and_not_while_a_panel_starts_something(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.run_folder.live.running._WAIT_S", 0.05)
    with processes.one_at_a_time(tmp_path), pytest.raises(BusyError, match="starts something"), told(tmp_path, "home"):
        pass
    (folder := tmp_path / "20260101T000000Z-run-bench").mkdir()
    with StopFlag() as flag:
        flag.begin(folder)
        with pytest.raises(BusyError, match="run-bench goes on in"), told(tmp_path, "home"):
            pass
    with told(tmp_path, "home"):
        pass
    (file := tmp_path / "a file").write_text("")
    with pytest.raises(BusyError, match="no stop flag in"), told(file, "home"):
        pass
