"""Fits on several cores are what they are on one."""

from __future__ import annotations

import os
import threading

import pytest

from rig.identification.side_by_side import FEWEST_ROWS, on_all_cores, side_by_side


def test_they_run_at_once_stay_in_order_and_spread_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2})
    together = threading.Barrier(3)

    def work(item: int) -> tuple[int, bool]:
        together.wait(60.0)  # it ends only where three run at once
        inside = side_by_side(lambda _: threading.current_thread(), range(3), FEWEST_ROWS)
        return item, set(inside) == {threading.current_thread()}

    with on_all_cores():
        assert side_by_side(work, range(6), FEWEST_ROWS) == [(item, True) for item in range(6)]
        short = side_by_side(lambda _: threading.current_thread(), range(3), FEWEST_ROWS - 1)
    alone = side_by_side(lambda _: threading.current_thread(), range(3), FEWEST_ROWS)
    assert set(short) == set(alone) == {threading.current_thread()}


def test_the_first_failure_is_the_one_that_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    with on_all_cores(), pytest.raises(ZeroDivisionError):
        side_by_side(lambda item: 1 // item, (1, 0, 2), FEWEST_ROWS)
