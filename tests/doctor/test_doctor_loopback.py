"""`rig doctor --loopback` on bare emulated boards: all wires, some wires, and defects put into the firmware."""

import errno
import json
import os
import subprocess
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from evidence import evidence
from firmware_copy import copied_firmware

from emulated_chips import build as chip_build
from emulated_chips.opening import bare_chip
from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.emulated.firmware_build import Variant
from rig.cli import main
from rig.running.doctor.finding import Finding
from rig.running.doctor.loopback import Visit, visit_board

CORE, BOARDS = "core/rig_core.c", {"uno": "emulated-chip", "pico": "emulated-pico"}
NEVER_TRIPS = (CORE, "silent_us >= core->setup.watchdog_ms * US_PER_MS", "silent_us > 0x7FFFFFFFu")
INVERTED = {
    "uno": (
        "boards/uno/bridge.c",
        "#define OUTPUT_A BIT(COM1A1)",
        "#define OUTPUT_A (uint8_t)(BIT(COM1A1) | BIT(COM1A0))",
    ),
    "pico": (
        "boards/pico/bridge.c",
        "#define DRIVES FUNCTION_PWM\n",
        "#define DRIVES (FUNCTION_PWM | OUTPUT_INVERTED)\n",
    ),
}


def visited(board: str, wires: int = 7, options: Variant = firmware_build.PLAIN_VARIANT) -> Visit:
    transport = bare_chip(BOARDS[board], options, wires)
    try:
        return visit_board(transport, repeats=1)
    finally:
        transport.close()


def bad(visit: Visit) -> dict[str, str]:
    return {finding.topic: finding.words for finding in visit.findings if finding.state == "bad"}


@pytest.fixture
def build_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, tuple[str, str, str]], None]:
    """Builds a board's firmware with a defect; from then on every such chip runs it."""

    def build(board: str, defect: tuple[str, str, str]) -> None:
        sources = copied_firmware(tmp_path / "firmware")
        where, right, wrong = defect
        text = (sources / where).read_text()
        assert text.count(right) == 1, f"{where} has changed: adapt the defect"
        (sources / where).write_text(text.replace(right, wrong))
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
        folder = tmp_path / "build"
        subprocess.run(["make", "-s", "-C", str(sources), board, f"BUILD={folder}"], check=True, env=environment)
        if board == "uno":
            chip = chip_build.build_chip()._replace(hex=folder / "uno" / "rig_uno.hex")
            monkeypatch.setattr(chip_build, "build_chip", lambda *_: chip)
        else:
            pico = chip_build.build_pico_chip()._replace(uf2=folder / "pico" / "rig_pico.uf2")
            monkeypatch.setattr(chip_build, "build_pico_chip", lambda *_: pico)

    return build


def test_a_bare_board_is_measured_and_a_report_written(tmp_path: Path) -> None:
    """Also what the report says: that no chip was there."""
    done = CliRunner().invoke(main, ["doctor", "--loopback", "emulated-chip", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "D9  o-----o A3" in done.stdout.splitlines()[3]
    (folder,) = tmp_path.glob("*-loopback-*")
    report = json.loads((folder / "report.json").read_text())
    assert report["ok"] and report["emulated"] and report["board"]["name"] == "uno"
    measured = report["measured"]
    assert all(0.098 <= trip["after_s"] <= 0.102 for trip in measured["watchdog"])
    assert all(trip["after_s"] <= 0.1e-3 for trip in measured["estop"])
    assert abs(measured["pulses_Hz"] - 20_000) < 50
    assert measured["restart"]["causes"] == "watchdog" and measured["restart"]["forgot"]
    for share in measured["shares"]:
        assert abs(share["ends"][0] - abs(share["drive"])) < 0.02
    said = (folder / "report.txt").read_text()
    assert "no chip was there" in said and "after the host fell silent" in said


@pytest.mark.parametrize(
    ("wires", "topic", "words"),
    [
        (6, "drive D9", "D9 itself is right, but A3 is high all the time: the wire D9 - A3 is missing"),
        *evidence((3, "wires", "D4 - A5 is missing"), (5, "drive D10", "the wire D10 - A4 is missing")),
    ],
)
def test_a_missing_wire_is_told_from_a_wrong_output(wires: int, topic: str, words: str) -> None:
    options = Variant("IN1_IN2", 1_000_000, end_switches=True, encoder=True)
    found = bad(visited("uno", wires, options))
    assert set(found) == {topic}  # all else that can be measured is, and is right
    assert words in found[topic]


@pytest.mark.parametrize("board", ["uno", *evidence("pico")])
def test_a_watchdog_that_does_not_trip(board: str, build_with: Callable[[str, tuple[str, str, str]], None]) -> None:
    build_with(board, NEVER_TRIPS)
    found = bad(visited(board))
    assert set(found) == {"watchdog"}
    assert "does not trip" in found["watchdog"]


@pytest.mark.parametrize("board", ["uno", *evidence("pico")])
def test_an_inverted_pwm(board: str, build_with: Callable[[str, tuple[str, str, str]], None]) -> None:
    build_with(board, INVERTED[board])
    found = bad(visited(board))
    topic = {"uno": "drive D9", "pico": "drive GP16"}[board]
    assert set(found) == {topic}
    assert "the PWM is inverted" in found[topic]


def test_what_a_board_has_shown_is_told_where_no_report_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> Path:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    visit = SimpleNamespace(findings=[Finding("reset", "good", "it was back")], ok=True)
    monkeypatch.setattr("rig.running.doctor.loopback.bare_board", lambda *_: nullcontext())
    monkeypatch.setattr("rig.running.doctor.loopback.visit_board", lambda *_, **__: visit)
    monkeypatch.setattr("rig.running.doctor.loopback.write_report", full)
    done = CliRunner().invoke(main, ["doctor", "--loopback", "emulated", "--out", str(tmp_path)])
    assert done.exit_code == 1 and "it was back" in done.stdout
    assert done.stderr == f"rig: {tmp_path}: no report can be written there: No space left on device\n"
