"""A calibration that pages go through: its process, its questions, and what Stop does to it."""

from __future__ import annotations

import io
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from processes import wait_until

from rig.config import ready
from rig.core.faults import Fault
from rig.panel import calibrating, processes
from rig.panel.bench import CALIBRATION, Bench
from rig.panel.calibration import Calibration
from rig.panel.messages import RefusedError
from rig.run_folder.live.stop_flag import command_of
from rig.running.calibrate import session
from rig.running.calibrate.draft import save


def begun(bench: Bench) -> Calibration:
    bench.calibrate()
    assert bench.calibration is not None
    return bench.calibration


def open_question(calibration: Calibration) -> dict[str, Any]:
    wait_until(lambda: not calibration.works)
    question = calibration.shown()["question"]
    assert question is not None, calibration.shown()
    return dict(question)


def end(calibration: Calibration) -> dict[str, Any]:
    wait_until(lambda: not calibration.goes_on)
    end = calibration.shown()["end"]
    assert end is not None
    return dict(end)


def test_it_asks_refuses_late_answers_after_a_stop_and_keeps_other_commands_out(tmp_path: Path) -> None:
    config = tmp_path / "bench.yaml"
    config.write_text(ready.text("simulated"))
    before = config.read_text()
    bench = Bench(config, tmp_path / "runs")
    calibration = begun(bench)
    steps = open_question(calibration)
    assert [name for name, _ in steps["choices"]] == ["angles", "travel", "strokes", "dead-band"]
    for other in (bench.calibrate, lambda: bench._start("jog")):
        with pytest.raises(RefusedError, match="a calibration goes on already"):
            other()
    assert bench.stop().runs == ()  # an answer that comes after it was given before it
    with pytest.raises(RefusedError, match="not open any more"):
        calibration.answer(steps["number"], {"steps": ["strokes"]})
    still = open_question(calibration)
    assert still["words"] == steps["words"]
    with pytest.raises(RefusedError, match="too long"):
        calibration.answer(still["number"], {"answer": "9" * 1000})
    calibration.answer(still["number"], {"end": True})
    words = {"written": False, "words": "ended; nothing is written", "cure": "bench.yaml is as it was"}
    assert end(calibration) == words
    assert config.read_text() == before

    another = begun(bench)
    assert open_question(another)["words"] == steps["words"]
    with pytest.raises(RefusedError, match="not open any more"):  # of a page that has slept since the first one
        another.answer(steps["number"], {"steps": ["strokes"]})
    another.answer(open_question(another)["number"], {"end": True})
    end(another)

    again = begun(bench)  # stopped while it does something
    assert bench.stop().runs == (CALIBRATION,)
    assert end(again)["words"] == "stopped; nothing is written"


def test_a_port_that_does_not_open_is_told_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "bench.yaml"
    config.write_text(ready.text("simulated"))

    def is_held(*_: object) -> None:
        raise Fault("LINK_OPEN", "/dev/ttyACM7: another program holds it")

    monkeypatch.setattr(calibrating, "calibrate", is_held)
    monkeypatch.setattr("sys.stdin", io.StringIO('{"steps": ["travel"]}\n'))
    calibrating.main(config, tmp_path / "runs")
    assert "/dev/ttyACM7: another program holds it" in json.loads(capsys.readouterr().out.splitlines()[-1])["words"]


def test_a_config_that_is_none_says_why(tmp_path: Path) -> None:
    config = tmp_path / "bench.yaml"
    config.write_text("daq: [not, a, config]\nname: '<b>'\n")
    over = end(begun(Bench(config, tmp_path)))
    assert over["words"] == "rig cannot calibrate with this config"
    assert "bench.yaml:1" in over["cure"]


def test_a_line_that_is_no_message_is_among_the_last_words_and_ends_nothing(tmp_path: Path) -> None:
    """As a package may print one."""
    calibration = Calibration(tmp_path / "none.yaml", tmp_path, lambda: None)
    for line in ("[]", "3", '"ask"', "{}", "{"):
        calibration._take(f"{line}\n")
        assert line in calibration._words
    end(calibration)


def test_a_stop_after_the_last_yes_says_what_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It comes as late as it can: the file is there, and nobody has said so yet."""
    config = tmp_path / "bench.yaml"
    config.write_text(ready.text("simulated"))
    before = config.read_text()

    def save_and_stop(*given: Any) -> Path:
        backup = save(*given)
        os.kill(os.getpid(), signal.SIGTERM)  # as Calibration.stop
        return backup

    def ended(*_: object) -> None:
        raise AssertionError("the process has ended, and its page says that nothing is written")

    monkeypatch.setattr(session, "save", save_and_stop)
    answers = [{"steps": ["travel"]}, *({"answer": text} for text in ("yes", "", "", "widen", "yes"))]
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{json.dumps(answer)}\n" for answer in answers)))
    usual = signal.signal(signal.SIGTERM, ended)
    try:
        calibrating.main(config, tmp_path / "runs")
    finally:
        signal.signal(signal.SIGTERM, usual)
    *_, last = map(json.loads, capsys.readouterr().out.splitlines())
    assert (last["type"], last["written"], last["words"]) == ("end", True, "bench.yaml is written")
    assert config.read_text() != before


def test_a_calibration_begins_beside_nothing_that_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither while another panel starts something, nor beside the calibration of another panel or of a terminal."""
    monkeypatch.setattr(processes, "_WAIT_S", 0.05)
    config = tmp_path / "bench.yaml"
    config.write_text(ready.text("simulated"))
    runs = tmp_path / "runs"
    one, other = Bench(config, runs), Bench(config, runs)
    with processes.one_at_a_time(runs), pytest.raises(RefusedError, match="another panel of this folder starts"):
        one.calibrate()
    calibration = begun(one)
    question = open_question(calibration)
    for begins in (other.calibrate, lambda: other._start("jog")):
        with pytest.raises(RefusedError, match="rig calibrate goes on already"):
            begins()
    assert [command_of(folder) for folder in other.stop().runs] == ["rig calibrate"]
    calibration.answer(question["number"], {"end": True})
    end(calibration)
