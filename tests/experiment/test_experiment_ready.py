"""What is compiled before a device is opened: how far it is, in words."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import pytest

from rig.experiment import ready
from rig.model.compiled import kernel


def test_it_says_that_it_compiles_and_then_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a clock on which each loop takes 2 s."""

    def compile_five(*_: object) -> None:
        for begins in [*kernel._told] * 5:
            begins()

    seconds = count(100.0, 2.0)
    monkeypatch.setattr(ready, "make_fits_ready", compile_five)
    told: list[str] = []
    clock: Callable[[], float] = lambda: next(seconds)  # noqa: E731
    ready.make_ready(told.append, designs=False, clock=clock)
    assert told == [ready.BEGINS, ready.GOES_ON.format(6.0, 4)]


def test_what_is_ready_says_nothing() -> None:
    ready.make_ready(lambda words: None)
    told: list[str] = []
    ready.make_ready(told.append)
    assert told == []
