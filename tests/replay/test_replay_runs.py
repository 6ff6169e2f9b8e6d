"""Runs that end early, each replayed to the end that it had; and the command."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import rig
from run_copy import GOLDEN, RunCopy

from rig import config
from rig.backends.simulated.driver import SimulatedDriver
from rig.config import Experiment
from rig.core.faults import Fault
from rig.core.signals import FLAG_GUARD_BRAKED, FLAG_GUARD_CLIPPED, Sample
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.reader import read_run
from rig.running.experiment import script as experiment
from rig.running.replay import replay

ROOT = Path(__file__).resolve().parents[2]


def short(**relay: object) -> Experiment:
    """config/quick.yaml with given gains and without tracking."""
    e = config.load(ROOT / "config/quick.yaml")
    gains = {"target": None, "gains": [{"h1_V": 0.42, "h2_V": 0.84}], "cycles": 3} | relay
    return Experiment.model_validate_json(json.dumps(e.model_dump(mode="json") | {"relay": gains, "tracking": None}))


def failing(monkeypatch: pytest.MonkeyPatch, method: str, call: int, error: Exception) -> None:
    """From its nth call on, a method of the simulated driver fails."""
    original, calls = getattr(SimulatedDriver, method), [0]

    def fails(self: SimulatedDriver, *arguments: object) -> object:
        calls[0] += 1
        if calls[0] >= call:
            raise error
        return original(self, *arguments)

    monkeypatch.setattr(SimulatedDriver, method, fails)


@pytest.mark.parametrize("method", ["read", "write"])
@pytest.mark.parametrize("call", [40, 480])  # at rest and in the relay test
def test_a_link_that_fails(method: str, call: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failing(monkeypatch, method, call, Fault("LINK_LOST", "the cable is out"))
    outcome = experiment.run_relay(short(), tmp_path)
    done = replay(outcome.folder)
    assert done.is_same and done.ending == "a fault" and done.fault is not None
    assert str(done.fault) == str(outcome.fault) and done.replayed == done.rows


def test_a_program_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failing(monkeypatch, "write", 480, ValueError("a defect"))
    outcome = experiment.run_relay(short(), tmp_path)
    assert outcome.fault is not None and outcome.fault.code == "INTERNAL"
    done = replay(outcome.folder)
    assert done.is_same and done.fault is not None and done.fault.code == "INTERNAL"


def test_a_run_that_is_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original, calls = SimulatedDriver.read, [0]

    def read(self: SimulatedDriver) -> Sample:
        calls[0] += 1
        if calls[0] == 300:
            signal.raise_signal(signal.SIGINT)
        return original(self)

    monkeypatch.setattr(SimulatedDriver, "read", read)
    outcome = experiment.run_relay(short(), tmp_path)
    assert outcome.fault is not None and outcome.fault.code == "INTERRUPTED"
    done = replay(outcome.folder)
    assert done.is_same and done.replayed == done.rows and str(done.fault) == str(outcome.fault)


def test_a_guard_that_brakes_and_a_cycle_that_never_settles(tmp_path: Path) -> None:
    gains = [{"h1_V": 0.3, "h2_V": 2.2}]
    outcome = experiment.run_relay(short(gains=gains, cycles=3), tmp_path)
    flags = read_run(outcome.folder).flags
    assert np.count_nonzero(flags & FLAG_GUARD_BRAKED) > 0
    done = replay(outcome.folder)
    assert done.is_same and done.compared == len(flags) and str(done.fault) == str(outcome.fault)


def test_a_jog_from_outside_the_limits(tmp_path: Path) -> None:
    e = config.load(ROOT / "config/quick.yaml")
    emulated = e.model_dump(mode="json")
    emulated["emulated"]["motor"]["start_rad"] = 1.5
    e = Experiment.model_validate_json(json.dumps(emulated))
    for u_V, refused in ((1.0, True), (-1.0, False)):
        outcome = experiment.jog(e, u_V, 0.2, tmp_path)
        assert bool(np.any(read_run(outcome.folder).flags & FLAG_GUARD_CLIPPED)) is refused
        done = replay(outcome.folder)
        assert done.is_same and done.fault is None


def test_a_start_outside_the_limits(tmp_path: Path) -> None:
    e = short().model_dump(mode="json")
    e["emulated"]["motor"]["start_rad"] = 1.5
    outcome = experiment.run_relay(Experiment.model_validate_json(json.dumps(e)), tmp_path)
    done = replay(outcome.folder)
    assert done.is_same and done.fault is not None and done.fault.code == "START_OUTSIDE"


# ---------------------------------------------------------------------- the command


def test_the_command_says_the_same() -> None:
    result = rig("replay", GOLDEN / "chip")
    assert result.exit_code == 0
    assert result.stdout.startswith("the same drive in ") and "to its end" in result.stdout
    said = json.loads(rig("replay", GOLDEN / "simulated-fault", "--json").stdout)
    assert said["ok"] and said["ending"] == "a fault" and said["fault"]["code"] == "OVERSPEED"


def test_the_command_names_the_difference(tmp_path: Path) -> None:
    run = RunCopy(GOLDEN / "chip", tmp_path / "run")
    k = run.number_of("relay-1", 50)
    run.rows[k]["u_V"] = "0.0"
    result = rig("replay", run.write())
    assert result.exit_code == 1
    assert f"tick {run.tick(k)}, " in result.stdout and f"line {k + 2})" in result.stdout
    assert "decided by the law" in result.stdout
    result = rig("replay", run.folder, "--json")
    said = json.loads(result.stdout)
    assert result.exit_code == 1 and not said["ok"] and said["replayed"] == k
    assert said["difference"]["tick"] == run.tick(k) and said["difference"]["recorded_V"] == 0.0


@pytest.mark.parametrize("field", ["script", "drive_units", "order", "firmware"])
def test_an_older_run_is_refused_in_words(field: str, tmp_path: Path) -> None:
    run = RunCopy(GOLDEN / "simulated-jog", tmp_path / "run")
    del run.meta[field]
    result = rig("replay", run.write())
    assert result.exit_code == 2
    assert f"does not say {field}: an older version recorded this run" in result.stderr


def test_what_is_no_run_of_ours_is_bad_input(tmp_path: Path) -> None:
    assert rig("replay", tmp_path / "nowhere").exit_code == 2
    run = RunCopy(GOLDEN / "simulated-jog", tmp_path / "run")
    run.write()
    for name in ("meta.json", "events.jsonl"):
        kept = (run.folder / name).read_bytes()
        (run.folder / name).unlink()
        with pytest.raises(RecordingError, match="is missing"):
            replay(run.folder)
        (run.folder / name).write_bytes(kept)
    (run.folder / "config.yaml").write_text("name: [", encoding="utf-8")
    assert rig("replay", run.folder).exit_code == 2
    (run.folder / "config.yaml").unlink()
    with pytest.raises(RecordingError, match="without its config"):
        replay(run.folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"meta": ("script", {"name": "dance"})}, "does not know the script 'dance'"),
        ({"meta": ("script", {"name": "jog"})}, "script"),
        ({"meta": ("script", 7)}, "no script"),
        ({"meta": ("drive_units", "many")}, "drive_units"),
        ({"meta": ("drive_units", -3)}, "drive_units"),
        ({"meta": ("firmware", {"clock_ratio": 0})}, "clock_ratio"),
        ({"meta": ("order", "at_random")}, "order"),
        ({"event": {"t_s": 0.1, "kind": "model", "method": "sampled-data", "tau_s": "x"}}, "event model is broken"),
        ({"event": {"t_s": 0.1, "kind": "fault", "code": "NEVER_HEARD_OF"}}, "does not know the fault"),
    ],
)
def test_a_broken_run_is_bad_input_in_words(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    run = RunCopy(GOLDEN / "simulated-jog", tmp_path / "run")
    if "meta" in change:
        key, value = change["meta"]
        run.meta[key] = value
    else:
        run.events.append(change["event"])
    result = rig("replay", run.write())
    assert result.exit_code == 2, result.output
    assert words in result.stderr


@pytest.mark.parametrize("law", [None, "balanced pairs", "of another version"])
def test_a_run_whose_breakaway_law_is_no_more_says_which_commit_replays_it(law: str | None, tmp_path: Path) -> None:
    run = RunCopy(GOLDEN / "simulated", tmp_path / "old")
    del run.meta["script"]["breakaway"]
    if law is not None:
        run.meta["script"]["breakaway"] = law
    result = rig("replay", run.write())
    assert result.exit_code == 2
    assert f"its breakaway check is that of an older version: {law or 'ramps one way'}" in result.stderr
    assert "git checkout 599afeb2" in result.stderr


def test_a_run_whose_search_tried_the_first_gains_alone_says_which_commit_replays_it(tmp_path: Path) -> None:
    run = RunCopy(GOLDEN / "simulated", tmp_path / "old")
    del run.meta["script"]["search"]
    result = rig("replay", run.write())
    assert result.exit_code == 2
    assert "its gain search is that of an older version" in result.stderr and "git checkout 0d61cc00" in result.stderr


def test_a_run_of_now_says_which_breakaway_law_ran(tmp_path: Path) -> None:
    outcome = experiment.run_breakaway(short(), tmp_path)
    run = RunCopy(outcome.folder, tmp_path / "copy")
    assert run.meta["script"] == {"name": "breakaway", "breakaway": "balanced pairs, in the device's steps"}
    assert replay(outcome.folder).is_same
