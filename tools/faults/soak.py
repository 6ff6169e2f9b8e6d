"""A long day at the bench: run after run on one device that stays powered, and now and then something goes wrong.

PYTHONPATH=tools python -m faults.soak [--hours 8] [--seed 1]

Hours are of the device's time, shared by the devices; everything but the other processes that some rows need lives in
virtual time. Which row comes in which run, and when, follows from the seed. Exit status 1 where a fault is unexplained,
a sample is lost, a mended bench does not move again, or memory grows.
"""

from __future__ import annotations

import argparse
import random
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from faults.backends import PLAIN, Backend, InjectableBlock
from faults.bounds import Times
from faults.case import SETTLE_S, judged, new_injector, restart, undisturbed
from faults.case import run as run_on
from faults.case import times as times_of
from faults.injector import FaultInjector
from faults.rows import ROWS, RUNNING, RUNS_ON, Row
from faults.stages import CYCLE
from rig.config.schema import Experiment
from shared.cases import spread

CYCLES = 30  # of a relay test, unless something ends it
FAULTY = 0.5  # share of the runs in which something goes wrong
GROWTH_MB = 4.0  # of memory, from the first third of the runs to the last: more is growth
NOTHING = Row("nothing", "nothing goes wrong", lambda injector: None, RUNNING, (RUNS_ON,), status=(0, 1))


@dataclass
class Day:
    """What came of one device's share.

    hours     of its time
    runs      and how often each row came
    trouble   run, row and what should not be
    memory_MB of this process after each run
    """

    backend: str
    hours: float = 0.0
    runs: int = 0
    rows: Counter[str] = field(default_factory=Counter)
    trouble: list[str] = field(default_factory=list)
    memory_MB: list[float] = field(default_factory=list)

    @property
    def growth_MB(self) -> float:
        """From the middle of the first third of the runs to that of the last."""
        third = len(self.memory_MB) // 3
        if third == 0:
            return 0.0
        return sorted(self.memory_MB[-third:])[third // 2] - sorted(self.memory_MB[:third])[third // 2]


def rows_for(backend: Backend) -> tuple[Row, ...]:
    """The rows that a device which stays powered can meet in a run, in this process."""
    traits = CYCLE.traits(backend.traits)
    rows = (row.on(traits) for row in ROWS if row.is_for(traits))
    return tuple(row for row in rows if not (row.early or row.alone or row.same))


def spend(key: str, hours: float, seed: int) -> Day:
    """Run after run on the device of that key, until its time is spent."""
    backend = next(b for b in PLAIN if b.key == key)
    rng, day = random.Random(f"{backend.key} {seed}"), Day(backend.key)
    plain = undisturbed(backend, "relay")
    config = backend.config()
    config["relay"]["cycles"] = CYCLES
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        injector, experiment = new_injector(backend, config, folder, rng.randrange(2**32))
        language, limits = backend.language, experiment.limits.hard_rad
        times, (cycle_s, next_s) = times_of(backend, "relay"), plain.windows[CYCLE.key]
        device, timeout_s, began_s = injector.device, experiment.daq.timeout_s, injector.now_s()
        while (injector.now_s() - began_s) < 3600.0 * hours:
            row = rng.choice(rows_for(backend)) if rng.random() < FAULTY else NOTHING
            injector = FaultInjector(device, language(experiment), limits, timeout_s, folder, rng.randrange(2**32))
            injector.spare_s, injector.too_late_s = backend.spare_s(experiment), backend.too_late_s(experiment)
            phase = rng.uniform(0.0, CYCLES - 5.0)
            injector.schedule(injector.now_s() + cycle_s + phase * (next_s - cycle_s), row.act)
            for words in _one(row, backend, phase, injector, times, experiment):
                day.trouble.append(f"run {day.runs + 1}, {row.name} at cycle {phase:.2f}: {words}")
            if isinstance(device, InjectableBlock):
                device.forget()  # what it keeps for tests is not the host's memory
            shutil.rmtree(folder / "runs", ignore_errors=True)
            day.runs += 1
            day.rows[row.name] += 1
            day.memory_MB.append(_memory_MB())
        day.hours = (injector.now_s() - began_s) / 3600.0
    return day


def _one(
    row: Row, backend: Backend, phase: float, injector: FaultInjector, times: Times, experiment: Experiment
) -> list[str]:
    """One run, and after what went wrong a mended bench that has to move again; what should not be."""
    run = run_on(injector, backend)
    injector.watch(SETTLE_S)
    trouble = list(judged(row, backend, CYCLE, phase, injector, times, run).trouble)
    injector.cure()
    if row.lasting:
        injector.bring_home()
    elif row is not NOTHING and run.fault is not None:
        injector.device.place(0.0)
    shutil.rmtree(injector.folder / "runs", ignore_errors=True)
    if run.fault is not None and (code := restart(injector, backend, experiment)):
        trouble.append(f"the next run, mended: {code}")
    return trouble


def _memory_MB() -> float:
    """Of this process now, resident."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def main() -> int:
    """Spend the hours, one process a device, and say what came of them."""
    options = argparse.ArgumentParser(prog="python -m faults.soak", description=__doc__)
    options.add_argument("--hours", type=float, default=8.0, help="of the devices' time, together")
    options.add_argument("--seed", type=int, default=1)
    given = options.parse_args()
    started_s, failed = time.monotonic(), False
    for _, day in spread(spend, [(backend.key, given.hours / len(PLAIN), given.seed) for backend in PLAIN], jobs=2):
        wrong = sum(count for name, count in day.rows.items() if name != NOTHING.name)
        print(
            f"{day.backend}: {day.hours:.2f} h of its time, {day.runs} runs, {wrong} with one of "
            f"{len(day.rows) - 1} faults; {len(day.trouble)} unexplained; memory {day.memory_MB[-1]:.0f} MB, "
            f"growth {day.growth_MB:+.1f} MB",
            flush=True,
        )
        for words in day.trouble:
            print(f"  {words}")
        failed |= bool(day.trouble) or day.growth_MB > GROWTH_MB
    print(f"{given.hours:g} h in {(time.monotonic() - started_s) / 60.0:.1f} min")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
