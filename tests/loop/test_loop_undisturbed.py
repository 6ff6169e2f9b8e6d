"""Whatever hangs, fills its pipe or burns a core beside the loop: the loop goes on."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from evidence import evidence
from processes import PLAIN_RIG
from simulated_bench import DEMO, GUARD, LIMITS, PERIOD_S, SCALING, simulated_bench

from rig.backends.clock import MonotonicClock
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.control.guard import Guard
from rig.control.law import Constant, Rest
from rig.control.loop.real_time import real_time
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.core.faults import Fault
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.sink import NullSink, Row

ROOT = Path(__file__).resolve().parents[2]
STAGES = ("rest", "jog")
TICKS = 3000


@contextlib.contextmanager
def stopped(pid: int) -> Iterator[None]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def full_pipe() -> tuple[int, int]:
    """Both ends of a pipe that takes nothing more."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b"." * 4096)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b".")
    os.set_blocking(writing, True)
    return reading, writing


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def command_of(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    return ""


# -- no tick waits for anybody: in virtual time, where the loop itself never sleeps ------------------------------------


def waits_in(ticks: int, record: NullSink | Recorder) -> int:
    """Times that this thread gave its core away by itself while so many ticks ran."""
    bench = simulated_bench()
    bench.loop._record = record
    with bench.loop.armed(LIMITS):
        bench.loop.run(Rest(0.1), "rest")
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
        bench.loop.run(Rest(ticks * PERIOD_S), "rest")
        return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before


@pytest.mark.parametrize("writer", ["running", "stopped"])
def test_no_tick_waits_for_the_recorder(writer: str, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES)
    hold = stopped(recorder.writer_pid) if writer == "stopped" else contextlib.nullcontext()
    with hold:
        waits = waits_in(TICKS, recorder)
    recorder.close()
    assert waits < TICKS // 100  # one wait a tick would be 3000
    assert len(read_run(tmp_path)) >= TICKS


def test_a_wait_in_a_tick_would_be_seen() -> None:
    class Waiting(NullSink):
        def sample(self, *row: object) -> None:
            time.sleep(1e-6)

    assert waits_in(300, Waiting()) > 250


def test_no_tick_waits_for_a_disk_that_takes_nothing(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "samples.csv")
    disk = os.open(tmp_path / "samples.csv", os.O_RDWR | os.O_NONBLOCK)
    fcntl.fcntl(disk, fcntl.F_SETPIPE_SZ, 4096)
    recorder = Recorder(tmp_path, STAGES)
    recorder.close_timeout_s = 0.1
    assert waits_in(TICKS, recorder) < TICKS // 100
    with pytest.raises(Fault, match=r"it still holds \d+ rows and is left running"):
        recorder.close()
    data = b""  # the disk goes on, and every row arrives
    while recorder._process.poll() is None or select.select([disk], [], [], 0.0)[0]:
        if select.select([disk], [], [], 0.01)[0]:
            data += os.read(disk, 65536)
    os.close(disk)
    assert data.count(b"\n") > TICKS


# -- a whole run beside which nobody reads and the progress hangs ------------------------------------------------------


def test_a_run_ends_well_though_its_output_is_full_and_its_progress_hangs(tmp_path: Path) -> None:
    config = yaml.safe_load((ROOT / "config" / "quick.yaml").read_text())
    config["relay"] = {"gains": [{"h1_V": 0.8, "h2_V": 0.9}], "cycles": 4}
    del config["tracking"]
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
    terminal, seen_by_rig = os.openpty()
    reading, writing = full_pipe()
    run = subprocess.Popen(
        [sys.executable, "-c", PLAIN_RIG, "relay", str(tmp_path / "config.yaml"), "--out", str(tmp_path / "runs")],
        stdout=writing,
        stderr=seen_by_rig,
        cwd=ROOT,
    )
    os.close(writing)
    os.close(seen_by_rig)

    def results() -> list[Path]:
        return list((tmp_path / "runs").glob("*/report.html"))

    hung = 0
    while not results():
        assert run.poll() is None, "the run ended without a report"
        for child in children(run.pid):
            if not hung and "rig.run_folder.recording.follow" in command_of(child):
                os.kill(child, signal.SIGSTOP)
                hung = child
        time.sleep(0.002)
    assert hung, "no progress was shown"
    assert json.loads(results()[0].with_name("result.json").read_text())["faults"] == []
    told = b""
    while run.poll() is None or select.select([reading], [], [], 0.0)[0]:
        if select.select([reading], [], [], 0.05)[0]:
            piece = os.read(reading, 65536)
            if not piece:
                break
            told += piece
    assert run.wait(20) == 0
    assert b"backend: simulated" in told
    os.close(reading)
    os.close(terminal)


# -- in real time: late ticks beside a disturbance, against those without it in the same run ---------------------------


class Lateness(NullSink):
    """Counts ticks that woke more than a quarter of a period late, beside a real record."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self.late = self.ticks = 0

    def sample(self, *row: *Row) -> None:
        *_, late_us, _, _ = row
        self.ticks += 1
        self.late += late_us > 0.25e6 * PERIOD_S
        self.recorder.sample(*row)

    def complete(self, t_u_s: float, u_V: float, flags: int = 0) -> None:
        self.recorder.complete(t_u_s, u_V, flags)

    def check(self) -> None:
        self.recorder.check()


def real_time_bench(recorder: Recorder) -> tuple[SimulatedDriver, Loop, Lateness]:
    clock = MonotonicClock(200e-6)
    driver = SimulatedDriver(clock, DEMO, SCALING, SimulatedLatency(0.001, 0.0), 1)
    record = Lateness(recorder)
    return driver, Loop(driver, clock, Guard(GUARD), record, PERIOD_S, StopRequest(StopFlag.unseen())), record


BURN = "while True:\n    [line.split(',') for line in open({path!r})]"


@contextlib.contextmanager
def reader_that_burns_a_core(recorder: Recorder) -> Iterator[None]:
    burner = subprocess.Popen([sys.executable, "-c", BURN.format(path=str(recorder.folder / "samples.csv"))])
    try:
        yield
    finally:
        burner.kill()
        burner.wait()


@contextlib.contextmanager
def stopped_writer(recorder: Recorder) -> Iterator[None]:
    with stopped(recorder.writer_pid):
        yield


@contextlib.contextmanager
def progress_into_a_full_pipe(recorder: Recorder) -> Iterator[None]:
    reading, writing = full_pipe()
    viewer = subprocess.Popen(
        [sys.executable, "-m", "rig.run_folder.recording.follow", str(recorder.folder)],
        stdin=subprocess.PIPE,
        stderr=writing,
    )
    try:
        yield
    finally:
        viewer.kill()
        viewer.communicate()
        os.close(reading)
        os.close(writing)


@contextlib.contextmanager
def busy_thread(recorder: Recorder) -> Iterator[None]:
    over = threading.Event()

    def burn() -> None:
        while not over.is_set():
            sum(range(100))

    thread = threading.Thread(target=burn, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


Disturbance = Callable[[Recorder], contextlib.AbstractContextManager[object]]


def nobody(recorder: Recorder) -> contextlib.nullcontext[None]:
    return contextlib.nullcontext()


@pytest.mark.alone
@pytest.mark.parametrize(
    "disturbance", [reader_that_burns_a_core, *evidence(stopped_writer, progress_into_a_full_pipe)]
)
def test_ticks_are_as_punctual_beside_a_disturbance_and_not_beside_a_thread_of_the_process(
    disturbance: Disturbance, tmp_path: Path
) -> None:
    """Share of late ticks, in turns of half a second."""
    recorder = Recorder(tmp_path, STAGES)
    _, loop, record = real_time_bench(recorder)
    late: dict[Disturbance, float] = dict.fromkeys((nobody, disturbance, busy_thread), 0.0)
    with real_time():
        for beside in 2 * tuple(late):
            record.late = record.ticks = 0
            with beside(recorder), loop.armed(LIMITS):
                loop.run(Rest(0.5), "rest")
            late[beside] += 0.5 * record.late / record.ticks  # what was skipped was late, too
    recorder.close()
    assert late[disturbance] <= late[nobody] + 0.3
    assert late[busy_thread] > late[nobody] + 0.3, "it would be seen"


@pytest.mark.alone
def test_a_writer_that_stays_stopped_ends_the_run_at_zero_drive_with_every_row_kept(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES)
    recorder.stall_timeout_s = 0.3
    driver, loop, record = real_time_bench(recorder)
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*has written nothing for 0\.3 s"), loop.armed(LIMITS):
        loop.run(Constant(0.3, 60.0), "jog")
    assert driver.bench.pin_counts == 0
    recorder.close()
    run = read_run(tmp_path)
    assert len(run) == record.ticks
    assert sorted(run.tick) == list(run.tick)
