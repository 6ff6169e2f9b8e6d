"""`rig jog --leased`, as a panel uses it: in real time, and paced, on the emulated board, and its record replayed."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from evidence import evidence

from rig.cli import main
from rig.run_folder.live.lease import NAME, Leaser
from rig.run_folder.live.running import running
from rig.run_folder.live.view import LiveView, Snapshot
from rig.running.replay import replay

ROOT = Path(__file__).resolve().parents[2]


def await_(view: LiveView, what: Callable[[Snapshot], bool], process: subprocess.Popen[str]) -> Snapshot:
    while not what(seen := view.read()):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    return seen


@pytest.mark.realtime
@pytest.mark.parametrize("port", ["emulated-realtime", *evidence("emulated")])
def test_a_jog_drives_while_it_is_renewed_and_stands_when_the_one_who_jogs_is_gone(tmp_path: Path, port: str) -> None:
    config = tmp_path / "bench.yaml"
    text = (ROOT / "config/demo.yaml").read_text(encoding="utf-8")
    config.write_text(text.replace("port: emulated ", f"port: {port} "), encoding="utf-8")
    command = [sys.executable, "-m", "rig", "jog", str(config), "--leased", "--pace", "1", "--out", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while not (found := list(tmp_path.glob(f"*/{NAME}"))):
            assert process.poll() is None, process.communicate()
            time.sleep(0.01)
        folder = found[0].parent
        assert [(one.folder, one.runner.pid) for one in running(tmp_path)] == [(folder, process.pid)]
        view, leaser = LiveView(folder), Leaser(folder)
        await_(view, lambda seen: seen.numbers["stage"] == "jog" and bool(seen.rows), process)
        for _ in range(6):
            last = leaser.drive(0.6)
            time.sleep(0.05)
        # no more renewed: as from a panel that was killed, frozen or cut off
        seen = await_(view, lambda seen: seen.rows[-1].u_V == 0.0 and any(row.u_V for row in seen.rows), process)
        assert seen.runner is not None and seen.numbers["command"] == "jog"
        driven_s = max(row.t_s for row in seen.rows if row.u_V != 0.0)
        assert (port == "emulated") == math.isnan(seen.runner.zero_s)
        assert math.isnan(seen.runner.zero_s) or driven_s + seen.runner.zero_s <= 1e-9 * last.expires_ns
        leaser.drive(-0.6)
        await_(view, lambda seen: seen.rows[-1].u_V < 0.0, process)
        leaser.end()
        printed, said = process.communicate()
        leaser.close()
    assert process.returncode == 0, said
    assert "rad" in printed and not (folder / NAME).exists()
    assert (view.read().state, view.read().numbers["drive_is_off"]) == ("ended", True)
    again = replay(folder)
    assert again.is_same and again.replayed == again.rows == len(view.read().rows)


@pytest.mark.parametrize(
    ("config", "given", "words"),
    [
        ("quick.yaml", ["--leased"], "a lease runs out in real time"),
        ("demo.yaml", ["--leased"], "--pace 1"),
        ("quick.yaml", ["--leased", "--u-V", "0.5"], "either --u-V or --leased"),
        ("quick.yaml", [], "either --u-V or --leased"),
        ("quick.yaml", ["--u-V", "0.5", "--seconds", "6"], "--seconds 6 is too long"),
    ],
)
def test_a_jog_that_makes_no_sense_is_refused_in_words(
    tmp_path: Path, config: str, given: list[str], words: str
) -> None:
    result = CliRunner().invoke(main, ["jog", str(ROOT / "config" / config), *given, "--out", str(tmp_path)])
    assert result.exit_code in (1, 2) and words in result.stderr
