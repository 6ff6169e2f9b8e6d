"""The writer process: it takes rows and events out of shared memory and appends them to the run folder.

Started by ``recorder.Recorder`` as ``python -m rig.run_folder.recording.writer MEMORY PARENT CAPACITY_ROWS
CAPACITY_EVENT_BYTES
FOLDER STAGE...``; MEMORY is a descriptor, or the path of a file. Nobody writes to its standard input. The end of that
pipe says that the loop has closed the recorder, or that its process is gone. Then the writer writes everything that is
in the memory, the open row too, and ends.

If a disk fails, no row in the memory is lost: the file goes on in a second file. This one begins with all rows that may
not be on the failed disk. ``samples.csv.from-12345`` replaces samples.csv from byte 12345 on. It is beside samples.csv,
or in a new folder for temporary files. The reader joins the parts that are beside samples.csv.

The writer resumes where the files end, so a second writer can finish the work of one that was killed. It reserves some
room on the disk. When the disk is full it tells the loop to end, and uses this room for the rows until then.
It must be ready before a motor may move, so it starts fast: no numpy, no json.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, Protocol

from rig.core.memory_file import allocate
from rig.core.plain_file import open_folder
from rig.run_folder.recording import layout
from rig.run_folder.recording.layout import ROW, SharedMemory
from rig.run_folder.recording.sample_columns import HEADER, SampleRow, format_row


class EndOfInput(Protocol):
    """What can be waited for."""

    def wait(self, timeout: float) -> bool:
        """Wait for the end, at most ``timeout`` seconds. Returns whether it has come."""


def end_of_input() -> EndOfInput:
    """The end of this process's standard input. A thread reads it, because not every system can poll a pipe."""
    over = threading.Event()

    def read() -> None:
        with contextlib.suppress(OSError):
            while os.read(0, 4096):
                pass
        over.set()

    threading.Thread(target=read, daemon=True).start()
    return over


SAMPLES: Final = "samples.csv"
EVENTS: Final = "events.jsonl"

POLL_S: Final = 0.005
SYNC_EVERY_S: Final = 1.0
ROWS_AT_ONCE: Final = 1024
KEPT_BYTES: Final = 1 << 20  # room for the rows and events until the loop has ended, and for result.json
_FULL: Final = (errno.ENOSPC, errno.EDQUOT)
_NAN: Final = float("nan")
# no link: the folder may be one that others write in, too; and for Windows: no carriage returns
_APPEND: Final = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


class AppendOnlyFile:
    """A file that only grows. Data is safe from the death of this process once ``write`` has returned.

    makes_room  called when writing fails; returns True if writing may be tried again
    elsewhere   folders in which the file may go on else, in the order to try them; default: none
    moved       called with the new place of the file, and the error
    at          descriptor of its folder, which somebody may swap for another one; None: it is reached by its name
    Every method raises OSError with the file's name.
    """

    def __init__(
        self,
        path: Path,
        makes_room: Callable[[OSError], bool] = lambda _: False,
        elsewhere: Callable[[], Iterator[Path]] = lambda: iter(()),
        moved: Callable[[Path, OSError], None] = lambda _, __: None,
        at: int | None = None,
    ) -> None:
        self._path, self._at = path, at
        self._home = path.parent, at
        self._name = path.name
        self._makes_room, self._elsewhere, self._moved = makes_room, elsewhere, moved
        self._descriptor = _open_own(path, at)
        self._has_links = os.fstat(self._descriptor).st_nlink > 0  # some file systems count none
        self._safe_bytes = 0  # bytes that are on the disk for sure
        self._since = bytearray()  # bytes written after them
        self._size = 0  # bytes that the file must hold

    def whole_lines(self) -> tuple[int, int]:
        """Number and bytes of the lines in the file. It cuts off a torn last line."""
        status = os.fstat(self._descriptor)
        if not stat.S_ISREG(status.st_mode):
            return 0, 0
        lines = end = position = 0
        os.lseek(self._descriptor, 0, os.SEEK_SET)  # writes still go to the end (O_APPEND)
        while block := os.read(self._descriptor, 1 << 20):
            lines += block.count(b"\n")
            if b"\n" in block:
                end = position + block.rindex(b"\n") + 1
            position += len(block)
        if end < position:
            os.ftruncate(self._descriptor, end)
        self._safe_bytes = self._size = end
        self._since.clear()
        return lines, end

    def write(self, data: bytes | memoryview) -> None:
        """Append ``data``, whole lines. Raises OSError, with the file's name, if no place takes it."""
        self._since += data
        rest = memoryview(data)
        while rest:
            try:
                written = os.write(self._descriptor, rest)
                rest = rest[written:]
                self._size += written
            except OSError as error:
                named = self._named(error)
                if not self._makes_room(named):
                    self._go_on_elsewhere(named)
                    return

    @property
    def is_cut(self) -> bool:
        """Whether somebody has made the file shorter."""
        status = os.fstat(self._descriptor)
        return stat.S_ISREG(status.st_mode) and status.st_size < self._size

    def sync(self) -> None:
        """Force new data onto the disk. Raises OSError as ``write`` does."""
        if self._has_lost_its_name():
            self._get_a_name()
        if not self._since:
            return
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            if error.errno != errno.EINVAL:  # a pipe cannot be synchronised
                # data in the kernel's memory may never reach the disk, and fsync reports that only once
                self._go_on_elsewhere(self._named(error))
        self._safe_bytes += len(self._since)
        self._since.clear()

    def _has_lost_its_name(self) -> bool:
        """Whether somebody has deleted or renamed it; a folder that was renamed takes it along."""
        mine = os.fstat(self._descriptor)
        if self._has_links and mine.st_nlink == 0:
            return True
        try:
            here = os.stat(_by(self._path, self._at), dir_fd=self._at, follow_symlinks=False)
            return not os.path.samestat(here, mine)
        except OSError:
            return stat.S_ISREG(mine.st_mode) and (self._at is not None or self._path.parent.is_dir())

    def _get_a_name(self) -> None:
        """Somebody has deleted the file. What it holds is there until it is closed: write all of it anew."""
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        held = bytearray()
        while block := os.read(self._descriptor, 1 << 20):
            held += block
        self._safe_bytes, self._since = 0, held
        self._go_on_elsewhere(OSError(errno.ENOENT, "somebody has deleted or renamed it", str(self._path)), self._name)

    def _go_on_elsewhere(self, error: OSError, name: str = "") -> None:
        """Write the data that may not be on the disk to a new file, and go on there. Raises ``error`` if none works."""
        names = (*([name] if name else []), f"{self._name}.from-{self._safe_bytes}")
        for path in (folder / called for folder in self._elsewhere() for called in names):
            at = self._home[1] if path.parent == self._home[0] else None
            try:
                descriptor = os.open(_by(path, at), _APPEND | os.O_EXCL, 0o666, dir_fd=at)
            except OSError:
                continue
            try:
                rest = memoryview(bytes(self._since))
                while rest:
                    rest = rest[os.write(descriptor, rest) :]
                os.fsync(descriptor)
            except OSError:
                os.close(descriptor)
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(_by(path, at), dir_fd=at)
                continue
            os.close(self._descriptor)
            self._path, self._at, self._descriptor, self._size = path, at, descriptor, len(self._since)
            self._moved(path, error)
            return
        raise error

    def _named(self, error: OSError) -> OSError:
        return OSError(error.errno, error.strerror, str(self._path))


class KeptRoom:
    """Reserved room on the disk, until it is given up or this process ends.

    folder  of the reserving file
    size    bytes
    Raises OSError if the disk does not have so much.
    """

    def __init__(self, folder: Path, size: int) -> None:
        try:
            # a file without a name: nothing is left behind, whatever ends this process
            self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - it is kept open
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(folder)) from error
        try:
            allocate(self._file.fileno(), size)
        except OSError as error:
            self._file.close()
            raise OSError(error.errno, error.strerror, str(folder)) from error

    def give_up(self) -> None:
        """Free the room."""
        self._file.close()


class Writer:
    """Moves the loop's rows and events from the memory into the two files.

    Raises OSError if the files cannot be opened (constructor) or written (the other methods); NotPlainError for a link
    in the place of the folder.
    """

    def __init__(self, shared: SharedMemory, folder: Path, stages: Sequence[str]) -> None:
        self._shared = shared
        self._stages = stages
        self._folder = folder
        at, names = open_folder(folder), (SAMPLES, EVENTS)  # others may write beside it: it is reached by its name once
        files = (AppendOnlyFile(folder / n, self._makes_room, self._elsewhere, self._moved, at) for n in names)
        self._samples, self._events = files
        self._room: KeptRoom | None = None
        self._serves = False  # until it is True, a failing disk refuses the run
        self._other_folder: Path | None = None
        self._moves: list[tuple[Path, str]] = []
        self._last_t_s = _NAN

    def resume(self) -> None:
        """Start where the files end: at the beginning, or where a killed writer stopped."""
        lines, _ = self._samples.whole_lines()
        if lines == 0:
            self._samples.write(HEADER.encode("ascii"))
        _, event_bytes = self._events.whole_lines()
        counters, written = self._shared.counters, max(lines - 1, 0)
        # Somebody may have deleted or cut the files of a killed writer: what the memory still holds is written.
        first = max(written, counters[layout.ROWS_OPENED] - self._shared.capacity_rows)
        counters[layout.ROWS_LOST] += first - written
        counters[layout.ROWS_TAKEN] = first
        first_byte = self._first_event(event_bytes)
        counters[layout.EVENTS_LOST] += first_byte > event_bytes  # one or more
        counters[layout.EVENT_BYTES_TAKEN] = min(first_byte, counters[layout.EVENT_BYTES])

    def _first_event(self, written: int) -> int:
        """Bytes of events before the first whole line to write, where ``written`` bytes are in the file."""
        published, size = self._shared.counters[layout.EVENT_BYTES], self._shared.capacity_event_bytes
        if written >= published - size:
            return written
        first = published - size + 1  # the byte before the oldest one is overwritten
        while first < published and self._shared.events[(first - 1) % size] != ord("\n"):
            first += 1
        return first

    def keep_room(self) -> None:
        """Reserve room for the case that the disk gets full."""
        self._room = KeptRoom(self._folder, KEPT_BYTES)

    def _makes_room(self, error: OSError) -> bool:
        """Give up the reserved room, once, and tell the loop to end."""
        room, self._room = self._room, None
        if room is None or error.errno not in _FULL:
            return False
        self._shared.fail(layout.CANNOT_WRITE, _in_words(error))
        room.give_up()
        return True

    def _elsewhere(self) -> Iterator[Path]:
        """Folders in which the files may go on."""
        if not self._serves:
            return
        yield self._folder
        with contextlib.suppress(OSError):
            if self._other_folder is None:
                self._other_folder = Path(tempfile.mkdtemp(prefix=f"{self._folder.name}-"))
            yield self._other_folder

    def _moved(self, path: Path, error: OSError) -> None:
        """Tell the loop to end, and where the rest of the rows is."""
        self._moves.append((path, _in_words(error)))
        places = "; ".join(
            f"{why}, so {'all of it is written anew' if why.startswith(f'{place}:') else f'it goes on in {place}'}"
            for place, why in self._moves
        )
        self._shared.fail(layout.MOVED, places)

    def serve(self, is_over: EndOfInput, parent: int) -> None:
        """Write until the loop's side ends, then write the last rows.

        is_over  the end of standard input
        parent   process id of the loop's process: without it the loop is gone
        """
        self._serves = True
        counters = self._shared.counters
        next_sync_s = time.monotonic() + SYNC_EVERY_S
        while True:
            # Counters first, data after the wait: some processors reorder memory accesses, but a few milliseconds
            # later the data that a counter announces is there for sure.
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
        self._mend(SAMPLES, self._samples)
        taken = shared.counters[layout.ROWS_TAKEN]
        while taken < end:
            batch_end = min(end, taken + ROWS_AT_ONCE)
            self._samples.write("".join(map(self._line, range(taken, batch_end))).encode("ascii"))
            taken = batch_end
            shared.counters[layout.ROWS_TAKEN] = taken  # now the loop may use the slots again

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
        self._mend(EVENTS, self._events)
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
            import json  # here, not above: the process must start fast

            text = (
                f'{{"t_s": {t_s}, "kind": "record_moved", "to": {json.dumps(str(path))}, "why": {json.dumps(why)}}}\n'
            )
            self._events.write(text.encode("ascii"))
        if not counters[layout.CLOSED]:
            self._events.write(f'{{"t_s": {t_s}, "kind": "loop_died"}}\n'.encode("ascii"))

    def _sync(self) -> None:
        self._samples.sync()
        self._events.sync()

    def _mend(self, name: str, file: AppendOnlyFile) -> None:
        """Go back to where the file ends, if somebody has cut it short, and tell the loop to end."""
        if file.is_cut and not self._moves:
            words = f"somebody has cut {self._folder / name} short: what the memory holds of it is written anew"
            self._shared.fail(layout.MOVED, words)
            self.resume()


def main(arguments: Sequence[str]) -> int:
    """Run the writer. Exit status 0: done; 1: failed, the reason is in the shared memory."""
    # It ends with the loop. A signal from a terminal or a service manager to the whole group must not end it.
    for name in ("SIGINT", "SIGHUP", "SIGTERM"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    # The writer must not inherit the real-time priority of the loop.
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
        if shared.counters[layout.ROWS_OPENED] == 0:  # else it only finishes the work of another writer
            writer.keep_room()
        shared.counters[layout.STATE] = layout.READY
        writer.serve(is_over, parent)
    except OSError as error:
        shared.fail(layout.CANNOT_WRITE, _in_words(error))
        return 1
    return 0


def _by(path: Path, at: int | None) -> Path:
    """How a file is reached: in the folder with that descriptor, or by its whole path."""
    return path if at is None else Path(path.name)


def _open_own(path: Path, at: int | None) -> int:
    """Open a file of the run. Raises OSError for what only has its name: bytes must not go elsewhere."""
    try:
        descriptor = os.open(_by(path, at), _APPEND, 0o666, dir_fd=at)
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        raise OSError(errno.ELOOP, "it is a link, and rig follows none here", str(path)) from error
    if os.fstat(descriptor).st_nlink > 1:
        os.close(descriptor)
        raise OSError(errno.EMLINK, "the file has another name, too, so it is not this run's", str(path))
    return descriptor


def _in_words(error: OSError) -> str:
    return f"{error.filename}: {error.strerror}" if error.filename else str(error)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
