"""What a replay compares with: the recorded rows, the next row, how the run ended, and the first difference."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NoReturn

from rig.control.loop.device_relay import STOPPING
from rig.control.loop.stop_request import StopRequest
from rig.core.faults import Fault
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.sample_columns import SampleRow

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
# and faults that laws raise: the same samples must raise them again. Any other fault came from the device, the link, a
# signal or the disk.
OF_LAW_OR_GUARD = OF_GUARD | {
    *("NO_MOTION", "LOAD_TURNS", "DRIVE_STUCK_ON", "SENSOR_NOISY"),
    *("NO_CYCLE", "NOT_HOME", "NO_SWITCHING", "DEVICE_RELAY"),
}
AFTER_DRIVING = frozenset({"NOT_IDENTIFIED"})


@dataclass(frozen=True)
class Difference:
    """The first difference between replay and recording.

    line         line of samples.csv; None after its end
    tick, t_s, stage   as recorded; after the end of the recording: those of its last row
    by           what decided: law, guard; or record: the recording contradicts itself
    recorded, replayed  both sides, in words
    recorded_V, replayed_V   both drives, V; None if something else than the drive differs
    asked_V      drive that the law asked for in the replay, V; None if it asked for none
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
    """The replay differs from the recording."""

    def __init__(self, difference: Difference) -> None:
        self.difference = difference
        super().__init__(str(difference))


class RecordEnds(Exception):
    """The recording ends here, but not the run: it was killed, or its last rows are lost."""


class ReplayedRows:
    """The rows of a recording, how far the replay has come, and how the run ended.

    recording    the run
    period_s     period of the loop
    fault        the fault that ended the run; None: no fault did
    is_whole     whether the run came to its end, with all its rows
    stop         gets the signal that interrupted the run, at its last row
    on_progress  called now and then with (rows done, rows in all)

    next         number of the next row
    asked_V      drive that the law asked for last, V; nan: none
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
        # rows of a relay in the device from after the end of the loop: no law decided on them
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
    def holds_device_relay(self) -> bool:
        """Whether a relay in the device made some of the rows."""
        return any(row.in_device for row in self._rows)

    @property
    def is_over(self) -> bool:
        """Whether every row has been replayed."""
        return self.next >= len(self)

    @property
    def ends_in_tick(self) -> bool:
        """Whether a fault on the last row's sample ended the run before a drive went out."""
        return bool(self._rows) and not self[-1].in_device and math.isnan(self[-1].t_u_s) and self[-1].u_V == 0.0

    @property
    def must_come_again(self) -> bool:
        """Whether law or guard raised the fault that ended the run: then the replay must raise it again.

        A fault of the same code came from the device if the last drive had gone out and no reading followed.
        """
        fault = self.fault
        if fault is None or fault.code not in OF_LAW_OR_GUARD:
            return False
        is_open = bool(self._rows) and not self[-1].in_device and math.isnan(self[-1].t_u_s)
        return self.ends_in_tick or not is_open

    def set_clock(self) -> None:
        """Set the clock just before the next row's tick. So the loop goes on there, and skips ticks without a row.

        This may set it back: to complete its last row, the loop sleeps until the tick after it.
        """
        if not self.is_over:
            self.now_s = (self[self.next].tick - 0.5) * self.period_s

    def advance(self) -> None:
        """Go to the next row."""
        self.next += 1
        self.set_clock()
        if self.is_over and self.fault is not None and self.fault.code == "INTERRUPTED":
            self._stop.reason = self.fault.detail
        if self._on_progress is not None and (self.next % _TELL_EVERY_ROWS == 0 or self.is_over):
            self._on_progress(self.next, len(self))

    def end(self, *, arming: bool = False) -> NoReturn:
        """End the replay where the recording ends: as the run ended, or with a difference.

        arming  the loop is about to arm the device, which may have refused
        Raises the run's Fault if it came from neither law nor guard; RecordEnds; else Diverged.
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
                "the recording ends here, the run did not"
                if fault is None
                else f"the rows end here, then {fault.code}",
                "goes on",
            )
        )

    def missed_fault(self) -> Diverged:
        """What to raise if the replay does not raise the fault that ended the run."""
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
        """What to raise for a difference in row number ``row``; ``recorded_V``, ``replayed_V``: both drives, V."""
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
