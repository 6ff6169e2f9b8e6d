"""The wake-up benchmark's loops run as told, and its figures are what they are called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.wake_up import Block, available, build_c_loop, ratio, start, summary


@pytest.mark.realtime
@pytest.mark.parametrize("loop", available())
def test_each_loop_runs_so_many_ticks_and_none_early(loop: str, tmp_path: Path) -> None:
    running = start(loop, "ordinary", build_c_loop(tmp_path))
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


def test_summary_takes_all_blocks_and_values_that_occurred() -> None:
    blocks = [Block(np.arange(1.0, 51.0), 2), Block(np.arange(51.0, 101.0), 3)]
    assert summary(blocks) == {"ticks": 100, "p50_us": 50.0, "p99_us": 99.0, "max_us": 100.0, "skipped": 5}
    assert summary([Block(np.ones(3), None)])["skipped"] is None


def test_the_ratio_says_nothing_below_the_resolution() -> None:
    def late(p99_us: float) -> dict[str, float | int | None]:
        return {"p99_us": p99_us}

    assert ratio(late(0.09), late(0.03)) == 1.0
    assert ratio(late(3.0), late(0.03)) == 3.0
    assert ratio(late(30.0), late(20.0)) == 1.5
