"""Ticks that the loop on an emulated servo's bus misses, beside bare C loops that do nothing, at once and in one run.

PYTHONPATH=tools python -m bench.servo_loop [--json] [--minutes M]

A machine that stands still makes every loop miss ticks. So on each core a C loop (`peers/wake_up_loop.c`) of the same
period, policy and spin sleeps and wakes at the same time: a tick that ours misses while one of them was late is the
machine's. Of the others a tick is the bus's if answers of the usual time would have made it punctual. The emulated
servo's pseudo-terminal needs a worker of the kernel, which has the ordinary priority: any program that computes keeps
it from its core. So each second turn raises these workers (`loop.raise_workers`).
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from bench.benchmark import options, tell
from bench.late_ticks import Block
from bench.tick import CONFIG, BareRelay, Limited, in_real_time
from bench.wake_up import PRIORITY, SPIN_US, TickingProcess, build, fifo_is_allowed
from rig.backends.links.open_link import OpenLink
from rig.backends.registry import Bench
from rig.config import Experiment, load
from rig.control.guard import Guard
from rig.control.loop.real_time import real_time
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.core.faults import Fault
from rig.core.signals import FLAG_SKIPPED
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.recording.sink import NullSink
from rig.running.preflight.room_to_stop import guard_settings_of
from rig.running.session import real_time_of

CONFIGS = {"dynamixel": "servo.yaml", "feetech": "servo-sts3215.yaml"}
TURN_S = 10.0
STANDS_NS = 1_000_000  # a bare loop that is so late was kept from its core
WATCHDOG_S = 0.5  # a run of a real one ends; here ticks are counted

Span = tuple[int, int]  # ns of CLOCK_MONOTONIC


class Gap(NamedTuple):
    """Missed ticks: the tick before, and the one behind; what the one before took, s, and what of it answers took."""

    before: int
    behind: int
    took_s: float
    waited_s: float


class Missing(NullSink):
    """Keeps the ticks that made others be missed.

    link   whose reads are waits for answers
    due_s  when a tick is due, in the clock of ``time.monotonic``
    """

    def __init__(self, link: OpenLink, due_s: Callable[[int], float]) -> None:
        self.gaps: list[Gap] = []
        self.waits_s: list[float] = []  # of each tick
        self._due_s, self._read, self._waited_s, self._last = due_s, link.read, 0.0, Gap(0, 0, 0.0, 0.0)
        link.read = self._timed  # type: ignore[method-assign]  # of this one

    def _timed(self, timeout_s: float) -> bytes:
        begun_s = time.monotonic()
        try:
            return self._read(timeout_s)
        finally:
            self._waited_s += time.monotonic() - begun_s

    def sample(self, *row: object) -> None:
        """A tick's drive is out."""
        tick, flags = row[0], row[8]
        assert isinstance(tick, int) and isinstance(flags, int)
        if flags & FLAG_SKIPPED:
            self.gaps.append(self._last._replace(behind=tick))
        self._last = Gap(tick, tick, time.monotonic() - self._due_s(tick), self._waited_s)
        self.waits_s.append(self._waited_s)
        self._waited_s = 0.0

    def is_of_the_bus(self, gap: Gap, period_s: float) -> bool:
        """Whether no tick would have been missed, had the answers come as they mostly do."""
        return gap.took_s - gap.waited_s + statistics.median(self.waits_s) < period_s


def stood(blocks: Sequence[Block]) -> list[Span]:
    """When a bare loop was kept from its core."""
    told = [block.ticks for block in blocks if block.ticks is not None]
    return [
        (int(due_ns), int(due_ns + late_ns))
        for ticks in told
        for due_ns, late_ns in zip(ticks.due_ns, ticks.late_ns, strict=True)
        if late_ns > STANDS_NS
    ]


class Counts:
    """What came of the turns under one condition."""

    def __init__(self) -> None:
        self.ticks = self.missed = self.of_the_bus = self.while_no_bare_loop_stood = self.own = 0
        self.bare_ticks = self.bare_missed = 0
        self.bare_longest_late_ms = 0.0
        self.faults: list[str] = []

    def gap(self, gap: Gap, *, is_of_the_bus: bool, stood: bool) -> None:
        """Ticks that were missed; ``stood``: a bare loop was kept from its core meanwhile."""
        count = gap.behind - gap.before - 1
        self.while_no_bare_loop_stood += count * (not stood)
        self.of_the_bus += count * (not stood and is_of_the_bus)
        self.own += count * (not stood and not is_of_the_bus)

    def bare(self, blocks: Sequence[Block]) -> None:
        """What the bare loops did in a turn."""
        self.bare_ticks += sum(block.late_us.size for block in blocks)
        self.bare_missed += sum(block.skipped or 0 for block in blocks)
        longest_ms = 1e-3 * max(float(block.late_us.max()) for block in blocks)
        self.bare_longest_late_ms = max(self.bare_longest_late_ms, round(longest_ms, 2))


def turn(experiment: Experiment, bench: Bench, peers: Sequence[TickingProcess], counts: Counts) -> None:
    """One turn of the loop, and of the bare ones beside it."""
    period_s, ticks = experiment.period_s, round(TURN_S / experiment.period_s)
    link = getattr(bench.driver, "_transport", None)
    assert isinstance(link, OpenLink)
    guard, zero_s = Guard(guard_settings_of(experiment)), 0.0
    guard.sign_proven = True
    record = Missing(link, lambda tick: zero_s + period_s * tick)
    loop = Loop(bench.driver, bench.clock, guard, record, period_s, StopRequest(StopFlag.unseen()))
    zero_s = bench.clock.now_s() - loop.now_s
    with ThreadPoolExecutor(len(peers)) as pool:
        beside = [pool.submit(peer.run, ticks, round(1e6 * period_s)) for peer in peers]
        try:
            with loop.armed(experiment.device.arming):
                loop.run(Limited(BareRelay(), ticks), "relay-1")
        except Fault as fault:
            counts.faults.append(f"{fault.code}: {fault.detail}")
        finally:
            loop.close()  # else it reads on, between the next one's exchanges
            del link.read
        blocks = [one.result() for one in beside]
    spans = stood(blocks)
    counts.bare(blocks)
    counts.ticks += loop.statistics.ticks
    counts.missed += loop.statistics.skipped
    for gap in record.gaps:
        begin_ns, end_ns = (round(1e9 * (zero_s + period_s * tick)) for tick in (gap.before, gap.behind))
        has_stood = any(from_ns < end_ns and to_ns > begin_ns for from_ns, to_ns in spans)
        counts.gap(gap, is_of_the_bus=record.is_of_the_bus(gap, period_s), stood=has_stood)


def measured(config: str, turns: int) -> dict[str, Any]:
    """Ticks that ran and were missed, with the kernel's workers as usual and raised, turn by turn."""
    experiment = load(CONFIG / config)
    daq = experiment.daq.model_copy(update={"watchdog_s": WATCHDOG_S, "timeout_s": 0.1})
    experiment = experiment.model_copy(update={"daq": daq})
    priority = PRIORITY["fifo"] if fifo_is_allowed() else 0
    conditions = {"workers_as_usual": (False, Counts()), "workers_raised": (True, Counts())}
    refused: list[str] = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        bench = stack.enter_context(in_real_time(experiment))
        c_loop = build("wake_up_loop", Path(folder))
        cores = range(os.cpu_count() or 1)
        peers = [TickingProcess(["taskset", "-c", str(k), c_loop, str(priority), str(SPIN_US)]) for k in cores]
        for peer in peers:
            stack.callback(peer.close)
            peer.run(5, 1000)  # first pages
        for _ in range(turns):
            for raises, counts in conditions.values():
                with real_time(replace(real_time_of(experiment), raise_workers=raises)) as done:
                    turn(experiment, bench, peers, counts)
                refused = done.refused
    return {"refused": refused, **{name: vars(counts) for name, (_, counts) in conditions.items()}}


def main() -> int:
    """Both protocols, one after the other."""
    parser = options("Missed ticks of a servo's loop beside bare loops.")
    parser.add_argument("--minutes", type=float, default=0.5, help="of each protocol and condition")
    arguments = parser.parse_args()
    turns = max(round(60.0 * arguments.minutes / TURN_S), 1)
    result: dict[str, object] = {"fifo": fifo_is_allowed(), "cores": os.cpu_count()}
    result |= {protocol: measured(config, turns) for protocol, config in CONFIGS.items()}
    tell(result, as_json=arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
