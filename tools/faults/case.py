"""One case: a row of the matrix, on one device, at one phase of the limit cycle."""

from __future__ import annotations

import csv
import json
import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import yaml
from click.testing import CliRunner

import rig.bench
from faults.backends import BACKENDS, Backend
from faults.bounds import Times
from faults.rows import Row
from faults.stand import Stand
from rig import experiment as script
from rig.cli import main
from rig.config import check
from rig.config.schema import Experiment

FIRST_CYCLE = 4  # the fault comes in the one after it: the amplitude is that of the limit cycle by then
SETTLE_S = 1.5  # after the run: the watchdog acts, the shaft stops
START_RAD = 0.5  # farthest from the centre that a run starts at where there is no cycle yet


@dataclass(frozen=True)
class Found:
    """What came of a case.

    off_s      from the fault until the drive was at 0 for good, or was the host's again where the run goes on
    bound_s    that it must be within
    beyond_rad farthest of the shaft beyond a hard limit
    code       of the fault that the run shows; empty: none
    status     exit status
    stage      that the run was in when it ended
    lost       samples that the device has told of and the record has not
    restart    what the next run does, in words; empty where it was not tried
    trouble    what should not be; empty where all is well
    """

    row: str
    backend: str
    phase: float
    off_s: float
    bound_s: float
    beyond_rad: float
    code: str
    status: int
    stage: str
    lost: int
    restart: str = ""
    trouble: tuple[str, ...] = ()


@dataclass
class Run:
    """A finished run: how it ended, and its record."""

    status: int
    output: str
    folder: Path
    rows: list[dict[str, str]]
    events: list[dict[str, Any]]

    @property
    def fault(self) -> dict[str, Any] | None:
        """The event of the fault that ended it, if one did."""
        return next((event for event in self.events if event["kind"] == "fault"), None)

    @property
    def stages(self) -> list[str]:
        """That it came to."""
        return [str(event["name"]) for event in self.events if event["kind"] == "stage"]


@contextmanager
def patched(stand: Stand, backend: Backend) -> Iterator[None]:
    """rig connects to the stand instead of a new device; no figures are drawn."""
    with (
        patch.object(rig.bench, backend.place, lambda experiment: stand),
        patch.object(script, "write_report", lambda *_: None),
    ):
        yield


def write(folder: Path, config: dict[str, Any]) -> Path:
    """The config as a file."""
    path = folder / "fault.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


def new_stand(backend: Backend, experiment: Experiment, seed: int = 1) -> Stand:
    """The device, powered on."""
    return Stand(
        backend.device(experiment),
        backend.language(experiment),
        experiment.limits.hard_rad,
        experiment.daq.timeout_s,
        seed,
    )


def relay_run(stand: Stand, backend: Backend, folder: Path) -> tuple[int, str]:
    """`rig relay`: exit status and what it says."""
    with patched(stand, backend):
        result = CliRunner().invoke(main, ["relay", str(folder / "fault.yaml"), "--out", str(folder / "runs")])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def finished(folder: Path, status: int, output: str) -> Run:
    """The run below ``folder / "runs"``."""
    run_folder = next((folder / "runs").iterdir())
    with (run_folder / "samples.csv").open(encoding="ascii") as file:
        rows = list(csv.DictReader(file))
    events = [json.loads(line) for line in (run_folder / "events.jsonl").read_text(encoding="ascii").splitlines()]
    return Run(status, output, run_folder, rows, events)


@lru_cache
def cycle(backend: Backend) -> tuple[float, float]:
    """Device time at which the cycle after FIRST_CYCLE begins where nothing goes wrong, and its length, s."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        experiment = check(write(folder, backend.config()))[0]
        stand = new_stand(backend, experiment)
        run = finished(folder, *relay_run(stand, backend, folder))
        if run.status:
            raise RuntimeError(f"{backend.key}: the run fails without a fault: {run.output}")
        asked_s = dict(stand.read_at)
        row = run.rows[len(run.rows) // 2]
        offset_s = asked_s[int(row["seq"])] - float(row["t_s"])
        ends = [float(e["t_s"]) for e in run.events if e["kind"] == "cycle"]
        return ends[FIRST_CYCLE - 1] + offset_s, ends[FIRST_CYCLE] - ends[FIRST_CYCLE - 1]


def measure(row: Row, backend: Backend, phase: float, restarts: bool = False) -> Found:
    """Run it. ``phase`` 0 to 1 of the limit cycle."""
    start_s, length_s = cycle(backend)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = backend.config()
        if row.early:
            config["emulated"]["motor"]["start_rad"] = START_RAD * (2.0 * phase - 1.0)
        experiment = check(write(folder, config))[0]
        stand = new_stand(backend, experiment)
        stand.schedule(0.0 if row.early else start_s + phase * length_s, row.act)
        times = backend.times(experiment, length_s)
        status, output = relay_run(stand, backend, folder)
        stand.watch(SETTLE_S)
        found = judged(row, backend, phase, stand, times, finished(folder, status, output))
        if restarts:
            found = _restarted(found, row, backend, stand, experiment, folder)
        return found


def judged(row: Row, backend: Backend, phase: float, stand: Stand, times: Times, run: Run) -> Found:
    """What was measured, and what of it should not be."""
    truth = stand.device.truth()
    code = "" if run.fault is None else str(run.fault["code"])
    if code == "" and run.status == 0:
        off_s = stand.astray_s
    else:
        began_s = stand.first_drive_s if row.early else stand.fault_s
        off_s = max(truth.pin_changed_s - began_s, 0.0) if truth.pin_V == 0.0 else math.inf
        off_s = 0.0 if math.isnan(off_s) else off_s  # it never drove
    found = Found(
        row.name,
        backend.key,
        phase,
        off_s,
        row.bound.seconds(times),
        stand.beyond_rad,
        code,
        run.status,
        run.stages[-1] if run.stages else "before the first",
        len(missing(stand, run)),
    )
    trouble = []
    if not off_s <= found.bound_s:
        trouble.append(f"drive on for {1e3 * off_s:.2f} ms, bound {1e3 * found.bound_s:.2f} ms")
    if code not in row.codes:
        trouble.append(f"shows {code or 'no fault'} ({'' if run.fault is None else run.fault['detail']})")
    if (found.status != 0) != bool(code):
        trouble.append(f"exit status {found.status} with {code or 'no fault'}: {run.output[-300:]}")
    if row.early and any(stage.startswith("relay") for stage in run.stages):
        trouble.append("a relay ran")
    if found.lost:
        trouble.append(f"{found.lost} samples lost")
    if "Traceback" in run.output or any(e["kind"] == "traceback" for e in run.events):
        trouble.append("a traceback")
    return replace(found, trouble=tuple(trouble))


def missing(stand: Stand, run: Run) -> list[int]:
    """Keys of samples that the device has told of, in time, and that the record has not.

    One that came with a latched fault is in the record if the fault's event has its counts. The last exchange before
    a stop without a fault is none: it only asks what came of the last drive.
    """
    recorded = {int(row["seq"]) for row in run.rows}
    detail = "" if run.fault is None else str(run.fault["detail"])
    lost = []
    for reading in stand.readings:
        in_detail = f"{reading.counts} counts" in detail and reading is stand.readings[-1]
        only_asks = reading.key in stand.closing and run.fault is None
        if reading.is_well and reading.key not in recorded and not only_asks and not in_detail:
            lost.append(reading.key)
        elif not reading.is_well and not in_detail and reading.key not in recorded:
            lost.append(reading.key)
    return lost


def _restarted(
    found: Found, row: Row, backend: Backend, stand: Stand, experiment: Experiment, folder: Path
) -> Found:
    words, trouble = [], list(found.trouble)
    if row.lasting:
        code = restart(stand, backend, experiment, folder)
        words.append(f"refused: {code}" if code else "moves")
        if code not in row.refused:
            trouble.append(f"the next run, not mended: {code or 'moves'}")
    stand.cure()
    code = restart(stand, backend, experiment, folder)
    words.append(("mended: " if row.lasting else "") + (f"refused: {code}" if code else "moves"))
    if code:
        trouble.append(f"the next run, mended: {code}")
    return replace(found, restart="; ".join(words), trouble=tuple(trouble))


def restart(stand: Stand, backend: Backend, experiment: Experiment, folder: Path) -> str:
    """The next run, as far as the breakaway check: the code that ends it, or nothing where the shaft moves."""
    stand.forget()
    with patched(stand, backend):
        try:
            outcome = script.run_breakaway(experiment, folder / "restarts")
        except script.Fault as fault:
            return fault.code
    if outcome.fault is None and math.isnan(stand.first_drive_s):
        return "it says that it moves, and has not driven"
    return "" if outcome.fault is None else outcome.fault.code
