"""`rig calibrate` from begin to end, with scripted answers, on emulated benches that are not as the config says."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from rig.cli import main
from rig.config import load, ready
from rig.running.preflight import check

RPC, CENTRE = 0.0043, 500.0  # the true sensor, for 10 bits
COMMENT = re.compile(r"#.*")


def bench(folder: Path, name: str, port: str | None, *, rpc: float = RPC, centre: float = CENTRE) -> Path:
    """A ready config with a bench that is not as it says: another sensor, a reversed drive, nearer stops."""
    text = ready.text(name)
    truth = f"rad_per_count: {rpc}\n    centre_counts: {centre}"
    text = re.sub(r"(?m)^  potentiometer:\n", f"  potentiometer:\n    {truth}\n", text)
    text = re.sub(
        r"(?m)^emulated:.*\n  motor:\n", "emulated:\n  reversed: true\n  motor:\n    stop_rad: [-2.05, 2.15]\n", text
    )
    if port is not None:
        text = re.sub(r"(?m)^  port: \S+", f"  port: {port}", text)
    file = folder / f"{name}.yaml"
    file.write_text(text)
    return file


def calibrated(file: Path, answers: str, *more: str, stdin: bool = False) -> Result:
    """The command with these answers, a line each; blanks part them, and `.` is an empty line."""
    lines = "".join(("" if word == "." else word) + "\n" for word in answers.split())
    arguments = ["calibrate", str(file), *more, "--out", str(file.parent / "runs")]
    if not stdin:
        script = file.parent / "answers.txt"
        script.write_text("# answers\n" + lines)
        arguments += ["--answers", str(script)]
    return CliRunner().invoke(main, arguments, input=lines if stdin else None)


ANGLES = "0.5 . -114 -60 60 114 ."
TRAVEL = "yes . ."
STROKES = "yes reversed yes"


def assert_as_the_truth(file: Path, *, rpc: float = RPC, centre: float = CENTRE) -> None:
    e, _ = check(file)
    found, zero = e.sensor.straight
    offset_rad = e.emulated.potentiometer.offset_rad if e.emulated is not None else 0.0
    assert found == pytest.approx(rpc, rel=0.01)
    assert (zero - centre) * rpc == pytest.approx(offset_rad, abs=0.012)
    assert e.limits.hard_rad == pytest.approx((-1.85, 1.95), abs=0.04)
    assert e.drive.reversed is True


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_at_a_question_ends_it_in_words(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = bench(tmp_path, "simulated", None)
    before, handler = file.read_text(), signal.getsignal(number)

    def lines(_: Path | None) -> Iterator[str]:
        os.kill(os.getpid(), number)
        yield "yes"

    monkeypatch.setattr("rig.cli.calibrate._lines", lines)
    done = calibrated(file, ANGLES)
    assert done.exit_code == 1 and f"ended by {number.name}; nothing is written" in done.output
    assert file.read_text() == before and signal.getsignal(number) == handler


def test_every_step_on_a_simulated_bench(tmp_path: Path) -> None:
    file = bench(tmp_path, "simulated", None)
    before = file.read_text()
    volts = "1.0 1.85 2.73 -1.0 -1.85 -2.73"
    done = calibrated(file, f"{ANGLES} {TRAVEL} {STROKES} yes {volts} yes", "--json", stdin=True)
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["ok"] and set(told["changes"]) == {
        "sensor.calibration", "sensor.calibration_error_rad", "sensor.linearity_percent", "limits.soft_rad",
        "limits.hard_rad", "drive.reversed", "drive.dead_band_duty", "breakaway.max_V",
    }  # fmt: skip
    assert_as_the_truth(file)
    assert Path(told["backup"]).read_text() == before
    assert COMMENT.findall(file.read_text()) == COMMENT.findall(before)
    assert "swap these two wires at one end" in done.stderr
    assert "o----.   .----o terminal 1" in done.stderr


@pytest.mark.parametrize(
    ("name", "port", "rpc"),
    [
        pytest.param("demo-pico", "emulated-pico", 0.25 * RPC, id="the Pico's chip", marks=pytest.mark.evidence),
        pytest.param("modbus-rtu", "emulated", -RPC, id="Modbus"),
        pytest.param("demo", "emulated", RPC, id="the board"),
    ],
)
def test_angles_on_emulated_devices(tmp_path: Path, name: str, port: str, rpc: float) -> None:
    centre = 2000.0 if name == "demo-pico" else CENTRE
    file = bench(tmp_path, name, port, rpc=rpc, centre=centre)
    done = calibrated(file, "0.5 . -114 114 . yes", "angles")
    assert done.exit_code == 0, done.output
    assert load(file).sensor.straight[0] == pytest.approx(rpc, rel=0.01)


@pytest.mark.evidence
def test_an_encoder_and_the_strokes_on_the_chip(tmp_path: Path) -> None:
    """Lines taken for edges, and counts that fall; the motor of the chip then turns as it should."""
    file = tmp_path / "encoder.yaml"
    text = ready.text("encoder").replace("counts_per_turn: 64 ", "counts_per_turn: 16 ")
    file.write_text(text.replace("emulated:\n", "emulated:\n  potentiometer: {rad_per_count: -0.00196349541}\n"))
    done = calibrated(file, "2 . 140 sign yes . . keep yes yes", "turn", "travel", "strokes")
    assert done.exit_code == 0, done.output
    encoder = load(file).sensor.encoder
    assert encoder is not None and (encoder.counts_per_turn, encoder.sign) == (64, -1)


def test_nothing_is_written_without_a_yes(tmp_path: Path) -> None:
    file = bench(tmp_path, "simulated", None)
    before = file.read_bytes()
    for answers, words in (
        (f"{ANGLES} no", "nothing is written"),
        (f"{ANGLES}", "the answers ended at: write this to"),
        ("0.5 . quit", "ended; nothing is written"),
        ("0.5 . 4,5", "Enter alone: no more angles; before: '4,5' is no angle"),
    ):
        done = calibrated(file, answers, "angles")
        assert (done.exit_code, words in done.output) == (1, True), done.output
    assert file.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["answers.txt", "runs", "simulated.yaml"]
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [".panel"], "the lock of those who start"


def test_what_cannot_begin(tmp_path: Path) -> None:
    file = bench(tmp_path, "simulated", None)
    for arguments, words in (
        (("calibrate", file, "turn"), "this bench has no step 'turn'"),
        (("calibrate", file, "--answers", tmp_path / "none.txt"), "cannot be read"),
        (("calibrate", tmp_path / "none.yaml"), "no such file"),
    ):
        done = CliRunner().invoke(main, [str(a) for a in arguments])
        assert (done.exit_code, words in done.output) == (2, True), done.output
