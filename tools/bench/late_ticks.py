"""What made a tick late, and what a ratio of two p99s is worth: the arithmetic of `wake_up.py`.

A tick is looked into when its loop was late by more than LATE_NS, or when its work lasted into the next tick, which was
then skipped. What was lost is the time from due to awake, else from awake to the end of the work. Its cause, the
first of these that accounts for half of it:

machine      the witness was late, too, and mostly because its timer was: nothing ran on its core, not even an
             interrupt; or the kernel kept interrupts off for so long, which looks the same from within
kernel       the witness was late, too, mostly between its timer and its turn, though it goes before all programs: the
             kernel was at something that it does not interrupt, or the machine stood still just then
outranked    the witness was not late, and the loop was ready to run and did not: a task went before it
loop         it waited for a page of memory, or its own work lasted
unexplained  none of these
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CAUSES = ("machine", "kernel", "outranked", "loop", "unexplained")
NOBODYS = (0, 1)  # where even the witness did not run, no program would have
LATE_NS = 250_000  # more than the spin: neither a wake-up from a deep sleep nor an interrupt makes a tick so late
WITNESS_PERIOD_NS = 1_000_000
WITNESS_PHASE_US = 600  # the loops' ticks are due at 500: one tick in a million is this late unseen
FEWEST_TICKS = 500  # of fewer the p99 is one of the five largest
RESOLUTION_US = 1.0  # below it a p99 is the pace of reading the clock, and a ratio of two says nothing of a loop
FEWEST_BLOCKS = 20  # an interval drawn from fewer is too narrow
LATER_US = 10.0
RESAMPLES = 1000

Whole = NDArray[np.int64]


class Ticks(NamedTuple):
    """Of each tick, ns: how late; when due; from due to the end of its work; ready but not running, since the tick
    before; and page faults since then. Arrays of one length.
    """

    late_ns: Whole
    due_ns: Whole
    over_ns: Whole
    queued_ns: Whole
    faults: Whole


class Stalls(NamedTuple):
    """The witness's late instants: core; when due, ns; how late, ns; how much of that it was ready to run, ns."""

    core: Whole
    due_ns: Whole
    late_ns: Whole
    queued_ns: Whole

    @property
    def still_ns(self) -> Whole:
        """How late its timer came, ns."""
        return self.late_ns - self.queued_ns


class Block(NamedTuple):
    """How late each tick was, us; ticks skipped, None where the loop does not say; evidence, where there is some."""

    late_us: NDArray[np.float64]
    skipped: int | None
    ticks: Ticks | None = None
    stalls: Stalls | None = None


class Disturbed(NamedTuple):
    """Ticks looked into: which of the block's, the index of its cause in CAUSES, the ticks that it had skipped."""

    tick: Whole
    cause: Whole
    skipped: Whole


def overlap_ns(core: Whole, from_ns: Whole, to_ns: Whole, begin_ns: int, end_ns: int) -> int:
    """How much of begin to end the intervals of one core cover, ns; of the core where that is most."""
    overlap = np.minimum(to_ns, end_ns) - np.maximum(from_ns, begin_ns)
    return int(np.bincount(core, weights=np.maximum(overlap, 0), minlength=1).max())


def disturbed(block: Block, period_ns: int) -> Disturbed:
    """Look into a block's ticks. The block has evidence."""
    ticks, stalls = block.ticks, block.stalls
    assert ticks is not None and stalls is not None and block.skipped is not None
    skipped = np.append(np.diff(ticks.due_ns) // period_ns - 1, 0)
    skipped[-1] = block.skipped - skipped.sum()
    chosen = np.flatnonzero((ticks.late_ns > LATE_NS) | (skipped > 0))
    causes = []
    for k in chosen:
        waited = ticks.late_ns[k] > LATE_NS
        begin_ns = int(ticks.due_ns[k] + (0 if waited else ticks.late_ns[k]))
        # ours tells its end when the row is written; a tick that skipped others lasted at least into the last of them
        over_ns = max(ticks.over_ns[k], skipped[k] * period_ns)
        end_ns = int(ticks.due_ns[k] + (ticks.late_ns[k] if waited else over_ns))
        # the witness knows nothing of the time before its first instant
        seen_ns = begin_ns + (1000 * WITNESS_PHASE_US - begin_ns) % WITNESS_PERIOD_NS
        timer_ns, ran_ns = stalls.due_ns + stalls.still_ns, stalls.due_ns + stalls.late_ns
        half_ns = max((end_ns - seen_ns) / 2, 1)
        if overlap_ns(stalls.core, stalls.due_ns, ran_ns, seen_ns, end_ns) >= half_ns:
            still_ns = overlap_ns(stalls.core, stalls.due_ns, timer_ns, seen_ns, end_ns)
            queued_ns = overlap_ns(stalls.core, timer_ns, ran_ns, seen_ns, end_ns)
            cause = "machine" if still_ns >= queued_ns else "kernel"
        elif 2 * ticks.queued_ns[k] >= end_ns - begin_ns:
            cause = "outranked"
        elif ticks.faults[k] > 0 or not waited:
            cause = "loop"
        else:
            cause = "unexplained"
        causes.append(CAUSES.index(cause))
    return Disturbed(chosen, np.array(causes, dtype=np.int64), skipped[chosen])


def p99_us(late_us: NDArray[np.float64]) -> float | None:
    """One of the values; None of too few."""
    if late_us.size < FEWEST_TICKS:
        return None
    return round(float(np.quantile(late_us, 0.99, method="inverted_cdf")), 2)


def summary(blocks: Sequence[Block]) -> dict[str, float | int | None]:
    """Quantiles over all blocks, us, and the ticks skipped."""
    late_us = np.concatenate([block.late_us for block in blocks])
    skipped = [block.skipped for block in blocks if block.skipped is not None]
    return {
        "ticks": int(late_us.size),
        "p50_us": round(float(np.quantile(late_us, 0.5, method="inverted_cdf")), 2),
        "p99_us": p99_us(late_us),
        "max_us": round(float(late_us.max()), 2),
        "later_than_10_us": round(float(np.mean(late_us > LATER_US)), 5),
        "skipped": sum(skipped) if skipped else None,
    }


def by_cause(blocks: Sequence[Block], period_us: int) -> dict[str, object]:
    """Late ticks and skipped ticks of each cause; and the p99 without those that no program could have made."""
    late, skipped = np.zeros(len(CAUSES), int), np.zeros(len(CAUSES), int)
    for block in blocks:
        found = disturbed(block, 1000 * period_us)
        waited = block.late_us[found.tick] > LATE_NS / 1000
        late += np.bincount(found.cause[waited], minlength=len(CAUSES))
        skipped += np.bincount(found.cause, weights=found.skipped, minlength=len(CAUSES)).astype(int)
    return {
        "late_by_cause": dict(zip(CAUSES, late.tolist(), strict=True)),
        "skipped_by_cause": dict(zip(CAUSES, skipped.tolist(), strict=True)),
        "skipped_though_the_witness_ran": int(skipped.sum() - skipped[list(NOBODYS)].sum()),
        "p99_while_the_witness_ran_us": summary(while_the_witness_ran(blocks, period_us))["p99_us"],
    }


def while_the_witness_ran(blocks: Sequence[Block], period_us: int) -> list[Block]:
    """The blocks without the ticks that were late while even the witness did not run."""
    found = [disturbed(block, 1000 * period_us) for block in blocks]
    return [
        Block(np.delete(block.late_us, looked.tick[np.isin(looked.cause, NOBODYS)]), None)
        for block, looked in zip(blocks, found, strict=True)
    ]


def machine(blocks: Sequence[Block], duration_s: float, cores: int) -> dict[str, float | int]:
    """How often and for how long the witness did not run, in blocks that took ``duration_s`` together, ms of all cores.

    chance  the share of its instants late enough to account for a late tick: how often that is one by chance
    """
    told = [block.stalls for block in blocks if block.stalls is not None]
    still_ns, queued_ns, late_ns = (
        np.concatenate([getattr(stalls, name) for stalls in told]) for name in ("still_ns", "queued_ns", "late_ns")
    )
    result: dict[str, float | int] = {"of_ms": round(1e3 * duration_s * cores)}
    for name, lost_ns in (("machine", still_ns), ("kernel", queued_ns)):
        long_ns = lost_ns[lost_ns > LATE_NS]
        result[f"{name}_times"] = int(long_ns.size)
        result[f"{name}_ms"] = round(1e-6 * float(long_ns.sum()), 1)
        result[f"{name}_longest_ms"] = round(1e-6 * float(long_ns.max(initial=0)), 1)
    instants = duration_s * cores * 1e9 / WITNESS_PERIOD_NS
    return result | {"chance": round(float(np.count_nonzero(late_ns > LATE_NS / 4) / instants), 4)}


def ratio(ours_us: float, peer_us: float) -> float:
    """Our p99 over the peer's, either at least the resolution."""
    return round(max(ours_us, RESOLUTION_US) / max(peer_us, RESOLUTION_US), 3)


def ratio_interval(ours: Sequence[Block], peers: Sequence[Block]) -> tuple[float, float]:
    """95 % interval of the ratio of the p99s: rounds drawn anew, with repetition, each with its block of either loop.

    Ticks of one block are disturbed together, so that it is the blocks, not the ticks, that are drawn.
    """
    drawn = _draw(len(ours))
    a, b = (np.maximum(_p99_of_drawn(blocks, drawn), RESOLUTION_US) for blocks in (ours, peers))
    return _interval(a / b)


def share_ratio(ours: Sequence[Block], peers: Sequence[Block]) -> tuple[float, tuple[float, float]] | None:
    """Our share of ticks later than LATER_US over the peer's, and its 95 % interval; None where too few are.

    The p99 is on a cliff where about one tick in a hundred is disturbed; the share of them is not.
    """
    a, b = (np.array([np.count_nonzero(block.late_us > LATER_US) for block in blocks]) for blocks in (ours, peers))
    if min(a.sum(), b.sum()) < 20:
        return None
    more = sum(block.late_us.size for block in peers) / sum(block.late_us.size for block in ours)
    drawn = _draw(len(ours))
    return round(float(more * a.sum() / b.sum()), 3), _interval(more * (drawn @ a) / np.maximum(drawn @ b, 1))


def _draw(rounds: int) -> NDArray[np.int64]:
    """How often each round is in each of RESAMPLES draws."""
    return np.random.default_rng(1).multinomial(rounds, np.full(rounds, 1.0 / rounds), size=RESAMPLES)


def _interval(values: NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.quantile(values, [0.025, 0.975])
    return round(float(low), 3), round(float(high), 3)


def _p99_of_drawn(blocks: Sequence[Block], drawn: NDArray[np.int64]) -> NDArray[np.float64]:
    late_us = np.concatenate([block.late_us for block in blocks])
    block_of = np.repeat(np.arange(len(blocks)), [block.late_us.size for block in blocks])
    order = np.argsort(late_us)
    late_us, block_of = late_us[order], block_of[order]
    p99s = []
    for times in drawn:
        up_to = np.cumsum(times[block_of])
        p99s.append(late_us[np.searchsorted(up_to, 0.99 * up_to[-1])])
    return np.array(p99s)


def verdict(interval: tuple[float, float], goal: float) -> str:
    """What the interval says of a ratio that should be at most ``goal``."""
    low, high = interval
    if high <= goal:
        return "held"
    return "missed" if low > goal else "this run cannot tell"
