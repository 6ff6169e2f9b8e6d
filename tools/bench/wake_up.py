"""How late loops wake up: ours, a C loop, cyclictest and loop-rate-limiters, in turn in one run.

python tools/bench/wake_up.py [--json] [--minutes M] [--loops ours,C] [--policies fifo] [--conditions idle,busy]

Blocks of half a second, each loop after the other, so that what else the machine does hits all of them alike: only
ratios are read. Ours and the C loop (`peers/wake_up_loop.c`) have the same policy, the same spin, locked memory and no
timer slack. cyclictest and loop-rate-limiters cannot spin. busy: a process that counts on every core, ordinary policy.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

PEERS = Path(__file__).resolve().parent / "peers"
PRIORITY = {"fifo": 60, "ordinary": 0}
SPIN_US = 200
RESOLUTION_US = 1.0  # below it a p99 is the pace of reading the clock, and a ratio of two says nothing of a loop
BLOCK_S = 0.5
CYCLICTEST_LONGEST_US = 100_000
LOOPS = ("ours, spin", "C, spin", "ours", "C", "cyclictest", "loop-rate-limiters")
PAIR, PAIR_ROUNDS = ("ours, spin", "C, spin"), 50  # of 600 ticks the p99 is the sixth largest: chance
BURN = """
import os, sys, threading
threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
while True:
    pass
"""


class Block(NamedTuple):
    """How late each tick was, us; ticks skipped, None where the loop does not say."""

    late_us: np.ndarray
    skipped: int | None


class TickingProcess:
    """A loop in a process of its own, that runs when told to."""

    def __init__(self, command: Sequence[str]) -> None:
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, ticks: int, period_us: int) -> Block:
        """So many ticks."""
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(f"{ticks} {period_us}\n")
        process.stdin.flush()
        numbers = process.stdout.readline().split()
        if not numbers:
            raise RuntimeError(f"{process.args!r} has ended")
        return Block(np.array(numbers[1:], dtype=float) / 1e3, int(numbers[0]))

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()


class Cyclictest:
    """Debian's rt-tests; started anew for each block, so that its first ticks are cold."""

    def __init__(self, policy: str) -> None:
        # a priority, even 0, means SCHED_FIFO to it
        self._options = ["--policy=fifo", f"--priority={PRIORITY[policy]}"] if PRIORITY[policy] else ["--policy=other"]

    def run(self, ticks: int, period_us: int) -> Block:
        """So many ticks; cyclictest counts whole us and does not say what it skipped."""
        with tempfile.NamedTemporaryFile(suffix=".json") as file:
            command = ["cyclictest", "--quiet", "--mlockall", "--threads=1", *self._options, f"--json={file.name}"]
            command += [f"--interval={period_us}", f"--loops={ticks}", f"--histogram={CYCLICTEST_LONGEST_US}"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            told = json.load(file)["thread"]["0"]
        counts = {int(late_us): int(number) for late_us, number in told["histogram"].items()}
        late_us = np.repeat(np.array(list(counts), dtype=float), list(counts.values()))
        beyond = ticks - late_us.size  # of the histogram
        return Block(np.concatenate((late_us, np.full(max(beyond, 0), float(told["max"])))), None)

    def close(self) -> None:
        """Nothing runs."""


def build_c_loop(folder: Path) -> str:
    """Compile the C loop."""
    program = folder / "wake_up_loop"
    source = PEERS / "wake_up_loop.c"
    subprocess.run(["cc", "-O2", "-Wall", "-Wextra", "-Werror", str(source), "-o", str(program)], check=True)
    return str(program)


def start(loop: str, policy: str, c_loop: str) -> TickingProcess | Cyclictest:
    """One of LOOPS, ready to run."""
    priority, spin_us = str(PRIORITY[policy]), str(SPIN_US if loop.endswith("spin") else 0)
    if loop == "cyclictest":
        return Cyclictest(policy)
    if loop == "loop-rate-limiters":
        return TickingProcess([sys.executable, str(PEERS / "rate_limiter_loop.py"), priority])
    if loop.startswith("C"):
        return TickingProcess([c_loop, priority, spin_us])
    return TickingProcess([sys.executable, str(PEERS / "our_loop.py"), priority, spin_us])


@contextmanager
def cores(condition: str) -> Iterator[None]:
    """All cores busy for the block, or nothing."""
    number = (os.cpu_count() or 1) if condition == "busy" else 0
    burners = [subprocess.Popen([sys.executable, "-c", BURN], stdin=subprocess.PIPE) for _ in range(number)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


def fifo_is_allowed() -> bool:
    """Whether this user may have SCHED_FIFO."""
    command = ["chrt", "--fifo", str(PRIORITY["fifo"]), "true"]
    return subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode == 0


def available() -> tuple[str, ...]:
    """The loops that this user may run: cyclictest starts for nobody who may not have SCHED_FIFO."""
    return LOOPS if fifo_is_allowed() else tuple(loop for loop in LOOPS if loop != "cyclictest")


def summary(blocks: Sequence[Block]) -> dict[str, float | int | None]:
    """Quantiles over all blocks, us, and the ticks skipped."""
    late_us = np.concatenate([block.late_us for block in blocks])
    p50, p99, largest = np.quantile(late_us, [0.5, 0.99, 1.0], method="inverted_cdf")
    skipped = [block.skipped for block in blocks if block.skipped is not None]
    return {
        "ticks": int(late_us.size),
        "p50_us": round(float(p50), 2),
        "p99_us": round(float(p99), 2),
        "max_us": round(float(largest), 2),
        "skipped": sum(skipped) if skipped else None,
    }


def ratio(ours: dict[str, float | int | None], peer: dict[str, float | int | None]) -> float:
    """Our p99 over the peer's, either at least the resolution."""
    a, b = (max(found["p99_us"] or 0.0, RESOLUTION_US) for found in (ours, peer))
    return round(a / b, 3)


def measure(
    loops: Sequence[str], policies: Sequence[str], conditions: Sequence[str], period_us: int, rounds: int
) -> dict[str, dict[str, dict[str, object]]]:
    """Condition, policy, loop: its summary, and our ratios to the C loop's."""
    ticks = round(1e6 * BLOCK_S / period_us)
    blocks: dict[tuple[str, str, str], list[Block]] = {
        (condition, policy, loop): [] for condition in conditions for policy in policies for loop in loops
    }
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        c_loop = build_c_loop(Path(folder))
        running = {(policy, loop): start(loop, policy, c_loop) for policy in policies for loop in loops}
        for process in running.values():
            stack.callback(process.close)
            process.run(5, period_us)  # imports, first pages
        for _ in range(rounds):
            for condition in conditions:
                with cores(condition):
                    for (policy, loop), process in running.items():
                        blocks[condition, policy, loop].append(process.run(ticks, period_us))
    result: dict[str, dict[str, dict[str, object]]] = {}
    for condition in conditions:
        result[condition] = {}
        for policy in policies:
            found = {loop: summary(blocks[condition, policy, loop]) for loop in loops}
            row: dict[str, object] = dict(found)
            for ours, peer, name in (("ours, spin", "C, spin", "p99_ratio_spin"), ("ours", "C", "p99_ratio_no_spin")):
                if ours in found and peer in found:
                    row[name] = ratio(found[ours], found[peer])
            result[condition][policy] = row
    return result


def table(result: dict[str, dict[str, dict[str, object]]]) -> str:
    """For people, as Markdown."""
    lines = ["| cores, policy, loop | ticks | p50 us | p99 us | max us | skipped |", "|---|---|---|---|---|---|"]
    ratios = []
    for condition, policies in result.items():
        for policy, row in policies.items():
            for name, found in row.items():
                if isinstance(found, dict):
                    skipped = "-" if found["skipped"] is None else found["skipped"]
                    cells = f"{found['ticks']} | {found['p50_us']} | {found['p99_us']} | {found['max_us']} | {skipped}"
                    lines.append(f"| {condition}, {policy}: {name} | {cells} |")
                else:
                    ratios.append(f"{condition}, {policy}: {name} {found}")
    return "\n".join([*lines, "", *ratios])


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="How late loops wake up, side by side.")
    parser.add_argument("--minutes", type=float, default=None, help="of each loop in each condition (default: 3 s)")
    parser.add_argument("--period-us", type=int, default=5000)
    parser.add_argument("--loops", default=None, help="e.g. ours,C: these with a spin only")
    parser.add_argument("--policies", default="fifo,ordinary")
    parser.add_argument("--conditions", default="idle,busy")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rounds = 6 if arguments.minutes is None else max(round(60.0 * arguments.minutes / BLOCK_S), 1)
    loops = available() if arguments.loops is None else tuple(f"{name}, spin" for name in arguments.loops.split(","))
    policies, notes = arguments.policies.split(","), []
    if "fifo" in policies and not fifo_is_allowed():
        policies.remove("fifo")
        notes.append(
            "SCHED_FIFO is refused to this user: `rig doctor` says what to type; without it no cyclictest either"
        )
    conditions = arguments.conditions.split(",")
    result = measure(loops, policies, conditions, arguments.period_us, rounds)
    pair = {}
    if arguments.minutes is None and arguments.loops is None and "fifo" in policies:
        pair = measure(PAIR, ["fifo"], conditions, arguments.period_us, PAIR_ROUNDS)
    numbers = {
        "period_us": arguments.period_us,
        "spin_us": SPIN_US,
        "ratio_resolution_us": RESOLUTION_US,
        "cores": os.cpu_count(),
        "notes": notes,
        **result,
        **({"pair": pair} if pair else {}),
    }
    tables = [table(result), *(["", "Longer, the pair that the goal is for:", "", table(pair)] if pair else [])]
    print(json.dumps(numbers) if arguments.json else "\n".join([*notes, *tables]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
