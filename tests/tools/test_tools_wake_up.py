"""The wake-up benchmark's loops run as told, its figures are what they are called, and known causes are found."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench import late_ticks
from bench.late_ticks import (
    CAUSES,
    LATE_NS,
    WITNESS_PERIOD_NS,
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
from bench.wake_up import PAIR, WITNESS_PRIORITY, TickingProcess, Witness, available, build, fifo_is_allowed, start

PERIOD_NS = 2_000_000
T0_NS = 500_000  # the loops' phase
NO_STALLS = Stalls(*np.zeros((4, 0), dtype=np.int64))


@pytest.fixture(scope="module")
def loop_in_c(tmp_path_factory: pytest.TempPathFactory) -> str:
    return build("wake_up_loop", tmp_path_factory.mktemp("c"))


@pytest.mark.realtime
@pytest.mark.parametrize("loop", [loop for loop in available() if loop not in PAIR])
def test_each_other_loop_runs_so_many_ticks_and_none_early(loop: str, loop_in_c: str) -> None:
    running = start(loop, "ordinary", loop_in_c)
    try:
        blocks = [running.run(20, 2000) for _ in range(2)]
    finally:
        running.close()
    for block in blocks:
        assert block.late_us.min() >= 0.0
        if loop.startswith("C"):  # it counts a tick that it had to skip as one of the twenty
            assert block.late_us.size + (block.skipped or 0) >= 20
        else:
            assert block.late_us.size == 20
        assert (block.skipped is None) == (loop == "cyclictest")
        assert (block.ticks is not None) == loop.startswith(("ours", "C"))


@pytest.mark.realtime
@pytest.mark.parametrize("loop", PAIR)
def test_the_evidence_of_the_pair_belongs_to_their_ticks(loop: str, loop_in_c: str) -> None:
    running = start(loop, "ordinary", loop_in_c)
    assert isinstance(running, TickingProcess)
    try:
        running.run(5, 2000)
        begin_ns = time.monotonic_ns()
        block = running.run(20, 2000)
        end_ns = time.monotonic_ns()
    finally:
        running.close()
    ticks = block.ticks
    assert ticks is not None and block.skipped is not None
    assert block.late_us.min() >= 0.0 and block.late_us.size + block.skipped >= 20
    assert begin_ns < ticks.due_ns[0] and ticks.due_ns[-1] + ticks.over_ns[-1] < end_ns
    assert np.all(np.diff(ticks.due_ns) % PERIOD_NS == 0)
    assert np.sum(np.diff(ticks.due_ns) // PERIOD_NS - 1) <= block.skipped
    assert np.all(ticks.over_ns >= ticks.late_ns)
    assert np.all(ticks.queued_ns >= 0) and np.all(ticks.faults >= 0)


@pytest.mark.alone
def test_the_witness_notes_that_it_stood_still(tmp_path: Path) -> None:
    witness = Witness(build("witness", tmp_path))
    if not fifo_is_allowed(WITNESS_PRIORITY):
        with pytest.raises(RuntimeError, match="has ended"):
            witness.stalls()
        witness.close()
        return
    try:
        witness.stalls()
        time.sleep(0.01)  # its threads are under way
        pid = witness._process.pid
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.03)
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.005)
        stalls = witness.stalls()
    finally:
        witness.close()
    # stopped somewhere between two of its instants
    long = stalls.still_ns > 30_000_000 - 2 * WITNESS_PERIOD_NS
    assert set(stalls.core[long]) == os.sched_getaffinity(0)
    assert np.all(stalls.due_ns % WITNESS_PERIOD_NS == 1000 * WITNESS_PHASE_US)


def ticks_of(
    frozen: list[tuple[int, int]], queued: dict[int, int], slow: dict[int, int], faults: dict[int, int], number: int
) -> Block:
    """A block as a loop and a one-core witness would tell it.

    frozen  when the machine stands still, ns; queued, slow, faults: of the tick due so many periods after the start,
            how long it waits for the core, works, and waits for a page, ns
    """

    def released_ns(t_ns: int) -> int:
        for begin_ns, end_ns in frozen:
            if begin_ns <= t_ns < end_ns:
                return end_ns
        return t_ns

    rows, skipped, k = [], 0, 0
    while k < number:
        due_ns = T0_NS + k * PERIOD_NS
        woke_ns = released_ns(due_ns) + queued.get(k, 0) + faults.get(k, 0)
        over_ns = released_ns(woke_ns + 20_000 + slow.get(k, 0)) - due_ns
        rows.append((woke_ns - due_ns, due_ns, over_ns, queued.get(k, 0), int(k in faults)))
        skipped += over_ns // PERIOD_NS
        k += 1 + over_ns // PERIOD_NS
    stalls = []
    instant_ns = 1000 * WITNESS_PHASE_US
    while instant_ns < T0_NS + number * PERIOD_NS:
        late_ns = released_ns(instant_ns) - instant_ns
        if late_ns > 60_000:
            stalls.append((0, instant_ns, late_ns, 0))
        instant_ns += WITNESS_PERIOD_NS * (1 + late_ns // WITNESS_PERIOD_NS)
    ticks = Ticks(*np.array(rows, dtype=np.int64).T)
    told = Stalls(*np.array(stalls, dtype=np.int64).reshape(-1, 4).T)
    return Block(ticks.late_ns / 1e3, skipped, ticks, told)


def counts(**of_cause: int) -> dict[str, int]:
    """The others are zero."""
    assert set(of_cause) <= set(CAUSES)
    return dict.fromkeys(CAUSES, 0) | of_cause


def test_known_causes_are_found() -> None:
    at = [T0_NS + k * PERIOD_NS for k in range(50)]
    block = ticks_of(
        frozen=[
            (at[3] - 100_000, at[3] + 300_000),  # late
            (at[10] - 900_000, at[10] + 20_500_000),  # late, and the next ten skipped
            (at[30] + 10_000, at[30] + 4_100_000),  # while it worked: awake in time, two skipped
            (at[45] + 400_000, at[45] + 1_500_000),  # between two ticks: nothing
        ],
        queued={24: 2_500_000, 25: 100_000},  # one late, one skipped; the other not worth a look
        slow={36: 6_100_000},  # three skipped
        faults={40: 700_000},
        number=50,
    )
    found = by_cause([block], 2000)
    assert found["late_by_cause"] == counts(machine=2, outranked=1, loop=1)
    assert found["skipped_by_cause"] == counts(machine=10 + 2, outranked=1, loop=3)
    assert found["skipped_though_the_witness_ran"] == 1 + 3
    assert sum(b.late_us.size for b in while_the_witness_ran([block], 2000)) == block.late_us.size - 3


def test_without_a_witness_that_saw_it_a_late_tick_is_not_the_machines() -> None:
    block = ticks_of([(T0_NS - 1000, T0_NS + 900_000)], {}, {}, {}, 5)
    assert by_cause([block], 2000)["late_by_cause"] == counts(machine=1)
    unseen = block._replace(stalls=NO_STALLS)
    assert by_cause([unseen], 2000)["late_by_cause"] == counts(unexplained=1)


def test_a_tick_that_skipped_others_lasted_into_the_last_of_them() -> None:
    # the machine stands still for 12 ms after our loop has told its end, 30 us after the tick was due
    due_ns = T0_NS + PERIOD_NS * np.array([0, 7, 8])
    nothing = np.zeros(3, dtype=np.int64)
    ticks = Ticks(nothing, due_ns, np.full(3, 30_000), nothing, nothing)
    stalls = Stalls(*np.array([[1, 1000 * WITNESS_PHASE_US, 12_000_000, 0]]).T)
    found = by_cause([Block(np.zeros(3), 6, ticks, stalls)], 2000)
    assert found["skipped_by_cause"] == counts(machine=6)


def test_a_witness_that_had_to_queue_accuses_the_kernel_not_the_machine() -> None:
    block = ticks_of([(T0_NS - 1000, T0_NS + 900_000)], {}, {}, {}, 5)
    assert block.stalls is not None and block.ticks is not None
    behind = block.stalls._replace(queued_ns=block.stalls.late_ns)
    waited = block.ticks._replace(queued_ns=block.ticks.late_ns)
    told = by_cause([block._replace(stalls=behind, ticks=waited)], 2000)
    assert told["late_by_cause"] == counts(kernel=1)


def frozen_at(every_10_ms: list[int], phase_ns: int, length_ns: int) -> list[tuple[int, int]]:
    """Where the machine stands still: relative to each fifth tick."""
    begins = [T0_NS + 5 * k * PERIOD_NS + phase_ns for k in sorted(every_10_ms)]
    return [(begin, begin + length_ns) for begin in begins]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(0, 39), unique=True, max_size=4),
    st.integers(-900_000, 900_000),
    st.integers(100_000, 9_000_000),
)
def test_whatever_the_machine_does_it_is_blamed_for(at: list[int], phase_ns: int, length_ns: int) -> None:
    block = ticks_of(frozen_at(at, phase_ns, length_ns), {}, {}, {}, 200)
    late = int(np.sum(block.late_us * 1000 > LATE_NS))
    found = by_cause([block], 2000)
    assert found["late_by_cause"] == counts(machine=late)
    assert found["skipped_by_cause"] == counts(machine=block.skipped or 0)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(0, 39), unique=True, max_size=4),
    st.integers(-900_000, 900_000),
    st.integers(100_000, 3_000_000),
    st.integers(0, 39),
)
def test_the_machine_is_not_blamed_for_the_loops_own_work(
    at: list[int], phase_ns: int, length_ns: int, slow: int
) -> None:
    elsewhere = ticks_of(frozen_at(at, phase_ns, length_ns), {}, {}, {}, 200)
    block = ticks_of([], {}, {5 * slow + 3: 2_500_000}, {}, 200)._replace(stalls=elsewhere.stalls)
    skipped = by_cause([block], 2000)["skipped_by_cause"]
    assert skipped == counts(loop=1)


def test_how_long_the_machine_stood_still() -> None:
    stalls = Stalls(*np.array([[0, 10, 3_000_000, 0], [1, 10, 900_000, 800_000], [1, 20, 500_000, 0]]).T)
    told = machine([Block(np.zeros(1), 0, None, stalls)], duration_s=0.1, cores=2)
    assert (told["machine_times"], told["machine_ms"], told["machine_longest_ms"]) == (2, 3.5, 3.0)
    assert (told["kernel_times"], told["kernel_ms"], told["kernel_longest_ms"]) == (1, 0.8, 0.8)
    assert (told["of_ms"], told["chance"]) == (200, 3 / 200)


def test_summary_takes_all_blocks_and_values_that_occurred() -> None:
    blocks = [Block(np.arange(1.0, 501.0), 2), Block(np.arange(501.0, 1001.0), 3)]
    expected = {
        "ticks": 1000,
        "p50_us": 500.0,
        "p99_us": 990.0,
        "max_us": 1000.0,
        "later_than_10_us": 0.99,
        "skipped": 5,
    }
    assert summary(blocks) == expected
    assert summary([Block(np.ones(499), None)])["skipped"] is None


def test_too_few_ticks_have_no_p99() -> None:
    assert summary([Block(np.ones(499), 0)])["p99_us"] is None
    assert summary([Block(np.ones(499), 0), Block(np.ones(1), 0)])["p99_us"] == 1.0


def test_the_ratio_says_nothing_below_the_resolution() -> None:
    assert ratio(0.09, 0.03) == 1.0
    assert ratio(3.0, 0.03) == 3.0
    assert ratio(30.0, 20.0) == 1.5


def blocks_of(rng: np.random.Generator, number: int, scale_us: float, spread: float) -> list[Block]:
    """Ticks of one block are late together: each has its own scale."""
    return [
        Block(scale_us * np.exp(rng.normal(0.0, spread)) * rng.exponential(1.0, 100), 0, None, None)
        for _ in range(number)
    ]


def test_the_interval_holds_the_true_ratio_as_often_as_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(late_ticks, "RESAMPLES", 250)
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(60):
        low, high = ratio_interval(blocks_of(rng, 40, 40.0, 0.7), blocks_of(rng, 40, 20.0, 0.7))
        held += low <= 2.0 <= high
    # of 60 at 95 %: 51 or more with a probability of 0.999
    assert held >= 51


def test_blocks_that_differ_widen_the_interval_though_the_ticks_are_as_many() -> None:
    rng = np.random.default_rng(4)
    widths = []
    for spread in (0.0, 0.7):
        low, high = ratio_interval(blocks_of(rng, 40, 20.0, spread), blocks_of(rng, 40, 20.0, spread))
        widths.append(high / low)
    assert widths[1] > 1.5 * widths[0]


def test_the_verdict_is_only_given_where_the_run_can_tell() -> None:
    rng = np.random.default_rng(5)
    same, worse = (
        verdict(ratio_interval(blocks_of(rng, 200, scale, 0.1), blocks_of(rng, 200, 20.0, 0.1)), 1.2)
        for scale in (20.0, 30.0)
    )
    assert (same, worse) == ("held", "missed")
    few = ratio_interval(
        *([blocks_of(rng, 1, scale, 0.0)[0] for scale in scales] for scales in ([5, 80, 20], [20, 5, 80]))
    )
    assert verdict(few, 1.2) == "this run cannot tell"


def test_the_share_of_late_ticks_is_compared_with_an_interval() -> None:
    ours = [Block(np.repeat([0.0, 50.0], [190, 10]), 0) for _ in range(30)]
    peer = [Block(np.repeat([0.0, 50.0], [90, 10]), 0) for _ in range(30)]
    assert share_ratio(ours, peer) == (0.5, (0.5, 0.5))
    assert share_ratio(ours, [Block(np.zeros(100), 0) for _ in range(30)]) is None
