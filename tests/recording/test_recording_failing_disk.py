"""A disk that fails during a run: the rows in memory go on elsewhere, and read back whole."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rig.core.faults import Fault
from rig.core.memory_file import create_file
from rig.core.signals import Sample
from rig.output.report.source import load
from rig.run_folder.recording import layout
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.layout import ROW, SharedMemory
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.text_file import MOST_PARTS
from rig.run_folder.recording.writer import AppendOnlyFile, Writer

EIO = OSError(errno.EIO, os.strerror(errno.EIO))
OS_WRITE, OS_FSYNC, OS_OPEN = os.write, os.fsync, os.open


class Bench:
    """A writer in this process, and the loop's side of its memory."""

    def __init__(self, folder: Path) -> None:
        self._descriptor = create_file(layout.size_of(64, 4096))
        self.shared = SharedMemory(self._descriptor, 64, 4096)
        self.folder = folder
        self.writer = Writer(self.shared, folder, ["relay-1"])
        self.writer.resume()
        self._rows = 0

    def record(self, rows: int) -> None:
        """Publish rows and an event, and let the writer write and sync them, as at the end of a run."""
        for k in range(self._rows, self._rows + rows):
            t_s = 0.01 * k
            row = (k, k, t_s, 0.1 * k, k, 0.0, 1.0, 0.0, 0.0, 0, 0.0, 0.0, 0, t_s + 0.002, 0.5, 0, k + 1)
            ROW.pack_into(self.shared.rows, k * ROW.size, *row)
        self._rows += rows
        line = f'{{"t_s": 0.0, "kind": "rows", "until": {self._rows}}}\n'.encode()
        counters = self.shared.counters
        written = counters[layout.EVENT_BYTES]
        self.shared.events[written : written + len(line)] = line
        counters[layout.EVENT_BYTES] = written + len(line)
        counters[layout.ROW_COMPLETED] = counters[layout.ROWS_OPENED] = self._rows
        counters[layout.CLOSED] = 1
        is_over = threading.Event()
        is_over.set()
        self.writer.serve(is_over, os.getppid())

    def close(self) -> None:
        self.shared.close()
        os.close(self._descriptor)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    folder = tmp_path / "run"
    folder.mkdir()
    bench = Bench(folder)
    bench.record(5)
    yield bench
    bench.close()


def name_of(descriptor: int) -> str:
    return Path(f"/proc/self/fd/{descriptor}").readlink().name


def failing_write(*names: str) -> Callable[[int, bytes], int]:
    """``os.write`` on a disk that takes 30 bytes more of these files, and then fails."""
    failed: list[str] = []

    def write(descriptor: int, data: bytes) -> int:
        name = name_of(descriptor)
        if name in failed:
            raise EIO
        if name in names:
            failed.append(name)
            return OS_WRITE(descriptor, bytes(data)[:30])
        return OS_WRITE(descriptor, data)

    return write


def test_a_write_error_costs_no_row_and_no_event(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "write", failing_write("samples.csv", "events.jsonl"))
    size = (bench.folder / "samples.csv").stat().st_size
    bench.record(6)
    bench.record(1)
    monkeypatch.undo()
    moved = bench.folder / f"samples.csv.from-{size}"
    assert moved.is_file()
    run = read_run(bench.folder)
    assert run.tick.tolist() == list(range(12))
    assert f"the disk failed: from byte {size} on it is {moved.name}" in run.notes
    assert [event.detail["until"] for event in run.events if event.kind == "rows"] == [5, 11, 12]
    told = [event.as_json() for event in run.events if event.kind == "record_moved"]
    assert (told[0]["to"], told[0]["why"]) == (str(moved), f"{bench.folder / 'samples.csv'}: Input/output error")
    assert bench.shared.counters[layout.STATE] == layout.MOVED
    assert f"samples.csv: Input/output error, so it goes on in {moved}" in bench.shared.reason()
    assert "events.jsonl: Input/output error" in bench.shared.reason()
    shown = load(bench.folder)
    assert shown.recording is not None
    assert len(shown.recording) == 12
    assert len(shown.events) == len(run.events)


def test_rows_that_the_kernel_could_not_put_on_the_disk_are_written_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failed fsync: what was written since the last good one is lost, though every write had succeeded."""
    samples = bench.folder / "samples.csv"
    size = samples.stat().st_size

    def fsync(descriptor: int) -> None:
        if name_of(descriptor) == "samples.csv":
            os.truncate(samples, size + 7)
            raise EIO
        OS_FSYNC(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    bench.record(6)
    monkeypatch.undo()
    assert read_run(bench.folder).tick.tolist() == list(range(11))


def test_rows_are_put_on_the_disk_every_second(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A power cut takes a second of them, not the run. The clock goes a second at each look."""
    synced: list[str] = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(name_of(descriptor)))
    looks = [0.0]

    def later() -> float:
        looks[0] += 1.0
        return looks[0]

    class Over:
        """Over at its fourth look; the loop writes a row at each of the first three."""

        def wait(self, timeout_s: float) -> bool:
            counters = bench.shared.counters
            counters[layout.ROW_COMPLETED] = counters[layout.ROWS_OPENED] = counters[layout.ROWS_OPENED] + 1
            return len(synced) >= 3 or looks[0] > 20.0

    monkeypatch.setattr("rig.run_folder.recording.writer.time.monotonic", later)
    bench.writer.serve(Over(), os.getppid())
    assert synced.count("samples.csv") >= 4  # three in the run, and the last
    assert looks[0] < 20.0


def test_a_second_error_moves_it_once_more(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "write", failing_write("samples.csv"))
    bench.record(4)
    first = next(path.name for path in bench.folder.iterdir() if ".from-" in path.name)
    monkeypatch.setattr(os, "write", failing_write("samples.csv", first))
    bench.record(3)
    monkeypatch.undo()
    assert len([path for path in bench.folder.iterdir() if path.name.startswith("samples.csv.from-")]) == 2
    assert read_run(bench.folder).tick.tolist() == list(range(12))


def test_where_the_folder_takes_no_new_file_it_goes_on_among_the_temporary_ones(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))

    def read_only(path: Path, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        if (dir_fd is not None or Path(path).parent == bench.folder) and flags & os.O_CREAT:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return OS_OPEN(path, flags, mode, dir_fd=dir_fd)

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", failing_write("samples.csv"))
        patch.setattr(os, "open", read_only)
        bench.record(6)
    moved = next((tmp_path / "tmp").glob("run-*/samples.csv.from-*"))
    assert bench.shared.reason().endswith(f"so it goes on in {moved}")
    assert read_run(bench.folder).tick.tolist() == list(range(5))
    shutil.move(moved, bench.folder)
    assert read_run(bench.folder).tick.tolist() == list(range(11))


def test_where_no_place_takes_it_the_error_comes_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = AppendOnlyFile(tmp_path / "a", elsewhere=lambda: iter([tmp_path / "none", tmp_path]))
    file.write(b"one\n")
    file.sync()
    monkeypatch.setattr(os, "write", failing_write("a", "a.from-4"))
    with pytest.raises(OSError, match="Input/output error"):
        file.write(b"two\n" * 20)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_gap_before_the_other_file_is_said(bench: Bench) -> None:
    samples = bench.folder / "samples.csv"
    content = samples.read_bytes()
    lines = content.splitlines(keepends=True)
    cut = len(b"".join(lines[:4]))  # three rows
    end = len(b"".join(lines[:5]))  # the fourth is lost
    (bench.folder / f"samples.csv.from-{end}").write_bytes(b"".join(lines[5:]))
    samples.write_bytes(content[: cut + 9])
    run = read_run(bench.folder)
    assert run.tick.tolist() == [0, 1, 2, 4]
    assert run.notes[:2] == (
        f"the disk failed: from byte {end} on it is samples.csv.from-{end}",
        f"it is torn before that: {end - cut - 9} bytes are lost",
    )


def test_more_parts_than_disks_could_fail_are_refused(bench: Bench) -> None:
    size = (bench.folder / "samples.csv").stat().st_size
    for k in range(MOST_PARTS + 1):
        (bench.folder / f"samples.csv.from-{size + k}").write_bytes(b"x")
    with pytest.raises(RecordingError, match="more than 30 files"):
        read_run(bench.folder)


def test_the_run_ends_and_says_where_the_rest_is(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, ["relay-1"])
    recorder._shared.fail(layout.MOVED, "x: Input/output error, so it goes on in y")
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*goes on in y"):
        recorder.check()
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*goes on in y"):
        recorder.close()


def test_a_writer_that_is_killed_after_the_disk_failed_is_not_followed_by_one_that_hides_the_loss(
    tmp_path: Path,
) -> None:
    """A second one would go on at the end of the first file: the reader takes what is beside it instead."""
    recorder = Recorder(tmp_path, ["relay-1"])
    recorder._shared.fail(layout.MOVED, "x: Input/output error, so it goes on in y")
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    size = (tmp_path / "samples.csv").stat().st_size
    for k in range(2):
        recorder.sample(k, Sample(0.01 * k, 0.1, 5), "relay-1", 0.0, 0.0, 1.0, 0.0, 0.0, 0)
    os.kill(recorder.writer_pid, signal.SIGKILL)
    with pytest.raises(Fault, match=r"RECORDER_DEAD.*goes on in y; 2 rows and 0 bytes of events are lost"):
        recorder.close()
    assert (tmp_path / "samples.csv").stat().st_size == size
