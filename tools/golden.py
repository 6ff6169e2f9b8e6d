"""Golden recordings: a short run of every backend, with what `rig replay` and `rig identify` say of it.

    python tools/golden.py            records those that can be made anew to the byte (virtual time)
    python tools/golden.py NAME ...   records these; those in real time come out a little different each time

tests/golden/NAME is a run folder without its report, result and anything of this machine, and with golden.json: the
answers. They are made again only where a change of the format or of a law asks for it, and looked at before they go in.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rig import config
from rig.identification import IdentifyError, identify
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import json_text
from rig.run_folder.recording.reader import read_run
from rig.run_folder.results import JsonObject
from rig.running.experiment import script as experiment
from rig.running.replay import replay
from rig.running.session import Outcome

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "tests/golden"
ANSWERS = "golden.json"
KEPT = ("config.yaml", "events.jsonl", "meta.json", "samples.csv")
_OF_THIS_MACHINE = ("started_utc", "versions", "host", "command", "real_time")


def _jog(e: config.Experiment, parent: Path) -> Outcome:
    return experiment.jog(e, 1.5, 0.2, parent)


def _halted(e: config.Experiment, parent: Path) -> Outcome:
    """Halted twice for longer than a period, so that ticks are skipped."""
    halt = f"kill -STOP {os.getpid()}; sleep 0.03; kill -CONT {os.getpid()}"
    script = f"sleep 9; {halt}; sleep 3; {halt}"
    helpers: list[subprocess.Popen[bytes]] = []
    try:
        return experiment.run(e, parent, lambda folder, said: helpers.append(subprocess.Popen(["sh", "-c", script])))
    finally:
        for helper in helpers:
            helper.wait()


@dataclass(frozen=True)
class Golden:
    """One recording: its config as a file of config/ with dotted keys changed (None: left out), and how it is run."""

    base: str
    changes: dict[str, Any]
    run: Callable[[config.Experiment, Path], Outcome] = experiment.run
    is_virtual: bool = True


_TARGET: dict[str, Any] = {
    "relay.until": None,
    "relay.target": {"amplitude_rad": 0.5, "period_s": 1.0},
    "relay.cycles": 12,
}
_FIXED: dict[str, Any] = {
    **_TARGET,
    "relay.target": None,
    "relay.gains": [{"h1_V": 0.42, "h2_V": 0.84}],
    "relay.cycles": 6,
}
_SHORT: dict[str, Any] = {"tracking.duration_s": 2.5, "tracking.methods": ["sampled-data"]}
_CHIP: dict[str, Any] = {"daq.port": "emulated-chip", "limits.max_speed_rad_s": 4.6}

RUNS: dict[str, Golden] = {
    "simulated": Golden("simulated", {**_TARGET, "relay.cycles": 4, **_SHORT}),
    "simulated-hysteretic": Golden(
        "least-squares", {"relay.hysteretic": [{"d_V": 0.8, "eps_rad": 0.5}, {"d_V": 1.0, "eps_rad": 0.3}]}
    ),
    "simulated-jog": Golden("simulated", _TARGET, _jog),
    "simulated-fault": Golden("simulated", {**_FIXED, "limits.max_speed_rad_s": 1.5, "tracking": None}),
    "host-board": Golden("demo", {"daq.port": "emulated-realtime", **_FIXED, **_SHORT}, _halted, is_virtual=False),
    "chip": Golden("demo", {**_CHIP, **_FIXED, **_SHORT, "tracking.methods": ["triple-relay"]}),
    "chip-relay-in-device": Golden("device-relay", {**_CHIP, **_FIXED, "relay.cycles": 5, "tracking": None}),
    "modbus": Golden("modbus-rtu", {"daq.port": "emulated", **_FIXED, **_SHORT}),
    "modbus-separate": Golden(
        "modbus-rtu",
        {
            "daq.port": "emulated",
            "daq.modbus.requests": "separate",
            "daq.timeout_s": 0.0045,
            **_FIXED,
            "tracking": None,
        },
    ),
}


def experiment_of(golden: Golden) -> config.Experiment:
    """Its config, as a user could write it."""
    text = yaml.safe_load((ROOT / f"config/{golden.base}.yaml").read_text(encoding="utf-8"))
    for key, value in golden.changes.items():
        *path, last = key.split(".")
        section = text
        for name in path:
            section = section[name]
        if value is None:
            section.pop(last, None)
        else:
            section[last] = value
    with tempfile.TemporaryDirectory() as folder:
        path_of_config = Path(folder) / "golden.yaml"
        path_of_config.write_text(yaml.safe_dump(text), encoding="utf-8")
        return config.load(path_of_config)


def answers(folder: Path) -> dict[str, Any]:
    """What `rig replay` and `rig identify` say of a run folder: estimates, or why there are none."""
    said = replay(folder).as_json()
    said.pop("folder")
    try:
        found = identify([read_run(folder)])
        estimates: JsonObject = {method: estimate.as_result().as_json() for method, estimate in found.estimates.items()}
        refused = None
    except (IdentifyError, RecordingError) as error:
        estimates, refused = {}, error.cause
    return {"replay": said, "estimates": estimates, "not_identified": refused}


def record(name: str, into: Path) -> Path:
    """Record one into ``into``/name, in place of what is there. Raises Fault where the bench cannot be opened."""
    golden = RUNS[name]
    with tempfile.TemporaryDirectory() as parent:
        outcome = golden.run(experiment_of(golden), Path(parent))
        folder = into / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for file in KEPT:
            shutil.copyfile(outcome.folder / file, folder / file)
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    kept = {key: value for key, value in meta.items() if key not in _OF_THIS_MACHINE}
    (folder / "meta.json").write_text(json_text(kept), encoding="utf-8")
    (folder / ANSWERS).write_text(json_text(answers(folder)), encoding="utf-8")
    return folder


def departures(stored: dict[str, Any], said: dict[str, Any]) -> list[str]:
    """How the answers of now differ from the stored ones, better or worse; [] where they do not.

    The replay must be the same to the last word. Of an estimate: verdict and rows, each parameter within a tenth of
    its stored interval's half width (rms and intervals within 3 and 10 %, either way).
    """
    found = [f"replay: {name}" for name, value in stored["replay"].items() if said["replay"].get(name) != value]
    if said["not_identified"] != stored["not_identified"]:
        found.append("not_identified")
    if said["estimates"].keys() != stored["estimates"].keys():
        return [*found, "other estimates"]
    for method, then in stored["estimates"].items():
        now = said["estimates"][method]
        found += [f"{method}: {name}" for name in ("verdict", "rows") if now[name] != then[name]]
        if not _is_within(now["rms_rad"], then["rms_rad"], 0.03):
            found.append(f"{method}: rms_rad")
        if now["ci95"].keys() != then["ci95"].keys():
            found.append(f"{method}: other intervals")
            continue
        for name, (low, high) in then["ci95"].items():
            half = 0.5 * (high - low)
            if not abs(now[name] - then[name]) <= 0.1 * half:
                found.append(f"{method}: {name}")
            if not _is_within(0.5 * (now["ci95"][name][1] - now["ci95"][name][0]), half, 0.1):
                found.append(f"{method}: interval of {name}")
    return found


def _is_within(now: float, then: float, share: float) -> bool:
    """Whether ``now`` is ``then`` up to a share of it."""
    return abs(now - then) <= share * abs(then)


def main(names: list[str]) -> int:
    """Record those named, or all that live in virtual time."""
    unknown = [name for name in names if name not in RUNS]
    if unknown:
        print(f"no golden recording {', '.join(unknown)}; there are: {', '.join(RUNS)}", file=sys.stderr)
        return 2
    for name in names or [name for name, golden in RUNS.items() if golden.is_virtual]:
        folder = record(name, GOLDEN)
        said = json.loads((folder / ANSWERS).read_text(encoding="utf-8"))
        size_kB = sum(file.stat().st_size for file in folder.iterdir()) / 1000.0
        verdicts = ", ".join(f"{method} {e['verdict']}" for method, e in said["estimates"].items())
        same = "same drive" if said["replay"]["ok"] else f"DIFFERENT: {said['replay']['difference']}"
        print(f"{name}: {said['replay']['rows']} rows, {size_kB:.0f} kB, {same}; {verdicts or said['not_identified']}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
