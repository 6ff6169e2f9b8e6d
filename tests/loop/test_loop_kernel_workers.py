"""The kernel's workers are raised for a run, and given back whatever ends it."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import wait_until

from rig.control.loop import kernel_workers
from rig.control.loop.kernel_workers import PF_KTHREAD, Worker, main, raised_workers, workers

RUN = """
import sys, time
from pathlib import Path
from rig.control.loop.kernel_workers import raised_workers
with raised_workers(7, Path(sys.argv[1])) as said:
    print(*said, flush=True)
    time.sleep(3600)
"""


def put(proc: Path, number: int, name: str, flags: int = PF_KTHREAD | 0x40, start: int = 77) -> None:
    """A folder like /proc with that process: fields of its state as in proc(5), from its number to its start."""
    (proc / str(number)).mkdir(parents=True, exist_ok=True)
    fields = [0] * 30
    fields[6], fields[19] = flags, start
    (proc / str(number) / "stat").write_text(f"{number} ({name}) {' '.join(map(str, fields))}\n", encoding="ascii")


def numbers(proc: Path) -> list[int]:
    return sorted(worker.number for worker in workers(proc))


@pytest.fixture
def worker(tmp_path: Path) -> Iterator[int]:
    """A process of the test's own that a folder in place of /proc calls a worker of the kernel's."""
    with subprocess.Popen(["sleep", "60"]) as process:
        put(tmp_path, process.pid, "kworker/u8:1")
        yield process.pid
        process.kill()


def may_raise(worker: int) -> bool:
    """Whether this user may; leaves it as it was."""
    try:
        os.sched_setscheduler(worker, os.SCHED_FIFO, os.sched_param(7))
    except PermissionError:
        return False
    os.sched_setscheduler(worker, os.SCHED_OTHER, os.sched_param(0))
    return True


def test_only_those_bound_to_no_core_are_meant(tmp_path: Path) -> None:
    for number, name in ((11, "kworker/u8:1-events_unbound"), (12, "kworker/0:1"), (13, "bash"), (14, "kworker/u4:0")):
        put(tmp_path, number, name)
    put(tmp_path / "self", 15, "kworker/u8:2")
    put(tmp_path, 16, "kworker/u8:3) S 2 (", PF_KTHREAD)  # a name may hold brackets
    put(tmp_path, 17, "kworker/u8:4", 0x400000)  # no thread of the kernel's
    put(tmp_path, 18, "x) S 1 0 0 0 -1 2097152 (kworker/u8:5", 0x400000)
    assert numbers(tmp_path) == [11, 14, 16]


RENAMED = """
import ctypes, time
ctypes.CDLL(None).prctl(15, b"kworker/u8:9-fake", 0, 0, 0)  # PR_SET_NAME
print("renamed", flush=True)
time.sleep(60)
"""


def test_a_process_that_calls_itself_a_worker_is_not_touched() -> None:
    """Any process can take that name; the keeper is rig's own, on the machine's own /proc."""
    with subprocess.Popen([sys.executable, "-c", RENAMED], stdout=subprocess.PIPE, text=True) as fake:
        assert fake.stdout is not None
        try:
            assert fake.stdout.readline() == "renamed\n"
            named = Path("/proc", str(fake.pid), "comm").read_text(encoding="ascii")
            assert named.startswith("kworker/u8:9")
            assert fake.pid not in numbers(Path("/proc"))
            assert Worker.of(fake.pid, Path("/proc")) is None
            assert not Worker(fake.pid, 0).schedule(Path("/proc"), os.SCHED_BATCH, 0)  # which anybody may ask for
            assert os.sched_getscheduler(fake.pid) == os.SCHED_OTHER
        finally:
            fake.kill()


def test_a_number_that_has_become_another_process_is_left_alone(worker: int, tmp_path: Path) -> None:
    """Numbers are given out again: neither raised nor given back unless it is what it was."""
    (was,) = workers(tmp_path)
    assert was.schedule(tmp_path, os.SCHED_BATCH, 0)
    assert os.sched_getscheduler(worker) == os.SCHED_BATCH
    put(tmp_path, worker, "kworker/u8:1", start=78)
    assert not was.schedule(tmp_path, os.SCHED_OTHER, 0)
    put(tmp_path, worker, "bash", 0)
    assert not was.schedule(tmp_path, os.SCHED_OTHER, 0)
    assert os.sched_getscheduler(worker) == os.SCHED_BATCH


@pytest.mark.realtime
def test_within_the_block_they_go_first_and_after_it_no_longer(worker: int, tmp_path: Path) -> None:
    allowed = may_raise(worker)
    with raised_workers(7, tmp_path) as (count, refusal):
        assert (count, refusal) == ((1, "") if allowed else (0, "Operation not permitted"))
        assert os.sched_getscheduler(worker) == (os.SCHED_FIFO if allowed else os.SCHED_OTHER)
        assert os.sched_getparam(worker).sched_priority == (7 if allowed else 0)
    assert os.sched_getscheduler(worker) == os.SCHED_OTHER


@pytest.mark.realtime
def test_kill_9_of_the_run_gives_them_back(worker: int, tmp_path: Path) -> None:
    allowed = may_raise(worker)
    with subprocess.Popen([sys.executable, "-c", RUN, str(tmp_path)], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        assert run.stdout.readline().startswith("1" if allowed else "0")
        assert os.sched_getscheduler(worker) == (os.SCHED_FIFO if allowed else os.SCHED_OTHER)
        run.kill()
    wait_until(lambda: os.sched_getscheduler(worker) == os.SCHED_OTHER)


class Scheduler:
    """Grants all but some, and keeps what it was asked for."""

    def __init__(self, *, gone: int = 0, forbidden: int = 0) -> None:
        self.gone, self.forbidden = gone, forbidden
        self.asked: list[tuple[int, int, int]] = []

    def set(self, worker: int, policy: int, parameter: os.sched_param) -> None:
        if worker == self.gone:
            raise ProcessLookupError
        if worker == self.forbidden:
            raise PermissionError(1, "Operation not permitted")
        self.asked.append((worker, policy, parameter.sched_priority))


@pytest.mark.parametrize(
    ("scheduler", "said", "raised"),
    [
        (Scheduler(), "3 \n", [21, 22, 23]),
        (Scheduler(gone=22), "2 \n", [21, 23]),
        (Scheduler(forbidden=22), "1 Operation not permitted\n", [21]),
    ],
)
def test_what_was_raised_is_given_back_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    scheduler: Scheduler,
    said: str,
    raised: list[int],
) -> None:
    for number in (21, 22, 23):
        put(tmp_path, number, "kworker/u8:1")
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(os, "sched_setscheduler", scheduler.set)
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    found = sorted(workers(tmp_path))
    monkeypatch.setattr(kernel_workers, "workers", lambda proc: iter(found))  # in order
    assert main(["59", str(tmp_path)]) == 0
    assert capsys.readouterr().out == said
    first = [(worker, os.SCHED_FIFO, 59) for worker in raised]
    assert scheduler.asked == first + [(worker, os.SCHED_OTHER, 0) for worker in raised]
