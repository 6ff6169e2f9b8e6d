"""The witness beside a run in real time: what it takes for a stall of the machine is none of rig's, nor its own."""

from __future__ import annotations

import fcntl
import importlib.util
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest

from shared import witness

SPIN_S = 0.4
SPINS = f"""
import os, time
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(60))
until_s = time.monotonic() + {SPIN_S}
while time.monotonic() < until_s: pass
"""
TRIES = 5

pytestmark = pytest.mark.alone


def spun(cores: int) -> float:
    """The longest stall, s, beside loops of rig's priority that hold every core for SPIN_S."""
    with witness.Witness() as beside:
        loops = [subprocess.Popen([sys.executable, "-I", "-S", "-c", SPINS]) for _ in range(cores)]
        assert all(loop.wait() in (0, 1) for loop in loops)  # 1: no such priority here, and so no spin
        return witness.longest_s(beside.seen())


def test_sums_at_the_priority_of_rigs_loop_are_no_stall_of_the_machine() -> None:
    """A machine that stands still meanwhile for as long is seen, too: not each time."""
    assert any(spun(cores=2) < SPIN_S / 2 for _ in range(TRIES))


def test_what_it_notes_is_more_than_a_pipe_holds(tmp_path: Path) -> None:
    """A write that waits for its reader would be a stall of its own, and the end of what it sees."""
    ticking = noting_every_tick(tmp_path)
    with ticking.Witness() as beside:
        assert beside._process is not None and beside._process.stdout is not None
        holds = fcntl.fcntl(beside._process.stdout, fcntl.F_SETPIPE_SZ, 4096)
        began_s = time.monotonic()
        time.sleep(0.5)
        ended_s = time.monotonic()
        seen = beside.seen()
    last_s = max(stall.began_s for stall in seen)
    assert last_s - began_s > 0.9 * (ended_s - began_s)
    assert sum(len(f"{stall.began_s:.6f} {stall.lasted_s:.6f}\n") for stall in seen) > holds


def noting_every_tick(folder: Path) -> ModuleType:
    """A copy of the witness that takes every tick of a finer grid for a stall."""
    text = Path(witness.__file__).read_text(encoding="utf-8")
    path = folder / "every_tick.py"
    path.write_text(
        text.replace(f"SEEN_S = {witness.SEEN_S:.3f}", "SEEN_S = -1.0").replace("TICK_S = 0.005", "TICK_S = 0.0004"),
        encoding="utf-8",
    )
    spec = importlib.util.spec_from_file_location("every_tick", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.SEEN_S < 0.0 and module.TICK_S < 0.001
    return module
