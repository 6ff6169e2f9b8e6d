"""kill -9 on a running `rig run`: the emulated device's drive goes to 0 by its own watchdog, and the record is whole.

In real time on the compiled firmware's core behind a pty. No absolute time of this machine is asserted: the bound on
the device's own trace is the watchdog time and the longest pause that the machine imposed on the device in this run.
The watchdog's exact bound is measured in virtual time (tests/hil/test_hil_safety.py).
"""

from __future__ import annotations

import csv
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner
from evidence import evidence
from processes import wait_until

from rig.cli import main
from rig.run_folder.recording.reader import read_run

ROOT = Path(__file__).resolve().parents[2]
RIG = [sys.executable, "-m", "rig"]


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGKILL, *evidence(signal.SIGTERM)])
def test_killed_in_the_middle_of_a_relay_test(tmp_path: Path, number: signal.Signals) -> None:
    link, trace, runs = tmp_path / "device", tmp_path / "trace.csv", tmp_path / "runs"
    config = yaml.safe_load((ROOT / "config/demo.yaml").read_text(encoding="utf-8"))
    config["daq"] |= {"port": str(link), "adapter": "none"}
    config["breakaway"] |= {"ramp_V_s": 0.8, "rest_s": 0.2}
    # so slow that there is room for a long watchdog: beside other tests the machine stands still for a while
    config["daq"]["watchdog_s"], config["limits"]["max_speed_rad_s"] = 0.2, 3.9
    config["relay"] = {"gains": [{"h1_V": 0.35, "h2_V": 0.75}], "cycles": 60}
    del config["tracking"]
    config["drive"]["bridge"] = "pwm-dir"  # nobody can tell by its name that nothing turns behind it
    path = tmp_path / "kill.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    device = subprocess.Popen([*RIG, "emulate", str(path), "--link", str(link), "--trace", str(trace)])
    loop: subprocess.Popen[bytes] | None = None
    try:
        wait_until(link.exists)
        loop = subprocess.Popen([*RIG, "run", str(path), "--out", str(runs)])

        def cycles() -> int:
            assert loop is not None and loop.poll() is None, "the run ended by itself: the captured stderr says why"
            events = list(runs.glob("*/events.jsonl"))
            return events[0].read_text().count('"cycle"') if events else 0

        wait_until(lambda: cycles() >= 8)
        os.kill(loop.pid, number)
        killed_s = time.monotonic()
        status = loop.wait()
        assert status == (-9 if number == signal.SIGKILL else 1)
        wait_until(lambda: time.monotonic() > killed_s + 1.0)
    finally:
        if loop is not None:
            loop.kill()
            loop.wait()
        device.send_signal(signal.SIGINT)
        device.wait()
    with trace.open() as file:
        rows = [(float(r["t_s"]), float(r["drive_V"]), float(r["y_rad"]), r["fault"]) for r in csv.DictReader(file)]
    driven = [t for t, volts, _, _ in rows if volts != 0.0]
    if number == signal.SIGKILL:
        longest_pause_s = max(b[0] - a[0] for a, b in itertools.pairwise(rows))
        assert driven[-1] - killed_s < config["daq"]["watchdog_s"] + 2.0 * longest_pause_s
        assert rows[-2][3] == "5"  # DEVICE_WATCHDOG; the last row is the device's own end
    assert rows[-1][1] == 0.0
    low, high = config["limits"]["hard_rad"]
    assert low < min(row[2] for row in rows)
    assert max(row[2] for row in rows) < high

    folder = next(runs.iterdir())
    recording = read_run(folder)
    ticks = recording.tick
    # every tick that the loop opened is there, in order, up to the last
    assert list(ticks) == sorted(set(ticks))
    assert float(recording.t_s[-1]) > 6.0
    ends = [json.loads(line)["kind"] for line in (folder / "events.jsonl").read_text().splitlines()]
    assert ("loop_died" in ends) == (number == signal.SIGKILL)
    identified = CliRunner().invoke(main, ["identify", str(folder), "--method", "sampled-data", "--json"])
    assert identified.exit_code == 0, identified.output
    estimate = json.loads(identified.stdout)["estimates"]["sampled-data"]
    assert estimate["tau_s"] == pytest.approx(config["emulated"]["motor"]["tau_s"], rel=0.05)


def test_too_few_cycles_are_said_to_be_too_few(tmp_path: Path) -> None:
    """A record cut off early: identify says how many cycles are missing, and gives no number as ok."""
    result = CliRunner().invoke(main, ["relay", str(ROOT / "config/simulated.yaml"), "--out", str(tmp_path), "--json"])
    folder = Path(json.loads(result.stdout)["folder"])
    lines = (folder / "samples.csv").read_text().splitlines(keepends=True)
    begin = next(k for k, line in enumerate(lines) if ",relay-1," in line)
    (folder / "samples.csv").write_text("".join(lines[: begin + 150]) + lines[begin + 150][:20])
    (folder / "result.json").unlink()
    cut = CliRunner().invoke(main, ["identify", str(folder), "--method", "triple-relay"])
    assert cut.exit_code in (1, 2)
    assert "cycle" in cut.output
