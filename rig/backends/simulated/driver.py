"""The simulated driver: the exact bench in virtual time, deterministic by seed, faster than real time."""

from __future__ import annotations

import math
import random
from array import array
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from rig.backends.driver import Clock, DeviceInfo, DeviceWatchdog
from rig.core.calibration import Scaling, hard_limits_in_counts
from rig.core.faults import Fault
from rig.core.signals import Limits, Order, Sample
from rig.model.bench import BenchModel, BenchParameters


@dataclass(frozen=True)
class SimulatedLatency:
    """Time from sampling the position to the effect of the drive: uniform, mean +- half width, s."""

    mean_s: float
    half_width_s: float


class SimulatedDriver:
    """The emulated bench as a driver, with a device's own watchdog and travel limits.

    clock         virtual time; ``read`` lets the bench catch up with it
    bench         what is really there
    scaling       sensor and drive as the config describes them; readings at or beyond the rails make the device stop
    latency       from the write of a drive until it acts; may be longer than a period
    order         "write_first": a drive goes out with the next ``read``, just before its sample, and acts at once
    """

    backend = "simulated in virtual time"

    def __init__(
        self,
        clock: Clock,
        bench: BenchParameters,
        scaling: Scaling,
        latency: SimulatedLatency,
        seed: int,
        order: Order = "sample_first",
    ) -> None:
        self.order: Order = order
        self.bench = BenchModel(bench, seed)
        self.failsafe: DeviceWatchdog | None = DeviceWatchdog(1.0)  # until armed with less
        self.link_statistics: Mapping[str, int] = {}
        self._clock = clock
        self._calibration = scaling.calibration
        self._drive_map = scaling.drive_map
        self._rail_counts = scaling.rail_counts
        self._latency = latency
        self._jitter = random.Random(seed + 1)
        self._now_s = clock.now_s()
        self._limits: Limits | None = None
        self._heard_s = self._now_s
        self._fault: Fault | None = None
        self._pending: deque[tuple[float, int]] = deque()  # effect times, drive units; in order of both
        self._staged: int | None = None  # goes out with the next reading
        self._effect_s = math.nan  # until something was driven
        self._seq = 0
        self._shaft_t_s, self._shaft_rad = array("d"), array("d")
        self._recovering = False  # armed outside the hard limits: only inward drive, until inside

    def open(self) -> DeviceInfo:
        """Meet the simulated device."""
        return DeviceInfo(
            build="simulated",
            board="simulated",
            reset_cause="power-on",
            emulated=True,
            drive_units=self._drive_map.full_units,
        )

    def arm(self, limits: Limits) -> None:
        """Give the device its limits and allow drive; clears a latched fault. ValueError as for a real device."""
        hard_limits_in_counts(limits, self._calibration, self._drive_map, self._rail_counts)
        self._catch_up()
        self._limits = limits
        self.failsafe = DeviceWatchdog(limits.watchdog_s)
        self._fault = None
        self._heard_s = self._now_s
        self.bench.arm()
        self._recovering = True  # until a reading inside says otherwise

    def read(self) -> Sample:
        """Sample the bench now. Raises the device's latched Fault."""
        self._catch_up()
        if self._staged is not None and self._fault is None:
            self._effect_s = self._heard_s = self._now_s
            self._set_pin(self._staged)
            self._staged = None
        if self.bench.pin_counts == 0:
            self._heard_s = self._now_s  # as in the firmware: only drives keep a drive on
        counts = self.bench.read_counts()
        self._shaft_t_s.append(self._now_s)
        self._shaft_rad.append(self.bench.shaft_rad)
        self._check_device(counts)
        if self._fault is not None:
            raise self._fault
        self._seq += 1
        return Sample(
            t_s=self._now_s,
            y_rad=self._calibration.to_rad(counts),
            y_counts=counts,
            v_rad_per_s=self.bench.read_tachometer_rad_s(),
            t_u_s=self._effect_s,
            u_V=self._drive_map.to_volts(round(self.bench.pin_counts)),
            seq=self._seq,
        )

    def shaft(self) -> tuple[array[float], array[float]]:
        """Times of the readings so far, s, and where the shaft really was, rad."""
        return self._shaft_t_s, self._shaft_rad

    def write(self, u_V: float) -> None:
        """Set the drive; it acts after the latency. Raises ValueError beyond the drive's range, Fault if not armed."""
        units = self._drive_map.to_units(u_V)
        if self._limits is None:
            raise Fault("DEVICE_NOT_ARMED")
        if self._clock.now_s() > self._now_s:
            self._catch_up()
        if self._fault is not None:
            return  # latched: the next reading tells
        if abs(u_V) > self._limits.max_u_V + 0.5 * self._drive_map.full_V / self._drive_map.full_units:
            self._stop(Fault("DEVICE_DRIVE_RANGE", f"{u_V:.3f} V; armed for {self._limits.max_u_V:.3f} V"))
            return
        if self.order == "write_first":
            self._staged = units
            return
        half_width = self._latency.half_width_s
        delay_s = self._latency.mean_s + self._jitter.uniform(-half_width, half_width)
        effect_s = self._now_s + max(delay_s, 0.0)
        if self._pending:
            effect_s = max(effect_s, self._pending[-1][0])  # none overtakes another
        self._pending.append((effect_s, units))
        self._heard_s = self._now_s

    def safe_stop(self) -> bool:
        """Set 0 V and disarm, at once."""
        self._catch_up()
        self._pending.clear()
        self._staged = None
        self._set_pin(0)
        self._limits = None
        return True

    def close(self) -> None:
        """Nothing to give back."""
        if self._limits is not None:
            self.safe_stop()

    def _catch_up(self) -> None:
        now_s = self._clock.now_s()
        if self._limits is not None and self._fault is None:
            silent_at = self._heard_s + self._limits.watchdog_s
            if silent_at < now_s:
                self._advance_to(silent_at)
                self._stop(Fault("DEVICE_WATCHDOG", f"silent for {self._limits.watchdog_s * 1e3:.0f} ms"))
        self._advance_to(now_s)

    def _advance_to(self, t_s: float) -> None:
        while self._pending and self._pending[0][0] <= t_s:
            effect_s, units = self._pending.popleft()
            self.bench.advance(max(effect_s - self._now_s, 0.0))
            self._now_s = max(effect_s, self._now_s)
            self._effect_s = self._now_s
            self._set_pin(units)
        self.bench.advance(max(t_s - self._now_s, 0.0))
        self._now_s = max(t_s, self._now_s)

    def _set_pin(self, units: int) -> None:
        self.bench.pin_counts = units

    def _stop(self, fault: Fault) -> None:
        self._fault = fault
        self._pending.clear()
        self._staged = None
        self._effect_s = self._now_s
        self._set_pin(0)

    def _check_device(self, counts: int) -> None:
        """The device's own layer: rails and hard limits."""
        if self._limits is None or self._fault is not None:
            return
        low, high = self._rail_counts
        if not low < counts < high:
            self._stop(Fault("DEVICE_SENSOR", f"reading {counts} counts"))
            return
        y_rad = self._calibration.to_rad(counts)
        low_rad, high_rad = self._limits.hard_rad
        if low_rad <= y_rad <= high_rad:
            self._recovering = False
        elif not self._recovering:
            self._stop(Fault("DEVICE_TRAVEL", f"y = {y_rad:.3f} rad"))
        elif self._drive_map.to_volts(round(self.bench.pin_counts)) * y_rad > 0.0:
            self._stop(Fault("DEVICE_TRAVEL", f"outward drive at y = {y_rad:.3f} rad"))
