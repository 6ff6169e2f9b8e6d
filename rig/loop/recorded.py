"""A recorded run as a bench: the loop gets the same samples again, and each drive is held to the one that acted.

``RecordedDriver`` and ``RecordedClock`` are the bench, ``Comparison`` is where the loop's rows go, ``ReplayLoop`` is
the loop; all of them share one ``Tape``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NoReturn

from rig.control.law import Law
from rig.daq.calibration import Calibration, DriveMap
from rig.daq.driver import DeviceInfo, DeviceWatchdog
from rig.daq.relay_stream import TICK_S, RelayCommand, RelayRow, relay_command
from rig.faults import Fault
from rig.loop.runner import STOPPING, Loop
from rig.loop.stop_request import StopRequest
from rig.recording.reader import Recording
from rig.recording.record import NoRecord, Row
from rig.signals import FLAG_GUARD_BRAKED, FLAG_GUARD_CLIPPED, FLAG_SATURATED, FLAG_SKIPPED, Limits, Order, Sample

By = Literal["law", "guard", "record"]

_GUARD_FLAGS = FLAG_GUARD_CLIPPED | FLAG_GUARD_BRAKED
_TELL_EVERY_ROWS = 2000
_NAN = math.nan
# Faults that guard and loop raise on a sample
OF_GUARD = frozenset(
    (
        *("LAW_FAILED", "SENSOR_RAIL", "SENSOR_JUMP", "SENSOR_STUCK", "TRAVEL_HARD", "POLARITY", "OVERSPEED"),
        "RELAY_STOPPED",
    )
)
# and those of laws: the same samples must bring them out again. Any other came from the device, the link, a signal or
# the disk.
_OF_LAW_OR_GUARD = OF_GUARD | {
    *("NO_MOTION", "DRIVE_STUCK_ON", "SENSOR_NOISY", "NO_CYCLE", "NOT_HOME", "NO_SWITCHING", "DEVICE_RELAY"),
}
_AFTER_DRIVING = frozenset({"NOT_IDENTIFIED"})


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


class Tape:
    """The rows of a record, how far the replay has come, and how the run ended.

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
        stages: list[str] = recording.stage.tolist()
        # what came of a relay in the device after the loop had given up: nobody decided on it
        end = stages.index(STOPPING) if STOPPING in stages else len(stages)
        self.stages = stages[:end]
        self.ticks: list[int] = recording.tick.tolist()[:end]
        self.seq: list[int] = recording.seq.tolist()[:end]
        self.t_s: list[float] = recording.t_s.tolist()[:end]
        self.t_u_s: list[float] = recording.t_u_s.tolist()[:end]
        self.y_rad: list[float] = recording.y_rad.tolist()[:end]
        self.y_counts: list[int] = recording.y_counts.tolist()[:end]
        self.v_rad_per_s: list[float] = recording.v_rad_per_s.tolist()[:end]
        self.u_V: list[float] = recording.u_V.tolist()[:end]
        self.z_rad_s: list[float] = recording.z_rad_s.tolist()[:end]
        self.yd_rad: list[float] = recording.yd_rad.tolist()[:end]
        self.flags: list[int] = recording.flags.tolist()[:end]
        # a row of the relay in the device took no time of the loop's
        self.in_device: list[bool] = [math.isnan(late_us) for late_us in recording.late_us.tolist()[:end]]
        self.stops: list[bool] = [bool(e.get("confirmed", True)) for e in recording.events if e.get("kind") == "stop"]
        self._is_whole = is_whole
        self._stop = stop
        self._on_progress = on_progress

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def is_over(self) -> bool:
        """Whether every row has been replayed."""
        return self.next >= len(self)

    @property
    def ends_in_tick(self) -> bool:
        """Whether the last row was cut off while its drive was decided: that of a fault on its sample."""
        return bool(self.t_s) and not self.in_device[-1] and math.isnan(self.t_u_s[-1]) and self.u_V[-1] == 0.0

    @property
    def must_come_again(self) -> bool:
        """Whether the fault that ended the run is one that laws or guard raised on a sample.

        One of the same name came from the device where the last drive had gone out and nothing was read since.
        """
        fault = self.fault
        if fault is None or fault.code not in _OF_LAW_OR_GUARD:
            return False
        is_open = bool(self.t_s) and not self.in_device[-1] and math.isnan(self.t_u_s[-1])
        return self.ends_in_tick or not is_open

    def set_clock(self) -> None:
        """Put the clock just before the next row's tick, so that the loop goes on there: it skips what has no row.

        Even back, where the loop has slept until a tick to read what came of its last drive.
        """
        if not self.is_over:
            self.now_s = (self.ticks[self.next] - 0.5) * self.period_s

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
        if fault is not None and fault.code not in _AFTER_DRIVING:
            if self.must_come_again and not arming:
                raise self.missed_fault()
            raise fault
        if not self._is_whole:
            raise RecordEnds
        last = len(self) - 1
        raise Diverged(
            Difference(
                None,
                self.ticks[last],
                self.t_s[last],
                self.stages[last],
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
                self.ticks[row],
                self.t_s[row],
                self.stages[row],
                by,
                recorded,
                replayed,
                recorded_V,
                replayed_V,
                asked_V,
            )
        )


class RecordedClock:
    """Time as the record has it: it passes from row to row."""

    absolute = True

    def __init__(self, tape: Tape) -> None:
        self._tape = tape

    def now_s(self) -> float:
        """Time of the replay, s."""
        return self._tape.now_s

    def sleep_until(self, t_s: float) -> float:
        """Let time pass to ``t_s``; none if that is past. The time then, s."""
        self._tape.now_s = max(self._tape.now_s, t_s)
        return self._tape.now_s


class RecordedDriver:
    """The samples of a record behind the driver interface, the relay in a device included. Nothing is driven.

    order        as it was
    calibration, drive_map   as they were, the drive's units included
    clock_ratio  device seconds for one of the host's
    """

    failsafe: DeviceWatchdog | None = DeviceWatchdog(1.0)
    backend = "a record"
    link_statistics: Mapping[str, int] = {}

    def __init__(
        self, tape: Tape, order: Order, calibration: Calibration, drive_map: DriveMap, clock_ratio: float
    ) -> None:
        self.order = order
        self._tape = tape
        self._calibration = calibration
        self._drive_map = drive_map
        self._clock_ratio = clock_ratio
        self._is_armed_anew = False
        self._stops = 0
        self._device_stage = ""

    def open(self) -> DeviceInfo:
        """Nothing to meet."""
        return DeviceInfo(build="", board="record", reset_cause="", emulated=True, clock_ratio=self._clock_ratio)

    def arm(self, limits: Limits) -> None:
        """Go on at the next row; raises as ``Tape.end`` where there is none."""
        if self._tape.is_over:
            self._tape.end(arming=True)
        self._is_armed_anew = True
        self._tape.set_clock()

    def read(self) -> Sample:
        """The next row's sample, with what the row before it says of the last drive; raises as ``Tape.end``.

        After the last row there is one more: the exchange that completed it.
        """
        tape, row = self._tape, self._tape.next
        t_u_s, u_V = (_NAN, 0.0) if row == 0 or self._is_armed_anew else (tape.t_u_s[row - 1], tape.u_V[row - 1])
        self._is_armed_anew = False
        if row < len(tape):
            return Sample(
                tape.t_s[row], tape.y_rad[row], tape.y_counts[row], tape.v_rad_per_s[row], t_u_s, u_V, tape.seq[row]
            )
        if row == 0 or math.isnan(t_u_s) or tape.in_device[row - 1]:
            tape.end()
        return Sample(tape.t_s[-1] + tape.period_s, tape.y_rad[-1], tape.y_counts[-1], _NAN, t_u_s, u_V, tape.seq[-1])

    def write(self, u_V: float) -> None:
        """Take the drive, as the device would; ``Comparison`` judges it. Raises ValueError beyond the drive's range.

        Raises the fault that ended the run where that was in this tick and came from neither law nor guard.
        """
        self._drive_map.to_units(u_V)
        tape, fault = self._tape, self._tape.fault
        in_last_tick = tape.next == len(tape) - 1 and tape.ends_in_tick
        if fault is not None and in_last_tick and fault.code not in _OF_LAW_OR_GUARD | _AFTER_DRIVING | {"INTERRUPTED"}:
            raise fault

    def safe_stop(self) -> bool:
        """Whether the device confirmed it then."""
        self._stops += 1
        stops = self._tape.stops
        return stops[self._stops - 1] if self._stops <= len(stops) else True

    def close(self) -> None:
        """Nothing to give back."""

    # ------------------------------------------------------------------ the relay in the device

    @property
    def tick_s(self) -> float:
        """The device's tick in host time, s."""
        return TICK_S / self._clock_ratio

    def relay_command(self, h1_V: float, h2_V: float, z_bound_rad_s: float) -> RelayCommand:
        """As the device was told; raises as ``relay_stream.relay_command``."""
        return relay_command(h1_V, h2_V, z_bound_rad_s, self._calibration, self._drive_map, self.tick_s)

    def start_relay(self, command: RelayCommand) -> None:
        """Go on at the relay's first row. Raises as ``Tape.end``; Diverged where the next row is none of a device's."""
        if self._tape.is_over:
            self._tape.end()
        row = self._tape.next
        if not self._tape.in_device[row]:
            raise self._tape.diverged(row, "record", "a tick of the loop", "the relay in the device starts")
        self._device_stage = self._tape.stages[row]
        self._tape.set_clock()

    def keep(self) -> None:
        """The relay goes on; raises as ``Tape.end``, and Diverged where it had ended."""
        tape = self._tape
        if tape.is_over:
            tape.end()
        if not self._is_of_relay(tape.next):
            raise tape.diverged(tape.next, "law", "the relay in the device has ended", f"{self._device_stage} goes on")

    def read_rows(self) -> list[RelayRow]:
        """The rows that the loop took in this tick."""
        tape, first = self._tape, self._tape.next
        end = first
        while end < len(tape) and self._is_of_relay(end) and tape.ticks[end] * tape.period_s <= tape.now_s + 1e-9:
            end += 1
        return self._rows(first, end)

    def stop_relay(self) -> list[RelayRow]:
        """The relay's last rows."""
        first = end = self._tape.next
        while end < len(self._tape) and self._is_of_relay(end):
            end += 1
        return self._rows(first, end)

    def _is_of_relay(self, row: int) -> bool:
        return self._tape.in_device[row] and self._tape.stages[row] == self._device_stage

    def _rows(self, first: int, end: int) -> list[RelayRow]:
        t = self._tape
        return [
            RelayRow(t.t_s[k], t.t_u_s[k], t.y_rad[k], t.y_counts[k], t.u_V[k], t.seq[k]) for k in range(first, end)
        ]


class Comparison(NoRecord):
    """Where the rows of a replayed loop go: each is compared with the record's; Diverged at the first difference.

    When a drive took effect is the record's own word, and what laws and guard come to shows in the drive.

    quantise   what the device makes of a drive, V to V; None where it does not say: drives then agree to 1 uV

    compared   rows whose drive is the one that acted
    lost       rows whose drive never reached the device
    limited    rows in which the device drove less than it was told to
    """

    def __init__(self, tape: Tape, quantise: Callable[[float], float] | None) -> None:
        self.compared = 0
        self.lost = 0
        self.limited = 0
        self._tape = tape
        self._quantise = quantise

    def sample(self, *row: *Row) -> None:
        """Compare a row that the loop would write.

        Raises Diverged at the first difference; where the record has no more rows, as ``Tape.end``.
        """
        tick, _, stage, z_rad_s, yd_rad, u_V, _, _, flags = row
        tape, at = self._tape, self._tape.next
        if tape.is_over:
            tape.end()
        self._compare_course(at, tick, stage, flags)
        self._compare_drive(at, u_V, flags)
        for what, unit, then, now in (
            ("integral", "rad s", tape.z_rad_s[at], z_rad_s),
            ("reference", "rad", tape.yd_rad[at], yd_rad),
        ):
            if not _same(then, now):
                raise tape.diverged(at, "law", f"{what} {then!r} {unit}", f"{what} {now!r} {unit}")
        tape.advance()

    def _compare_course(self, row: int, tick: int, stage: str, flags: int) -> None:
        """The row's place in the run: its tick, whether some were skipped before it, its stage, what the guard did."""
        tape = self._tape
        recorded = tape.flags[row]
        after_relay = row > 0 and tape.in_device[row - 1] and not tape.in_device[row]
        if flags & ~recorded & FLAG_SKIPPED and not after_relay:
            raise tape.diverged(row, "record", "no ticks were skipped before this row", "rows are missing before it")
        if recorded & ~flags & FLAG_SKIPPED and not after_relay:
            raise tape.diverged(row, "record", "ticks were skipped before this row", "no rows are missing before it")
        if tick != tape.ticks[row]:
            raise tape.diverged(row, "record", f"tick {tape.ticks[row]}", f"tick {tick}")
        if stage != tape.stages[row]:
            raise tape.diverged(row, "law", f"stage {tape.stages[row]}", f"stage {stage}")
        if (flags ^ recorded) & _GUARD_FLAGS:
            raise tape.diverged(row, "guard", _guard_words(recorded), _guard_words(flags), tape.u_V[row])

    def _compare_drive(self, row: int, u_V: float, flags: int) -> None:
        tape = self._tape
        recorded_V, t_u_s = tape.u_V[row], tape.t_u_s[row]
        if tape.in_device[row]:
            self.compared += 1  # the loop itself holds the law to it
            return
        if t_u_s < tape.t_s[row]:
            self.lost += 1  # the device still says the drive before it
            return
        if tape.flags[row] & FLAG_SATURATED:
            self.limited += 1
            return
        acts_V = u_V if self._quantise is None else self._quantise(u_V)
        if math.isnan(t_u_s) and recorded_V == u_V:
            acts_V = u_V  # the device has not told of it: it stands there as it was commanded
        if acts_V != recorded_V and (self._quantise is not None or abs(acts_V - recorded_V) > 1e-6):
            by: By = "guard" if (flags | tape.flags[row]) & _GUARD_FLAGS else "law"
            raise tape.diverged(row, by, f"{recorded_V:+.6f} V", f"{acts_V:+.6f} V", recorded_V, acts_V)
        self.compared += 1


class ReplayLoop(Loop):
    """The loop, with an ear at its laws: what each asked for is kept on the tape."""

    tape: Tape

    def run(self, law: Law, stage: str, watch: Callable[[float], None] | None = None) -> None:
        """As ``Loop.run``."""
        super().run(_Heard(law, self.tape), stage, watch)

    def run_in_device(
        self, law: Law, command: RelayCommand, stage: str, watch: Callable[[float], None] | None = None
    ) -> None:
        """As ``Loop.run_in_device``."""
        super().run_in_device(_Heard(law, self.tape), command, stage, watch)

    def _record_last_rows(self) -> None:
        """None: a replay ends where the loop gives up."""


class _Heard:
    """A law whose drives are kept."""

    def __init__(self, law: Law, tape: Tape) -> None:
        self._law = law
        self._tape = tape
        self._show()

    def step(self, sample: Sample) -> float:
        """The law's drive, V."""
        self._tape.asked_V = _NAN
        try:
            u_V = self._law.step(sample)
        finally:
            self._show()
        self._tape.asked_V = u_V
        return u_V

    def _show(self) -> None:
        self.finished, self.z_rad_s, self.yd_rad = self._law.finished, self._law.z_rad_s, self._law.yd_rad


def _same(a: float, b: float) -> bool:
    """Whether two numbers are the same, up to the last bits in which mathematical libraries differ; nan is nan."""
    return a == b or math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12) or (math.isnan(a) and math.isnan(b))


def _guard_words(flags: int) -> str:
    if flags & FLAG_GUARD_BRAKED:
        return "the guard braked"
    return "the guard let less drive out" if flags & FLAG_GUARD_CLIPPED else "the guard let the law's drive out"
