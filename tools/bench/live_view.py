"""What it costs the loop to be watched: beside itself alone, turn by turn on one emulated board.

PYTHONPATH=tools python -m bench.live_view [--json] [--seconds 8] [--viewers 5]

A relay test runs on the emulated serial board in real time, recorded to disk, at 10 ms. In every other half second it
has a stop flag, and each of the viewers, a process of its own, reads the run folder 25 times a second, as a panel does.
In between they stand still. Told are lateness and parts of the tick of both, the age of the newest row as the viewers
saw it, the cost of a look at the flag, and the time from a request to stop, at any instant, until the device has
confirmed that its drive is 0.
"""

from __future__ import annotations

import math
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench.benchmark import options, tell
from bench.tick import CONFIG, GAINS_V, TURN_S, Limited, in_real_time
from rig.backends.registry import Bench
from rig.config import Experiment, load
from rig.control.excitation import RelayTest
from rig.control.guard import Guard
from rig.control.law import Constant
from rig.control.loop.real_time import real_time
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.relay import DualChannelRelay
from rig.core.faults import Fault
from rig.model.cycle_detector import CycleDetector
from rig.run_folder.live.stop_flag import StopFlag, request_stop
from rig.run_folder.live.view import LiveView
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.sink import JsonScalar, NullSink
from rig.running.preflight.room_to_stop import guard_settings_of
from rig.running.session import real_time_of
from shared.table import markdown

EVERY_S = 0.04
PARTS = ("late_us", "compute_us", "record_us")
LOOKS = 100_000
STOPS = 20


def view(folder: Path) -> int:
    """As one panel: read until the end of standard input, then print the age of the newest row at each read, ms."""
    live, after, ages_ms = LiveView(folder), -1, []
    live.read()
    print("ready", flush=True)
    last_s = next_s = time.monotonic()
    while not select.select([sys.stdin], [], [], max(next_s - time.monotonic(), 0.0))[0]:
        next_s = max(next_s + EVERY_S, time.monotonic())
        seen = live.read()
        is_paced = time.monotonic() - last_s < 2.0 * EVERY_S  # else it stood still, and nobody looked
        last_s = time.monotonic()
        if seen.rows and seen.rows[-1].number > after and seen.age_s is not None:
            after = seen.rows[-1].number
            ages_ms += [1e3 * seen.age_s] if is_paced else []
    print(" ".join(f"{age:.2f}" for age in ages_ms))
    return 0


class StopTime(NullSink):
    """When the loop was told that the device had confirmed the stop, s; nan: not yet."""

    at_s = math.nan

    def event(self, t_s: float, kind: str, **fields: JsonScalar) -> None:
        """Take an event."""
        if kind == "stop":
            self.at_s = time.monotonic()


def stop_ms(bench: Bench, experiment: Experiment, folder: Path, faults: list[str]) -> list[float]:
    """Times from a request to stop until the device has confirmed it, ms: each request in another part of a tick.

    They end early with a device that latches a fault, which ``faults`` gets.
    """
    times_ms: list[float] = []
    for number in range(STOPS):
        one = folder / f"stop-{number}"
        one.mkdir()
        asked_s: list[float] = []

        def ask(one: Path = one, asked_s: list[float] = asked_s) -> None:
            request_stop(one, "bench")
            asked_s.append(time.monotonic())

        with StopFlag() as flag:
            flag.begin(one)
            guard, stopped = Guard(guard_settings_of(experiment)), StopTime()
            loop = Loop(bench.driver, bench.clock, guard, stopped, experiment.period_s, StopRequest(flag))
            asking = threading.Timer(0.1 + number / STOPS * experiment.period_s, ask)
            try:
                with real_time(real_time_of(experiment)), loop.armed(experiment.device.arming):
                    asking.start()
                    loop.run(Constant(0.3, 1.0), "jog")
            except Fault as fault:
                if asking.ident is not None:
                    asking.join()
                if fault.code != "INTERRUPTED":
                    faults.append(fault.code)
                    break
                times_ms.append(1e3 * (stopped.at_s - asked_s[0]))
    return times_ms


def look_ns(flag: StopFlag | None) -> float:
    """Time of one look at a stop request, ns: the least of five rounds."""
    request, rounds = StopRequest(flag), []
    for _ in range(5):
        begin = time.perf_counter_ns()
        for _ in range(LOOKS):
            request.look()
        rounds.append((time.perf_counter_ns() - begin) / LOOKS)
    return min(rounds)


def measure(seconds: float, viewers: int, folder: Path) -> dict[str, Any]:
    """The loop watched and alone."""
    experiment = load(CONFIG / "demo.yaml")
    with in_real_time(experiment) as bench, StopFlag() as flag:
        recorder = Recorder(folder, ["relay-1"])
        flag.begin(folder)
        guards = [Guard(guard_settings_of(experiment)) for _ in range(2)]
        for guard in guards:
            guard.sign_proven = True
        stops = (StopRequest(flag), StopRequest(StopFlag.unseen()))
        loops = [
            Loop(bench.driver, bench.clock, guard, recorder, experiment.period_s, stop)
            for guard, stop in zip(guards, stops, strict=True)
        ]
        flag.tell(-loops[0].since_start_s(0.0), experiment.period_s)
        command = (sys.executable, "-m", "bench.live_view", "--view", str(folder))
        watching = [
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(viewers)
        ]
        for process in watching:
            assert process.stdout is not None and process.stdout.readline() == "ready\n"
        relay, detector = DualChannelRelay(*GAINS_V, 0.7), CycleDetector(0.3, 0.08)
        faults: list[str] = []
        try:
            for turn in range(2 * round(seconds / (2.0 * TURN_S))):
                loop = loops[turn % 2]
                for process in watching:
                    os.kill(process.pid, signal.SIGSTOP if turn % 2 else signal.SIGCONT)
                test = RelayTest(relay, detector, GAINS_V, 1000, 1e6)
                try:
                    with real_time(real_time_of(experiment)), loop.armed(experiment.device.arming):
                        loop.run(Limited(test, round(TURN_S / experiment.period_s)), "relay-1")
                except Fault as fault:  # a machine that stood still for longer than daq.timeout_s
                    faults.append(fault.code)
        finally:
            recorder.close()
            for process in watching:
                os.kill(process.pid, signal.SIGCONT)
        ages_ms = [float(age) for process in watching for age in process.communicate()[0].split()]
        looks_ns = {"with_flag": round(look_ns(flag), 1), "without": round(look_ns(None), 1)}
        stops_ms = stop_ms(bench, experiment, folder, faults)
    return result(loops) | {
        "age_ms": spread(ages_ms),
        "stop_ms": spread(stops_ms),
        "look_ns": looks_ns,
        "viewers": viewers,
        "faults": faults,
    }


def spread(values: list[float]) -> dict[str, float]:
    """Median, 99th percentile, largest and number."""
    p50, p99, largest = np.percentile(values, [50, 99, 100]) if values else [math.nan] * 3
    return {"p50": round(p50, 1), "p99": round(p99, 1), "max": round(largest, 1), "number": len(values)}


def result(loops: list[Loop]) -> dict[str, Any]:
    """Of both loops, and their ratios."""
    found: dict[str, Any] = {}
    for name, loop in zip(("watched", "alone"), loops, strict=True):
        told = loop.summary().as_json()
        found[name] = {"ticks": told["ticks"], "skipped": told["skipped"]} | {part: told[part] for part in PARTS}
    ratios = {
        f"{part.removesuffix('_us')}_p50_ratio": round(found["watched"][part]["p50"] / found["alone"][part]["p50"], 3)
        for part in PARTS[1:]
    }
    return found | ratios


def table(found: dict[str, Any]) -> str:
    """For people."""
    rows = []
    for name in ("watched", "alone"):
        one = found[name]
        rows.append(
            (
                name,
                one["ticks"],
                one["skipped"],
                *(f"{one[part]['p50']:.1f} / {one[part]['p99']:.1f}" for part in PARTS),
            )
        )
    age, stop, look = found["age_ms"], found["stop_ms"], found["look_ns"]
    return "\n".join(
        [
            markdown(("loop", "ticks", "skipped", "wake", "compute", "record"), rows),
            "",
            f"Each: median / p99, us. {found['viewers']} viewers; age of the newest row at a read: {age['p50']:g} ms "
            f"(median), {age['p99']:g} (p99), {age['max']:g} (largest of {age['number']}).",
            f"From a request to stop until the device has confirmed 0 V: {stop['p50']:g} ms (median), {stop['max']:g} "
            f"(largest of {stop['number']}).",
            *([f"ended by {', '.join(found['faults'])}"] if found["faults"] else []),
            f"A look at the stop request: {look['with_flag']:g} ns with a flag, {look['without']:g} ns without.",
        ]
    )


def main() -> int:
    """Measure and print."""
    parser = options("What it costs the loop to be watched.")
    parser.add_argument("--seconds", type=float, default=8.0, help="of both loops together")
    parser.add_argument("--viewers", type=int, default=5)
    parser.add_argument("--view", type=Path, help="be one of them, on this run folder")
    arguments = parser.parse_args()
    if arguments.view is not None:
        return view(arguments.view)
    with tempfile.TemporaryDirectory() as folder:
        found = measure(arguments.seconds, arguments.viewers, Path(folder))
    tell(found, as_json=arguments.json, text=table(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
