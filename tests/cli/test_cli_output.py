"""How commands say things: tables on a terminal and in a pipe, stages in a pipe, the verdict, names of run folders."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import yaml
from command_line import rig
from rich.console import Console

from rig.cli.terminal import show_details, show_estimates, show_run, tracking_words
from rig.output.text import plain_table
from rig.run_folder.recording.csv_file import read_csv
from rig.run_folder.results import (
    Answer,
    EstimateResult,
    IdentificationResult,
    LoopResult,
    RelayTestResult,
    RunResult,
    TrackingResult,
    TrueMotor,
)
from rig.run_folder.results.result import NO_ESTIMATE, Quantiles
from rig.running.session import Outcome

ROOT = Path(__file__).resolve().parents[2]
SIMULATED = ROOT / "config/quick.yaml"


def estimate(verdict: str = "ok") -> EstimateResult:
    ci95 = {"tau_s": [0.169, 0.171], "K_rad_s_V": [6.4, 6.6], "fc_V": [0.47, 0.49]}
    return EstimateResult(tau_s=0.17, K_rad_s_V=6.5, fc_V=0.48, ci95=ci95, verdict=verdict)


METHODS = ("sampled-data", "triple-relay", "describing-function", "least-squares")
TRUTH = TrueMotor(tau_s=0.17, K_rad_s_V=6.5, fc_V=0.48)
TRACKING = {method: TrackingResult(rms_rad=0.0123) for method in METHODS}


@pytest.mark.parametrize("width", [80, 60])
def test_a_table_on_a_terminal_never_cuts_the_name_of_a_method(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = io.StringIO()
    monkeypatch.setattr("rich.console.Console", partial(Console, width=width, file=shown, force_terminal=True))
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    show_estimates({method: estimate() for method in METHODS}, TRUTH, TRACKING)
    for method in METHODS:
        assert method in shown.getvalue()
    assert "…" not in shown.getvalue()
    assert max(len(re.sub(r"\x1b\[[0-9;]*m", "", line)) for line in shown.getvalue().splitlines()) <= width


def test_a_table_in_a_pipe_is_plain(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    show_estimates({method: estimate("refused" if method == METHODS[3] else "ok") for method in METHODS}, TRUTH)
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["method", "tau,", "s", "K,", "(rad/s)/V", "f_c,", "V", "verdict"]
    assert [re.split(" {2,}", line)[0] for line in lines[2:]] == [*METHODS, "truth"]
    assert re.split(" {2,}", lines[5]) == ["least-squares", "-", "-", "-", "refused"]
    assert re.fullmatch(r"[ -~±\n]*", "\n".join(lines))  # no boxes, no colours


def test_plain_columns_stand_below_each_other() -> None:
    assert plain_table(("a", ""), [("long name", "1"), ("b", "")]) == ["a          -", "long name  1", "b          -"]


def test_a_run_is_summed_up_in_fewer_than_ten_lines_and_verbose_tells_the_rest(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    test = RelayTestResult(stage="relay-1", h1_V=0.3, h2_V=0.7, period_s=1.6, amplitude_rad=0.5, cycles=10)
    result = RunResult(
        backend="simulated",
        relays=(test,),
        estimates={method: estimate() for method in METHODS},
        answer=Answer.model_validate(estimate().as_json() | {"method": METHODS[0]}),
        tracking=TRACKING | {METHODS[0]: TrackingResult(rms_rad=0.0035, true_rms_rad=0.0013)},
        loop=LoopResult(period_s=0.01, ticks=100, skipped=0, late_us=Quantiles(p50=1.0, p99=2.0, max=3.0)),
        truth=TRUTH,
        config_notes=tuple(f"note {k}" for k in range(4)),
    )
    outcome = Outcome(tmp_path, result)
    show_run(outcome, verbose=False)
    short = capsys.readouterr().out
    assert len(short.splitlines()) - 3 < 10  # but for the notes
    assert "2 more notes are in the report" in short
    assert "(in brackets the true shaft's): sampled-data 3.5 (1.3), triple-relay 12.3, " in short
    show_run(outcome)
    whole = capsys.readouterr().out
    for word in ("relay-1: h1", "the plain motor by each method", "loop: ", "note 3"):
        assert word in whole and word not in short


def test_what_did_not_track_stands_after_what_did_with_its_reason() -> None:
    ran, left = TrackingResult(rms_rad=0.0036, true_rms_rad=0.0017), TrackingResult(not_run="its estimate was refused")
    error = "tracking error, mrad RMS (in brackets the true shaft's): sampled-data 3.6 (1.7)"
    assert tracking_words({"triple-relay": left, "sampled-data": ran}) == (
        f"{error}; not run: triple-relay (its estimate was refused)"
    )
    assert tracking_words({"triple-relay": left}) == "tracking not run: triple-relay (its estimate was refused)"
    none = TrackingResult(not_run=NO_ESTIMATE)  # these tests are not for that method
    assert tracking_words({"triple-relay": none, "sampled-data": ran}) == error
    assert "no method of tracking.methods has an estimate" in tracking_words({"triple-relay": none})


def test_a_doubt_to_record_anew_is_followed_by_what_to_type(capsys: pytest.CaptureFixture[str]) -> None:
    doubtful = EstimateResult(fc_V=0.48, verdict="doubtful", reasons=("only 4 cycles: record ten",))
    show_details(IdentificationResult(estimates={"sampled-data": doubtful}))
    assert "`rig relay CONFIG`; more cycles: relay.cycles" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "verdict", "status"),
    [
        ({}, "ok", 0),
        ({"supply_V": 10.0}, "ok with 1 note", 0),
        ({"cyles": 3, "nonsense": 1}, "refused, 2 problems; nothing would be run", 2),
    ],
)
def test_check_ends_with_a_verdict(tmp_path: Path, change: dict[str, float], verdict: str, status: int) -> None:
    config = yaml.safe_load(SIMULATED.read_text(encoding="utf-8"))
    if "supply_V" in change:
        config["emulated"] |= change
    else:
        config |= change
    path = tmp_path / "changed.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    result = rig("check", path)
    assert result.exit_code == status
    assert result.stdout.splitlines()[-1] == f"verdict: {verdict}"
    said = json.loads(rig("check", path, "--json").stdout)
    assert said["verdict"] == verdict
    assert said["ok"] == (status == 0)


def test_a_missing_port_is_said_before_anything_is_loaded_opened_or_waited_for(tmp_path: Path) -> None:
    """What would take the time: none of it is so much as imported, and there is no port to be opened."""
    config = tmp_path / "uno.yaml"
    text = (ROOT / "config/uno.yaml").read_text(encoding="utf-8")
    config.write_text(text.replace("/dev/ttyACM0", "/dev/ttyNONE"), encoding="utf-8")
    commands = [["run"], ["relay"], ["jog", "--u-V", "0.5"], ["track", "--model", "none"]]
    program = (
        "import json, sys\n"
        "from rig.cli import main\n"
        "for command in json.loads(sys.argv[1]):\n"
        "    try:\n"
        "        main(command)\n"
        "    except SystemExit as end:\n"
        "        print(end.code)\n"
        "print(json.dumps(sorted(sys.modules)))\n"
    )
    lines = [[command, str(config), *options, "--out", str(tmp_path / "runs")] for command, *options in commands]
    done = subprocess.run(
        [sys.executable, "-c", program, json.dumps(lines)], capture_output=True, text=True, check=True, cwd=ROOT
    )
    *statuses, modules = done.stdout.splitlines()
    assert statuses == ["1"] * len(commands)
    assert done.stderr.count("rig: LINK_OPEN: the port could not be opened (/dev/ttyNONE: no such device; ") == 4
    assert done.stderr.count("daq.port") == 4
    slow = {
        "numpy",
        "scipy",
        "serial",
        "rig.control.loop.real_time",
        "rig.backends.links.serial_port",
        "rig.running.experiment",
        "rig.control.loop.runner",
    }
    assert not slow & set(json.loads(modules))
    assert not (tmp_path / "runs").exists()


def test_ports_that_are_there_are_named_where_one_is_missing(tmp_path: Path) -> None:
    from rig.backends.links.device_file import require_device_file
    from rig.core.faults import Fault

    (tmp_path / "ttyUSB3").touch()
    with pytest.raises(Fault, match=rf"/dev/ttyNONE: no such device; there is {tmp_path}/ttyUSB3"):
        require_device_file("/dev/ttyNONE", tmp_path)
    for port in (None, "emulated", "tcp://10.0.0.1", str(tmp_path / "ttyUSB3"), "COM3"):
        require_device_file(port, tmp_path)


@pytest.mark.parametrize(("name", "chip"), [("encoder", "chip"), ("demo-pico", "Pico")])
def test_an_installed_rig_refuses_an_emulated_chip(
    name: str, chip: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "core").mkdir()
    for file in ("Makefile", "core/rig_core.c"):  # what a wheel packs of the firmware; no emulator
        (tmp_path / file).touch()
    monkeypatch.setattr("rig.backends.serial.emulated.firmware_build.source_folder", lambda: tmp_path)
    refused = rig("run", ROOT / "config" / f"{name}.yaml", "--out", tmp_path / "runs")
    assert refused.exit_code == 1
    assert f"the emulated {chip} is in rig's repository only" in refused.stderr
    assert "`rig config copy simulated`" in refused.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.evidence
def test_in_a_pipe_each_stage_is_a_plain_line_and_folders_tell_commands_apart(tmp_path: Path) -> None:
    config = yaml.safe_load(SIMULATED.read_text(encoding="utf-8"))
    config["relay"] = {"gains": [{"h1_V": 0.45, "h2_V": 0.9}], "cycles": 5}
    del config["tracking"]
    path = tmp_path / "quick.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    program = """
import rig.running.session
from rig.cli import main
from rig.identification import identification
rig.running.session.write_report = identification._add_motor_law = lambda *_: None
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", program, "relay", str(path), "--out", str(tmp_path / "runs")],
        capture_output=True, text=True, check=True, cwd=ROOT,
    )  # fmt: skip
    said = [re.fullmatch(r" +[0-9]+\.[0-9] s  (.*)", line) for line in done.stderr.splitlines()]
    stages = [line[1] for line in said if line]
    assert stages[:3] == ["breakaway", "relay-1", "identify"]
    assert stages[3:] in ([], ["report"])  # said where it takes seconds, as on a busy machine
    assert all(said), done.stderr
    [relay] = (tmp_path / "runs").glob("*-relay-quick")
    assert rig("jog", path, "--u-V", "0.8", "--out", tmp_path / "runs").exit_code == 0
    [jog] = (tmp_path / "runs").glob("*-jog-quick")
    assert re.fullmatch(r"\d{8}T\d{6}Z-jog-quick", jog.name)

    # rows of a record: those alone, by the numbers that messages and result.json have
    first, last = json.loads((relay / "result.json").read_text())["estimates"]["sampled-data"]["rows"]
    part = json.loads(rig("identify", relay, "--rows", f"{first + 50}:{last}", "--json").stdout)
    rows = part["estimates"]["sampled-data"]["rows"]
    assert first + 50 <= rows[0] < rows[1] == last
    assert rig("export", relay, "--to", tmp_path / "part.csv", "--rows", f"{first}:{first + 9}").exit_code == 0
    assert len(read_csv(tmp_path / "part.csv")) == 10
    beyond = rig("identify", relay, "--rows", "0:99999")
    assert (beyond.exit_code, "give --rows within 0:" in beyond.stderr) == (2, True)
    two = rig("identify", relay, tmp_path / "part.csv", "--rows", "0:9")
    assert (two.exit_code, "--rows takes one recording, not 2" in two.stderr) == (2, True)
