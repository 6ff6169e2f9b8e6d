"""The loop's side of recording: rows and events go into shared memory, and another process puts them on disk.

``sample``, ``complete`` and ``event`` only write memory, and never wait. If the memory is full they drop the row and
count it. ``check`` raises long before that: when the writer has ended, when it has written nothing for some seconds
although rows wait, or when the memory is nearly full. Virtual time can stand still: there ``check`` waits for the disk.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from rig.core.copies import keep_from_copies, no_longer_own
from rig.core.faults import Fault
from rig.core.memory_file import create_file, create_named_file
from rig.core.package import FOLDER
from rig.run_folder.recording import layout
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.layout import COMPLETION, COMPLETION_AT, ROW, SharedMemory
from rig.run_folder.recording.sink import JsonScalar, Row
from rig.run_folder.recording.writer import SAMPLES

__all__ = ["Recorder", "RecordingError"]

START_TIMEOUT_S: Final = 20.0
PATIENCE_S: Final = 60.0  # in virtual time, for a disk that takes nothing
_PASSES_DESCRIPTORS: Final = sys.platform != "win32"
EVENT_BYTES: Final = 512  # room for one event in the ring, on average
_STAGE_NAME: Final = re.compile(r"[A-Za-z0-9_.:-]{1,64}")
_NAN: Final = math.nan

# Writers that ``close`` left running on purpose. Without this list Python would warn about a child process.
_left_running: list[subprocess.Popen[bytes]] = []


class Recorder:
    """Appends the rows and events of one run to its folder.

    folder           the run folder; must exist and hold no samples yet
    stages           names of every stage that will be recorded: 1 to 64 of letters, digits and ``_.:-``
    capacity_rows    rows that the memory holds while the writer is busy; at 100 Hz the default is eleven minutes
    capacity_events  events that it holds, of 512 bytes on average
    waits            whether the run may wait for the disk: in virtual time nothing moves meanwhile

    Returns once the writer process has opened the files and written the header. Raises RecordingError where the
    folder cannot be written, Fault RECORDER_DEAD where the disk is full, ValueError for bad stages or capacities.
    """

    close_timeout_s = 10.0  # longest wait for the writer in ``close``
    stall_timeout_s = 10.0  # longest time without a written row although rows wait: a busy disk can take seconds
    writer: tuple[str, ...] = ("-m", "rig.run_folder.recording.writer")  # what Python runs as the writer

    def __init__(
        self,
        folder: Path,
        stages: Sequence[str],
        capacity_rows: int = 65536,
        capacity_events: int = 2048,
        *,
        waits: bool = False,
    ) -> None:
        if capacity_rows < 8 or capacity_events < 8:
            raise ValueError("capacity_rows and capacity_events must be at least 8")
        for name in stages:
            if not _STAGE_NAME.fullmatch(name):
                raise ValueError(f"stage name {name!r}: use 1 to 64 letters, digits and _.:-")
        self.folder = folder.absolute()
        samples = self.folder / SAMPLES
        if samples.is_file() and samples.stat().st_size > 0:
            raise RecordingError(samples, "already holds a recording", "start each run in a new folder")

        self._stages = tuple(stages)
        self._stage_index = {name: index for index, name in enumerate(self._stages)}
        self._capacity_rows = capacity_rows
        self._capacity_event_bytes = capacity_events * EVENT_BYTES
        self._opened = 0
        self._open_offset = -1  # of the row that ``complete`` is to finish
        self._dropped = False  # the memory had no room for that row
        self._taken = 0  # rows on disk at the last ``check``
        self._stalled_since_s: float | None = None  # when ``check`` first saw rows wait with none written since
        self._closed = False
        self._waits = waits
        if waits:
            self.stall_timeout_s = self.close_timeout_s = PATIENCE_S

        size = layout.size_of(capacity_rows, self._capacity_event_bytes)
        self._memory_name: Path | None = None  # path of the file behind the memory, if the system needs one
        try:
            if _PASSES_DESCRIPTORS:
                self._descriptor = create_file(size)
            else:
                self._descriptor, self._memory_name = create_named_file(size)
        except OSError as error:
            raise RecordingError(
                self.folder,
                f"no shared memory for the recorder: {error.strerror}",
                "raise the largest size of a file (ulimit -f)"
                if error.errno == errno.EFBIG
                else f"free {size / 1e6:.0f} MB in /dev/shm, or where temporary files go",
            ) from error
        self._shared = SharedMemory(self._descriptor, capacity_rows, self._capacity_event_bytes)
        self._counters, self._rows = self._shared.counters, self._shared.rows
        self._process = self._start_writer(subprocess.PIPE)
        if self._process.stdin:  # in a copy of this process it would keep the writer waiting
            keep_from_copies(self._process.stdin.fileno())
        # Without ``close`` the writer would wait for more rows for ever.
        weakref.finalize(self, _close_pipe, self._process)
        try:
            self._await_ready()
        except (RecordingError, Fault):
            self._release()
            raise

    @property
    def writer_pid(self) -> int:
        """Process id of the writer."""
        return self._process.pid

    # -- the loop's calls: memory writes only ---------------------------------------------------------------------

    def sample(self, *row: *Row) -> None:
        """Open the next row: the sample, and the *commanded* drive, V.

        If ``complete`` was not called for the row before, that row stays as it is, without a time of effect.
        Raises ValueError for a stage that is not one of ``stages``.
        """
        tick, sample, stage, z_rad_s, yd_rad, u_V, late_us, io_us, flags = row
        try:
            stage_index = self._stage_index[stage]
        except KeyError:
            raise ValueError(f"stage {stage!r} is none of {', '.join(self._stages)}") from None
        opened = self._opened
        if opened - self._counters[layout.ROWS_TAKEN] >= self._capacity_rows:
            self._counters[layout.ROWS_LOST] += 1
            self._open_offset, self._dropped = -1, True
            return
        offset = opened % self._capacity_rows * ROW.size
        sampled = (sample.seq, sample.t_s, sample.y_rad, sample.y_counts, sample.v_rad_per_s)
        decided = (u_V, z_rad_s, yd_rad, stage_index, late_us, io_us, flags)
        ROW.pack_into(self._rows, offset, tick, *sampled, *decided, _NAN, 0.0, 0, 0)
        self._open_offset, self._dropped = offset, False
        self._opened = opened + 1
        self._counters[layout.ROWS_OPENED] = self._opened  # last: from here on the row is there

    def complete(self, t_u_s: float, u_V: float, flags: int = 0) -> None:
        """Finish the open row: the time at which its drive took effect, and the drive that the device reports.

        ``flags`` are added to the flags of the row. Raises RuntimeError if no row is open.
        """
        if self._open_offset < 0:
            if self._dropped:
                return  # counted when it was dropped; ``check`` says so
            raise RuntimeError("complete() without an open row: call sample() first, and complete() once a row")
        COMPLETION.pack_into(self._rows, self._open_offset + COMPLETION_AT, t_u_s, u_V, flags, self._opened)
        self._open_offset = -1
        self._counters[layout.ROW_COMPLETED] = self._opened

    def event(self, t_s: float, kind: str, **fields: JsonScalar) -> None:
        """Append ``{"t_s": .., "kind": .., fields}`` to events.jsonl; nan and infinities become null.

        Raises TypeError for a field that is no string, number, bool or None.
        """
        values: dict[str, JsonScalar] = {"t_s": t_s, "kind": kind, **fields}
        for name, value in values.items():
            if isinstance(value, float):
                if not math.isfinite(value):
                    values[name] = None
            elif value is not None and not isinstance(value, str | int):
                raise TypeError(f"event field {name} is a {type(value).__name__}, not a JSON scalar")
        line = json.dumps(values).encode("ascii") + b"\n"

        size, written = self._capacity_event_bytes, self._counters[layout.EVENT_BYTES]
        if written + len(line) - self._counters[layout.EVENT_BYTES_TAKEN] > size:
            self._counters[layout.EVENTS_LOST] += 1
            return
        start = written % size
        first = line[: size - start]
        rest = line[len(first) :]
        self._shared.events[start : start + len(first)] = first
        self._shared.events[: len(rest)] = rest
        self._counters[layout.EVENT_BYTES] = written + len(line)

    def check(self) -> None:
        """Raise Fault RECORDER_DEAD if the writer has ended, failed, lost rows, or does not keep up. It is quick.

        A recorder that ``waits`` lets the writer catch up instead.
        """
        if self._waits:
            self._await(lambda: not self._far_behind())
        reason = self._ended() or self._lost() or self._far_behind() or self._stalled()
        self._raise(reason)

    def drain(self) -> None:
        """Wait until every completed row is in the file, however slow the disk is.

        Call it between stages, while the drive is at rest. Raises Fault RECORDER_DEAD only if the writer has
        ended, failed or lost rows, or has written nothing for ``stall_timeout_s``.
        """
        self._await(lambda: self._counters[layout.ROWS_TAKEN] >= self._finished_rows())

    def _await(self, is_enough: Callable[[], bool]) -> None:
        """Wait while the writer writes. Raises Fault RECORDER_DEAD if it does not."""
        while not is_enough():
            self._raise(self._ended() or self._lost() or self._stalled())
            time.sleep(0.002)

    def _raise(self, reason: str) -> None:
        if reason:
            raise Fault("RECORDER_DEAD", reason)

    # -- the end --------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Write everything, the open row too, and end the writer.

        It takes at most ``close_timeout_s``, or twice that if the writer was killed. A stopped writer is continued. If
        the writer was killed, a second one writes the rest; but if the disk had failed before, the rest is lost.
        Raises Fault RECORDER_DEAD if rows or events are lost, not yet on disk, or in another place. A second call does
        nothing.
        """
        if self._closed:
            return
        self._closed = True
        self._counters[layout.CLOSED] = 1
        try:
            if hasattr(signal, "SIGCONT"):
                self._process.send_signal(signal.SIGCONT)
            self._await_end()
            # killed: the rows are still in memory, and the file shows how far it got, unless it goes on elsewhere
            if self._process.returncode < 0 and not self._moved():
                self._process = self._start_writer(subprocess.DEVNULL)
                self._await_end()
            reason = self._unwritten() or self._lost() or self._moved()
            if reason:
                raise Fault("RECORDER_DEAD", reason)
        finally:
            self._release()

    def _await_end(self) -> None:
        _close_pipe(self._process)
        try:
            self._process.wait(self.close_timeout_s)
        except subprocess.TimeoutExpired:
            _left_running.append(self._process)
            left = self._opened - self._counters[layout.ROWS_TAKEN]
            raise Fault(
                "RECORDER_DEAD",
                f"process {self._process.pid} has not finished within {self.close_timeout_s:g} s; it still holds"
                f" {left} rows and is left running",
            ) from None

    def _release(self) -> None:
        _close_pipe(self._process)
        self._counters, self._rows = memoryview(b"").cast("q"), memoryview(b"")
        self._shared.close()
        os.close(self._descriptor)
        if self._memory_name is not None:
            with contextlib.suppress(OSError):  # a writer that was left running still has it open
                self._memory_name.unlink()

    # -- the state of the writer, as text; empty if all is well ---------------------------------------------------

    def _ended(self) -> str:
        status = self._process.poll()
        if self._counters[layout.STATE] in (layout.CANNOT_OPEN, layout.CANNOT_WRITE, layout.MOVED):
            return self._shared.reason()
        if status is None:
            return ""
        how = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
        return f"its process {how}"

    def _lost(self) -> str:
        rows, events = self._counters[layout.ROWS_LOST], self._counters[layout.EVENTS_LOST]
        if not rows and not events:
            return ""
        return f"{rows} rows and {events} events are lost: the memory was full, or somebody cut the files"

    def _moved(self) -> str:
        return self._shared.reason() if self._counters[layout.STATE] == layout.MOVED else ""

    def _far_behind(self) -> str:
        rows = self._opened - self._counters[layout.ROWS_TAKEN]
        if 8 * rows > 7 * self._capacity_rows:
            return f"{rows} rows wait to be written, of {self._capacity_rows} that fit"
        counters = self._counters
        event_bytes = counters[layout.EVENT_BYTES] - counters[layout.EVENT_BYTES_TAKEN]
        if 8 * event_bytes > 7 * self._capacity_event_bytes:
            return f"{event_bytes} bytes of events wait to be written, of {self._capacity_event_bytes} that fit"
        return ""

    def _stalled(self) -> str:
        taken, now_s = self._counters[layout.ROWS_TAKEN], time.monotonic()
        if taken != self._taken or taken >= self._finished_rows():
            self._taken, self._stalled_since_s = taken, None
        elif self._stalled_since_s is None:
            self._stalled_since_s = now_s
        elif now_s - self._stalled_since_s > self.stall_timeout_s:
            rows = self._opened - taken
            return f"process {self._process.pid} has written nothing for {self.stall_timeout_s:g} s, {rows} rows wait"
        return ""

    def _finished_rows(self) -> int:
        """Rows that will not change any more: all but the open one."""
        return self._opened if self._open_offset < 0 else self._opened - 1

    def _unwritten(self) -> str:
        rows = self._opened - self._counters[layout.ROWS_TAKEN]
        event_bytes = self._counters[layout.EVENT_BYTES] - self._counters[layout.EVENT_BYTES_TAKEN]
        if self._process.returncode == 0 and rows == 0 and event_bytes == 0:
            return ""
        return f"{self._ended()}; {rows} rows and {event_bytes} bytes of events are lost"

    # -- starting the writer --------------------------------------------------------------------------------------

    def _start_writer(self, stdin: int) -> subprocess.Popen[bytes]:
        # The same modules as here, whatever the working directory; -S because the path is complete already.
        root = str(FOLDER.absolute().parent)
        path = [entry for entry in sys.path if entry]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*path, root])}
        memory = self._descriptor if self._memory_name is None else self._memory_name
        numbers = (memory, os.getpid(), self._capacity_rows, self._capacity_event_bytes)
        try:
            return subprocess.Popen(
                [sys.executable, "-S", "-P", *self.writer, *map(str, numbers), str(self.folder), *self._stages],
                bufsize=0,
                stdin=stdin,
                stdout=subprocess.DEVNULL,
                pass_fds=(self._descriptor,) if _PASSES_DESCRIPTORS else (),
                env=environment,
                start_new_session=True,  # Ctrl-C in the terminal is not meant for it
            )
        except OSError as error:
            raise RecordingError(
                self.folder, f"cannot start the recorder's process: {error.strerror}", "check the Python installation"
            ) from error

    def _await_ready(self) -> None:
        deadline_s = time.monotonic() + START_TIMEOUT_S
        while self._counters[layout.STATE] == layout.STARTING:
            if self._process.poll() is not None and self._counters[layout.STATE] == layout.STARTING:
                raise Fault("RECORDER_DEAD", f"{self._ended()} while starting")
            if time.monotonic() > deadline_s:
                self._process.kill()
                self._process.wait()
                raise Fault("RECORDER_DEAD", f"its process was not ready within {START_TIMEOUT_S:g} s")
            time.sleep(0.001)
        if self._counters[layout.STATE] != layout.READY:
            self._process.wait()
            if self._counters[layout.STATE] == layout.CANNOT_OPEN:
                raise RecordingError(
                    self.folder,
                    f"cannot be written ({self._shared.reason()})",
                    "check that it exists and its permissions, or choose another place with --out",
                )
            raise Fault("RECORDER_DEAD", self._shared.reason())


def _close_pipe(process: subprocess.Popen[bytes]) -> None:
    """Tell the writer that nothing more will come."""
    if process.stdin and not process.stdin.closed:
        no_longer_own(process.stdin.fileno())
        process.stdin.close()
