"""Without what only Linux has: Windows and macOS as far as this machine can pretend. Neither has been tried."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def commands(tmp_path: Path, platform: str, *lines: str) -> tuple[list[int], str, str]:
    """What these commands exit with and say, in one process of that platform: statuses, stdout, stderr."""
    python = tmp_path / "python"
    script = shlex.join([sys.executable, str(HERE / "other_platform.py"), platform])
    python.write_text(f'#!/bin/sh\nexec {script} "$@"\n', encoding="utf-8")
    python.chmod(0o755)
    path = os.pathsep.join(map(str, (ROOT, HERE)))
    done = subprocess.run(
        [python, "-m", "commands", *lines], cwd=tmp_path, capture_output=True, text=True, check=False, encoding="utf-8",
        env={**os.environ, "PYTHONPATH": path, "PRETENDED_PYTHON": str(python), "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    said, _, last = done.stdout.rstrip("\n").rpartition("\n")
    ended = json.loads(last)
    assert ended["start"] == ("spawn" if platform == "win32" else "fork")
    return ended["statuses"], said, done.stderr


def test_on_windows_all_but_the_devices_of_linux(tmp_path: Path) -> None:
    config = {name: shlex.quote(str(ROOT / f"config/{name}.yaml")) for name in ("demo", "uno", "campaign")}
    short = yaml.safe_load((ROOT / "config/simulated.yaml").read_text(encoding="utf-8"))
    short |= {"relay": {"gains": [{"h1_V": 0.45, "h2_V": 0.9}], "cycles": 5}, "tracking": None}
    (tmp_path / "simulated.yaml").write_text(yaml.safe_dump(short), encoding="utf-8")
    statuses, said, errors = commands(
        tmp_path, "win32",
        "run simulated.yaml",
        "identify runs/* --method triple-relay",
        "report runs/*",
        "export runs/* --to run.mat",
        "predict --tau 0.17 --K 6.5 --fc 0.5 --h1 0.8 --h2 1.0",
        "check simulated.yaml",
        # what takes Linux says so
        f"run {config['demo']} --out none",
        f"run {config['uno']} --out none",
        f"campaign {config['campaign']} --number 1",
    )  # fmt: skip
    assert statuses == [0, 0, 0, 0, 0, 0, 1, 1, 2], errors
    [run] = (tmp_path / "runs").iterdir()
    assert run.name.endswith("Z-run-simulated")
    assert {path.name for path in run.iterdir()} == {
        *("config.yaml", "meta.json", "samples.csv", "events.jsonl", "result.json", "report.html", "curves.json")
    }
    assert not any(":" in path.name for path in tmp_path.rglob("*"))
    assert b"\r" not in (run / "samples.csv").read_bytes()
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    assert result["estimates"]["sampled-data"]["tau_s"] == pytest.approx(0.17, rel=0.02)
    assert not result["faults"]
    assert (tmp_path / "run.mat").stat().st_size > 10_000
    assert str(Path("runs") / run.name / "report.html") in said.splitlines()
    assert "s  relay-1" in errors  # the stages, from a process of its own
    assert "config/simulated.yaml: it runs everywhere" in errors
    assert "on Windows a device on Modbus TCP, or daq.driver: simulated" in errors
    assert "run it on Linux" in errors


def test_on_macos_a_run_is_recorded(tmp_path: Path) -> None:
    simulated = shlex.quote(str(ROOT / "config/quick.yaml"))
    statuses, said, errors = commands(tmp_path, "darwin", f"jog {simulated} --u-V 1.0")
    assert statuses == [0], errors
    assert "rad" in said


@pytest.mark.parametrize(("platform", "name"), [("win32", "Windows"), ("darwin", "macOS")])
def test_real_time_says_what_it_cannot_promise(platform: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from rig.control.loop.real_time import real_time

    monkeypatch.setattr(sys, "platform", platform)
    with real_time() as done:
        assert done.granted == []
    assert done.refused[0].startswith(f"{name} has not been tried in real time: no priority, no locked memory")


@pytest.mark.parametrize("encoding", ["ascii", "cp437", "cp1252", "utf-8"])
def test_a_letter_that_a_pipe_has_no_code_for_is_no_traceback(encoding: str) -> None:
    program = "from rig.__main__ import never_stop_at_a_letter as n; n(); print('0.17 \u00b10.01 \u2713')"
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True, cwd=ROOT, env=environment)
    assert done.stdout.decode(encoding).strip().startswith("0.17 ")
    assert (b"?" in done.stdout) == (encoding != "utf-8")
