"""`rig servo` and `rig init --servo` on an emulated bus behind a pseudo-terminal."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from rig import config
from rig.backends.servo.emulated.servo import ServoOptions
from rig.backends.servo.emulated.servo_board import ServoBoard
from rig.cli import main
from rig.panel.bench import Bench
from rig.run_folder.live.running import running
from rig.run_folder.live.stop_flag import StopFlag
from rig.running.preflight import check

pytestmark = pytest.mark.realtime

SERVOS = [ServoOptions(model="xl330-m288", id=1), ServoOptions(model="xl330-m077", id=7, registers={"drive_mode": 8})]


@pytest.fixture
def port() -> Iterator[str]:
    with ServoBoard() as board:
        board.start(SERVOS)
        yield board.port


def said(*arguments: str, status: int = 0) -> str:
    done = CliRunner().invoke(main, list(arguments), catch_exceptions=False)
    assert done.exit_code == status, done.output
    return done.output


def test_a_scan_shows_every_servo_and_what_would_be_refused(port: str) -> None:
    servos = json.loads(said("servo", "scan", port, "--baud", "1000000", "--json"))["servos"]
    assert [(one["id"], one["model"]) for one in servos] == [(1, "xl330-m288"), (7, "xl330-m077")]
    assert servos[0]["refused"] == [] and "SERVO_SETUP" in servos[1]["refused"][0]
    assert servos[0]["supply_V"] == 5.0
    text = said("servo", "scan", port, "--baud", "1000000")
    assert "id 7: xl330-m077" in text and "refused: SERVO_SETUP" in text


def test_a_scan_at_another_baud_finds_nobody(port: str) -> None:
    assert "no servo answers at 57600 baud" in said("servo", "scan", port, "--baud", "57600")
    assert "9600<=x<=4500000" in said("servo", "scan", port, "--baud", "0", status=2)


def test_all_registers_are_shown(port: str) -> None:
    registers = json.loads(said("servo", "show", port, "7", "--json"))["registers"]
    assert registers["drive_mode"] == 8 and registers["model_number"] == 1190
    assert "operating_mode" in said("servo", "show", port, "1")


@pytest.mark.parametrize(("typed", "words"), [("n\n", ""), ("", "in a pipe say `--yes`")])
def test_who_says_no_or_nothing_changes_nothing(typed: str, words: str, port: str) -> None:
    done = CliRunner().invoke(main, ["servo", "baud", port, "1", "57600"], input=typed)
    assert done.exit_code == 2 and "nothing was changed" in done.output and words in done.output
    assert json.loads(said("servo", "show", port, "1", "--json"))["registers"]["baud_rate"] == 3


def test_a_servo_speaks_at_another_baud_from_then_on(port: str) -> None:
    assert "speaks at 57600 baud" in said("servo", "baud", port, "1", "57600", "--yes")
    (one,) = json.loads(said("servo", "scan", port, "--baud", "57600", "--json"))["servos"]
    assert one["id"] == 1
    assert "no 12345 baud" in said("servo", "baud", port, "7", "12345", "--yes", status=1)


@pytest.mark.parametrize("typed", [("show", "3"), ("baud", "3", "57600", "--yes"), ("restore", "3")])
def test_a_command_without_a_config_names_no_key_of_one_where_nobody_answers(typed: tuple[str, ...], port: str) -> None:
    told = said("servo", typed[0], port, *typed[1:], status=1)
    assert "no servo 3 answers" in told and f"`rig servo scan {port}` shows who answers" in told
    assert "daq." not in told and "rig check" not in told


def test_a_reboot_and_nobody_to_reboot(port: str) -> None:
    assert "answers again" in said("servo", "reboot", port, "1", "--yes")
    assert "no servo 3 answers" in said("servo", "reboot", port, "3", "--yes", status=1)


def test_facts_that_no_file_would_take_are_refused_before_the_servo_turns(port: str, tmp_path: Path) -> None:

    for file, words in ((tmp_path / "none" / "x.json", "is no folder"), (tmp_path, "is a directory")):
        assert words in said("servo", "facts", port, "1", "--to", str(file), status=2)


@pytest.mark.parametrize("words", ["INTERRUPTED", "ended by SIGTERM; no file is written"])
def test_a_stop_by_another_panel_or_a_signal_reaches_a_horn_that_turns(
    words: str, port: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers: list[bool | None] = []

    def asked_while_it_turns(flag: StopFlag) -> str:
        (going,) = running(tmp_path)
        if not answers:
            answers.append(going.runner.drives)
            if "SIGTERM" in words:
                os.kill(os.getpid(), signal.SIGTERM)
            assert Bench(None, tmp_path).stop().why == ""
        return asked_by(flag)

    asked_by = StopFlag.asked_by
    monkeypatch.setattr("rig.backends.servo.keeper.first_that_ends_with", lambda _: "")  # where the tests are that
    monkeypatch.setattr(StopFlag, "asked_by", asked_while_it_turns)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    file = tmp_path / "facts.json"
    arguments = ("servo", "facts", port, "1", "--yes", "--out", str(tmp_path), "--to", str(file))
    assert words in said(*arguments, status=1)
    assert answers == [True] and not file.exists() and running(tmp_path) == []
    registers = json.loads(said("servo", "show", port, "1", "--json"))["registers"]
    assert registers["torque_enable"] == 0 and registers["operating_mode"] == 3


def test_facts_are_written_where_nobody_cuts_the_supply(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven facts were lost at the last question, and the horn had to turn again."""
    monkeypatch.setattr("rig.backends.servo.keeper.first_that_ends_with", lambda _: "")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    file = tmp_path / "facts.json"
    with ServoBoard() as board:
        board.start([ServoOptions(model="sts3215", id=1)])
        arguments = ["servo", "facts", board.port, "1", "--out", str(tmp_path), "--to", str(file)]
        done = CliRunner().invoke(main, arguments, input="y\n", catch_exceptions=False)
    assert done.exit_code == 0 and "the supply was not cut" in done.output, done.output
    assert "lock_keeps_mode" not in json.loads(file.read_text())


def test_there_is_nothing_to_put_back(port: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert "nothing to put back" in said("servo", "restore", port, "1")


def test_what_a_run_has_left_is_put_back(port: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    file = tmp_path / "rig" / f"servo-{Path(port).name}-1.json"
    file.parent.mkdir()
    file.write_text(
        json.dumps({"model": "xl330-m288", "id": 1, "registers": {"pwm_limit": 300}, "set": {"pwm_limit": [885]}})
    )
    assert "put back: pwm_limit 300" in said("servo", "restore", port, "1")
    assert json.loads(said("servo", "show", port, "1", "--json"))["registers"]["pwm_limit"] == 300
    assert not file.exists()


@pytest.mark.parametrize(("arguments", "driver_model"), [
    (("--servo", "xl330-m288"), "xl330-m288"),
    (("--servo", "sts3215"), "sts3215"),
    (("--servo", "xm430-w350", "--supply-V", "12", "--no-load-rpm", "46"), "xm430-w350"),
    (("--servo", "xl430", "--supply-V", "11.1", "--no-load-rpm", "57"), "xl430-w250"),
])  # fmt: skip
def test_a_first_config_passes_the_check(arguments: tuple[str, ...], driver_model: str, tmp_path: Path) -> None:
    file = tmp_path / "bench.yaml"
    said("init", str(file), *arguments)
    experiment, _ = check(file)
    assert experiment.daq.servo is not None and experiment.daq.servo.model == driver_model
    assert experiment.daq.port == "emulated"


def test_a_first_config_knows_what_the_servo_tells(port: str, tmp_path: Path) -> None:
    file = tmp_path / "bench.yaml"
    said("init", str(file), "--servo", "xl330", "--port", port)
    e = config.load(file)
    assert e.daq.servo is not None and e.sensor.servo is not None
    assert (e.daq.port, e.daq.servo.model, e.daq.servo.id, e.drive.supply_V) == (port, "xl330-m288", 1, 5.0)
    assert e.emulated is None and e.sensor.servo.zero_counts == 2048
    assert not re.search("emulated|virtual", file.read_text())


@pytest.mark.parametrize(("arguments", "words"), [
    (("--servo", "ax-12"), "rig knows no servo"),
    (("--servo", "xl300-m288"), "did you mean xl330-m288 or"),
    (("--servo", "foo"), "a model of one of these: 2xc430, 2xl430, mx, sts3215,"),
    (("--servo", "xl330"), "xl330 may be xl330-m077 or xl330-m288"),
    (("--servo", "XL 330"), "XL 330 may be xl330-m077 or xl330-m288"),
    (("--servo", "xm430-w350"), "give --no-load-rpm"),
    (("--servo", "xl330", "--board", "uno"), "mean nothing with --servo"),
])  # fmt: skip
def test_what_cannot_be_is_refused(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    assert words in said("init", str(tmp_path / "bench.yaml"), *arguments, status=2)
