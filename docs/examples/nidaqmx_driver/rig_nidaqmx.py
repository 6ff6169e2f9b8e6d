"""A driver of rig for a card of National Instruments: one analogue input, one analogue output, asked on demand.

An example that was NOT run on hardware: it is tested on a stand-in for the package ``nidaqmx``.

Wiring: the potentiometer's wiper on an input, with 100 kOhm from there to ground, so that a broken wire reads 0 V,
which is a rail, and not whatever floats in; a servo amplifier of +-10 V on an output. The raw reading is in counts of
0.1 mV unless ``counts_per_V`` says otherwise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import nidaqmx
from nidaqmx.constants import TerminalConfiguration
from nidaqmx.errors import DaqError, DaqNotFoundError, DaqNotSupportedError
from nidaqmx.system import Device, System

from rig.backends.driver import DeviceInfo, DeviceWatchdog, DriverSettings
from rig.core.calibration import hard_limits_in_counts
from rig.core.faults import Fault
from rig.core.signals import Limits, Order, Sample

OUTPUT_V = 10.0  # the output's range is +- this
_WIRINGS = ("RSE", "NRSE", "DIFF")


@dataclass(frozen=True)
class Options:
    """What stands under ``daq.options``.

    device          the card's name in NI MAX
    position        input of the potentiometer's wiper
    wiring          of that input: RSE, NRSE or DIFF
    position_V      its range, [low, high], V
    counts_per_V    size of the raw reading that the calibration is in
    drive           output to the amplifier
    amplifier_gain  V at the motor for one V at the output
    drive_bits      of the output's converter
    """

    device: str = "Dev1"
    position: str = "ai0"
    wiring: str = "RSE"
    position_V: tuple[float, float] = (0.0, 5.0)
    counts_per_V: float = 10000.0
    drive: str = "ao0"
    amplifier_gain: float = 1.0
    drive_bits: int = 16

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Self:
        """From the config. Raises ValueError for a key that is none of these, or a value that cannot be."""
        known = [field.name for field in fields(cls)]
        unknown = [key for key in options if key not in known]
        if unknown:
            raise ValueError(f"{unknown[0]} is unknown; known: {', '.join(known)}")
        for name in ("device", "position", "wiring", "drive"):
            if not isinstance(options.get(name, ""), str):
                raise ValueError(f"{name} must be text, not {options[name]!r}")
        for name in ("counts_per_V", "amplifier_gain"):
            if not (_is_number(options.get(name, 1)) and options.get(name, 1) > 0.0):
                raise ValueError(f"{name} must be a number above 0, not {options[name]!r}")
        if options.get("wiring", "RSE") not in _WIRINGS:
            raise ValueError(f"wiring must be one of {', '.join(_WIRINGS)}, not {options['wiring']}")
        if options.get("drive_bits", 16) not in range(8, 25):
            raise ValueError(f"drive_bits must be a whole number from 8 to 24, not {options['drive_bits']!r}")
        match options.get("position_V", [0, 5]):
            case [low, high] if _is_number(low) and _is_number(high) and low < high:
                return cls(**{**options, "position_V": (low, high)})
            case other:
                raise ValueError(f"position_V must be [low, high] in V, not {other!r}")


class CardDriver:
    """Read the potentiometer, set the amplifier; each call waits for its conversion (on-demand timing)."""

    order: Order = "sample_first"

    # The card holds its last output when this program is silent, or has died: nothing sets 0 V. That is what None says,
    # and rig refuses to run unless the config has `daq.accept_no_watchdog: true`. Who writes that needs a button that
    # cuts the amplifier's supply, and an eye on the shaft. Some devices do have a watchdog, for which the package has
    # nidaqmx.system.WatchdogTask, with an expiration state of 0 V for the output: a driver for one of those starts it
    # in `arm`, resets it in `write`, and says DeviceWatchdog(watchdog_s) here.
    failsafe: DeviceWatchdog | None = None

    now_s = staticmethod(time.monotonic)  # rig's clock, unless a driver has an attribute `clock` of its own

    def __init__(self, settings: DriverSettings) -> None:
        """Touches no card: `rig check` constructs a driver, too. Raises ValueError for options that cannot be."""
        self.options = o = Options.of(settings.options)
        self.backend = f"nidaqmx:{o.device}"
        # one step of the converter is one unit of the drive
        self._step_V = 2.0 * OUTPUT_V / 2**o.drive_bits
        full_V = settings.drive_map.full_V
        if full_V > o.amplifier_gain * OUTPUT_V * (1.0 + 1e-9):
            raise ValueError(
                f"amplifier_gain {o.amplifier_gain:g} gives {o.amplifier_gain * OUTPUT_V:g} V at most; drive.supply_V "
                f"less drive.bridge_drop_V is {full_V:g} V"
            )
        # the highest code of the converter is one step below +10 V
        full_units = min(round(full_V / (o.amplifier_gain * self._step_V)), 2 ** (o.drive_bits - 1) - 1)
        self._drive_map = replace(settings.drive_map, full_units=full_units)
        self._unit_V = full_V / o.amplifier_gain / full_units  # at the output
        self._calibration = settings.calibration
        self._rail_counts = settings.rail_counts
        self._counts_max = settings.counts_max
        self._timeout_s = settings.timeout_s
        self._input: Any = None  # the two tasks, while open
        self._output: Any = None
        self._limits: Limits | None = None  # while armed
        self._units = 0  # at the output
        self._t_u_s = math.nan
        self._counts = {"reads": 0, "writes": 0, "errors": 0}

    @property
    def link_statistics(self) -> Mapping[str, int]:
        """Conversions asked for, and what went wrong in them."""
        return dict(self._counts)

    def open(self) -> DeviceInfo:
        """Reserve the two channels and set 0 V: the output may still hold what another program left. LINK_OPEN."""
        o = self.options
        try:
            card = Device(o.device)
            product, serial, simulated = card.product_type, card.serial_num, card.is_simulated
            version = System.local().driver_version
            self._input = nidaqmx.Task()
            low_V, high_V = o.position_V
            self._input.ai_channels.add_ai_voltage_chan(
                f"{o.device}/{o.position}",
                terminal_config=TerminalConfiguration[o.wiring],
                min_val=low_V,
                max_val=high_V,
            )
            self._output = nidaqmx.Task()
            self._output.ao_channels.add_ao_voltage_chan(f"{o.device}/{o.drive}", min_val=-OUTPUT_V, max_val=OUTPUT_V)
            # started once: a task that is not starts and stops with every sample
            self._input.start()
            self._output.start()
            self._output.write(0.0, timeout=self._timeout_s)
        except (DaqError, DaqNotFoundError, DaqNotSupportedError) as error:
            raise Fault("LINK_OPEN", f"{o.device}: {_first_line(error)}") from error
        self.backend = f"nidaqmx:{o.device} ({product}, serial {serial:X})"
        return DeviceInfo(
            build="NI-DAQmx {}.{}.{}".format(*version),
            board=product,
            reset_cause="not told",
            emulated=simulated,  # of NI MAX's simulated devices
            drive_units=self._drive_map.full_units,
        )

    def arm(self, limits: Limits) -> None:
        """Take the limits; ValueError as hard_limits_in_counts.

        The card holds none of them: travel is watched by rig's guard alone, the largest drive by ``write``.
        """
        hard_limits_in_counts(limits, self._calibration, self._drive_map, self._rail_counts)
        self._set(0)
        self._t_u_s = math.nan
        self._limits = limits

    def read(self) -> Sample:
        """Convert once. Raises Fault LINK_LOST."""
        before_s = self.now_s()
        with self._faults():
            volts = self._input.read(timeout=self._timeout_s)
        t_s = 0.5 * (before_s + self.now_s())
        self._counts["reads"] += 1
        # as a converter of that range does: beyond its ends it reads the end, which is a rail
        counts = min(max(round(volts * self.options.counts_per_V), 0), self._counts_max)
        return Sample(
            t_s=t_s,
            y_rad=self._calibration.to_rad(counts),
            y_counts=counts,
            t_u_s=self._t_u_s,
            u_V=self._drive_map.to_volts(self._units),
            seq=self._counts["reads"],
        )

    def write(self, u_V: float) -> None:
        """Set the output. Raises ValueError beyond what the amplifier gives or what was armed; Fault LINK_LOST."""
        units = self._drive_map.to_units(u_V)
        if self._limits is None:
            raise Fault("DEVICE_NOT_ARMED", f"{u_V:.3f} V")
        if abs(units) > abs(self._drive_map.to_units(self._limits.max_u_V)):
            raise ValueError(f"drive {u_V:g} V is beyond the {self._limits.max_u_V:g} V armed for")
        before_s = self.now_s()
        self._set(units)
        self._t_u_s = 0.5 * (before_s + self.now_s())

    def safe_stop(self) -> bool:
        """Set 0 V and disarm. False where the card did not take it: then only its supply stops the motor."""
        self._limits = None
        if self._output is None:
            return False
        try:
            self._set(0)
        except Fault:
            return False
        return True

    def close(self) -> None:
        """Give the channels back, at 0 V. May be called twice."""
        if self._output is not None:
            self.safe_stop()
        tasks, self._input, self._output = (self._input, self._output), None, None
        for task in tasks:
            if task is not None:
                task.close()

    def _set(self, units: int) -> None:
        with self._faults():
            # on demand, this returns once the converter has it: that is all the card ever says of its output
            self._output.write(units * self._unit_V, timeout=self._timeout_s)
        self._units = units
        self._counts["writes"] += 1

    @contextmanager
    def _faults(self) -> Iterator[None]:
        """What the package raises, as a fault that rig ends the run with."""
        if self._output is None:
            raise Fault("LINK_LOST", f"{self.options.device} is not open")
        try:
            yield
        except DaqError as error:
            self._counts["errors"] += 1
            raise Fault("LINK_LOST", f"{self.options.device}: {_first_line(error)}") from error


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n", maxsplit=1)[0]
