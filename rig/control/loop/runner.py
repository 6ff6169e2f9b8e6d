"""The loop: on an absolute grid of ticks it reads, decides, writes and records. However it ends, it stops the drive."""

from __future__ import annotations

import gc
import math
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rig.backends.clock import MonotonicClock
from rig.backends.driver import Clock, Driver, PulseDriver, RelayCommand, RelayDriver, RelayRow, StrokesCommand
from rig.control.guard import WINDOW_S, Guard
from rig.control.law import Law, Pulsed, Timed
from rig.control.loop.device_relay import DeviceRelay
from rig.control.loop.pause_watch import PauseWatch
from rig.control.loop.statistics import LoopStatistics
from rig.control.loop.stop_request import StopRequest
from rig.control.loop.suspend import SuspendWatch
from rig.control.motion import is_obeyed
from rig.core.faults import Fault
from rig.core.signals import FLAG_SATURATED, FLAG_SKIPPED, Limits, Sample
from rig.run_folder.live.law_lease import LawLease
from rig.run_folder.recording.sink import RowSink
from rig.run_folder.results import LoopResult

_CHECK_EVERY_TICKS = 25
_ENDS_LAW = ("INTERRUPTED", "LAW_TIME")  # in the middle of its step
_OLD_PERIODS = 2.0  # age of a reading on which nothing is decided any more
_KEPT_DRIVES = 512  # asked for last: those that may still wait in a device
_WELL = "exchanges"  # of a driver's counts the one that counts no error


class Loop:
    """Runs laws on a driver, tick by tick, inside ``armed``.

    Tick k is due at t0 + k * period_s. A late tick runs at once, with its true time. The loop skips and counts the
    ticks that have passed meanwhile; it never catches up. The drive that goes out is the guard's.

    driver, clock   the bench and its time. A driver of order "write_first" sends a drive with the next tick's exchange:
                    it acts about one period later, and its row says so
    guard           latches faults; one for each loop
    record          takes rows and events
    stop            checked every tick; a reason there raises Fault INTERRUPTED
    """

    def __init__(
        self, driver: Driver, clock: Clock, guard: Guard, record: RowSink, period_s: float, stop: StopRequest
    ) -> None:
        self.guard = guard
        self.statistics = LoopStatistics()
        self._driver = driver
        self._clock = clock
        self._record = record
        self._period_s = period_s
        # with the order write_first a drive acts a period later
        self._longest_latency_s = period_s * (2.0 if driver.order == "write_first" else 1.0)
        self._stop = stop
        self.pause_watch = PauseWatch(driver, clock, period_s, guard.settings.rail_counts)
        self._link_watch = _LinkWatch(driver, record)
        self._suspend_watch = SuspendWatch(clock)
        self._t0_s = clock.now_s() + period_s
        self._tick = 0
        self._row_open = False
        self._asked: deque[tuple[float, float]] = deque(maxlen=_KEPT_DRIVES)  # times of samples, and their drives
        self._skipped = 0  # ticks skipped just before the next one
        self.last_y_rad = math.nan  # position at the last tick, of the loop or of a relay in the device
        self._last_t_s = math.nan
        self._newest_t_s = -math.inf  # of any row
        self._write: Callable[[float], None] = driver.write
        self._relay = DeviceRelay(guard, record, self.statistics, self._since_start_s)
        self._rows = 0  # of the loop itself
        self.unconfirmed_stops = 0  # stops that the device did not confirm: its watchdog has to stop the drive
        self.latency_s = 0.0  # from sample to effect of the drive, smoothed
        guard.pace(period_s)

    def since_start_s(self, t_s: float) -> float:
        """A time of the clock as run time, s."""
        return t_s - self._t0_s

    @property
    def now_s(self) -> float:
        """Time since the run's start, s."""
        return self._clock.now_s() - self._t0_s

    @property
    def rows(self) -> int:
        """Rows recorded so far, those of a relay in the device too."""
        return self._rows + self._relay.rows

    def summary(self) -> LoopResult:
        """The loop for result.json."""
        return self.statistics.summary(self._period_s)

    def expect_delay(self, reported_s: float) -> None:
        """Take the delay from a sample to its drive, as the device reports it, s: it may be many ticks."""
        if self.waits(reported_s):
            self.latency_s = reported_s

    def waits(self, latency_s: float) -> bool:
        """Whether drives wait in a device with this latency, s: a report is not of the last drive."""
        return latency_s >= self._longest_latency_s

    def _since_start_s(self, t_s: float) -> float:
        """A driver's time as run time, s; to the nanosecond, so that a law decides on exactly what is recorded."""
        return round(t_s - self._t0_s, 9)

    @contextmanager
    def armed(self, limits: Limits) -> Iterator[None]:
        """Arm the device for the block. However the block ends, stop the drive and disarm.

        Between two blocks the device is in a pause. A fault in the pause is raised here, by ``check_stop``, or by the
        driver when it arms. After the last block ``close`` ends the pause.
        Raises Fault STOP_UNCONFIRMED, SUSPENDED, RECORDER_DEAD, and what the driver and ``check_stop`` raise;
        ValueError in real time without a stop flag.
        """
        with self._suspend_watch.told():
            yield from self._armed(limits)

    def _armed(self, limits: Limits) -> Iterator[None]:
        self.pause_watch.end()
        self.check_stop()
        self._suspend_watch.check()
        if isinstance(self._clock, MonotonicClock):
            if not self._stop.is_for_all:
                raise ValueError("in real time nothing drives that has no stop flag: StopFlag.open before the device")
            gc.collect()  # in the middle of a tick it would delay the drive
        gc.disable()
        try:
            self._stop.take_signals()  # a driver's library may have others
            self._stop.tell_drive(is_on=True)
            self.check_stop()  # who asked before this was told that nothing drives yet
            self.guard.rearm()
            self._driver.arm(limits)
            self._tick = max(self._tick, math.ceil(self.now_s / self._period_s))
            self._skipped = 0
            yield
            self._finish_row()
        finally:
            stopped = self._stop_drive()
        if not stopped:
            raise Fault("STOP_UNCONFIRMED")
        self.pause_watch.begin()

    @contextmanager
    def kept(self, lease: LawLease) -> Iterator[None]:
        """For the block, a keeper sees by the lease that the loop goes on, and whether a drive may be on."""
        self._stop.lease = lease
        try:
            yield
        finally:
            self._stop.lease = None

    def close(self) -> None:
        """Let go of the driver. May be called twice."""
        self.pause_watch.give_up()

    def _stop_drive(self) -> bool:
        """Stop, whatever happens. Returns whether the device confirmed it."""
        try:
            stopped = self._stop_confirmed()
            self._record_last_rows()
            return stopped
        finally:
            gc.enable()
            self._row_open = False

    def _stop_confirmed(self) -> bool:
        try:
            self._stop.tell_idle(is_idle=False)  # whatever ended the ticks: it waits for the device now
            stopped = self._driver.safe_stop()
        except Exception as error:  # noqa: BLE001 - a broken driver must not hide why the run ended
            stopped = False
            self._record.event(self.now_s, "stop_failed", error=repr(error))
        self._record.event(self.now_s, "stop", confirmed=stopped)
        self.unconfirmed_stops += not stopped
        if stopped:
            self._stop.tell_drive(is_on=False)
        return stopped

    def run(self, law: Law, stage: str, watch: Callable[[float], None] | None = None) -> None:
        """Run ``law`` to its end inside ``armed``; ``watch`` is called after each tick with its time, s.

        Raises Fault: the driver's, the guard's, the law's, INTERRUPTED, SUSPENDED, RECORDER_DEAD.
        """
        law = self._as_run(law)
        self._record.event(self.now_s, "stage", name=stage)
        self._write = self._writer(law)
        is_own = isinstance(law, Timed)
        while not law.finished:
            sample = self._run_tick(law, stage)
            if is_own:
                self._stop.take_signals()
            if watch is not None:
                watch(sample.t_s)

    def _as_run(self, law: Law) -> Law:
        """The law; in a replay with what it asks for."""
        return law

    def _writer(self, law: Law) -> Callable[[float], None]:
        """What sends the law's drives: as pulses where it wants that, and the device ends them by itself."""
        driver = self._driver
        if not (isinstance(law, Pulsed) and isinstance(driver, PulseDriver) and driver.pulses):
            return driver.write
        # 0 V of the guard goes out as a pulse, too: after a DRIVE the pulse's time would begin anew
        return lambda u_V: driver.write_pulse(u_V, law.pulse_s) if law.pulse_s > 0.0 else driver.write(u_V)

    def run_in_device(
        self,
        law: Law,
        command: RelayCommand | StrokesCommand,
        stage: str,
        watch: Callable[[float], None] | None = None,
        *,
        guard_ends_run: bool = True,
    ) -> None:
        """Let a law in the device drive until ``law`` has ended; inside ``armed``. The shaft may be in motion.

        ``law`` takes each tick of the device, and must decide the drive that the device drove. The guard checks each
        tick, too. It cannot change the device's drive: if it would have to, it ends the run; or, if
        ``guard_ends_run`` is False, the law alone: the next law's drive is the guard's again. Each tick of the loop
        keeps the device's watchdog quiet and fetches the rows that have come.
        Raises Fault as ``run``, and DEVICE_RELAY, RELAY_STOPPED, LINK_GAP; ValueError if the device has no such law.
        """
        driver = self._driver
        if not isinstance(driver, RelayDriver):
            raise ValueError(f"no relay in the device behind {self._driver.backend}")
        law = self._as_run(law)
        self._record.event(self.now_s, "stage", name=stage)
        self._finish_row()
        self.guard.pace(driver.tick_s, max(4.0 * self._period_s, WINDOW_S))
        self._relay.start(driver, command, ends_run=guard_ends_run)
        self._tick = max(self._tick, math.ceil(self.now_s / self._period_s))
        while not (law.finished or self._relay.refused):
            due_s, woke_s = self._await_tick()
            driver.keep()
            self._take_rows(driver.read_rows(), law, stage, watch)
            self.statistics.tick((woke_s - due_s) * 1e6, (self._clock.now_s() - woke_s) * 1e6)
            self._end_tick(due_s)
        self._take_rows(self._relay.stop(driver), law, stage, watch)
        self._relay.record_stop(driver, self._tick)
        self.guard.pace(self._period_s)
        self._last_t_s = math.nan
        self._tick = max(self._tick, math.ceil(self.now_s / self._period_s))

    def _take_rows(self, rows: list[RelayRow], law: Law, stage: str, watch: Callable[[float], None] | None) -> None:
        samples = self._relay.take(rows, self._tick, law, stage, watch)
        if samples:
            self.last_y_rad = samples[-1].y_rad

    def _record_last_rows(self) -> None:
        """Record the last rows of a relay in the device, if the run ends while it drives."""
        self._relay.record_last_rows(self._tick, self.now_s)

    def _run_tick(self, law: Law, stage: str) -> Sample:
        now_s = self._clock.now_s
        due_s, woke_s = self._await_tick()
        sample = self._fresh_reading()
        read_s = now_s()
        sample = sample._replace(t_s=self._since_start_s(sample.t_s), t_u_s=self._since_start_s(sample.t_u_s))
        if sample.t_s < self._newest_t_s:
            # record no row of it: nothing can read a recording whose time goes back
            raise Fault("DEVICE_RESET", f"a reading of {sample.t_s:.4f} s after one of {self._newest_t_s:.4f} s")
        self._newest_t_s = sample.t_s
        late_us, io_us = (woke_s - due_s) * 1e6, (read_s - woke_s) * 1e6
        self.statistics.tick(late_us, io_us)
        try:
            asked_V = law.step(sample)
            self._stop.tell_idle(is_idle=True)
            u_V, flags = self.guard.allow(sample, asked_V)
            decided_s = now_s()
            self._stop.tell_idle(is_idle=False)
            self._write(u_V)
        except BaseException as error:
            if isinstance(error, Fault) and error.code in _ENDS_LAW:
                self._complete_row(sample)  # no law decided on this reading, so a replay must not ask it to
            else:
                # record the reading that ended the run; the stop that follows drives 0 V
                self._record_tick(law, stage, sample, 0.0, late_us, io_us, 0)
            raise
        written_s = now_s()
        self._record_tick(law, stage, sample, u_V, late_us, io_us, flags)
        self._row_open = True
        self._asked.append((sample.t_s, u_V))
        self.statistics.drive((decided_s - read_s) * 1e6, (written_s - decided_s) * 1e6, (now_s() - written_s) * 1e6)
        self._end_tick(due_s)
        return sample

    def _fresh_reading(self) -> Sample:
        """A reading of this tick; another one where the host stood still after the device had taken the first."""
        begun_s, old_s = self._clock.now_s(), _OLD_PERIODS * self._period_s
        sample = self._driver.read()
        now_s = self._clock.now_s()
        return self._driver.read() if now_s - begun_s > old_s and now_s - sample.t_s > old_s else sample

    def _record_tick(
        self, law: Law, stage: str, sample: Sample, u_V: float, late_us: float, io_us: float, flags: int
    ) -> None:
        """Once the drive is out: complete the row before, by what this sample reports, and open this tick's row."""
        self._complete_row(sample)
        self._measure_latency(sample)
        self._last_t_s, self.last_y_rad = sample.t_s, sample.y_rad
        if self._skipped:
            flags |= FLAG_SKIPPED
        self._rows += 1
        self._record.sample(self._tick, sample, stage, law.z_rad_s, law.yd_rad, u_V, late_us, io_us, flags)

    def _await_tick(self) -> tuple[float, float]:
        """Sleep until the next tick is due. Returns when it was due and when the sleep ended, s."""
        due_s = self._t0_s + self._tick * self._period_s
        self._stop.tell_idle(is_idle=True)
        woke_s = self._clock.sleep_until(due_s)
        while woke_s < due_s and self._stop.reason is None:
            woke_s = self._clock.sleep_until(due_s)  # a signal ended the sleep, but not one that stops the run
        self._stop.tell_idle(is_idle=False)
        self.check_stop()
        self._suspend_watch.check()
        return due_s, woke_s

    def _end_tick(self, due_s: float) -> None:
        """Go to the next tick of the grid that is still ahead."""
        if self.statistics.ticks % _CHECK_EVERY_TICKS == 0:
            self._record.check()
            self._link_watch.look(self.now_s)
        self._skipped = max(int((self._clock.now_s() - due_s) / self._period_s), 0)
        self.statistics.skipped += self._skipped
        self._tick += 1 + self._skipped

    def check_stop(self) -> None:
        """Raise Fault INTERRUPTED if a signal or the stop flag asks for a stop, or the fault that a pause showed."""
        reason = self._stop.look()
        if reason is not None:
            raise Fault("INTERRUPTED", reason)
        self.pause_watch.check()

    def _complete_row(self, sample: Sample) -> None:
        if self._row_open:
            accepted = sample.t_u_s >= self._last_t_s  # else the drive was lost: the one before still acts
            clipped = accepted and not is_obeyed(self._decided_V(sample.t_u_s), sample.u_V)
            self._record.complete(sample.t_u_s, sample.u_V, FLAG_SATURATED if clipped else 0)
            self._row_open = False

    def _decided_V(self, t_u_s: float) -> float:
        """The drive that was asked for a delay before ``t_u_s``, V: where none waits in the device, the last one."""
        if not self.waits(self.latency_s) or math.isnan(t_u_s):
            return self._asked[-1][1]
        return min(self._asked, key=lambda asked: abs(asked[0] + self.latency_s - t_u_s))[1]

    def _measure_latency(self, sample: Sample) -> None:
        latency_s = sample.t_u_s - self._last_t_s
        if self.waits(self.latency_s) and math.isfinite(latency_s):
            # drives wait in the device: the report is of one that was decided whole periods ago
            latency_s += round((self.latency_s - latency_s) / self._period_s) * self._period_s
            self.latency_s += 0.05 * (latency_s - self.latency_s)
            return
        if 0.0 <= latency_s < self._longest_latency_s:  # false for nan, and after a skipped tick
            self.latency_s += (latency_s - self.latency_s) * (0.05 if self.latency_s else 1.0)

    def _finish_row(self) -> None:
        """One last exchange, to complete the last row with the effect of its drive."""
        if self._row_open:
            self._clock.sleep_until(self._t0_s + self._tick * self._period_s)
            sample = self._driver.read()
            self._complete_row(sample._replace(t_u_s=self._since_start_s(sample.t_u_s)))


class _LinkWatch:
    """Writes an event ``link`` whenever the driver has counted more errors of its link than before."""

    def __init__(self, driver: Driver, record: RowSink) -> None:
        self._driver = driver
        self._record = record
        self._errors = 0

    def look(self, now_s: float) -> None:
        """Look at the driver's counts; ``now_s`` is the time of the run. Writes memory only."""
        counts = self._driver.link_statistics
        # a driver of another package may count anything
        errors = {name: n for name, n in counts.items() if name != _WELL and isinstance(n, int) and n > 0}
        total = sum(errors.values())
        if total > self._errors:
            self._errors = total
            worst = max(errors, key=lambda name: errors[name])
            self._record.event(now_s, "link", errors=total, most=worst)
