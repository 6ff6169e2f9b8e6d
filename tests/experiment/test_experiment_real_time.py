"""Whole runs on the clock: in real time beside a witness, and paced while the whole machine stands still.

In real time a machine that stands still for longer than the device's watchdog ends a run, as it must. Whether it did,
the witness says (tools/shared/witness.py). Where it did not, a fault is a failure of rig.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from evidence import evidence
from processes import PLAIN_RIG
from short_runs import finds_the_truth, short, written

import whole

ROOT = Path(__file__).resolve().parents[2]
GAINS = [{"h1_V": 0.43, "h2_V": 0.80}]  # such as its own search finds
TRIES = 4
STOPPED_S = (0.04, 0.08, 0.15, 1.0)

pytestmark = [pytest.mark.realtime, pytest.mark.long]


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that end with their result: to look for laws and to draw takes longer than the run."""
    monkeypatch.setattr(whole, "PROGRAM", ("-c", PLAIN_RIG))


def shorter(config: dict[str, Any]) -> dict[str, Any]:
    """Each second is a second here."""
    return short(config, GAINS, cycles=3, tracking_s=2.0)


@pytest.mark.alone
@pytest.mark.parametrize(
    ("name", "is_short"), [("demo", True), *evidence(("modbus-tcp", True), ("modbus-rtu", True), ("demo", False))]
)
def test_a_run_beside_a_quiet_witness_ends_whole(
    name: str, is_short: bool, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Whatever came has to be right in every run; how many there were is in the test's report."""
    config = yaml.safe_load((ROOT / f"config/{name}.yaml").read_text(encoding="utf-8"))
    if is_short:
        shorter(config)
    config["loop"] = {"raise_workers": True}  # of the kernel, that carry a pseudo-terminal's bytes
    watchdog_s = config["daq"]["watchdog_s"]
    path = whole.in_real_time(written(config, tmp_path), tmp_path)
    stood: list[str] = []
    while len(stood) < TRIES:
        run, stood_s = whole.beside_a_witness(path, tmp_path / "runs", pty=name != "modbus-tcp")
        assert run.time == {"kind": "real"}
        assert run.outcome["link"].get("bad_replies", 0) == 0
        if not run.code:
            finds_the_truth(run.outcome)
            break
        assert stood_s > watchdog_s, f"{run.why}, and the machine stood still for {stood_s:.3f} s at most"
        stood.append(f"{run.code}: the witness saw {stood_s:.3f} s")
    record_property("the machine stood still", stood)
    if len(stood) == TRIES:
        pytest.skip(f"this machine stood still in each of {TRIES} runs, so no whole one was seen: {'; '.join(stood)}")


@pytest.mark.parametrize("name", ["demo", *evidence("modbus-rtu", "simulated")])
def test_a_paced_run_does_not_mind_that_all_its_processes_are_stopped(name: str, tmp_path: Path) -> None:
    """And records what it records anyway."""
    config = shorter(yaml.safe_load((ROOT / f"config/{name}.yaml").read_text(encoding="utf-8")))
    path = written(config, tmp_path)
    undisturbed = whole.end(whole.start(path, tmp_path / "runs"))
    stopped = whole.start(path, tmp_path / "runs", "--pace", "2")
    with whole.stopped_now_and_then(stopped, STOPPED_S) as stops:
        run = whole.end(stopped)
    assert run.why == undisturbed.why == ""
    assert run.recorded == undisturbed.recorded
    assert len(stops) >= len(STOPPED_S)
    assert run.time["stalls"] > 0 and run.time["longest_stall_s"] > 0.1
