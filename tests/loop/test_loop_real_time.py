"""The process set up for real time as far as the machine allows, and a clock that sleeps, spins and hears signals."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from processes import PLAIN_RIG

from rig.backends.clock import MonotonicClock
from rig.control.loop.real_time import RealTimeSettings, real_time

ROOT = Path(__file__).resolve().parents[2]


def as_nobody(code: str) -> str:
    """What ``code`` prints in a process that may neither have real-time priority nor lock memory."""
    preamble = """
import os, resource
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
if os.getuid() == 0:
    os.setgid(65534)
    os.setuid(65534)
from rig.control.loop.real_time import RealTimeSettings, real_time
"""
    # rig is imported before the process may no longer read this folder
    command = [sys.executable, "-c", f"import rig.control.loop.real_time\n{preamble}\n{code}"]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def test_what_is_refused_is_said_in_one_line_each_with_what_to_type() -> None:
    told = as_nobody("""
with real_time(RealTimeSettings(priority=60, cpu=4000, raise_workers=True)) as done:
    print(*done.refused, sep="\\n")
    print("granted", done.granted)
    print("policy", os.sched_getscheduler(0))
""").splitlines()
    core, memory, scheduler, workers, granted, policy = told
    assert core.startswith("core 4000 refused (Invalid argument): set loop.cpu to one of 0")
    assert memory.startswith("locked memory refused (")
    assert "put `@realtime - memlock unlimited` in /etc/security/limits.conf, join that group: " in memory
    assert memory.endswith("`sudo groupadd -f realtime; sudo adduser $USER realtime`, log in again")
    assert scheduler.startswith("SCHED_FIFO refused (Operation not permitted): put `@realtime - rtprio 90`")
    assert workers == "raised kernel workers refused (Operation not permitted): only root may have them"
    assert granted == "granted []"
    assert policy == f"policy {os.SCHED_OTHER}"


def test_nothing_asked_for_nothing_said() -> None:
    before = os.sched_getscheduler(0)  # with what an earlier run has left: the flag of SCHED_RESET_ON_FORK stays set
    with real_time(RealTimeSettings(priority=0, lock_memory=False)) as done:
        assert (done.granted, done.refused) == ([], [])
        assert os.sched_getscheduler(0) == before
        assert before & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


def test_the_core_is_kept_within_the_block_and_given_back() -> None:
    cores = os.sched_getaffinity(0)
    core = max(cores)
    with real_time(RealTimeSettings(priority=0, cpu=core, lock_memory=False)) as done:
        assert done.granted == [f"on core {core}"]
        assert os.sched_getaffinity(0) == {core}
    assert os.sched_getaffinity(0) == cores


class Machine:
    """Grants everything and keeps what it was asked for."""

    def __init__(self) -> None:
        self.scheduler: tuple[int, int] = (os.SCHED_OTHER, 0)
        self.locked = False
        self.asked: list[tuple[int, int]] = []

    def setscheduler(self, pid: int, policy: int, parameter: os.sched_param) -> None:
        self.scheduler = policy, parameter.sched_priority
        self.asked.append(self.scheduler)

    def mlockall(self, flags: int) -> int:
        self.locked = True
        return 0

    def munlockall(self) -> int:
        self.locked = False
        return 0

    def prctl(self, *arguments: object) -> int:
        return 0


def test_an_exception_in_the_block_gives_everything_back(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine()
    monkeypatch.setattr(os, "sched_setscheduler", machine.setscheduler)
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: machine.scheduler[0])
    monkeypatch.setattr(ctypes, "CDLL", lambda *a, **k: machine)
    with pytest.raises(ZeroDivisionError), real_time(RealTimeSettings(priority=42)) as done:
        assert machine.scheduler == (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 42)
        assert machine.locked
        assert done.granted == ["memory locked", "SCHED_FIFO at priority 42"]
        raise ZeroDivisionError
    # the flag that keeps children ordinary stays: a user may not take it back, and it does nothing to this process
    assert machine.scheduler == (os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)
    assert not machine.locked


def test_refusals_reach_meta_result_and_the_user(tmp_path: Path) -> None:
    config = yaml.safe_load((ROOT / "config" / "demo.yaml").read_text())
    config["daq"]["port"] = "emulated-realtime"
    config["loop"] = {"cpu": 4000, "spin_us": 50.0}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
    jog = ("jog", str(tmp_path / "config.yaml"), "--u-V", "0.1", "--seconds", "0.2", "--out", str(tmp_path))
    done = subprocess.run([sys.executable, "-c", PLAIN_RIG, *jog], cwd=ROOT, capture_output=True, text=True)
    (folder,) = (path.parent for path in tmp_path.glob("*/meta.json"))
    refused = json.loads((folder / "meta.json").read_text())["real_time"]["refused"]
    (line,) = (line for line in refused if line.startswith("core 4000 refused (Invalid argument)"))
    result = json.loads((folder / "result.json").read_text())
    assert result["loop"]["real_time"]["refused"] == refused
    assert f"loop: {line}" in result["notes"]
    assert f"loop: {line}" in done.stdout.splitlines()
    for part in ("late_us", "io_us", "compute_us", "write_us", "record_us"):
        assert result["loop"][part]["p50"] is not None


def test_sleep_tells_when_it_was_over_and_the_spin_ends_at_the_time_not_before() -> None:
    for spin_s in (0.0, 0.0005, 0.01):
        clock = MonotonicClock(spin_s)
        for _ in range(10):
            due_s = clock.now_s() + 0.002
            over_s = clock.sleep_until(due_s)
            assert due_s <= over_s <= clock.now_s()
        past_s = clock.now_s()
        assert clock.sleep_until(past_s - 1.0) >= past_s  # at once, and the true time


def test_a_spin_sleeps_before_it_spins() -> None:
    clock = MonotonicClock(0.001)
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    for _ in range(20):
        clock.sleep_until(clock.now_s() + 0.003)
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before >= 18


@pytest.mark.parametrize("spin_s", [0.0, 0.0005])
def test_a_signal_while_it_sleeps_ends_the_sleep(spin_s: float) -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGALRM, lambda number, frame: heard.append(number))
    try:
        clock = MonotonicClock(spin_s)
        due_s = clock.now_s() + 60.0
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        assert clock.sleep_until(due_s) < due_s
        assert heard == [signal.SIGALRM]
    finally:
        signal.signal(signal.SIGALRM, before)


def test_a_signal_while_it_spins_is_handled_in_the_spin() -> None:
    """Ctrl-C works while the clock spins: the handler runs in it, and what it raises comes out."""

    class Interrupted(Exception):
        pass

    def interrupt(number: int, frame: object) -> None:
        raise Interrupted

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        clock = MonotonicClock(60.0)  # spins from the beginning
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        with pytest.raises(Interrupted):
            clock.sleep_until(time.monotonic() + 50.0)
    finally:
        signal.signal(signal.SIGALRM, before)


def test_a_sleep_that_the_system_refuses_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    class Library:
        def clock_nanosleep(self, *arguments: object) -> int:
            return errno.EINVAL

    clock = MonotonicClock()
    monkeypatch.setattr(clock, "_libc", Library())
    with pytest.raises(OSError, match="clock_nanosleep"):
        clock.sleep_until(clock.now_s() + 1.0)
    assert ctypes.sizeof(clock._timespec) == 16
