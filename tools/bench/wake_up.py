"""How late loops wake up: ours, a C loop, cyclictest and loop-rate-limiters, in turn in one run.

PYTHONPATH=tools python -m bench.wake_up [--json] [--minutes M] [--loops ours,C] [--policies fifo]

Blocks of half a second, each loop after the other, so that what else the machine does hits all of them alike: only
ratios are read. Ours and the C loop (`peers/wake_up_loop.c`) have the same policy, the same spin, locked memory and no
timer slack. cyclictest and loop-rate-limiters cannot spin. busy: a process that counts on every core, ordinary policy.

The pair that the goal is for runs again, longer and with a witness (`peers/witness.c`) beside it, by which each late
tick gets a cause: `late_ticks.py`. So do the loops of --loops.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from bench.benchmark import options, tell
from bench.late_ticks import (
    FEWEST_BLOCKS,
    RESOLUTION_US,
    WITNESS_PHASE_US,
    Block,
    Stalls,
    Ticks,
    by_cause,
    machine,
    ratio,
    ratio_interval,
    share_ratio,
    summary,
    verdict,
    while_the_witness_ran,
)
from shared.table import markdown

PEERS = Path(__file__).resolve().parent / "peers"
PRIORITY = {"fifo": 60, "ordinary": 0}
SPIN_US = 200
WITNESS_PRIORITY = 90  # the largest that docs/timing.md and `rig doctor` have people ask for
GOAL = 1.2
BLOCK_S = 0.5
CYCLICTEST_LONGEST_US = 100_000
LOOPS = ("ours, spin", "C, spin", "ours", "C", "cyclictest", "loop-rate-limiters")
PAIR, PAIR_ROUNDS = ("ours, spin", "C, spin"), 50
BURN = """
import os, sys, threading
threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
while True:
    pass
"""


class Answering:
    """A process that answers each line by a line of numbers."""

    def __init__(self, command: Sequence[str]) -> None:
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, line: str) -> list[int]:
        """The answer."""
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(f"{line}\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        if not answer:
            raise RuntimeError(f"{process.args!r} has ended")
        return [int(number) for number in answer.split()]

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()


class TickingProcess(Answering):
    """A loop in a process of its own, that runs when told to."""

    def run(self, ticks: int, period_us: int) -> Block:
        """So many ticks."""
        skipped, columns, *numbers = self.ask(f"{ticks} {period_us}")
        told = np.array(numbers, dtype=np.int64).reshape(-1, columns).T
        return Block(told[0] / 1e3, skipped, Ticks(*told) if columns > 1 else None)


class Witness(Answering):
    """When a core stood still: `peers/witness.c`."""

    def __init__(self, program: str) -> None:
        super().__init__([program, str(WITNESS_PRIORITY), str(WITNESS_PHASE_US)])

    def stalls(self) -> Stalls:
        """Since it was last asked."""
        return Stalls(*np.array(self.ask(""), dtype=np.int64).reshape(-1, 4).T)


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


def build(peer: str, folder: Path) -> str:
    """Compile one of the peers that are C."""
    program, source = folder / peer, PEERS / f"{peer}.c"
    subprocess.run(
        ["cc", "-O2", "-Wall", "-Wextra", "-Werror", "-pthread", str(source), "-o", str(program)], check=True
    )
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


def fifo_is_allowed(priority: int = PRIORITY["fifo"]) -> bool:
    """Whether this user may have SCHED_FIFO."""
    command = ["chrt", "--fifo", str(priority), "true"]
    return subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode == 0


def available() -> tuple[str, ...]:
    """The loops that this user may run: cyclictest starts for nobody who may not have SCHED_FIFO."""
    return LOOPS if fifo_is_allowed() else tuple(loop for loop in LOOPS if loop != "cyclictest")


def steal_ms() -> float:
    """What the host owns up to having taken from all cores so far, ms: counted in hundredths of a second."""
    with Path("/proc/stat").open(encoding="ascii") as file:
        return 1e3 * int(file.readline().split()[8]) / os.sysconf("SC_CLK_TCK")


def measure(
    loops: Sequence[str],
    policies: Sequence[str],
    conditions: Sequence[str],
    period_us: int,
    rounds: int,
    witnessed: bool = False,
) -> dict[str, dict[str, dict[str, object]]]:
    """Condition, policy, loop: its summary, and our ratios to the C loop's; by cause where there is a witness."""
    ticks = round(1e6 * BLOCK_S / period_us)
    blocks: dict[tuple[str, str, str], list[Block]] = {
        (condition, policy, loop): [] for condition in conditions for policy in policies for loop in loops
    }
    took_s, stolen_ms = dict.fromkeys(conditions, 0.0), dict.fromkeys(conditions, 0.0)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        c_loop = build("wake_up_loop", Path(folder))
        running = {(policy, loop): start(loop, policy, c_loop) for policy in policies for loop in loops}
        for process in running.values():
            stack.callback(process.close)
            process.run(5, period_us)  # imports, first pages
        witness = Witness(build("witness", Path(folder))) if witnessed else None
        if witness is not None:
            stack.callback(witness.close)
        for _ in range(rounds):
            for condition in conditions:
                with cores(condition):
                    for (policy, loop), process in running.items():
                        if witness is not None:
                            witness.stalls()  # those before do not belong here
                        begin_s, before_ms = time.monotonic(), steal_ms()
                        block = process.run(ticks, period_us)
                        if witness is not None:
                            block = block._replace(stalls=witness.stalls())
                        blocks[condition, policy, loop].append(block)
                        took_s[condition] += time.monotonic() - begin_s
                        stolen_ms[condition] += steal_ms() - before_ms
    result: dict[str, dict[str, dict[str, object]]] = {}
    for condition in conditions:
        result[condition] = {}
        for policy in policies:
            row: dict[str, object] = {}
            for loop in loops:
                found = blocks[condition, policy, loop]
                row[loop] = summary(found) | (by_cause(found, period_us) if witnessed else {})
            for suffix, name in ((", spin", "spin"), ("", "no_spin")):
                if f"ours{suffix}" in loops and f"C{suffix}" in loops:
                    ours, peer = (blocks[condition, policy, loop + suffix] for loop in ("ours", "C"))
                    row |= compare(ours, peer, name)
                    if witnessed:
                        ours, peer = (while_the_witness_ran(found, period_us) for found in (ours, peer))
                        row |= compare(ours, peer, f"{name}_while_the_witness_ran")
            result[condition][policy] = row
        if witnessed:
            every = [block for key, found in blocks.items() if key[0] == condition for block in found]
            stood = machine(every, took_s[condition], os.cpu_count() or 1)
            result[condition]["machine"] = {**stood, "steal_ms": round(stolen_ms[condition])}
    return result


def compare(ours: Sequence[Block], peer: Sequence[Block], name: str) -> dict[str, object]:
    """The ratio of the p99s, its 95 % interval and what that says; that of late ticks; nothing of too few ticks."""
    a, b = summary(ours)["p99_us"], summary(peer)["p99_us"]
    if a is None or b is None:
        return {}
    if len(ours) < FEWEST_BLOCKS:
        return {f"p99_ratio_{name}": ratio(a, b)}
    interval = ratio_interval(ours, peer)
    found: dict[str, object] = {
        f"p99_ratio_{name}": ratio(a, b),
        f"p99_ratio_{name}_95": interval,
        f"p99_ratio_{name}_at_most_{GOAL}": verdict(interval, GOAL),
    }
    shares = share_ratio(ours, peer)
    if shares is not None:
        found |= {f"later_than_10_us_ratio_{name}": shares[0], f"later_than_10_us_ratio_{name}_95": shares[1]}
    return found


def table(result: dict[str, dict[str, dict[str, object]]]) -> str:
    """For people, as Markdown."""
    rows: list[tuple[str, ...]] = []
    notes = []
    for condition, policies in result.items():
        for policy, row in policies.items():
            for name, found in row.items():
                if not isinstance(found, dict):
                    notes.append(f"{condition}, {policy}: {name} {found}")
                    continue
                values = (found[key] for key in ("ticks", "p50_us", "p99_us", "max_us", "skipped"))
                cells = ("-" if value is None else str(value) for value in values)
                rows.append((f"{condition}, {policy}: {name}", *cells))
                for key in (
                    "late_by_cause",
                    "skipped_by_cause",
                    "skipped_though_the_witness_ran",
                    "p99_while_the_witness_ran_us",
                ):
                    if key in found:
                        notes.append(f"{condition}, {policy}, {name}: {key} {found[key]}")
    head = ("cores, policy, loop", "ticks", "p50 us", "p99 us", "max us", "skipped")
    return "\n".join([markdown(head, rows), "", *notes])


def main() -> int:
    """Measure and print."""
    parser = options("How late loops wake up, side by side.")
    parser.add_argument("--minutes", type=float, default=None, help="of each loop in each condition (default: 3 s)")
    parser.add_argument("--period-us", type=int, default=2000)
    parser.add_argument("--loops", default=None, help="e.g. ours,C: these with a spin only")
    parser.add_argument("--policies", default="fifo,ordinary")
    parser.add_argument("--conditions", default="idle,busy")
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
    witness_allowed = fifo_is_allowed(WITNESS_PRIORITY)
    if not witness_allowed:
        notes.append(
            f"no witness: SCHED_FIFO {WITNESS_PRIORITY} is refused to this user; late ticks have no cause here"
        )
    witnessed = arguments.loops is not None and witness_allowed and set(loops) <= set(PAIR)
    if arguments.period_us % 1000:
        parser.error("--period-us: whole milliseconds, so that the witness keeps beside the ticks")
    result = measure(loops, policies, conditions, arguments.period_us, rounds, witnessed)
    pair = {}
    if arguments.minutes is None and arguments.loops is None and "fifo" in policies:
        pair = measure(PAIR, ["fifo"], conditions, arguments.period_us, PAIR_ROUNDS, witness_allowed)
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
    tell(numbers, as_json=arguments.json, text="\n".join([*notes, *tables]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
