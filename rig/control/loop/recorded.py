"""A recorded run as a bench: the loop gets the same samples again, and must come to the drive that acted.

``RecordedDriver`` and ``RecordedClock`` are the bench. ``RowComparison`` takes the loop's rows. ``ReplayLoop`` is the
loop. All of them share one ``ReplayedRows``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from rig.backends.driver import (
    DeviceInfo,
    DeviceWatchdog,
    RelayCommand,
    RelayRow,
    RelayRules,
    StrokeRules,
    StrokesCommand,
    StrokeTimes,
)
from rig.control.law import Law
from rig.control.loop.replayed_rows import AFTER_DRIVING, OF_LAW_OR_GUARD, By, ReplayedRows
from rig.control.loop.runner import Loop
from rig.core.calibration import DriveMap
from rig.core.faults import Fault
from rig.core.signals import FLAG_GUARD_BRAKED, FLAG_GUARD_CLIPPED, FLAG_SATURATED, FLAG_SKIPPED, Limits, Order, Sample
from rig.run_folder.recording.sink import NullSink, Row
from rig.run_folder.recording.stage import StageKind

KEPT_DRIVES = 512  # decided last: those that may still wait in the device
_GUARD_FLAGS = FLAG_GUARD_CLIPPED | FLAG_GUARD_BRAKED
_NAN = math.nan


class RecordedClock:
    """The time of the recording: it passes from row to row."""

    absolute = True

    def __init__(self, replayed: ReplayedRows) -> None:
        self._replayed = replayed

    def now_s(self) -> float:
        """Time of the replay, s."""
        return self._replayed.now_s

    def sleep_until(self, t_s: float) -> float:
        """Let time pass to ``t_s``, unless that is past. Returns the time then, s."""
        self._replayed.now_s = max(self._replayed.now_s, t_s)
        return self._replayed.now_s


class RecordedDriver:
    """The samples of a recording behind the driver interface, with the relay in a device. It drives nothing.

    order        order of a tick in the run
    drive_map    of the run, with the drive's units
    clock_ratio  device seconds in a second of the host
    relay        what its device made of the gains of a relay in it; None: unknown
    """

    failsafe: DeviceWatchdog | None = DeviceWatchdog(1.0)
    backend = "a record"
    link_statistics: Mapping[str, int] = {}

    def __init__(
        self, replayed: ReplayedRows, order: Order, drive_map: DriveMap, clock_ratio: float, relay: RelayRules | None
    ) -> None:
        self.order = order
        self._replayed = replayed
        self._drive_map = drive_map
        self._clock_ratio = clock_ratio
        self._rules = relay
        self._is_armed_anew = False
        self._stops = 0
        self._device_stage = ""

    def open(self) -> DeviceInfo:
        """There is no device to open."""
        return DeviceInfo(build="", board="record", reset_cause="", emulated=True, clock_ratio=self._clock_ratio)

    def arm(self, limits: Limits) -> None:
        """Go on at the next row; without one, raises as ``ReplayedRows.end``."""
        if self._replayed.is_over:
            self._replayed.end(arming=True)
        self._is_armed_anew = True
        self._replayed.set_clock()

    def read(self) -> Sample:
        """The next row's sample, with the last drive as the row before reports it; raises as ``ReplayedRows.end``.

        After the last row there is one more sample: the exchange that completed that row.
        """
        replayed, row = self._replayed, self._replayed.next
        t_u_s, u_V = _NAN, 0.0
        if row > 0 and not self._is_armed_anew:
            t_u_s, u_V = replayed[row - 1].t_u_s, replayed[row - 1].u_V
        self._is_armed_anew = False
        if row < len(replayed):
            now = replayed[row]
            return Sample(now.t_s, now.y_rad, now.y_counts, now.v_rad_per_s, t_u_s, u_V, now.seq)
        if row == 0 or math.isnan(t_u_s) or replayed[row - 1].in_device:
            replayed.end()
        last = replayed[-1]
        return Sample(last.t_s + replayed.period_s, last.y_rad, last.y_counts, _NAN, t_u_s, u_V, last.seq)

    def write(self, u_V: float) -> None:
        """Take the drive, as the device would; ``RowComparison`` compares it. Raises ValueError beyond its range.

        If a fault of neither law nor guard ended the run in this tick, raises that fault.
        """
        self._drive_map.to_units(u_V)
        replayed, fault = self._replayed, self._replayed.fault
        in_last_tick = replayed.next == len(replayed) - 1 and replayed.ends_in_tick
        if fault is not None and in_last_tick and fault.code not in OF_LAW_OR_GUARD | AFTER_DRIVING | {"INTERRUPTED"}:
            raise fault

    def safe_stop(self) -> bool:
        """Whether the device confirmed the stop in the run."""
        self._stops += 1
        stops = self._replayed.stops
        return stops[self._stops - 1] if self._stops <= len(stops) else True

    def close(self) -> None:
        """Nothing to give back."""

    # ------------------------------------------------------------------ the relay in the device

    @property
    def tick_s(self) -> float:
        """The device's tick in host time, s."""
        return self._relay.tick_s

    def relay_command(self, h1_V: float, h2_V: float, z_bound_rad_s: float) -> RelayCommand:
        """The command that the device got; raises as ``RelayRules.relay_command``."""
        return self._relay.relay_command(h1_V, h2_V, z_bound_rad_s)

    def strokes_command(
        self, strokes: Sequence[tuple[float, float]], times: StrokeTimes, motion_rad: float
    ) -> StrokesCommand:
        """The command that the device got; raises as ``StrokeRules.strokes_command``.

        Raises Fault CONFIG_MISMATCH, too, for a driver without strokes.
        """
        if not isinstance(self._rules, StrokeRules):
            raise Fault("CONFIG_MISMATCH", "relay.where is device, but its driver does not say how strokes run there")
        return self._rules.strokes_command(strokes, times, motion_rad)

    @property
    def _relay(self) -> RelayRules:
        if self._rules is None:
            raise Fault("CONFIG_MISMATCH", "relay.where is device, but its driver does not say how a relay runs there")
        return self._rules

    def start_relay(self, command: RelayCommand) -> None:
        """Go on at the relay's first row.

        Raises as ``ReplayedRows.end``; Diverged if the next row does not come from a law in the device.
        """
        self._start_law("the relay in the device starts")

    def start_strokes(self, command: StrokesCommand) -> None:
        """Go on at the first row of the strokes; raises as ``start_relay``."""
        self._start_law("the strokes in the device start")

    def _start_law(self, what: str) -> None:
        if self._replayed.is_over:
            self._replayed.end()
        row = self._replayed.next
        if not self._replayed[row].in_device:
            raise self._replayed.diverged(row, "record", "a tick of the loop", what)
        self._device_stage = self._replayed[row].stage
        self._replayed.set_clock()

    def keep(self) -> None:
        """The law goes on. Raises as ``ReplayedRows.end``; Diverged if it had ended here in the run."""
        replayed = self._replayed
        if replayed.is_over:
            replayed.end()
        if not self._is_of_relay(replayed.next):
            raise replayed.diverged(
                replayed.next, "law", "the law in the device has ended", f"{self._device_stage} goes on"
            )

    def read_rows(self) -> list[RelayRow]:
        """The rows that the loop took in this tick."""
        replayed, first = self._replayed, self._replayed.next
        end = first
        while (
            end < len(replayed)
            and self._is_of_relay(end)
            and replayed[end].tick * replayed.period_s <= replayed.now_s + 1e-9
        ):
            end += 1
        return self._rows(first, end)

    def stop_relay(self) -> list[RelayRow]:
        """The law's last rows."""
        first = end = self._replayed.next
        while end < len(self._replayed) and self._is_of_relay(end):
            end += 1
        return self._rows(first, end)

    def row_after_stop(self) -> RelayRow | None:
        """The row that tells since when the drive was 0 V; None: the run has not recorded one."""
        row = self._replayed.next
        if row < len(self._replayed) and self._replayed[row].in_device and self._replayed[row].stage == StageKind.REST:
            return self._rows(row, row + 1)[0]
        return None

    def _is_of_relay(self, row: int) -> bool:
        recorded = self._replayed[row]
        return recorded.in_device and recorded.stage == self._device_stage

    def _rows(self, first: int, end: int) -> list[RelayRow]:
        rows = [self._replayed[k] for k in range(first, end)]
        return [RelayRow(row.t_s, row.t_u_s, row.y_rad, row.y_counts, row.u_V, row.seq) for row in rows]


class RowComparison(NullSink):
    """Compares each row of a replayed loop with the recorded row; raises Diverged at the first difference.

    It does not compare when a drive took effect: the replay takes that from the recording. The decisions of laws and
    guard show in the drive.

    quantise   the drive that the device makes of a commanded one, V to V; None: unknown, so drives must agree to 1 uV

    compared   rows whose drive is the one that acted
    lost       rows whose drive never reached the device
    limited    rows in which the device drove less than commanded
    delay_s    from a sample to its drive, where drives waited in the device: each row holds one that was decided
               earlier; 0.0 where they did not
    """

    def __init__(self, replayed: ReplayedRows, quantise: Callable[[float], float] | None) -> None:
        self.compared = 0
        self.lost = 0
        self.limited = 0
        self.delay_s = 0.0
        self._replayed = replayed
        self._quantise = quantise
        self._asked: deque[tuple[float, float, int]] = deque(maxlen=KEPT_DRIVES)

    def sample(self, *row: *Row) -> None:
        """Compare a row that the loop would write.

        Raises Diverged at the first difference; without another recorded row, as ``ReplayedRows.end``.
        """
        tick, _, stage, z_rad_s, yd_rad, u_V, _, _, flags = row
        replayed, at = self._replayed, self._replayed.next
        if replayed.is_over:
            replayed.end()
        self._compare_course(at, tick, stage, flags)
        self._compare_drive(at, u_V, flags)
        for what, unit, then, now in (
            ("integral", "rad s", replayed[at].z_rad_s, z_rad_s),
            ("reference", "rad", replayed[at].yd_rad, yd_rad),
        ):
            if not _same(then, now):
                raise replayed.diverged(at, "law", f"{what} {then!r} {unit}", f"{what} {now!r} {unit}")
        replayed.advance()

    def _compare_course(self, row: int, tick: int, stage: str, flags: int) -> None:
        """Compare the row's tick, whether ticks were skipped before it, its stage, and what the guard did."""
        replayed, then = self._replayed, self._replayed[row]
        recorded = then.flags
        after_relay = row > 0 and replayed[row - 1].in_device and not then.in_device
        if flags & ~recorded & FLAG_SKIPPED and not after_relay:
            raise replayed.diverged(
                row, "record", "no ticks were skipped before this row", "rows are missing before it"
            )
        if recorded & ~flags & FLAG_SKIPPED and not after_relay:
            raise replayed.diverged(
                row, "record", "ticks were skipped before this row", "no rows are missing before it"
            )
        if tick != then.tick:
            raise replayed.diverged(row, "record", f"tick {then.tick}", f"tick {tick}")
        if stage != then.stage:
            raise replayed.diverged(row, "law", f"stage {then.stage}", f"stage {stage}")
        if (flags ^ recorded) & _GUARD_FLAGS:
            raise replayed.diverged(row, "guard", _guard_words(recorded), _guard_words(flags), then.u_V)

    def _compare_drive(self, row: int, u_V: float, flags: int) -> None:
        replayed, then = self._replayed, self._replayed[row]
        recorded_V, t_u_s = then.u_V, then.t_u_s
        self._asked.append((then.t_s, u_V, flags))
        if self.delay_s > 0.0 and not then.in_device:
            decided_s, u_V, flags = min(self._asked, key=lambda asked: abs(asked[0] + self.delay_s - t_u_s))
            if not abs(decided_s + self.delay_s - t_u_s) < 0.5 * replayed.period_s:
                self.lost += 1  # nothing had come to the device
                return
            t_u_s = math.inf
        if then.in_device:
            self.compared += 1  # the loop itself compares it with the law's
            return
        if t_u_s < then.t_s:
            self.lost += 1  # the device still reports the drive before it
            return
        if then.flags & FLAG_SATURATED:
            self.limited += 1
            return
        acts_V = u_V if self._quantise is None else self._quantise(u_V)
        if math.isnan(t_u_s) and recorded_V == u_V:
            acts_V = u_V  # the device did not report it, so the row holds the commanded drive
        if acts_V != recorded_V and (self._quantise is not None or abs(acts_V - recorded_V) > 1e-6):
            by: By = "guard" if (flags | then.flags) & _GUARD_FLAGS else "law"
            raise replayed.diverged(row, by, f"{recorded_V:+.6f} V", f"{acts_V:+.6f} V", recorded_V, acts_V)
        self.compared += 1


class ReplayLoop(Loop):
    """The loop; it also keeps the drive that each law asks for."""

    replayed: ReplayedRows

    def _as_run(self, law: Law) -> Law:
        return _AskedDrive(law, self.replayed)

    def _record_last_rows(self) -> None:
        """Record none: a replay ends where the loop gives up."""


class _AskedDrive:
    """A law; keeps the drive that it asks for in ``replayed``."""

    def __init__(self, law: Law, replayed: ReplayedRows) -> None:
        self._law = law
        self._replayed = replayed
        self.z_rad_s, self.yd_rad = law.z_rad_s, law.yd_rad

    @property
    def finished(self) -> bool:
        """Whether the law has ended, or was ended between two steps."""
        return self._law.finished

    def step(self, sample: Sample) -> float:
        """The law's drive, V."""
        self._replayed.asked_V = _NAN
        try:
            u_V = self._law.step(sample)
        finally:
            self.z_rad_s, self.yd_rad = self._law.z_rad_s, self._law.yd_rad
        self._replayed.asked_V = u_V
        return u_V


def _same(a: float, b: float) -> bool:
    """Whether two numbers are equal up to the last bits, in which mathematical libraries differ; nan equals nan."""
    return a == b or math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12) or (math.isnan(a) and math.isnan(b))


def _guard_words(flags: int) -> str:
    if flags & FLAG_GUARD_BRAKED:
        return "the guard braked"
    return "the guard let less drive out" if flags & FLAG_GUARD_CLIPPED else "the guard let the law's drive out"
