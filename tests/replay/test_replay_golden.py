"""Golden recordings of every backend: the same drive tick for tick, the same estimates within two-sided thresholds."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evidence import evidence

import golden
from rig.core.signals import FLAG_SKIPPED
from rig.run_folder.recording.reader import read_run

pytestmark = pytest.mark.laws


def stored(name: str) -> dict[str, Any]:
    answers: dict[str, Any] = json.loads((golden.GOLDEN / name / golden.ANSWERS).read_text(encoding="utf-8"))
    return answers


STAY = ("simulated", "simulated-fault", "host-board", "chip-relay-in-device", "modbus")  # one of each kind of device


@pytest.mark.parametrize("name", [*STAY, *evidence(*(name for name in golden.RUNS if name not in STAY))])
def test_a_golden_recording_replays_and_identifies_as_it_did(name: str) -> None:
    said = golden.answers(golden.GOLDEN / name)
    assert said["replay"]["ok"] and said["replay"]["compared"] == said["replay"]["rows"]
    assert golden.departures(stored(name), json.loads(json.dumps(said))) == []


def test_the_golden_recordings_are_of_every_backend_and_small() -> None:
    meta = {name: json.loads((golden.GOLDEN / name / "meta.json").read_text(encoding="utf-8")) for name in golden.RUNS}
    assert set(meta) == {folder.name for folder in golden.GOLDEN.iterdir()}
    assert {m["firmware"]["board"] for m in meta.values()} == {"simulated", "host", "uno", "rig emulated I/O block"}
    assert {m["order"] for m in meta.values()} == {"sample_first", "write_first"}
    assert sum(file.stat().st_size for file in golden.GOLDEN.rglob("*")) < 3_000_000


def test_they_hold_what_makes_a_replay_hard() -> None:
    runs = {name: read_run(golden.GOLDEN / name) for name in golden.RUNS}
    stages = {stage for run in runs.values() for stage in run.stages()}
    assert stages >= {"rest", "jog", "breakaway", "search", "relay-1", "relay-2", "homing", "hysteretic-1"}
    assert stages >= {"track:sampled-data", "track:triple-relay"}
    in_device = np.isnan(runs["chip-relay-in-device"].late_us)
    assert 1000 < np.count_nonzero(in_device) < len(in_device)
    real_time = runs["host-board"]
    assert np.count_nonzero(real_time.flags & FLAG_SKIPPED) > 0  # ticks that the loop was too late for
    assert len(np.unique(np.diff(real_time.t_s))) > 100  # as far apart as a real machine has them


@pytest.mark.usefixtures("plain_motor")
def test_a_simulated_run_comes_out_the_same_to_the_byte(tmp_path: Path) -> None:
    name = "simulated-fault"
    anew = golden.record(name, tmp_path)
    for file in ("config.yaml", "events.jsonl", "samples.csv"):
        assert (anew / file).read_bytes() == (golden.GOLDEN / name / file).read_bytes()


@pytest.mark.parametrize(
    ("path", "factor", "complaint"),
    [
        (("estimates", "sampled-data", "rms_rad"), 1.05, "sampled-data: rms_rad"),
        (("estimates", "sampled-data", "rms_rad"), 0.95, "sampled-data: rms_rad"),
        (("estimates", "sampled-data", "tau_s"), 1.02, "sampled-data: tau_s"),
        (("estimates", "sampled-data", "tau_s"), 0.98, "sampled-data: tau_s"),
        (("estimates", "triple-relay", "fc_V"), 1.02, "triple-relay: fc_V"),
        (("estimates", "triple-relay", "fc_V"), 0.98, "triple-relay: fc_V"),
    ],
)
def test_better_and_worse_both_depart(path: tuple[str, ...], factor: float, complaint: str) -> None:
    then = stored("chip")
    assert golden.departures(then, then) == []
    now = copy.deepcopy(then)
    section = now
    for name in path[:-1]:
        section = section[name]
    section[path[-1]] *= factor
    assert golden.departures(then, now) == [complaint]


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_intervals_must_neither_shrink_nor_grow(factor: float) -> None:
    then = stored("chip")
    now = copy.deepcopy(then)
    estimate = now["estimates"]["sampled-data"]
    low, high = estimate["ci95"]["K_rad_s_V"]
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * factor
    estimate["ci95"]["K_rad_s_V"] = [middle - half, middle + half]
    assert golden.departures(then, now) == ["sampled-data: interval of K_rad_s_V"]


def test_verdicts_methods_and_the_replay_must_be_the_same() -> None:
    then = stored("chip")
    now = copy.deepcopy(then)
    now["estimates"]["sampled-data"]["verdict"] = "refused"
    now["replay"]["lost"] = 1
    assert golden.departures(then, now) == ["replay: lost", "sampled-data: verdict"]
    del now["estimates"]["triple-relay"]
    assert "other estimates" in golden.departures(then, now)
