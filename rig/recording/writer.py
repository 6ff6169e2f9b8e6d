"""The writer process: takes rows and events out of shared memory and appends them to the run folder.

Started by ``recorder.Recorder`` as ``python -m rig.recording.writer MEMORY PARENT CAPACITY_ROWS CAPACITY_EVENT_BYTES
FOLDER STAGE...``; MEMORY is a descriptor, or the path of a file. Its standard input is a pipe that nobody writes to:
its end says that the loop's process has closed the record or is gone; then whatever is in the memory is written, the
row still open included, and the process ends.

A disk that takes no more, or fails, costs no row that is in the memory: the file goes on in another one, which begins
with all that was written since the file was last known to be on the disk. ``samples.csv.from-12345`` holds what is to
be in samples.csv from byte 12345 on; it is beside it, or in a new folder where temporary files go. The reader takes
along what is beside it.

It resumes where the files end, so a second writer can finish the work of one that was killed. It keeps some room on the
disk: when the disk is full it says so, and still writes there what is in the memory and what comes until the loop has
ended.
Light on purpose (no numpy, no json): it has to be ready before a motor may move.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from rig.recording import layout
from rig.recording.columns import HEADER, SampleRow, format_row
from rig.recording.end_of_input import EndOfInput, end_of_input
from rig.recording.layout import ROW, SharedMemory

SAMPLES: Final = "samples.csv"
EVENTS: Final = "events.jsonl"

POLL_S: Final = 0.005
SYNC_EVERY_S: Final = 1.0
ROWS_AT_ONCE: Final = 1024
KEPT_BYTES: Final = 1 << 20  # of rows and events that come until the loop has ended, and of result.json
_FULL: Final = (errno.ENOSPC, errno.EDQUOT)
_NAN: Final = float("nan")
_APPEND: Final = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)  # Windows: no carriage returns


class AppendOnlyFile:
    """A file that only grows; what ``write`` returned from survives the death of this process.

    makes_room  asked when writing fails: True where it may be tried again
    elsewhere   folders to go on in where it may not: they are tried in turn; default: none
    moved       told where it goes on, and why
    Raises OSError with the file's name, from every method.
    """

    def __init__(
        self,
        path: Path,
        makes_room: Callable[[OSError], bool] = lambda _: False,
        elsewhere: Callable[[], Iterator[Path]] = lambda: iter(()),
        moved: Callable[[Path, OSError], None] = lambda _, __: None,
    ) -> None:
        self._path = path
        self._name = path.name
        self._makes_room, self._elsewhere, self._moved = makes_room, elsewhere, moved
        self._descriptor = os.open(path, _APPEND, 0o666)
        self._safe_bytes = 0  # known to be on the disk
        self._since = bytearray()  # written after them

    def whole_lines(self) -> tuple[int, int]:
        """Number and bytes of the lines that are there; a torn last line is cut off."""
        status = os.fstat(self._descriptor)
        if not stat.S_ISREG(status.st_mode):
            return 0, 0
        lines = end = position = 0
        os.lseek(self._descriptor, 0, os.SEEK_SET)  # writing is at the end all the same
        while block := os.read(self._descriptor, 1 << 20):
            lines += block.count(b"\n")
            if b"\n" in block:
                end = position + block.rindex(b"\n") + 1
            position += len(block)
        if end < position:
            os.ftruncate(self._descriptor, end)
        self._safe_bytes = end
        return lines, end

    def write(self, data: bytes | memoryview) -> None:
        """Append ``data``, whole lines. Raises OSError, with the file's name, where no place takes it."""
        self._since += data
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[os.write(self._descriptor, rest) :]
            except OSError as error:
                named = self._named(error)
                if not self._makes_room(named):
                    self._go_on_elsewhere(named)
                    return

    def sync(self) -> None:
        """Put what was written on the disk, if anything was since the last time. Raises OSError as ``write``."""
        if not self._since:
            return
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            if error.errno != errno.EINVAL:  # of a pipe, which nothing can be synchronised of
                # what is in the kernel's memory alone may never reach the disk, and nobody is told twice
                self._go_on_elsewhere(self._named(error))
        self._safe_bytes += len(self._since)
        self._since.clear()

    def _go_on_elsewhere(self, error: OSError) -> None:
        """Write what the disk may not have into a new file, and go on there. Raises ``error`` where none takes it."""
        for folder in self._elsewhere():
            path = folder / f"{self._name}.from-{self._safe_bytes}"
            try:
                descriptor = os.open(path, _APPEND | os.O_EXCL, 0o666)
            except OSError:
                continue
            try:
                rest = memoryview(bytes(self._since))
                while rest:
                    rest = rest[os.write(descriptor, rest) :]
                os.fsync(descriptor)
            except OSError:
                os.close(descriptor)
                path.unlink(missing_ok=True)
                continue
            os.close(self._descriptor)
            self._path, self._descriptor = path, descriptor
            self._moved(path, error)
            return
        raise error

    def _named(self, error: OSError) -> OSError:
        return OSError(error.errno, error.strerror, str(self._path))


class KeptRoom:
    """Room on the disk that nobody else gets, for as long as this process lives or until it is given up.

    Raises OSError where there is not so much.
    """

    def __init__(self, folder: Path, size: int) -> None:
        try:
            # without a name: whatever ends this process, nothing is left behind
            self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - it is kept open
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(folder)) from error
        try:
            layout.allocate(self._file.fileno(), size)
        except OSError as error:
            self._file.close()
            raise OSError(error.errno, error.strerror, str(folder)) from error

    def give_up(self) -> None:
        """Let others have it."""
        self._file.close()


class Writer:
    """Moves what the loop has published into the two files.

    Raises OSError where the files cannot be opened (constructor) or written (the rest).
    """

    def __init__(self, shared: SharedMemory, folder: Path, stages: Sequence[str]) -> None:
        self._shared = shared
        self._stages = stages
        self._folder = folder
        files = (AppendOnlyFile(folder / n, self._makes_room, self._elsewhere, self._moved) for n in (SAMPLES, EVENTS))
        self._samples, self._events = files
        self._room: KeptRoom | None = None
        self._serves = False  # before, a failing disk is a refusal
        self._other_folder: Path | None = None
        self._moves: list[tuple[Path, str]] = []
        self._last_t_s = _NAN

    def resume(self) -> None:
        """Start where the files end: at the beginning, or where a killed writer left off."""
        lines, _ = self._samples.whole_lines()
        if lines == 0:
            self._samples.write(HEADER.encode("ascii"))
        _, event_bytes = self._events.whole_lines()
        counters = self._shared.counters
        counters[layout.ROWS_TAKEN] = max(lines - 1, 0)
        counters[layout.EVENT_BYTES_TAKEN] = min(event_bytes, counters[layout.EVENT_BYTES])

    def keep_room(self) -> None:
        """Keep room on the disk, for the day that it is full."""
        self._room = KeptRoom(self._folder, KEPT_BYTES)

    def _makes_room(self, error: OSError) -> bool:
        """Give up the room that was kept, once, and tell the loop to end."""
        room, self._room = self._room, None
        if room is None or error.errno not in _FULL:
            return False
        self._shared.fail(layout.CANNOT_WRITE, _in_words(error))
        room.give_up()
        return True

    def _elsewhere(self) -> Iterator[Path]:
        """Folders that files may go on in."""
        if not self._serves:
            return
        yield self._folder
        with contextlib.suppress(OSError):
            if self._other_folder is None:
                self._other_folder = Path(tempfile.mkdtemp(prefix=f"{self._folder.name}-"))
            yield self._other_folder

    def _moved(self, path: Path, error: OSError) -> None:
        """Tell the loop to end, and where the rest is."""
        self._moves.append((path, _in_words(error)))
        places = "; ".join(f"{why}, so it goes on in {place}" for place, why in self._moves)
        self._shared.fail(layout.MOVED, places)

    def serve(self, is_over: EndOfInput, parent: int) -> None:
        """Write until the loop's side is over, then to the last row."""
        self._serves = True
        counters = self._shared.counters
        next_sync_s = time.monotonic() + SYNC_EVERY_S
        while True:
            # Counters first, data after the wait: on processors that reorder memory accesses the data that a
            # counter announces is certainly there a few milliseconds later.
            completed, opened = counters[layout.ROW_COMPLETED], counters[layout.ROWS_OPENED]
            event_bytes = counters[layout.EVENT_BYTES]
            over = is_over.wait(POLL_S) or os.getppid() != parent
            if over:
                break
            self._write_rows(opened if completed == opened else opened - 1)
            self._write_events(event_bytes)
            if time.monotonic() >= next_sync_s:
                self._sync()
                next_sync_s = time.monotonic() + SYNC_EVERY_S
        self._write_rows(counters[layout.ROWS_OPENED])
        self._write_events(counters[layout.EVENT_BYTES])
        self._write_last_words()
        self._sync()

    def _write_rows(self, end: int) -> None:
        shared = self._shared
        taken = shared.counters[layout.ROWS_TAKEN]
        while taken < end:
            batch_end = min(end, taken + ROWS_AT_ONCE)
            self._samples.write("".join(map(self._line, range(taken, batch_end))).encode("ascii"))
            taken = batch_end
            shared.counters[layout.ROWS_TAKEN] = taken  # from here on the loop may reuse the slots

    def _line(self, number: int) -> str:
        offset = number % self._shared.capacity_rows * ROW.size
        fields = ROW.unpack_from(self._shared.rows, offset)
        tick, seq, t_s, y_rad, counts, v, u_V, z_rad_s, yd_rad, stage, late_us, io_us, flags = fields[:13]
        t_u_s, completed_u_V, completed_flags, completed_as = fields[13:]
        if completed_as == number + 1:
            u_V, flags = completed_u_V, flags | completed_flags
        else:
            t_u_s = _NAN
        self._last_t_s = t_s
        name = self._stages[stage]
        row = SampleRow(tick, seq, t_s, t_u_s, y_rad, counts, v, u_V, z_rad_s, yd_rad, name, late_us, io_us, flags)
        return format_row(row)

    def _write_events(self, end: int) -> None:
        shared = self._shared
        taken = shared.counters[layout.EVENT_BYTES_TAKEN]
        if taken == end:
            return
        size = shared.capacity_event_bytes
        first, last = taken % size, end % size
        if first < last:
            self._events.write(bytes(shared.events[first:last]))
        else:  # around the end of the ring
            self._events.write(bytes(shared.events[first:]) + bytes(shared.events[:last]))
        shared.counters[layout.EVENT_BYTES_TAKEN] = end

    def _write_last_words(self) -> None:
        counters = self._shared.counters
        t_s = "null" if self._last_t_s != self._last_t_s else f"{self._last_t_s:.9f}"
        lost_rows, lost_events = counters[layout.ROWS_LOST], counters[layout.EVENTS_LOST]
        if lost_rows or lost_events:
            text = f'{{"t_s": {t_s}, "kind": "record_lost", "rows": {lost_rows}, "events": {lost_events}}}\n'
            self._events.write(text.encode("ascii"))
        for path, why in self._moves:
            import json  # only now: see above

            text = (
                f'{{"t_s": {t_s}, "kind": "record_moved", "to": {json.dumps(str(path))}, "why": {json.dumps(why)}}}\n'
            )
            self._events.write(text.encode("ascii"))
        if not counters[layout.CLOSED]:
            self._events.write(f'{{"t_s": {t_s}, "kind": "loop_died"}}\n'.encode("ascii"))

    def _sync(self) -> None:
        self._samples.sync()
        self._events.sync()


def main(arguments: Sequence[str]) -> int:
    """Run the writer; exit status 0 done, 1 the reason is in the shared memory."""
    # It ends when the loop does, not when a terminal or a service manager tells the whole group to.
    for name in ("SIGINT", "SIGHUP", "SIGTERM"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    # A loop that runs with real-time priority must not hand that down to its disk writer.
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

    memory = arguments[0]
    descriptor = int(memory) if memory.isdecimal() else os.open(memory, os.O_RDWR | getattr(os, "O_BINARY", 0))
    parent, capacity_rows, capacity_event_bytes = map(int, arguments[1:4])
    folder, stages = Path(arguments[4]), arguments[5:]
    shared = SharedMemory(descriptor, capacity_rows, capacity_event_bytes)
    is_over = end_of_input()
    try:
        writer = Writer(shared, folder, stages)
    except OSError as error:
        shared.fail(layout.CANNOT_OPEN, _in_words(error))
        return 1
    try:
        writer.resume()
        if shared.counters[layout.ROWS_OPENED] == 0:  # else it only finishes what another has begun
            writer.keep_room()
        shared.counters[layout.STATE] = layout.READY
        writer.serve(is_over, parent)
    except OSError as error:
        shared.fail(layout.CANNOT_WRITE, _in_words(error))
        return 1
    return 0


def _in_words(error: OSError) -> str:
    return f"{error.filename}: {error.strerror}" if error.filename else str(error)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
