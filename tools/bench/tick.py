"""A whole tick, from the wake-up to the recorded row, split: over a serial device, Modbus and the simulator.

PYTHONPATH=tools python -m bench.tick [--json] [--seconds 8]

The emulated devices run in real time: processes on this machine, behind a pseudo-terminal or on loopback, so that the
wire is that of this machine and not of a cable. A relay test runs, recorded to disk, with the config's loop settings.
A second loop takes turns with it, half a second each: the same driver with a relay of one line, no guard and no
recorder. What ours computes beyond it is what guard, cycle detector and checks cost.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from bench.benchmark import options, tell
from bench.wake_up import cores, fifo_is_allowed
from rig.backends.backend import truth_of
from rig.backends.clock import MonotonicClock
from rig.backends.emulated import words
from rig.backends.registry import Bench, connect
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.config import Experiment, load
from rig.control.excitation import RelayTest
from rig.control.guard import Guard
from rig.control.law import Law
from rig.control.loop.real_time import RealTime, real_time
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.relay import DualChannelRelay
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.cycle_detector import CycleDetector
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.sink import NullSink
from rig.run_folder.results.result import LoopResult
from rig.running.preflight.room_to_stop import guard_settings_of
from rig.running.session import real_time_of
from shared.table import markdown

CONFIG = Path(__file__).resolve().parents[2] / "config"
GAINS_V = (0.8, 1.0)
TURN_S = 0.5
PARTS = ("late_us", "io_us", "compute_us", "write_us", "record_us")


class Case(NamedTuple):
    """What is measured: a config at a period, under each of some conditions in turn."""

    name: str
    config: str
    period_s: float
    conditions: tuple[str, ...] = ("idle",)  # of CONDITIONS


# cores idle or busy, and loop.raise_workers
CONDITIONS = {"idle": ("idle", False), "cores busy": ("busy", False), "cores busy, workers raised": ("busy", True)}
CASES = (
    Case("simulator, 10 ms", "quick.yaml", 0.010),
    Case("serial, 10 ms", "demo.yaml", 0.010),
    Case("Modbus RTU at 115200 baud, 10 ms", "modbus-rtu.yaml", 0.010),
    Case("Modbus TCP, 10 ms", "modbus-tcp.yaml", 0.010),
    Case("serial, 1 ms", "demo.yaml", 0.001, tuple(CONDITIONS)),
)


class Limited:
    """A law, for so many ticks."""

    def __init__(self, law: Law, ticks: int) -> None:
        self._law, self._left = law, ticks
        self.z_rad_s, self.yd_rad, self.finished = law.z_rad_s, law.yd_rad, False

    def step(self, sample: Sample) -> float:
        """The law's drive, V."""
        self._left -= 1
        self.finished = self._left <= 0
        u_V = self._law.step(sample)
        self.z_rad_s, self.yd_rad = self._law.z_rad_s, self._law.yd_rad
        return u_V


class BareRelay:
    """One line: the least that a tick of a relay computes."""

    z_rad_s = yd_rad = math.nan
    finished = False

    def step(self, sample: Sample) -> float:
        """Drive, V."""
        return -1.0 if sample.y_rad > 0.0 else 1.0


class NoGuard(Guard):
    """Lets everything out: for the emulated bench of this benchmark alone."""

    def allow(self, sample: Sample, asked_V: float) -> tuple[float, int]:
        """What was asked for."""
        return asked_V, 0


@contextmanager
def in_real_time(experiment: Experiment) -> Iterator[Bench]:
    """The bench of the config in real time, a simulated one, too."""
    if experiment.daq.driver != "simulated":
        daq = experiment.daq.model_copy(update={"port": words.in_real_time(experiment.daq.port or "")})
        with connect(experiment.model_copy(update={"daq": daq}).device) as bench:
            yield bench
        return
    truth = truth_of(experiment.device)
    assert truth is not None
    clock = MonotonicClock(1e-6 * experiment.loop.spin_us)
    driver = SimulatedDriver(
        clock,
        truth,
        experiment.device.scaling,
        SimulatedLatency(0.001, 0.0),
        experiment.seed,
    )
    info = driver.open()
    yield Bench(driver, clock, info, truth)
    driver.safe_stop()


class Turns:
    """Our loop and the bare one on an open bench under one condition, a turn at a time."""

    def __init__(self, experiment: Experiment, bench: Bench, recorder: Recorder, condition: str) -> None:
        self._cores, raise_workers = CONDITIONS[condition]
        self._settings = replace(real_time_of(experiment), raise_workers=raise_workers)
        self._limits = experiment.device.arming
        self._ticks = round(TURN_S / experiment.period_s)
        settings = guard_settings_of(experiment)
        guard = Guard(settings)
        guard.sign_proven = True
        stop, period_s = StopRequest(StopFlag.unseen()), experiment.period_s
        self.ours = Loop(bench.driver, bench.clock, guard, recorder, period_s, stop)
        self.bare = Loop(bench.driver, bench.clock, NoGuard(settings), NullSink(), period_s, stop)
        self._relay, self._detector = DualChannelRelay(*GAINS_V, 0.7), CycleDetector(0.3, 0.08)
        self.done = RealTime()
        self.faults: list[str] = []

    def run(self) -> None:
        """One turn of each loop."""
        test = RelayTest(self._relay, self._detector, GAINS_V, 1000, 1e6)
        with cores(self._cores), real_time(self._settings) as self.done:
            for loop, law in ((self.ours, test), (self.bare, BareRelay())):
                try:
                    with loop.armed(self._limits):
                        loop.run(Limited(law, self._ticks), "relay-1")
                except Fault as fault:  # a machine that stood still for longer than daq.timeout_s
                    self.faults.append(fault.code)
                finally:
                    loop.close()  # else it reads on, between the other's exchanges

    def result(self) -> dict[str, Any]:
        """Quantiles of each part, ours and of the bare tick, us; the share of ticks skipped."""
        summary, bare = self.ours.summary(), self.bare.summary()
        told, peer = summary.as_json(), bare.as_json()
        ran, skipped = self.ours.statistics.ticks, self.ours.statistics.skipped
        return {
            "granted": self.done.granted,
            "refused": self.done.refused,
            "faults": self.faults,
            "ticks": ran,
            "skipped": skipped,
            "skipped_percent": round(100.0 * skipped / (ran + skipped), 4),
            **{part: told[part] for part in PARTS},
            "bare": {part: peer[part] for part in PARTS},
            "compute_p99_ratio_to_bare": _ratio(_p99(summary), _p99(bare)),
        }


def _p99(loop: LoopResult) -> float | None:
    """99th percentile of law and guard, us; None where a fault ended all turns at once."""
    return None if loop.compute_us is None else loop.compute_us.p99


def _ratio(ours: float | None, bare: float | None) -> float | None:
    return None if ours is None or bare is None else round(ours / bare, 2)


def measure(case: Case, turns: int, folder: Path) -> dict[str, dict[str, Any]]:
    """The results of a case, by name and condition."""
    experiment = load(CONFIG / case.config).model_copy(update={"period_s": case.period_s})
    folder.mkdir()
    with in_real_time(experiment) as bench:
        recorder = Recorder(folder, ["relay-1"])
        try:
            by_name = {f"{case.name}, {name}": Turns(experiment, bench, recorder, name) for name in case.conditions}
            for _ in range(turns):
                for one in by_name.values():
                    one.run()
        finally:
            recorder.close()
    return {name: one.result() for name, one in by_name.items()}


def table(results: dict[str, dict[str, Any]]) -> str:
    """For people, as Markdown."""
    rows = []
    for name, found in results.items():
        parts = [f"{found[part]['p50']:.0f} / {found[part]['p99']:.0f}" for part in PARTS]
        bare = f"{found['bare']['compute_us']['p50']:.0f} / {found['bare']['compute_us']['p99']:.0f}"
        skipped = f"{found['skipped_percent']:.3g} %"
        rows.append((name, found["ticks"], skipped, *parts, bare))
    faults = [f"{name}: ended by {', '.join(found['faults'])}" for name, found in results.items() if found["faults"]]
    head = (
        "bench, period", "ticks", "skipped", "wake", "wire: read", "compute", "wire: write", "record", "bare compute",
    )  # fmt: skip
    return "\n".join([markdown(head, rows), "", "Each: median / p99, us.", *faults])


def main(cases: Sequence[Case] = CASES) -> int:
    """Measure and print."""
    parser = options("A whole tick, split into its parts.")
    parser.add_argument("--seconds", type=float, default=8.0, help="of each case; half of it is the bare loop's")
    arguments = parser.parse_args()
    results: dict[str, dict[str, Any]] = {}
    turns = max(round(0.5 * arguments.seconds / TURN_S), 1)
    with tempfile.TemporaryDirectory() as folder:
        for number, case in enumerate(cases):
            results |= measure(case, turns, Path(folder) / str(number))
    told = {"fifo": fifo_is_allowed(), "cores": os.cpu_count(), "cases": results}
    tell(told, as_json=arguments.json, text=table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
