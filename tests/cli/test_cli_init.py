"""`rig init`: a few answers become a commented config that `rig check` accepts, and never replaces a file."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner
from command_line import rig
from evidence import evidence

from rig.cli import main
from rig.config import new_bench, ready
from rig.config.bridges import BRIDGES
from rig.config.load import load, load_with_places
from rig.running import preflight
from rig.running.preflight.rehearsal import FRICTION_SHARE, DataSheet, rehearsed

ANSWERED = ("--yes", "--bridge", "l298n", "--no-load-rpm", 590, "--port", "/dev/ttyUSB0")


def test_its_answers_stand_in_a_config_that_check_accepts(tmp_path: Path) -> None:
    file = tmp_path / "bench.yaml"
    made = rig("init", file, *ANSWERED, "--supply-V", 9, "--travel-deg", 80, "--tests", "full")
    assert made.exit_code == 0, made.output
    assert f"then type: rig flash {file}; " in made.stdout
    e = load(file)
    assert (e.name, e.daq.port, e.drive.bridge, e.drive.supply_V, e.drive.bridge_drop_V) == (
        "bench", "/dev/ttyUSB0", "in1-in2", 9.0, 2.0,
    )  # fmt: skip
    assert e.relay.target is not None and e.relay.target.period_s >= 1.4  # the triple relay needs that at 10 ms
    assert e.limits.hard_rad[1] == pytest.approx(1.4 - 0.2, abs=0.01)
    assert e.motor is not None and e.motor.no_load_speed_rad_s == pytest.approx(61.8, abs=0.1)
    comments = [line for line in (ready.text("uno")).splitlines() if line.strip().startswith("#")]
    kept = [line for line in comments[8:] if "config/uno.yaml" not in line]
    text = file.read_text(encoding="utf-8")
    assert all(line in text for line in kept)
    assert "uno.yaml" not in text and "L298N" in text


def test_a_name_or_port_that_yaml_takes_for_something_else_stands_in_quotes(tmp_path: Path) -> None:
    file = tmp_path / "123.yaml"
    assert rig("init", file, *ANSWERED[:-1], "/dev/left: #2").exit_code == 0
    assert (load(file).name, load(file).daq.port) == ("123", "/dev/left: #2")


@pytest.mark.parametrize("bridge", BRIDGES)
@pytest.mark.parametrize("travel_deg", [103.0, *evidence(40.0, 125.0)])
def test_any_bridge_and_travel_pass(tmp_path: Path, bridge: str, travel_deg: float) -> None:
    file = tmp_path / "bench.yaml"
    for supply_V, rpm, tests in ((6.5, 100.0, "full"), (10.0, 590.0, "quick")):
        told = ("uno", "potentiometer", bridge, "/dev/ttyACM0", supply_V, travel_deg, rpm)
        answers = new_bench.Answers(*told, tests=tests)
        file.write_text(new_bench.text(answers, "bench.yaml"), encoding="utf-8")
        preflight.check(file)


@pytest.mark.parametrize("supply_V", [6.5, 24.0])
@pytest.mark.parametrize("rpm", [20, 60, *evidence(120, 300)])
def test_a_slow_motor_or_a_high_supply_gets_swings_that_a_rehearsal_can_make(
    tmp_path: Path, supply_V: float, rpm: int
) -> None:
    """19 of 48 fresh configs were refused by the command that `rig init` names next, or ended in NO_MOTION."""
    file = tmp_path / "bench.yaml"
    for travel_deg in (50, 103):
        told = (*ANSWERED[:3], "--no-load-rpm", rpm, *ANSWERED[5:], "--supply-V", supply_V, "--travel-deg", travel_deg)
        made = rig("init", file, *told, "--tests", "full")
        assert made.exit_code == 0, made.output
        e = rehearsed(load_with_places(file)[1], DataSheet())  # refuses swings out of reach
        assert e.breakaway.max_V >= 1.9 * FRICTION_SHARE * supply_V
        file.unlink()


@pytest.mark.parametrize(
    ("rpm", "bridge", "supply_V"),
    [(8, "l298n", 12), *evidence((20, "tb6612", 5), (20, "drv8871", 12)), (600, "tb6612", 5)],
)
def test_the_slowest_and_the_fastest_motor_of_a_low_supply_are_rehearsed_to_the_end(
    tmp_path: Path, rpm: int, bridge: str, supply_V: int
) -> None:
    """NO_MOTION, NO_CYCLE, and refused by `rig check`: each of them was."""
    file = tmp_path / "bench.yaml"
    made = rig("init", file, "--yes", "--bridge", bridge, "--no-load-rpm", rpm, "--supply-V", supply_V)
    assert made.exit_code == 0, made.output
    text = file.read_text(encoding="utf-8").replace("cycles: 10", "cycles: 3")
    file.write_text(text[: text.index("tracking:")], encoding="utf-8")
    told = rig("rehearse", file, "--out", tmp_path / "runs")
    assert told.exit_code == 0, told.output
    (run,) = (tmp_path / "runs").iterdir()
    answer = json.loads((run / "result.json").read_text(encoding="utf-8"))["answer"]
    assert answer["tau_s"] == pytest.approx(0.1, rel=0.05)


def test_somebody_who_answers_is_asked_for_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("click.testing._NamedTextIOWrapper.isatty", lambda self: True, raising=False)
    told = CliRunner().invoke(main, ["init"], input="uno\npotentiometer\ndrv8871\n/dev/ttyACM3\n9\n60\n350\n\n")
    assert told.exit_code == 0, told.output
    assert "DRV8871" in told.output
    e = load(tmp_path / "bench.yaml")
    assert e.daq.port == "/dev/ttyACM3" and e.relay.until is None and e.relay.target is not None
    told = CliRunner().invoke(
        main, ["init", "pico.yaml"], input="pico\nencoder\ntb6612\nturns\n/dev/ttyUSB3\n9\n64\n50\n20\n200\nquick\n"
    )
    assert told.exit_code == 0, told.output
    assert "rig flash pico.yaml --board pico; " in told.output
    e = load(tmp_path / "pico.yaml")
    assert e.sensor.encoder is not None and e.sensor.encoder.gear == 50.0 and e.limits.turns == 20.0
    assert e.relay.until is not None and e.relay.target is None


def test_an_answer_that_cannot_be_is_asked_for_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("click.testing._NamedTextIOWrapper.isatty", lambda self: True, raising=False)
    answers = "arduino uno encoder tb6612 turns /dev/ttyACM3 volts 24 9 0 64 -1 50 1 20 nan 200 full"
    told = CliRunner().invoke(main, ["init"], input="\n" + answers.replace(" ", "\n") + "\n")
    assert told.exit_code == 0, told.output
    for said in (
        "this has no default",
        "'arduino' is not one of",
        "'volts' is not a valid",
        "a motor supply of 24 V is nothing for TB6612FNG",
        "0 counts a turn are no encoder: four times the lines (PPR)",
        "a gear of -1 is none",
        "1 turns either way",
        "a speed of nan",
    ):
        assert told.output.count(said) == 1
    e = load(tmp_path / "bench.yaml")
    assert e.drive.supply_V == 9.0 and e.limits.turns == 20.0
    assert e.sensor.encoder is not None and e.sensor.encoder.counts_per_turn == 64 and e.sensor.encoder.gear == 50.0
    angle = CliRunner().invoke(main, ["init", "angle.yaml"], input="uno\npotentiometer\nl298n\n\n9\n20\n60\n350\n\n")
    assert angle.exit_code == 0 and "20 degrees to each side are not 40 to 125" in angle.output


def test_answers_that_contradict_each_other_are_not_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command that the error prints holds them all: with one number changed it passes."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("click.testing._NamedTextIOWrapper.isatty", lambda self: True, raising=False)
    answers = "uno encoder tb6612 turns /dev/ttyACM3 9 4096 50 20 300 quick".replace(" ", "\n") + "\n"
    told = CliRunner().invoke(main, ["init", "my bench.yaml"], input=answers)
    assert told.exit_code == 2 and "edges a second" in told.output
    command = shlex.split(told.output.split("change the wrong one here:\n     rig ")[1])
    assert command[:2] == ["init", "my bench.yaml"]
    again = CliRunner().invoke(main, ["64" if word == "4096" else word for word in command])
    assert again.exit_code == 0, again.output
    e = load(tmp_path / "my bench.yaml")
    assert e.sensor.encoder is not None and e.sensor.encoder.counts_per_turn == 64 and e.limits.turns == 20.0
    assert e.relay.until is not None


COUNTED = ("--sensor", "encoder", "--counts-per-turn", 64, "--gear", 50)
MOTOR = """
emulated:
  motor: {tau_s: 0.17, K_rad_s_V: 6.5, fc_plus_V: 0.5, fc_minus_V: 0.46}
"""


@pytest.mark.parametrize(
    ("board", "sensor", "limits", "moves"),
    [
        ("uno", (), "stops", False),
        ("uno", COUNTED, "stops", False),
        ("uno", COUNTED, "turns", False),
        ("uno", COUNTED, "none", True),
        ("pico", (), "stops", False),
        ("pico", COUNTED, "stops", False),
        *evidence(("pico", COUNTED, "turns", True)),
        ("pico", COUNTED, "none", False),
    ],
)
def test_every_board_sensor_and_limits_run_on_their_emulated_chip(
    tmp_path: Path, board: str, sensor: tuple[object, ...], limits: str, moves: bool
) -> None:
    """Written and checked, all of them; some of them armed, and driven for a moment."""
    file = tmp_path / "bench.yaml"
    made = rig(
        "init", file, "--yes", "--board", board, "--bridge", "tb6612", "--no-load-rpm", 300, "--limits", limits, *sensor
    )
    assert made.exit_code == 0, made.output
    port = {"uno": "emulated-chip", "pico": "emulated-pico"}[board]
    file.write_text(re.sub(r"port: /dev/\S+", f"port: {port}", file.read_text()) + MOTOR)
    if moves:
        jogged = rig("jog", file, "--u-V", 0.8, "--seconds", 0.2, "--out", tmp_path)
        assert jogged.exit_code == 0, jogged.output
    else:
        preflight.check(file)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give --yes --bridge NAME --no-load-rpm RPM;"),
        (("--sensor", "encoder", *ANSWERED[1:]), "give --yes --counts-per-turn COUNTS;"),
        (("--yes", "--sensor", "encoder"), "--bridge, --no-load-rpm, --counts-per-turn have no default"),
        ((*ANSWERED, "--counts-per-turn", 64), "--counts-per-turn belongs to --sensor encoder, not to potentiometer"),
        ((*ANSWERED, "--turns", 5), "--turns belongs to --limits turns, not to stops"),
        (("--yes", "--bridge", "l298n"), "--no-load-rpm has no default"),
        (("--servo", "xl430"), "its speed without load is missing"),
        ((*ANSWERED, "--supply-V", 1), "a motor supply of 1 V is nothing for L298N"),
        ((*ANSWERED, "--travel-deg", 200), "200 degrees to each side are not 40 to 125"),
        ((*ANSWERED, "--no-load-rpm", -3), "a speed of -3"),
        ((*ANSWERED, "--limits", "none"), "a potentiometer has ends"),
        ((*ANSWERED, "--sensor", "encoder"), "--counts-per-turn has no default"),
        ((*ANSWERED, "--sensor", "encoder", "--counts-per-turn", 0), "0 counts a turn are no encoder"),
        ((*ANSWERED, *COUNTED[:4], "--gear", 0), "a gear of 0 is none"),
        (
            (*ANSWERED, "--sensor", "encoder", "--counts-per-turn", 12),
            "12 counts for a turn of the measured shaft are too",
        ),
        ((*ANSWERED, "--sensor", "encoder", "--counts-per-turn", 8000), "the Arduino Uno or Nano counts 39000"),
        (
            (*ANSWERED, "--sensor", "encoder", "--counts-per-turn", 800, "--limits", "turns", "--turns", 1),
            "1 turns either way",
        ),
    ],
)
def test_what_cannot_be_is_said_and_nothing_is_written(tmp_path: Path, words: tuple[object, ...], said: str) -> None:
    refused = rig("init", tmp_path / "bench.yaml", *words)
    assert refused.exit_code == 2
    assert said in refused.stderr
    assert not list(tmp_path.iterdir())


def test_a_file_is_never_replaced_and_a_config_that_check_refuses_is_said(tmp_path: Path) -> None:
    (tmp_path / "there.yaml").write_text("mine\n")
    assert "is there already" in rig("init", tmp_path / "there.yaml", *ANSWERED).stderr
    fast = rig("init", tmp_path / "fast.yaml", *ANSWERED, "--no-load-rpm", 9000)
    assert fast.exit_code == 2
    assert "breakaway.max_V" in fast.stderr and "correct these numbers" in fast.stdout


def test_a_bridge_that_lets_the_motor_run_free_is_refused_with_the_way_out(tmp_path: Path) -> None:
    refused = rig("init", tmp_path / "bench.yaml", *ANSWERED, "--bridge", "l298-ena")
    assert refused.exit_code == 2 and not (tmp_path / "bench.yaml").exists()
    assert "run free while PWM is low" in refused.output and "answer l298n" in refused.output
