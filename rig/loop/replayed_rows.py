"""What a replay is held to: recorded rows, how far it has come, how the run ended, and where the two part."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NoReturn

from rig.faults import Fault
from rig.loop.device_relay import STOPPING
from rig.loop.stop_request import StopRequest
from rig.recording.columns import SampleRow
from rig.recording.reader import Recording

By = Literal["law", "guard", "record"]

_TELL_EVERY_ROWS = 2000
_NAN = math.nan
# Faults that guard and loop raise on a sample
OF_GUARD = frozenset(
    {
        *("LAW_FAILED", "SAMPLE_STALE", "SENSOR_RAIL", "SENSOR_JUMP", "SENSOR_STUCK"),
        *("TRAVEL_HARD", "POLARITY", "OVERSPEED", "RELAY_STOPPED"),
    }
)
# and those of laws: the same samples must bring them out again. Any other came from the device, the link, a signal or
# the disk.
OF_LAW_OR_GUARD = OF_GUARD | {
    *("NO_MOTION", "DRIVE_STUCK_ON", "SENSOR_NOISY", "NO_CYCLE", "NOT_HOME", "NO_SWITCHING", "DEVICE_RELAY"),
}
AFTER_DRIVING = frozenset({"NOT_IDENTIFIED"})


@dataclass(frozen=True)
class Difference:
    """The first place at which the replay is not the record.

    line         of samples.csv; None where the record has ended
    tick, t_s, stage   as recorded, or as the replay had them where the record has ended
    by           what decided: the law, the guard, or the record itself contradicts the loop
    recorded, replayed  in words
    recorded_V, replayed_V   drives, V; None where it is not a drive that differs
    asked_V      what the law asked for in the replay, V; None where it asked for nothing
    """

    line: int | None
    tick: int
    t_s: float
    stage: str
    by: By
    recorded: str
    replayed: str
    recorded_V: float | None = None
    replayed_V: float | None = None
    asked_V: float | None = None

    def __str__(self) -> str:
        place = "after the last line" if self.line is None else f"line {self.line}"
        return (
            f"tick {self.tick}, t = {self.t_s:.6f} s, stage {self.stage} (samples.csv, {place}): "
            f"recorded: {self.recorded}; replayed: {self.replayed}; decided by the {self.by}"
        )


class Diverged(Exception):
    """The replay is not the record."""

    def __init__(self, difference: Difference) -> None:
        self.difference = difference
        super().__init__(str(difference))


class RecordEnds(Exception):
    """The record ends here, without an end of the run: it was killed, or its last rows are lost."""


class ReplayedRows:
    """The rows of a recording, how far the replay has come, and how the run ended.

    recording   of a run folder
    period_s    of the loop
    fault       that ended the run; None for none
    is_whole    whether the run came to its end, and its rows are all there
    stop        told where the run was interrupted by a signal
    on_progress is told (rows done, of) now and then

    next        number of the row that comes next
    asked_V     what the law asked for last; nan for nothing
    """

    def __init__(
        self,
        recording: Recording,
        period_s: float,
        fault: Fault | None,
        is_whole: bool,
        stop: StopRequest,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> None:
        self.period_s = period_s
        self.fault = fault
        self.next = 0
        self.asked_V = _NAN
        self.now_s = -period_s  # so that the loop's first tick, a period later, is at 0
        rows = recording.rows()
        # what came of a relay in the device after the loop had given up: nobody decided on it
        end = next((k for k, row in enumerate(rows) if row.stage == STOPPING), len(rows))
        self._rows = rows[:end]
        self.stops: list[bool] = [bool(e.detail.get("confirmed", True)) for e in recording.events if e.kind == "stop"]
        self._is_whole = is_whole
        self._stop = stop
        self._on_progress = on_progress

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, row: int) -> SampleRow:
        return self._rows[row]

    @property
    def is_over(self) -> bool:
        """Whether every row has been replayed."""
        return self.next >= len(self)

    @property
    def ends_in_tick(self) -> bool:
        """Whether the last row was cut off while its drive was decided: that of a fault on its sample."""
        return bool(self._rows) and not self[-1].in_device and math.isnan(self[-1].t_u_s) and self[-1].u_V == 0.0

    @property
    def must_come_again(self) -> bool:
        """Whether the fault that ended the run is one that laws or guard raised on a sample.

        One of the same name came from the device where the last drive had gone out and nothing was read since.
        """
        fault = self.fault
        if fault is None or fault.code not in OF_LAW_OR_GUARD:
            return False
        is_open = bool(self._rows) and not self[-1].in_device and math.isnan(self[-1].t_u_s)
        return self.ends_in_tick or not is_open

    def set_clock(self) -> None:
        """Put the clock just before the next row's tick, so that the loop goes on there: it skips what has no row.

        Even back, where the loop has slept until a tick to read what came of its last drive.
        """
        if not self.is_over:
            self.now_s = (self[self.next].tick - 0.5) * self.period_s

    def advance(self) -> None:
        """On to the next row."""
        self.next += 1
        self.set_clock()
        if self.is_over and self.fault is not None and self.fault.code == "INTERRUPTED":
            self._stop.reason = self.fault.detail
        if self._on_progress is not None and (self.next % _TELL_EVERY_ROWS == 0 or self.is_over):
            self._on_progress(self.next, len(self))

    def end(self, *, arming: bool = False) -> NoReturn:
        """The replay goes on where the record does not: for the reason that the run had, or else they differ.

        ``arming``: the device is about to be armed, and may have refused.
        Raises the run's Fault where it was none of law or guard, RecordEnds, or Diverged.
        """
        fault = self.fault
        if fault is not None and fault.code not in AFTER_DRIVING:
            if self.must_come_again and not arming:
                raise self.missed_fault()
            raise fault
        if not self._is_whole:
            raise RecordEnds
        last = len(self) - 1
        raise Diverged(
            Difference(
                None,
                self[last].tick,
                self[last].t_s,
                self[last].stage,
                "record",
                "the record ends here, the run did not" if fault is None else f"the rows end here, then {fault.code}",
                "goes on",
            )
        )

    def missed_fault(self) -> Diverged:
        """The fault that ended the run does not come out again."""
        fault = self.fault
        seen = "" if fault is None else str(fault)
        return self.diverged(len(self) - 1, "law", f"the run ended: {seen}", "no fault")

    def diverged(
        self,
        row: int,
        by: By,
        recorded: str,
        replayed: str,
        recorded_V: float | None = None,
        replayed_V: float | None = None,
    ) -> Diverged:
        """What to raise for a difference in a row."""
        asked_V = None if math.isnan(self.asked_V) else self.asked_V
        return Diverged(
            Difference(
                row + 2,
                self[row].tick,
                self[row].t_s,
                self[row].stage,
                by,
                recorded,
                replayed,
                recorded_V,
                replayed_V,
                asked_V,
            )
        )
