"""Whether runs on emulated devices end whole, whatever this machine does meanwhile: ``make whole TIMES=20``.

Three questions, each asked TIMES over, of config/demo.yaml:

* virtual: beside four busy loops, does each run end whole, and record the same to the last digit?
* paced: the same at pace 1, while all processes of the run are stopped together, for 40 to 1000 ms, again and again?
* real: on the board in a process of its own, in real time, does any run end in a fault where the witness
  (tools/shared/witness.py) saw the machine stand still for no longer than the device's watchdog?

It ends with 1 where an answer is no.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from shared.witness import Witness, longest_s

ROOT = Path(__file__).resolve().parent.parent
BUSY_LOOPS = 4
STOPPED_S = (0.04, 1.0)  # shortest and longest
BETWEEN_S = (0.3, 2.0)
PACED_AT_ONCE = 5  # each sleeps most of its time
PROGRAM = ("-m", "rig")  # what Python is told to run


class Ended(NamedTuple):
    """How a run ended.

    code      of its fault; "" if it ended whole
    why       it failed, in words
    recorded  digest of its rows
    outcome   what `--json` printed
    time      of meta.json
    """

    code: str
    why: str
    recorded: str
    outcome: dict[str, Any]
    time: dict[str, Any]


def start(config: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    """``rig run`` in a session of its own."""
    command = [sys.executable, "-P", *PROGRAM, "run", str(config), "--out", str(out), "--json", *options]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )  # fmt: skip


def end(run: subprocess.Popen[str]) -> Ended:
    """Wait for its end. Raises RuntimeError where it gave no result."""
    printed, said = run.communicate()
    if not printed:
        raise RuntimeError(f"exit status {run.returncode}: {said}")
    outcome = json.loads(printed)
    folder = Path(outcome["folder"])
    code = outcome["faults"][0]["code"] if outcome["faults"] else ""
    rows = hashlib.sha256((folder / "samples.csv").read_bytes()).hexdigest()
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    return Ended(code, outcome.get("cause", ""), rows, outcome, meta["time"])


@contextlib.contextmanager
def busy(loops: int) -> Iterator[None]:
    """So many processes that do nothing but compute, for the block."""
    running = [subprocess.Popen([sys.executable, "-I", "-S", "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for one in running:
            one.kill()
            one.wait()


@contextlib.contextmanager
def stopped_now_and_then(run: subprocess.Popen[str], chosen: Sequence[float] | None = None) -> Iterator[list[float]]:
    """In the block all processes of the run stand still together, again and again; yields the lengths so far, s.

    chosen  lengths, one after the other, over and over; None: at random within STOPPED_S
    """
    over, stops = threading.Event(), list[float]()
    at_random = random.Random(run.pid)

    def stop() -> None:
        while not over.wait(at_random.uniform(*BETWEEN_S)):
            length_s = chosen[len(stops) % len(chosen)] if chosen else at_random.uniform(*STOPPED_S)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGSTOP)
                try:
                    time.sleep(length_s)
                finally:
                    os.killpg(run.pid, signal.SIGCONT)
                stops.append(length_s)

    stopper = threading.Thread(target=stop)
    stopper.start()
    try:
        yield stops
    finally:
        over.set()
        stopper.join()


def in_real_time(config: Path, folder: Path) -> Path:
    """A copy of the config whose emulated device is a process of its own."""
    text = yaml.safe_load(config.read_text(encoding="utf-8"))
    text["daq"]["port"] += "-realtime"
    copy = folder / f"{config.stem}-realtime.yaml"
    copy.write_text(yaml.safe_dump(text), encoding="utf-8")
    return copy


class Beside(NamedTuple):
    """A run in real time, and for how long at most the witness beside it saw the machine stand still, s."""

    run: Ended
    stood_s: float


def beside_a_witness(config: Path, out: Path, *, pty: bool) -> Beside:
    """Run it. ``pty``: bytes of a pseudo-terminal go between host and device."""
    with Witness(pty=pty) as witness:
        ended = end(start(config, out))
        return Beside(ended, longest_s(witness.seen()))


def _virtual(times: int, folder: Path, config: Path) -> bool:
    with busy(BUSY_LOOPS):
        runs = [end(start(config, folder / "virtual")) for _ in range(times)]
    return _same(f"virtual, beside {BUSY_LOOPS} busy loops", runs)


def _paced(times: int, folder: Path, config: Path) -> bool:
    stops = list[float]()

    def one(number: int) -> Ended:
        run = start(config, folder / f"paced-{number}", "--pace", "1")
        with stopped_now_and_then(run) as lengths_s:
            ended = end(run)
        stops.extend(lengths_s)
        return ended

    first = end(start(config, folder / "unpaced"))
    with ThreadPoolExecutor(PACED_AT_ONCE) as pool:
        paced = list(pool.map(one, range(times)))
    longest = max(run.time["longest_stall_s"] for run in paced)
    print(
        f"paced: stopped {len(stops)} times, {min(stops):.2f} to {max(stops):.2f} s; "
        f"stalls told: {sum(run.time['stalls'] for run in paced)}, {longest:.2f} s at most"
    )
    return _same("paced, stopped now and then", paced) and all(run.recorded == first.recorded for run in paced)


def _real(times: int, folder: Path, config: Path) -> bool:
    watchdog_s = yaml.safe_load(config.read_text(encoding="utf-8"))["daq"]["watchdog_s"]
    runs = [beside_a_witness(in_real_time(config, folder), folder / "real", pty=True) for _ in range(times)]
    quiet = [one for one in runs if one.stood_s <= watchdog_s]
    faults = [one for one in quiet if one.run.code]
    excused = [one.run.code for one in runs if one.run.code and one.stood_s > watchdog_s]
    print(
        f"real: {sum(not one.run.code for one in runs)} of {times} whole; {len(faults)} of {len(quiet)} beside a quiet "
        f"witness ended in a fault; where it saw more than {watchdog_s:g} s: {', '.join(excused) or 'no fault'}; the "
        f"longest that it saw: {max(one.stood_s for one in runs):.3f} s"
    )
    for one in faults:
        print(f"real: {one.run.why} (the witness saw {one.stood_s:.3f} s)")
    return not faults


def _same(what: str, runs: list[Ended]) -> bool:
    whole = [run for run in runs if not run.why]
    kinds = {run.recorded for run in whole}
    print(f"{what}: {len(whole)} of {len(runs)} whole, {len(kinds)} different recordings")
    for run in runs:
        if run.why:
            print(f"{what}: {run.why}")
    return len(whole) == len(runs) and len(kinds) == 1


QUESTIONS = {"virtual": _virtual, "paced": _paced, "real": _real}


def main() -> int:
    """Ask. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="whole", description=__doc__)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--ask", choices=QUESTIONS, action="append", help="only this one; may be given again")
    parser.add_argument("--config", type=Path, default=ROOT / "config/demo.yaml")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="whole-") as name:
        answers = [QUESTIONS[one](asked.times, Path(name), asked.config) for one in asked.ask or QUESTIONS]
    return 0 if all(answers) else 1


if __name__ == "__main__":
    sys.exit(main())
