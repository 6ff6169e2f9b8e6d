"""The record while it is made: nothing is lost, nothing waits, and a dead recorder says so."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import gc
import json
import math
import os
import random
import re
import resource
import select
import shutil
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from evidence import evidence, one_of_each
from processes import wait_until

from rig.core.faults import Fault
from rig.core.memory_file import create_file
from rig.core.signals import Sample
from rig.run_folder.recording import layout
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.sample_columns import COLUMNS, HEADER, KINDS
from rig.run_folder.recording.sink import JsonScalar
from rig.run_folder.recording.writer import AppendOnlyFile, KeptRoom, Writer

STAGES = ("breakaway", "relay-1", "track:sampled-data")

# The loop, killed by the test: says on its standard output which tick it has opened, and the writer's pid first.
LOOP = """
import os, sys, time
from pathlib import Path
from rig.run_folder.recording.recorder import Recorder
from rig.core.signals import Sample
recorder = Recorder(Path(sys.argv[1]), ["relay-1"], capacity_rows=1024)
os.write(1, b"%d\\n" % recorder.writer_pid)
for tick in range(1_000_000):
    recorder.sample(tick, Sample(tick * 0.01, 0.1 * tick, tick % 1024, seq=tick), "relay-1", 0.0, 0.0, 1.0, 0.0, 0.0, 0)
    os.write(1, b"%d\\n" % tick)
    recorder.event(tick * 0.01, "tick", tick=tick)
    recorder.complete(tick * 0.01 + 0.003, 0.5)
    recorder.check()
    time.sleep(0.0005)
"""


def record(recorder: Recorder, ticks: range, stage: str = "relay-1") -> None:
    for tick in ticks:
        t_s = 0.01 * tick
        sample = Sample(t_s, math.sin(t_s), 512 + tick % 7, seq=tick & 0xFFFF)
        recorder.sample(tick, sample, stage, 0.1 * t_s, math.nan, 1.8, 12.5, 1500.25, 1)
        recorder.complete(t_s + 0.0034, 1.7 / 3, 8)


def lines(path: Path) -> list[str]:
    return path.read_text().splitlines()


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    recorder = Recorder(tmp_path, STAGES)
    yield recorder
    recorder.close()


@pytest.fixture
def small(tmp_path: Path) -> Iterator[Recorder]:
    """A recorder with room for 64 rows, whose writer the test may stop or kill."""
    recorder = Recorder(tmp_path, STAGES, capacity_rows=64, capacity_events=8)
    yield recorder
    with contextlib.suppress(ProcessLookupError):
        os.kill(recorder.writer_pid, signal.SIGCONT)
    with contextlib.suppress(Fault):
        recorder.close()


def test_columns_are_those_of_the_architecture() -> None:
    assert tuple(KINDS) == COLUMNS
    assert HEADER == ("tick,seq,t_s,t_u_s,y_rad,y_counts,v_rad_per_s,u_V,z_rad_s,yd_rad,stage,late_us,io_us,flags\n")


def test_what_is_recorded_is_read_back(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES, capacity_rows=64)
    samples = [Sample(k * 0.01 + 1e-9, math.pi * 10.0 ** (k - 6), 900 + k, -math.e / (k + 1), seq=k) for k in range(12)]
    for k, sample in enumerate(samples):
        recorder.sample(2 * k, sample, STAGES[k // 4], 1 / 3 - k, 1e-7 * k, 5.0, 0.125 * k, 1000 + k, 4)
        recorder.complete(sample.t_s + 0.0012, -0.1 * k, 8)
    recorder.close()

    run = read_run(tmp_path)
    for k, sample in enumerate(samples):
        assert run.t_s[k] == pytest.approx(sample.t_s, abs=5.1e-10)
        assert run.t_u_s[k] == pytest.approx(sample.t_s + 0.0012, abs=5.1e-10)
        # exactly, to the last bit:
        assert (run.y_rad[k], run.y_counts[k], run.v_rad_per_s[k]) == sample[1:4]
        assert (run.u_V[k], run.z_rad_s[k], run.yd_rad[k]) == (-0.1 * k, 1 / 3 - k, 1e-7 * k)
        assert (run.tick[k], run.seq[k], run.stage[k], run.flags[k]) == (2 * k, k, STAGES[k // 4], 12)
        assert (run.late_us[k], run.io_us[k]) == (0.125 * k, 1000 + k)


def test_the_open_row_keeps_the_commanded_drive(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES)
    record(recorder, range(3))
    recorder.sample(3, Sample(0.03, 0.5, 1), "relay-1", 0.0, 0.0, 1.25, 0.0, 0.0, 2)
    recorder.close()
    assert lines(tmp_path / "samples.csv")[-1] == "3,0,0.030000000,,0.5,1,,1.25,0.0,0.0,relay-1,0.000,0.000,2"


def test_a_row_never_completed_stays_among_the_others(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES, capacity_rows=8)
    for tick in range(40):  # five times around the ring: a slot's earlier completion must not count again
        recorder.sample(tick, Sample(0.01 * tick, 0.0, 0), "relay-1", 0.0, 0.0, 2.0, 0.0, 0.0, 0)
        if tick % 3 == 0:
            recorder.complete(0.01 * tick + 0.002, 1.0)
        if tick % 4 == 0:
            wait_until(lambda: len(lines(tmp_path / "samples.csv")) >= tick)  # noqa: B023 -- called at once
    recorder.close()
    run = read_run(tmp_path)
    assert list(run.tick) == list(range(40))
    for tick in range(40):
        known = tick % 3 == 0
        assert math.isnan(run.t_u_s[tick]) != known
        assert run.u_V[tick] == (1.0 if known else 2.0)


def test_rows_reach_the_file_while_the_run_goes_on(recorder: Recorder, tmp_path: Path) -> None:
    record(recorder, range(10))
    wait_until(lambda: len(lines(tmp_path / "samples.csv")) == 11)


def test_an_open_row_waits_for_its_completion(recorder: Recorder, tmp_path: Path) -> None:
    """What is in the file does not change any more."""
    record(recorder, range(3))
    recorder.sample(3, Sample(0.03, 0.5, 1), "relay-1", 0.0, 0.0, 1.25, 0.0, 0.0, 0)
    wait_until(lambda: len(lines(tmp_path / "samples.csv")) == 4)
    recorder.event(0.03, "later")
    wait_until(lambda: len(lines(tmp_path / "events.jsonl")) == 1)  # the writer has looked again since
    assert len(lines(tmp_path / "samples.csv")) == 4
    recorder.complete(0.0334, 1.2)
    wait_until(lambda: len(lines(tmp_path / "samples.csv")) == 5)
    assert lines(tmp_path / "samples.csv")[-1].startswith("3,0,0.030000000,0.033400000,0.5,1,,1.2,")


def test_drained_rows_can_be_read_while_the_run_goes_on(recorder: Recorder, tmp_path: Path) -> None:
    record(recorder, range(500))
    recorder.sample(500, Sample(5.0, 0.0, 0), "relay-1", 0.0, 0.0, 0.0, 0.0, 0.0, 0)
    recorder.drain()
    assert len(read_run(tmp_path)) == 500
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    record(recorder, range(501, 502))
    recorder.stall_timeout_s = 0.02
    with pytest.raises(Fault, match=r"has written nothing for 0\.02 s, 2 rows wait"):
        recorder.drain()
    os.kill(recorder.writer_pid, signal.SIGCONT)


def test_the_same_calls_give_the_same_bytes(tmp_path: Path) -> None:
    contents = []
    for name, pause_s in (("a", 0.0), ("b", 0.004)):
        (tmp_path / name).mkdir()
        recorder = Recorder(tmp_path / name, STAGES, capacity_rows=512)
        for k in range(20):
            record(recorder, range(10 * k, 10 * k + 10))
            recorder.event(0.1 * k, "block", k=k)
            time.sleep(pause_s)
        recorder.close()
        contents.append([(tmp_path / name / file).read_bytes() for file in ("samples.csv", "events.jsonl")])
    assert contents[0] == contents[1]


def test_events_keep_their_order_and_types(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES, capacity_events=16)
    expected = []
    for k in range(300):  # many times around the ring, in lines of many lengths
        fields: dict[str, JsonScalar] = {
            "k": k,
            "text": "é\n\"'" * (k % 90),
            "value": k / 3,
            "yes": k % 2 == 0,
            "none": None,
        }
        recorder.event(0.01 * k, "stage", **fields)
        expected.append({"t_s": 0.01 * k, "kind": "stage", **fields})
        if k % 4:
            recorder.check()
        else:
            wait_until(lambda: len(lines(tmp_path / "events.jsonl")) > k)  # noqa: B023
    recorder.event(math.nan, "odd", value=math.inf)
    recorder.close()
    found = [json.loads(line) for line in lines(tmp_path / "events.jsonl")]
    assert found == [*expected, {"t_s": None, "kind": "odd", "value": None}]


def test_wrong_use_is_an_error_in_words(recorder: Recorder) -> None:
    with pytest.raises(ValueError, match=r"'relay-2' is none of breakaway, relay-1"):
        recorder.sample(0, Sample(0.0, 0.0, 0), "relay-2", 0.0, 0.0, 0.0, 0.0, 0.0, 0)
    with pytest.raises(RuntimeError, match="without an open row"):
        recorder.complete(0.0, 0.0)
    record(recorder, range(1))
    with pytest.raises(RuntimeError, match="once a row"):
        recorder.complete(0.0, 0.0)
    with pytest.raises(TypeError, match="field detail is a list"):
        recorder.event(0.0, "fault", detail=[1])  # type: ignore[arg-type]  # a list is refused


@pytest.mark.parametrize("name", ["", "a,b", "relay 1", "x" * 65, "naïve", 'a"'])
def test_stage_names_that_would_break_the_csv_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="stage name"):
        Recorder(tmp_path, ["ok", name])


# -- the end of the loop's process ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, *evidence(2, 3, 4, 5)])
def test_after_kill_9_every_opened_row_is_in_the_file(tmp_path: Path, seed: int) -> None:
    loop = subprocess.Popen([sys.executable, "-c", LOOP, str(tmp_path)], stdout=subprocess.PIPE)
    assert loop.stdout is not None
    loop.stdout.readline()
    rows = random.Random(seed).randrange(1, 400)
    for _ in range(rows):
        last = int(loop.stdout.readline())
    time.sleep(random.Random(seed).random() * 0.002)
    loop.kill()
    loop.wait()
    last = max([last, *map(int, loop.stdout.read().split(b"\n")[:-1])])
    loop.stdout.close()

    wait_until(lambda: any('"loop_died"' in line for line in lines(tmp_path / "events.jsonl")))
    run = read_run(tmp_path)
    # One more than was said may be there: opened, and killed before saying so.
    assert len(run) in (last + 1, last + 2)
    assert list(run.tick) == list(range(len(run)))
    assert not any("torn" in note for note in run.notes)
    assert not any(map(math.isnan, run.t_u_s[:-1]))
    assert set(run.u_V[:-1]) == {0.5}
    assert run.u_V[-1] == (1.0 if math.isnan(run.t_u_s[-1]) else 0.5)
    ticks = [event.detail["tick"] for event in run.events[:-1]]
    assert ticks == list(range(len(ticks)))
    assert len(ticks) >= last
    assert run.events[-1].as_json() == {"t_s": run.t_s[-1], "kind": "loop_died"}


def test_signals_to_the_writer_do_not_end_it(recorder: Recorder, tmp_path: Path) -> None:
    assert os.getsid(recorder.writer_pid) != os.getsid(0)
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        os.kill(recorder.writer_pid, number)
    record(recorder, range(5))
    wait_until(lambda: len(lines(tmp_path / "samples.csv")) == 6)
    recorder.check()


def test_the_writer_goes_with_a_recorder_that_nobody_closed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES)
    record(recorder, range(5))
    descriptor = os.pidfd_open(recorder.writer_pid)
    with pytest.warns(ResourceWarning):
        del recorder
        gc.collect()
    assert select.select([descriptor], [], [], 20)[0], "the writer is still there"
    os.close(descriptor)
    assert len(lines(tmp_path / "samples.csv")) == 6


# -- the end of the writer --------------------------------------------------------------------------------------------


def test_a_killed_writer_is_reported_and_its_rows_are_rescued(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES)
    record(recorder, range(20))
    recorder.event(0.1, "before")
    wait_until(lambda: len(lines(tmp_path / "samples.csv")) == 21)
    os.kill(recorder.writer_pid, signal.SIGKILL)

    def dead() -> bool:
        try:
            recorder.check()
        except Fault as fault:
            assert fault.code == "RECORDER_DEAD"
            assert "killed by signal 9" in fault.detail
            return True
        return False

    wait_until(dead)
    # The loop still brings the motor to rest, and records that.
    record(recorder, range(20, 30))
    recorder.event(0.3, "fault", code="RECORDER_DEAD")
    with (tmp_path / "samples.csv").open("a") as file:
        file.write("20,20,0.2000")  # killed within a line
    recorder.close()
    run = read_run(tmp_path)
    assert list(run.tick) == list(range(30))
    assert [event.kind for event in run.events] == ["before", "fault"]


@pytest.mark.parametrize("kept", [0, 7])
def test_rows_of_a_killed_writer_whose_files_are_cut_too_are_never_others(
    small: Recorder, tmp_path: Path, kept: int
) -> None:
    """The memory holds the last 64 rows and the last events: those are written, the others are said to be lost."""
    for k in range(0, 300, 20):
        record(small, range(k, k + 20))
        small.event(0.01 * k, "cycle", fills="x" * 400)
        small.drain()
    os.kill(small.writer_pid, signal.SIGKILL)
    held = lines(tmp_path / "samples.csv")
    (tmp_path / "samples.csv").write_text("".join(f"{line}\n" for line in held[: 1 + kept]))
    (tmp_path / "events.jsonl").write_text("")
    with pytest.raises(Fault, match=rf"RECORDER_DEAD.*{300 - 64 - kept} rows"):
        small.close()
    assert lines(tmp_path / "samples.csv")[1:] == [*held[1 : 1 + kept], *held[-64:]]
    events = read_run(tmp_path).events
    assert [event.kind for event in events] == ["cycle"] * 9 + ["record_lost"]
    assert [event.t_s for event in events[:-1]] == [pytest.approx(0.2 * k) for k in range(6, 15)]


def test_a_full_disk_is_reported_with_its_reason(small: Recorder, tmp_path: Path) -> None:
    size = (tmp_path / "samples.csv").stat().st_size
    resource.prlimit(small.writer_pid, resource.RLIMIT_FSIZE, (size + 300, size + 300))
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*samples\.csv: File too large"):
        for k in range(4000):
            record(small, range(k, k + 1))
            small.check()
            time.sleep(0.002)
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*File too large.*rows.*lost"):
        small.close()
    # What fitted is readable; the line that did not is torn.
    run = read_run(tmp_path)
    assert 3 <= len(run) < 10
    assert "torn" in run.notes[0]


@pytest.mark.parametrize(
    ("name", "checks", "size"),
    one_of_each(("samples.csv", True, 0), ("events.jsonl", False, 10), ("samples.csv", False, 700)),
)
def test_a_file_that_somebody_cuts_is_written_anew_and_ends_the_run(
    tmp_path: Path, name: str, checks: bool, size: int
) -> None:
    recorder = Recorder(tmp_path, STAGES)
    record(recorder, range(30))
    for k in range(30):
        recorder.event(0.01 * k, "before", k=k)
    recorder.drain()
    os.truncate(tmp_path / name, size)
    words = rf"RECORDER_DEAD.*somebody has cut .*{name} short: what the memory holds of it is written anew"
    if checks:
        with pytest.raises(Fault, match=words):
            for k in range(30, 4000):
                record(recorder, range(k, k + 1))
                recorder.check()
                time.sleep(0.002)
    with pytest.raises(Fault, match=words):
        recorder.close()
    run = read_run(tmp_path)
    assert list(run.tick) == list(range(len(run))) and len(run) >= 30
    assert [event.kind for event in run.events] == ["before"] * 30
    assert run.notes == ("meta.json is missing",)


@pytest.mark.parametrize(
    ("name", "checks", "lose"),
    one_of_each(("samples.csv", True, "delete"), ("events.jsonl", False, "rename"), ("samples.csv", False, "replace")),
)
def test_a_file_that_somebody_deletes_is_written_anew_and_ends_the_run(
    tmp_path: Path, name: str, checks: bool, lose: str
) -> None:
    recorder = Recorder(tmp_path, STAGES)
    record(recorder, range(30))
    recorder.event(0.3, "before")
    recorder.drain()
    if lose == "delete":
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).rename(tmp_path / "away")
    if lose == "replace":
        (tmp_path / name).write_text("of somebody else\n")
    goes_on = f"{name}.from-0" if lose == "replace" else name
    so = f"it goes on in .*{goes_on}" if lose == "replace" else "all of it is written anew"
    words = rf"RECORDER_DEAD.*{name}: somebody has deleted or renamed it, so {so}"
    if checks:
        with pytest.raises(Fault, match=words):
            for k in range(30, 4000):
                record(recorder, range(k, k + 1))
                recorder.check()
                time.sleep(0.002)
    with pytest.raises(Fault, match=words):
        recorder.close()
    if goes_on == "events.jsonl.from-0":  # only rows are joined
        assert '"kind": "before"' in (tmp_path / goes_on).read_text()
        (tmp_path / goes_on).rename(tmp_path / name)
    run = read_run(tmp_path)
    assert list(run.tick) == list(range(len(run))) and len(run) >= 30
    assert run.events[0].kind == "before"


def test_rows_of_a_folder_that_somebody_deletes_are_found_where_the_fault_says(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    recorder = Recorder(folder, STAGES)
    record(recorder, range(30))
    recorder.drain()
    shutil.rmtree(folder)
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*goes on in (\S*samples\.csv)") as lost:
        recorder.close()
    found = re.search(r"in (\S*samples\.csv)", str(lost.value))
    assert found is not None
    assert len(lines(Path(found[1]))) == 31
    shutil.rmtree(Path(found[1]).parent)


def test_a_disk_full_from_the_start_is_reported_before_anything_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The writer itself: its words are what the recorder's fault quotes."""

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    descriptor = create_file(layout.size_of(64, 4096))
    shared = layout.SharedMemory(descriptor, 64, 4096)
    writer = Writer(shared, tmp_path, ["relay-1"])
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match=r"No space left on device.*samples\.csv"):
        writer.resume()
    shared.close()
    os.close(descriptor)


@pytest.mark.parametrize(("put", "said"), [(Path.symlink_to, "is a link"), (Path.hardlink_to, "has another name")])
def test_nothing_is_recorded_into_what_only_has_the_name(
    tmp_path: Path, put: Callable[[Path, Path], None], said: str
) -> None:
    """A folder of runs may be one that others write in, too: the writer itself looks, when it opens."""
    victim = tmp_path / "victim"
    victim.write_text("precious, and no line end")
    for name in ("samples.csv", "events.jsonl"):
        put(tmp_path / name, victim)
        with pytest.raises(OSError, match=said) as told:
            AppendOnlyFile(tmp_path / name)
        assert told.value.filename == str(tmp_path / name)
    assert victim.read_text() == "precious, and no line end"


def test_what_comes_until_the_loop_has_ended_fits_on_a_full_disk(tmp_path: Path) -> None:
    """The writer itself, on a disk that is full until the room that was kept is given up."""
    descriptor = create_file(layout.size_of(64, 4096))
    shared = layout.SharedMemory(descriptor, 64, 4096)
    writer = Writer(shared, tmp_path, ["relay-1"])
    writer.resume()
    writer.keep_room()
    assert [path.name for path in tmp_path.iterdir() if path.name not in ("samples.csv", "events.jsonl")] == []
    full = [OSError(errno.ENOSPC, "No space left on device", "samples.csv")]
    original = os.write

    def write(descriptor: int, data: bytes) -> int:
        if writer._room is not None:
            if len(data) > 100:
                return original(descriptor, data[:100])  # a part of it still fits
            raise full[0]
        return original(descriptor, data)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "write", write)
        writer._samples.write(b"x" * 150)
    assert (tmp_path / "samples.csv").read_bytes().endswith(b"\n" + b"x" * 150)
    assert shared.counters[layout.STATE] == layout.CANNOT_WRITE
    assert shared.reason().endswith("samples.csv: No space left on device")
    assert not writer._makes_room(full[0])  # there is only one
    shared.close()
    os.close(descriptor)


def test_a_disk_without_room_for_the_end_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"File too large|No space left"):
        KeptRoom(tmp_path, 1 << 62)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "taken" / "samples.csv").mkdir(parents=True)
    for folder, reason in (("missing", "No such file"), ("file", "Not a directory"), ("taken", "Is a directory")):
        with pytest.raises(RecordingError, match=reason):
            Recorder(tmp_path / folder, STAGES)


def test_a_folder_with_a_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "samples.csv").write_text(HEADER)
    with pytest.raises(RecordingError, match="already holds a recording"):
        Recorder(tmp_path, STAGES)
    assert (tmp_path / "samples.csv").read_text() == HEADER


# -- a writer that does not keep up -----------------------------------------------------------------------------------


def test_a_stopped_writer_does_not_hold_the_loop_up(recorder: Recorder) -> None:
    def median_ns() -> float:
        times = []
        for tick in range(3000):
            begin = time.perf_counter_ns()
            record(recorder, range(tick, tick + 1))
            times.append(time.perf_counter_ns() - begin)
        return statistics.median(times)

    running = median_ns()
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    stopped = median_ns()
    os.kill(recorder.writer_pid, signal.SIGCONT)
    assert stopped < 10 * running


def test_the_memory_filling_up_is_reported_before_a_row_is_lost(small: Recorder, tmp_path: Path) -> None:
    os.kill(small.writer_pid, signal.SIGSTOP)
    opened = 0
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*57 rows wait to be written, of 64"):
        for tick in range(64):
            record(small, range(tick, tick + 1))
            opened += 1
            small.check()
    os.kill(small.writer_pid, signal.SIGCONT)
    small.close()
    assert len(read_run(tmp_path)) == opened


def test_events_filling_up_are_reported(small: Recorder) -> None:
    os.kill(small.writer_pid, signal.SIGSTOP)
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*bytes of events wait"):
        for k in range(1000):
            small.event(0.0, "x", k=k)
            small.check()


def test_rows_and_events_that_find_no_room_are_counted_and_never_overwrite(small: Recorder, tmp_path: Path) -> None:
    os.kill(small.writer_pid, signal.SIGSTOP)
    record(small, range(100))
    for k in range(200):
        small.event(0.0, "x", text="y" * 100, k=k)
    with pytest.raises(Fault, match="36 rows and"):
        small.check()
    os.kill(small.writer_pid, signal.SIGCONT)
    with pytest.raises(Fault, match="36 rows and"):
        small.close()
    run = read_run(tmp_path)
    assert list(run.tick) == list(range(64))
    lost = run.events[-1].as_json()
    assert (lost["kind"], lost["rows"]) == ("record_lost", 36)
    assert isinstance(lost["events"], int) and len(run.events) - 1 + lost["events"] == 200
    assert [event.detail["k"] for event in run.events[:-1]] == list(range(len(run.events) - 1))


@contextlib.contextmanager
def hanging_disk(folder: Path) -> Iterator[int]:
    """Samples go into a pipe that takes 4 kB and then no more; yields its other end."""
    os.mkfifo(folder / "samples.csv")
    pipe = os.open(folder / "samples.csv", os.O_RDWR | os.O_NONBLOCK)
    fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, 4096)
    try:
        yield pipe
    finally:
        os.close(pipe)


def drained(pipe: int, process: subprocess.Popen[bytes]) -> bytes:
    """Everything that the process writes into the pipe until it ends."""
    data = b""
    while process.poll() is None or select.select([pipe], [], [], 0.0)[0]:
        if select.select([pipe], [], [], 0.01)[0]:
            data += os.read(pipe, 65536)
    return data


def test_a_stopped_writer_is_reported_long_before_the_memory_is_full_and_no_row_is_lost(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES)
    recorder.stall_timeout_s = 0.2
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    opened = 0
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*has written nothing for 0\.2 s, \d+ rows wait"):
        while opened < 60_000:  # 7/8 of what the memory holds are 57,344
            record(recorder, range(opened, opened + 1))
            opened += 1
            recorder.check()
            time.sleep(0.001)
    recorder.close()  # tells it to go on
    assert opened < 10_000
    assert list(read_run(tmp_path).tick) == list(range(opened))


def test_a_run_in_virtual_time_waits_for_the_disk_and_loses_no_row(tmp_path: Path) -> None:
    """A third of a second without a written row, and many times more rows than the memory holds."""
    recorder = Recorder(tmp_path, STAGES, capacity_rows=64, waits=True)
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    goes_on = threading.Timer(0.3, os.kill, (recorder.writer_pid, signal.SIGCONT))
    goes_on.start()
    for k in range(100):
        record(recorder, range(5 * k, 5 * k + 5))
        recorder.check()
    goes_on.join()
    recorder.close()
    assert list(read_run(tmp_path).tick) == list(range(500))


def test_a_disk_that_hangs_ends_a_run_in_virtual_time_too(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES, capacity_rows=64, waits=True)
    recorder.stall_timeout_s = 0.1
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    record(recorder, range(60))
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*has written nothing for 0\.1 s, 60 rows wait"):
        recorder.check()
    recorder.close()


def test_a_pause_without_rows_or_checks_is_no_stall(recorder: Recorder) -> None:
    recorder.stall_timeout_s = 0.1
    for round_ in range(3):
        record(recorder, range(10 * round_, 10 * round_ + 10))
        recorder.check()
        recorder.drain()
        time.sleep(0.15)
        recorder.check()  # nothing waits


def test_closing_lets_a_stopped_writer_go_on(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, STAGES)
    record(recorder, range(5))
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    record(recorder, range(5, 10))
    recorder.close()
    assert len(read_run(tmp_path)) == 10


def test_close_does_not_wait_for_ever(tmp_path: Path) -> None:
    with hanging_disk(tmp_path) as pipe:
        recorder = Recorder(tmp_path, STAGES)
        record(recorder, range(100))
        recorder.close_timeout_s = 0.05
        process = recorder._process
        with pytest.raises(Fault, match=r"RECORDER_DEAD.*not finished within 0\.05 s.*left running"):
            recorder.close()
        data = drained(pipe, process)  # the disk goes on, and then it finishes by itself
    assert data.count(b"\n") == 101


def test_close_twice_is_harmless(small: Recorder) -> None:
    record(small, range(3))
    small.close()
    small.close()
