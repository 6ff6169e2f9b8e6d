"""Ticks that the loop on an emulated servo's bus misses, beside bare C loops that do nothing, at once and in one run.

PYTHONPATH=tools python -m bench.servo_loop [--json] [--minutes M]

A machine that stands still makes every loop miss ticks. So on each core a C loop (`peers/wake_up_loop.c`) of the same
period, policy and spin sleeps and wakes at the same time: a tick that ours misses while one of them was late is the
machine's. What is left is ours, and that of the emulated servo and its pseudo-terminal, which have the ordinary
priority: other programs must rest.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from bench.benchmark import options, tell
from bench.late_ticks import Block
from bench.tick import CONFIG, BareRelay, Limited, in_real_time
from bench.wake_up import PRIORITY, SPIN_US, TickingProcess, build, fifo_is_allowed
from rig.config import load
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


class Missing(NullSink):
    """Keeps the numbers of the ticks that ran behind missed ones."""

    def __init__(self) -> None:
        self.gaps: list[tuple[int, int]] = []  # the tick before, and the one behind
        self._last = 0

    def sample(self, *row: object) -> None:
        """Keep that."""
        tick, flags = row[0], row[8]
        assert isinstance(tick, int) and isinstance(flags, int)
        if flags & FLAG_SKIPPED:
            self.gaps.append((self._last, tick))
        self._last = tick


def stood(blocks: Sequence[Block]) -> list[Span]:
    """When a bare loop was kept from its core."""
    told = [block.ticks for block in blocks if block.ticks is not None]
    return [
        (int(due_ns), int(due_ns + late_ns))
        for ticks in told
        for due_ns, late_ns in zip(ticks.due_ns, ticks.late_ns, strict=True)
        if late_ns > STANDS_NS
    ]


def measured(config: str, turns: int) -> dict[str, Any]:
    """Ticks that ran and were missed: ours, while no bare loop stood still, too; and theirs, of each core."""
    experiment = load(CONFIG / config)
    daq = experiment.daq.model_copy(update={"watchdog_s": WATCHDOG_S, "timeout_s": 0.1})
    experiment = experiment.model_copy(update={"daq": daq})
    period_s, cores = experiment.period_s, range(os.cpu_count() or 1)
    ticks, priority = round(TURN_S / period_s), PRIORITY["fifo"] if fifo_is_allowed() else 0
    found: dict[str, Any] = dict.fromkeys(("ticks", "missed", "missed_while_no_bare_loop_stood"), 0)
    found |= {"bare_ticks": 0, "bare_missed": 0, "bare_longest_late_ms": 0.0, "faults": []}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        bench = stack.enter_context(in_real_time(experiment))
        c_loop = build("wake_up_loop", Path(folder))
        peers = [TickingProcess(["taskset", "-c", str(k), c_loop, str(priority), str(SPIN_US)]) for k in cores]
        pool = stack.enter_context(ThreadPoolExecutor(len(peers)))
        for peer in peers:
            stack.callback(peer.close)
            peer.run(5, 1000)  # first pages
        found["refused"] = list(stack.enter_context(real_time(real_time_of(experiment))).refused)
        for _ in range(turns):
            guard, record = Guard(guard_settings_of(experiment)), Missing()
            guard.sign_proven = True
            loop = Loop(bench.driver, bench.clock, guard, record, period_s, StopRequest(StopFlag.unseen()))
            zero_ns = round(1e9 * (bench.clock.now_s() - loop.now_s))
            beside = [pool.submit(peer.run, ticks, round(1e6 * period_s)) for peer in peers]
            try:
                with loop.armed(experiment.device.arming):
                    loop.run(Limited(BareRelay(), ticks), "relay-1")
            except Fault as fault:
                found["faults"].append(f"{fault.code}: {fault.detail}")
            finally:
                loop.close()  # else it reads on, between the next one's exchanges
            blocks = [one.result() for one in beside]
            spans = stood(blocks)
            found["ticks"] += loop.statistics.ticks
            found["missed"] += loop.statistics.skipped
            for before, behind in record.gaps:
                begin_ns, end_ns = (round(zero_ns + 1e9 * period_s * tick) for tick in (before, behind))
                if not any(from_ns < end_ns and to_ns > begin_ns for from_ns, to_ns in spans):
                    found["missed_while_no_bare_loop_stood"] += behind - before - 1
            found["bare_ticks"] += sum(block.late_us.size for block in blocks)
            found["bare_missed"] += sum(block.skipped or 0 for block in blocks)
            longest_ms = 1e-3 * max(float(block.late_us.max()) for block in blocks)
            found["bare_longest_late_ms"] = max(found["bare_longest_late_ms"], round(longest_ms, 2))
    found["missed_per_missed_of_a_bare_loop"] = (
        round(found["missed"] * len(peers) / found["bare_missed"], 2) if found["bare_missed"] else None
    )
    return found


def main() -> int:
    """Both protocols, one after the other."""
    parser = options("Missed ticks of a servo's loop beside bare loops.")
    parser.add_argument("--minutes", type=float, default=0.5, help="of each protocol")
    arguments = parser.parse_args()
    turns = max(round(60.0 * arguments.minutes / TURN_S), 1)
    result: dict[str, object] = {"fifo": fifo_is_allowed(), "cores": os.cpu_count()}
    result |= {protocol: measured(config, turns) for protocol, config in CONFIGS.items()}
    tell(result, as_json=arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
