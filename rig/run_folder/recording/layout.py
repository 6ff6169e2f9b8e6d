"""The memory that the loop and the writer process share: counters, a ring of rows, a ring of event bytes.

There is one producer (the loop) and one consumer (the writer), so there are no locks. Only one side writes each
counter: one aligned 8-byte store, after the data that it announces. The file behind the memory has no name, so nothing
is left over, however the two processes end.
"""

from __future__ import annotations

import mmap
import struct
from typing import Final

# Counters (8 bytes each): first those that the loop writes; then, on a cache line of their own, the writer's.
ROWS_OPENED: Final = 0  # rows published; row k is in slot k % capacity
ROW_COMPLETED: Final = 1  # 1 + the number of the row completed last
EVENT_BYTES: Final = 2  # bytes of whole event lines published
ROWS_LOST: Final = 3  # rows dropped because the ring was full
EVENTS_LOST: Final = 4
CLOSED: Final = 5  # 1 once the loop has closed the recorder in order
ROWS_TAKEN: Final = 8  # rows that are in samples.csv
EVENT_BYTES_TAKEN: Final = 9  # bytes that are in events.jsonl
STATE: Final = 10  # one of the following

STARTING: Final = 0
READY: Final = 1
CANNOT_OPEN: Final = 2  # the files could not be created: the reason is in the memory
CANNOT_WRITE: Final = 3  # writing failed later: the reason is in the memory
MOVED: Final = 4  # writing failed later, and goes on in another place: the reason is in the memory

# tick seq t_s y counts v u z yd stage late io flags | t_u u flags number
# ``complete`` writes the part after the bar. Its last field is 1 + the row's number, written last.
ROW: Final = struct.Struct("=qqddqddddqddq ddqq")
COMPLETION: Final = struct.Struct("=ddqq")
COMPLETION_AT: Final = ROW.size - COMPLETION.size

_COUNTERS_SIZE: Final = 128
_REASON_AT: Final = _COUNTERS_SIZE
_REASON_SIZE: Final = 1024
_ROWS_AT: Final = 4096


class SharedMemory:
    """The shared memory, mapped into this process.

    file_descriptor  of the file behind it; the caller closes it
    capacity_rows, capacity_event_bytes  sizes of the two rings
    Raises OSError where it cannot be mapped.
    """

    def __init__(self, file_descriptor: int, capacity_rows: int, capacity_event_bytes: int) -> None:
        self.capacity_rows = capacity_rows
        self.capacity_event_bytes = capacity_event_bytes
        rows_end = _ROWS_AT + capacity_rows * ROW.size
        # Populate now: else the loop would wait for a page fault at its first write to each page.
        # Without flags the mapping is shared, too.
        size = size_of(capacity_rows, capacity_event_bytes)
        if hasattr(mmap, "MAP_POPULATE"):
            self._map = mmap.mmap(file_descriptor, size, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE)
        else:
            self._map = mmap.mmap(file_descriptor, size)
        self._view = memoryview(self._map)
        self.counters = self._view[:_COUNTERS_SIZE].cast("q")
        self.rows = self._view[_ROWS_AT:rows_end]
        self.events = self._view[rows_end : rows_end + capacity_event_bytes]
        self._reason = self._view[_REASON_AT : _REASON_AT + _REASON_SIZE]

    def fail(self, state: int, reason: str) -> None:
        """As the writer: set the state, and the reason for it."""
        text = reason.encode(errors="replace")[: _REASON_SIZE - 1]
        self._reason[: len(text) + 1] = text + b"\0"
        self.counters[STATE] = state

    def reason(self) -> str:
        """The reason that the writer left; empty if it left none."""
        return bytes(self._reason).split(b"\0", 1)[0].decode(errors="replace")

    def close(self) -> None:
        """Unmap."""
        for view in (self.counters, self.rows, self.events, self._reason, self._view):
            view.release()
        self._map.close()


def size_of(capacity_rows: int, capacity_event_bytes: int) -> int:
    """Bytes of shared memory for these capacities."""
    return _ROWS_AT + capacity_rows * ROW.size + capacity_event_bytes
