"""A law in the device while it drives: the loop records each of its ticks, and checks it by law and guard."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from rig.backends.driver import RelayCommand, RelayDriver, RelayRow, StrokeDriver, StrokesCommand
from rig.control.guard import Guard
from rig.control.law import Law
from rig.control.loop.statistics import LoopStatistics
from rig.core.faults import Fault
from rig.core.signals import FLAG_SKIPPED, Sample
from rig.run_folder.recording.sink import RowSink
from rig.run_folder.recording.stage import StageKind

STOPPING = "stopping"  # stage of the rows between the end of the run and the stop of the relay in the device


class DeviceRelay:
    """Follows the relay in the device, or the strokes. The loop keeps the device's watchdog quiet and fetches the rows.

    guard, record   the loop's own
    statistics      counts the device's ticks
    since_start_s   converts a time of the driver to the run's time, s

    refused  the first drive that the guard would not let out, in words, where that does not end the run; "": none yet
    """

    def __init__(
        self, guard: Guard, record: RowSink, statistics: LoopStatistics, since_start_s: Callable[[float], float]
    ) -> None:
        self._guard = guard
        self._record = record
        self._statistics = statistics
        self._since_start_s = since_start_s
        self._driver: RelayDriver | None = None  # while it drives
        self._tick_s = math.nan
        self._last_row_s = math.nan
        self._last_u_s = math.nan  # since when the last row's drive acts
        self._ends_run = True  # a drive that the guard would not let out
        self.refused = ""
        self.rows = 0  # recorded so far
        self._untaken: deque[RelayRow] = deque()  # rows that have come and are not recorded yet

    def start(self, driver: RelayDriver, command: RelayCommand | StrokesCommand, *, ends_run: bool = True) -> None:
        """Start the law.

        ends_run  a drive that the guard would not let out ends the run; False: it is noted in ``refused``
        Raises ValueError if the driver has no such law, and Fault as it.
        """
        self._tick_s = driver.tick_s
        self._last_row_s = math.nan
        self._ends_run = ends_run
        self.refused = ""
        if isinstance(command, RelayCommand):
            driver.start_relay(command)
        elif isinstance(driver, StrokeDriver):
            driver.start_strokes(command)
        else:
            raise ValueError(f"no strokes in the device behind {driver.backend}")
        self._driver = driver

    def stop(self, driver: RelayDriver) -> list[RelayRow]:
        """Stop the law. Returns its last rows. Raises Fault as the driver does."""
        last_rows = driver.stop_relay()
        self._driver = None  # all of its rows have come
        return last_rows

    def record_stop(self, driver: RelayDriver, tick: int) -> None:
        """Record since when the drive is 0 V, where the driver tells it: by a row of stage ``rest``."""
        row = driver.row_after_stop() if isinstance(driver, StrokeDriver) else None
        if row is not None:
            at_rest = row._replace(t_u_s=max(row.t_u_s, self._last_u_s))
            self._record_row(at_rest, self._sample(row), tick, str(StageKind.REST), math.nan, math.nan, 0)

    def take(
        self, rows: list[RelayRow], tick: int, law: Law, stage: str, watch: Callable[[float], None] | None
    ) -> list[Sample]:
        """Record each row under the loop's ``tick``, then check it. Returns what was read at each tick of the device.

        law    takes each tick of the device; it must decide the drive that the device drove
        watch  called after each tick with its time, s
        Raises Fault DEVICE_RELAY, RELAY_STOPPED, and the law's and the guard's.
        """
        self._untaken.extend(rows)
        samples: list[Sample] = []
        while self._untaken:
            sample = self._take_row(self._untaken.popleft(), tick, law, stage)
            samples.append(sample)
            if watch is not None:
                watch(sample.t_s)
        return samples

    def _take_row(self, row: RelayRow, tick: int, law: Law, stage: str) -> Sample:
        sample = self._sample(row)
        try:
            decided_V = law.step(sample)
        finally:
            self._record_row(row, sample, tick, stage, law.z_rad_s, law.yd_rad, self._count_tick(sample))
        if row.u_V != decided_V:
            if self._driver is not None:
                # if the device stopped by itself, this raises its reason
                self._untaken.extend(self._driver.read_rows())
            elif row.u_V == 0.0:
                return sample  # it stopped by itself while it was told to stop: the next reading says why
            raise Fault("DEVICE_RELAY", f"{row.u_V:+.3f} V at {row.y_counts} counts, not {decided_V:+.3f} V")
        passed_V, _ = self._guard.allow(sample, row.u_V)
        if passed_V != row.u_V:
            refused = (
                f"{row.u_V:+.2f} V at {sample.y_rad:.3f} rad, {self._guard.velocity_rad_s:+.2f} rad/s, "
                f"predicted stop {self._guard.predicted_stop_rad:.3f} rad"
            )
            if self._ends_run:
                raise Fault("RELAY_STOPPED", refused)
            self.refused = self.refused or refused
        return sample

    def record_last_rows(self, tick: int, now_s: float) -> None:
        """Record the rows that are left when the run ends while the law drives; nothing checks them."""
        driver, self._driver = self._driver, None
        if driver is not None:
            try:
                self._untaken.extend(driver.read_rows())
            except Exception as error:  # noqa: BLE001 - a broken driver must not hide why the run ended
                self._record.event(now_s, "rows_lost", error=repr(error))
        while self._untaken:
            row = self._untaken.popleft()
            sample = self._sample(row)
            self._record_row(row, sample, tick, STOPPING, math.nan, math.nan, self._count_tick(sample))

    def _sample(self, row: RelayRow) -> Sample:
        return Sample(self._since_start_s(row.t_s), row.y_rad, row.y_counts, seq=row.block)

    def _count_tick(self, sample: Sample) -> int:
        """Count a tick of the device, and those before it that it did not run. Returns the flags of its row."""
        since_s, tick_s = sample.t_s - self._last_row_s, self._tick_s
        missed = max(round(since_s / tick_s) - 1, 0) if math.isfinite(since_s) else 0
        self._last_row_s = sample.t_s
        self._statistics.device_tick(tick_s, missed)
        return FLAG_SKIPPED if missed else 0

    def _record_row(
        self, row: RelayRow, sample: Sample, tick: int, stage: str, z_rad_s: float, yd_rad: float, flags: int
    ) -> None:
        self._last_u_s = row.t_u_s
        self.rows += 1
        self._record.sample(tick, sample, stage, z_rad_s, yd_rad, row.u_V, math.nan, math.nan, flags)
        self._record.complete(self._since_start_s(row.t_u_s), row.u_V)
