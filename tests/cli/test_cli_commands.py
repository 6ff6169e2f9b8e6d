"""What a person sees: exit status, one line of cause and one of cure, JSON and nothing else."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread

import click
import pytest
from command_line import rig
from evidence import evidence

from rig.cli import main
from rig.control.loop.stop_request import stop_on_signals
from rig.core import ctrl_c

ROOT = Path(__file__).resolve().parents[2]


def test_predict_gives_the_check_values_of_theory_section_4() -> None:
    result = rig("predict", "--tau", 1, "--K", 1, "--fc", 0.5, "--h1", 0.8, "--h2", 1.0, "--json")
    assert result.exit_code == 0
    prediction = json.loads(result.stdout)
    assert prediction["durations_s"] == pytest.approx([0.046812, 0.837516, 0.927743], abs=5e-7)
    assert prediction["y_switch_rad"][1] == pytest.approx(-0.351390, abs=5e-7)
    assert sorted(re for re, _ in prediction["eigenvalues"]) == pytest.approx([-0.620786, 0.0, 0.148697], abs=5e-7)
    assert prediction["largest_eigenvalue_J3"] == pytest.approx(1.482359, abs=5e-7)
    assert prediction["stable"] is True


@pytest.mark.parametrize(
    ("options", "words"),
    [(("--fc", 0.5, "--h1", 0.8, "--h2", 0.4), "h2"), (("--fc", 0.5, "--fs", 3.0, "--h1", 0.8, "--h2", 1), "sticks")],
)
def test_predict_says_why_there_is_no_cycle(options: tuple[str | float, ...], words: str) -> None:
    result = rig("predict", "--tau", 0.17, "--K", 6.5, *options)
    assert result.exit_code == 1
    assert words in result.stdout


def test_predict_refuses_senseless_numbers() -> None:
    result = rig("predict", "--tau", -1, "--K", 6.5, "--fc", 0.5, "--h1", 0.8, "--h2", 1)
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 2


@pytest.mark.parametrize("name", ["demo", "simulated", "least-squares", "uno"])
def test_check_passes_every_config_of_the_project(name: str) -> None:
    result = rig("check", ROOT / f"config/{name}.yaml")
    assert result.exit_code == 0, result.output
    assert "stop" in result.stdout


@pytest.mark.parametrize(("name", "words"), [("demo", "verdict: ok"), ("campaign", "rig campaign")])
def test_a_config_may_come_from_a_pipe(tmp_path: Path, name: str, words: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = Thread(target=(tmp_path / "pipe").write_bytes, args=((ROOT / f"config/{name}.yaml").read_bytes(),))
    writer.start()
    result = rig("check", tmp_path / "pipe")
    writer.join()
    assert result.exit_code == 0, result.output
    assert words in result.stdout


def test_bad_configs_end_with_status_2_and_no_traceback(tmp_path: Path) -> None:
    missing = rig("run", tmp_path / "none.yaml")
    assert missing.exit_code == 2
    text = (ROOT / "config/quick.yaml").read_text(encoding="utf-8")
    broken = tmp_path / "broken.yaml"
    broken.write_text(text.replace("until:", "untill:"), encoding="utf-8")
    for command in ("run", "check", "relay", "emulate"):
        result = rig(command, broken)
        assert result.exit_code == 2
        assert "untill" in result.stderr
        assert "did you mean" in result.stderr
        assert "Traceback" not in result.output
    as_json = rig("check", broken, "--json")
    assert json.loads(as_json.stdout)["ok"] is False


def test_a_missing_port_is_an_error_and_never_a_simulation(tmp_path: Path) -> None:
    text = (ROOT / "config/demo.yaml").read_text(encoding="utf-8")
    config = tmp_path / "real.yaml"
    text = text.replace("port: emulated", "port: /dev/ttyNONE\n  adapter: none")
    config.write_text(text.replace("\ndrive:", "\ndrive:\n  bridge: pwm-dir"), encoding="utf-8")
    result = rig("run", config, "--out", tmp_path / "runs")
    assert result.exit_code == 1
    lines = result.stderr.splitlines()
    assert "LINK_OPEN" in lines[0]
    assert "daq.port" in lines[1]
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "content",
    ["", "a,b\n1,2\n", "t_s,u_V,y_rad\n", "t_s,u_V,y_rad\n0,1,nan\n0.01,1,0\n0.02,1,0\n", "\x00\x01\x02",
     "t_s,u_V,y_rad\n0,1,0\n0.01,1,0\n0.005,1,0\n0.02,1,0\n", "t_s,u_V,y_rad\n0,1,0\n0.01,1,0\n0.02,1,0\n"],
)  # fmt: skip
def test_identify_refuses_bad_csv_in_two_lines(tmp_path: Path, content: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(content, encoding="utf-8")
    result = rig("identify", path)
    assert result.exit_code in (1, 2), result.output
    assert "Traceback" not in result.output
    if result.exit_code == 2:
        assert len(result.stderr.splitlines()) == 2


def test_schema_is_the_one_in_config() -> None:
    result = rig("schema")
    assert json.loads(result.stdout) == json.loads((ROOT / "config/schema.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("of", ["meta", "result"])
def test_two_schemas_at_once_are_refused(tmp_path: Path, of: str) -> None:
    to = tmp_path / "schema.json"
    result = rig("schema", "--of", of, "--campaign", "--to", to)
    assert result.exit_code == 2 and result.stdout == "" and not to.exists()
    assert result.stderr == f"rig: --campaign and --of {of} name two schemas\n     leave one of them out\n"
    assert rig("schema", "--of", "campaign", "--campaign").stdout == rig("schema", "--campaign").stdout


def test_each_command_stands_in_the_file_of_its_name() -> None:
    for name in main.commands:
        assert (ROOT / f"rig/cli/{name.replace('-', '_')}.py").is_file()


def test_help_shows_every_command_in_a_group_with_one_whole_short_sentence() -> None:
    said = rig("--help").stdout
    titles = [
        "Try it, without hardware:",
        "Measure a motor:",
        "Use what was measured:",
        "A bench of your own:",
        "Evidence:",
    ]
    assert [line for line in said.splitlines() if line in titles] == titles
    shown = dict(line.split(maxsplit=1) for line in said[said.index(titles[0]) :].splitlines() if line.startswith("  "))
    assert shown.keys() == main.commands.keys()
    assert all(re.fullmatch(r"[A-Z][^.]*\.", sentence) for sentence in shown.values())


def test_help_of_every_command_fits_a_screen() -> None:
    for name in main.commands:
        result = rig(name, "--help")
        assert result.exit_code == 0
        assert max(map(len, result.stdout.splitlines())) <= 100


@pytest.mark.realtime
@pytest.mark.parametrize("after_s", [0.2, 0.8, *evidence(0.05, 0.4, 1.6)])
def test_ctrl_c_while_starting_is_no_traceback(tmp_path: Path, after_s: float) -> None:
    """Wherever in its start it is caught; what is asserted is what it prints, not when."""
    command = [sys.executable, "-c", "from rig.__main__ import run; run()"]
    process = subprocess.Popen(
        [*command, "run", str(ROOT / "config/demo.yaml"), "--out", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate()
    assert process.returncode != 0
    assert ", in run\n" not in error  # before `run` it is Python that is still starting
    assert "Aborted" not in error


def test_ctrl_c_while_the_words_of_a_command_are_read_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(click.Group, "parse_args", interrupted)
    result = rig("run", "any.yaml")
    assert result.exit_code == 1 and result.stderr == "rig: interrupted; no drive is on\n"


def test_a_ctrl_c_that_somebody_swallows_while_rig_loads_is_heeded_before_anything_moves() -> None:
    class Finalised:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGINT)  # Python drops an exception that is raised in here

    before = signal.getsignal(signal.SIGINT)
    dropped: list[object] = []
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        ctrl_c.begin()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "unraisablehook", lambda lost: dropped.append(lost.exc_type))
            Finalised()
        assert dropped == [KeyboardInterrupt]
        with pytest.raises(KeyboardInterrupt), stop_on_signals():
            pytest.fail("it goes on")
        assert isinstance(signal.getsignal(signal.SIGINT), ctrl_c.CtrlC)
    finally:
        signal.signal(signal.SIGINT, before)


def test_ctrl_c_outside_of_the_loop_says_that_nothing_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rig.running.preflight.check", interrupted)
    result = rig("check", ROOT / "config/demo.yaml")
    assert (result.exit_code, result.stderr) == (1, "rig: interrupted; no drive is on\n")


@pytest.mark.realtime
@pytest.mark.parametrize("name", ["demo.yaml", "modbus-tcp.yaml"])
def test_emulate_ends_where_its_device_does(name: str) -> None:
    command = [sys.executable, "-m", "rig", "emulate", str(ROOT / "config" / name)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert "emulated device on" in process.stdout.readline()
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="ascii").split()
    for child in children:
        os.kill(int(child), signal.SIGKILL)
    _, said = process.communicate()
    assert process.returncode == 1
    assert "the emulated device ended, exit status -9" in said
    assert "Traceback" not in said
