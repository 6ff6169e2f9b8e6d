"""Without what only Linux has: Windows and macOS as far as this machine can pretend. Neither has been tried."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

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
    simulated = shlex.quote(str(ROOT / "config/simulated.yaml"))
    statuses, _, errors = commands(tmp_path, "win32", f"run {simulated} --out first")
    assert statuses == [0], errors
    [run] = (tmp_path / "first").iterdir()
    assert ":" not in run.name
    assert {path.name for path in run.iterdir()} == {
        *("config.yaml", "meta.json", "samples.csv", "events.jsonl", "result.json", "report.html")
    }
    assert b"\r" not in (run / "samples.csv").read_bytes()
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    assert result["estimates"]["sampled-data"]["verdict"] == "ok"
    (run / "report.html").unlink()

    statuses, said, errors = commands(
        tmp_path, "win32",
        f"identify first/{run.name} --method sampled-data",
        f"report first/{run.name}",
        f"export first/{run.name} --to run.mat",
        "predict --tau 0.17 --K 6.5 --fc 0.5 --h1 0.8 --h2 1.0",
        f"check {simulated}",
        # what takes Linux says so
        f"run {shlex.quote(str(ROOT / 'config/demo.yaml'))}",
        f"run {shlex.quote(str(ROOT / 'config/uno.yaml'))}",
        f"campaign {shlex.quote(str(ROOT / 'config/campaign.yaml'))} --number 1",
    )  # fmt: skip
    assert statuses == [0, 0, 0, 0, 0, 1, 1, 2], errors
    assert (run / "report.html").stat().st_size > 100_000
    assert (tmp_path / "run.mat").stat().st_size > 10_000
    assert "sampled-data" in said
    assert "config/simulated.yaml: it runs everywhere" in errors
    assert "/dev/ttyACM0: serial ports work on Linux" in errors
    assert "run it on Linux" in errors


def test_on_macos_a_run_is_recorded(tmp_path: Path) -> None:
    simulated = shlex.quote(str(ROOT / "config/simulated.yaml"))
    statuses, said, errors = commands(tmp_path, "darwin", f"jog {simulated} --u-V 1.0")
    assert statuses == [0], errors
    assert "rad" in said


@pytest.mark.parametrize(("platform", "name"), [("win32", "Windows"), ("darwin", "macOS")])
def test_real_time_says_what_it_cannot_promise(platform: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from rig.loop.real_time import real_time

    monkeypatch.setattr(sys, "platform", platform)
    with real_time() as done:
        assert done.granted == []
    assert done.refused[0].startswith(f"{name} has not been tried in real time: no priority, no locked memory")
