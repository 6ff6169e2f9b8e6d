"""A law of one's own on the compiled firmware, in virtual time: what it asks for, and what reaches the device's pin."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evidence import evidence
from own_laws import Spring, Stumbles

import rig
from emulated_chips.opening import emulated_chip
from rig import config
from rig.control.law import OwnLaw
from rig.core.signals import FLAG_GUARD_CLIPPED, FLAG_SKIPPED, Sample
from rig.notebook import Run
from rig.testing.devices import VirtualBoard, bench_parameters
from rig.testing.line import on_device

DEMO = config.load(rig.ready("demo"))
MAX_V = DEMO.drive.max_V
UNIT_V = DEMO.drive.supply_V / 799
SOON_S = 1e-3 + DEMO.period_s  # a tick of the device, and one of the loop


class Bench:
    """The demo's board in virtual time; it notes the largest drive at its pin, and when a law asked last."""

    def __init__(self, law: OwnLaw) -> None:
        assert DEMO.emulated is not None
        self.board = VirtualBoard(bench_parameters(DEMO.emulated, DEMO.tachometer), DEMO.seed)
        self.largest_V = 0.0
        self.asked_s = math.nan
        self._law, self._sleep, self._read = law, self.board.sleep_until, self.board.read
        self.board.read = self.read  # type: ignore[method-assign]  # it looks at the pin
        self.yd_rad = getattr(law, "yd_rad", math.nan)

    def read(self, timeout_s: float) -> bytes:
        data = self._read(timeout_s)
        self.largest_V = max(self.largest_V, abs(self.board.truth().pin_V))
        return data

    def step(self, sample: Sample) -> float:
        self.asked_s = self.board.now_s()
        return self._law.step(sample)

    def run(self, folder: Path, duration_s: float = 1.0) -> Run:
        with on_device(self.board):
            return rig.run(rig.ready("demo"), law=self, duration_s=duration_s, out=folder)

    def is_off(self) -> bool:
        """Whether the drive at the pin is 0 V, and the device disarmed."""
        truth = self.board.truth()
        return truth.pin_V == 0.0 and not truth.armed


class AsksFor:
    """A fixed drive at first, and something else from its 30th sample on."""

    def __init__(self, then: Any) -> None:
        self._then = then
        self._ticks = 0

    def step(self, sample: Sample) -> Any:
        self._ticks += 1
        return 0.8 if self._ticks < 30 else self._then


class Slow:
    """A fixed drive; it takes its time at the 30th sample: real time on a bench, the board's own here."""

    def __init__(self, think: Callable[[], object] = lambda: None) -> None:
        self._think = think
        self._ticks = 0

    def step(self, sample: Sample) -> float:
        self._ticks += 1
        if self._ticks == 30:
            self._think()
        return -2.0 * sample.y_rad


@pytest.mark.evidence
def test_it_drives_the_board_and_replays(tmp_path: Path) -> None:
    bench = Bench(Spring())
    run = bench.run(tmp_path, 2.0)
    assert run.failure == "" and run.stages() == ["rest", "breakaway", "law"]
    assert run["law"].y_rad[-1] == pytest.approx(0.3, abs=0.15)  # friction holds it near its place
    assert bench.is_off() and bench.largest_V <= MAX_V + UNIT_V
    assert rig.replay(run, law=Spring()).is_same
    other = rig.replay(run, law=Spring(to_rad=0.2)).difference
    assert other is not None and other.stage == "law"


def test_it_drives_the_chip_and_replays(tmp_path: Path) -> None:
    with on_device(emulated_chip):
        run = rig.run(rig.ready("demo"), law=Spring(), duration_s=0.5, out=tmp_path)
    assert run.failure == "" and len(run["law"]) == pytest.approx(50, abs=2)
    assert rig.replay(run, law=Spring()).is_same


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (Stumbles, "ZeroDivisionError"),
        (lambda: AsksFor(math.nan), "nan V"),
        *evidence((lambda: AsksFor(None), "TypeError"), (lambda: AsksFor(math.inf), "inf V")),
    ],
    ids=["exception", "nan", "nothing", "inf"],
)
def test_a_law_that_fails_leaves_no_drive_at_the_pin(tmp_path: Path, make: Callable[[], OwnLaw], words: str) -> None:
    bench = Bench(make())
    run = bench.run(tmp_path)
    assert run.failure.startswith("LAW_FAILED") and words in run.failure
    assert len(run["law"]) == 30 and run.u_V[-1] == 0.0
    assert bench.is_off() and 0.0 < bench.board.truth().pin_changed_s - bench.asked_s < SOON_S
    assert rig.replay(run, law=make()).is_same


@pytest.mark.parametrize("asked_V", [100.0, *evidence(-100.0)])
def test_a_drive_beyond_the_largest_never_reaches_the_pin(tmp_path: Path, asked_V: float) -> None:
    bench = Bench(AsksFor(asked_V))
    run = bench.run(tmp_path)
    rows = run["law"]
    assert (rows.flags & FLAG_GUARD_CLIPPED).any() and np.abs(rows.u_V).max() <= MAX_V + UNIT_V
    assert MAX_V - UNIT_V <= bench.largest_V <= MAX_V + UNIT_V
    assert np.abs(run.y_rad).max() < DEMO.limits.hard_rad[1] and bench.is_off()
    assert rig.replay(run, law=AsksFor(asked_V)).is_same


def slow_bench(takes_s: float) -> Bench:
    bench: Bench

    def think() -> None:
        bench.board.sleep_until(bench.board.now_s() + takes_s)

    bench = Bench(Slow(think))
    return bench


def test_a_law_that_takes_three_periods_misses_ticks_and_the_run_goes_on(tmp_path: Path) -> None:
    bench = slow_bench(3.2 * DEMO.period_s)
    run = bench.run(tmp_path)
    rows = run["law"]
    assert run.failure == "" and np.count_nonzero(rows.flags & FLAG_SKIPPED) == 1
    assert np.diff(rows.t_s).max() == pytest.approx(4 * DEMO.period_s, abs=DEMO.period_s)
    assert rig.replay(run, law=Slow()).is_same


def test_a_law_that_takes_longer_than_the_watchdog_is_stopped_by_the_device(tmp_path: Path) -> None:
    bench = slow_bench(3 * DEMO.daq.watchdog_s)
    run = bench.run(tmp_path)
    assert "WATCHDOG" in run.failure
    off_s = bench.board.truth().pin_changed_s - bench.asked_s
    assert 0.0 < off_s < DEMO.daq.watchdog_s + SOON_S and bench.is_off()
    assert rig.replay(run, law=Slow()).is_same
