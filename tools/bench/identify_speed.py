"""CPU seconds of `rig identify` and of a start, beside a fit by `solve_ivp` and `least_squares`, and an older rig.

Each figure is that of a whole command over one fit of the peer in the same run: the plain motor, from one start, fitted
to the first of two relay tests of 14 s. BEFORE has the same ratios of commit 378017e3, measured in the same way: so a
faster machine makes no faster rig.

    PYTHONPATH=tools python -m bench.identify_speed [--json] [--times 3] [--rig "python -m rig"]
RIG_SHARED_DATA adds the records that it names, and those of servos with BAM's published friction: M1 to M6, free and
with a load, by relay and by strokes. --rig: measure another rig, with an environment of its own:
--rig "env PYTHONPATH=OLD OLD/.venv/bin/python -m rig", OLD a clone of that commit.
"""

from __future__ import annotations

import os
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bam.__main__ import FREE, LOADS, recordings
from bam.records import Case, records_of
from bench.benchmark import options, tell
from bench.sampled_data_speed import peer
from real_records.__main__ import entries, identified
from rig.control.relay import DualChannelRelay
from rig.control.simulation import Sampling, simulate
from rig.identification import identify
from rig.identification.starts import Start
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import TimeSeries

MOTOR = Motor(0.17, 6.5, coulomb(0.48))
GAINS = ((0.17, 0.74), (0.25, 0.95))
LENGTH_S = 14.0
SERVO_SEED, SERVO_GOAL_CPU_S = 1, 15.0
START = Start(0.25, 5.0, 0.35)
BEFORE = {"start": 0.0140, "two records of 14 s": 0.0648, "EMPS": 0.4326}


def relay_test(k: int) -> Recording:
    """The one or the other of two tests."""
    sampling = Sampling(noise_rad=1e-3, resolution_rad=2.0 * np.pi / 4096.0, start_rad=0.3, seed=k + 1)
    return simulate(MOTOR, DualChannelRelay(*GAINS[k], np.inf), LENGTH_S, sampling)


def written(folder: Path) -> list[Path]:
    """Both tests as CSV files."""
    files = []
    for k in range(len(GAINS)):
        one, file = relay_test(k), folder / f"test-{k}.csv"
        table = np.column_stack((one.t_s, one.u_V, one.y_rad))
        np.savetxt(file, table, delimiter=",", header="t_s,u_V,y_rad", comments="", fmt="%.9g")
        files.append(file)
    return files


def cpu_of(command: Sequence[str], times: int) -> float:
    """CPU seconds of a command with all its threads and children: the fewest of so many, after one that compiles."""
    taken = []
    for _ in range(times + 1):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        taken.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(taken[1:])


def peer_cpu_s() -> float:
    """CPU seconds of the peer's fit."""
    one = relay_test(0)
    before = time.process_time()
    peer(TimeSeries(one.t_s, one.y_rad, None, one.u_V, name="peer"), [START])
    return time.process_time() - before


def servo_cpu_s(folder: Path) -> dict[str, float]:
    """CPU seconds of each identification of a servo, by its record; after one that compiles."""
    found = {}
    models = [f"m{k}" for k in range(1, 7)]
    cases = [
        Case("XL330", m, load, by) for m in models for load in (FREE, LOADS["XL330"]) for by in ("relay", "strokes")
    ]
    for one in (cases[0], *cases):
        given = recordings(one, records_of(one, folder, SERVO_SEED)[0])
        before = time.process_time()
        identify(given)
        found[f"{one.title}, {one.record}"] = time.process_time() - before
    return found


def commands(rig: Sequence[str], folder: Path, data: Path | None) -> dict[str, list[str]]:
    """Each figure's command."""
    found = {
        "start": [*rig, "identify", "--help"],
        "two records of 14 s": [*rig, "identify", *map(str, written(folder))],
    }
    if data is not None:
        emps = next((entry for entry in entries("emps", data, folder) if entry.name == "DATA_EMPS"), None)
        found |= {} if emps is None else {"EMPS": [*rig, "identify", *map(str, emps.paths)]}
    return found


def main() -> int:
    """Print CPU seconds, their ratios to the peer's, and these over those before."""
    parser = options("CPU seconds of rig identify beside a fit by solve_ivp and least_squares.")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--rig", default=f"{shlex.quote(sys.executable)} -m rig")
    given = parser.parse_args()
    named = os.environ.get("RIG_SHARED_DATA")
    data = Path(named) if named and Path(named).is_dir() else None
    peer_s = peer_cpu_s()
    result: dict[str, object] = {"peer_cpu_s": round(peer_s, 2)}
    with tempfile.TemporaryDirectory() as scratch:
        for name, command in commands(shlex.split(given.rig), Path(scratch), data).items():
            cpu_s = cpu_of(command, given.times)
            result[name] = {"cpu_s": round(cpu_s, 3), "over_peer": round(cpu_s / peer_s, 4)}
            if name in BEFORE:
                result[name] |= {"over_before": round(cpu_s / peer_s / BEFORE[name], 3)}  # type: ignore[operator]
        if data is not None and given.rig == parser.get_default("rig"):
            each = sorted(identified(entry)[2] for entry in entries("real", data, Path(scratch)))
            ninth = each[min(len(each) - 1, int(0.9 * len(each)))]
            result["real records"] = {
                f"{what}_{of}": round(value, 4)
                for what, value_s in (("nine_of_ten", ninth), ("most", each[-1]))
                for of, value in (("cpu_s", value_s), ("over_peer", value_s / peer_s))
            }
            servos = servo_cpu_s(data / "bam")
            slowest = max(servos, key=lambda name: servos[name])
            result["servos"] = {
                "records": len(servos), "slowest": slowest, "goal_cpu_s": SERVO_GOAL_CPU_S,
                "most_cpu_s": round(servos[slowest], 2), "most_over_peer": round(servos[slowest] / peer_s, 3),
            }  # fmt: skip
    tell(result, as_json=given.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
