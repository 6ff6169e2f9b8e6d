"""The one interface between a controller and a bench, whatever the link.

A run is ``open``, ``arm``, then ``read`` and ``write`` each tick, then ``safe_stop`` and ``close``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import index
from typing import Any, NamedTuple, Protocol, runtime_checkable

from rig.core.calibration import Calibration, DriveMap
from rig.core.signals import Limits, Order, Sample, plain


@dataclass(frozen=True)
class DeviceInfo:
    """What a device reports about itself when it is opened.

    build        firmware build
    board        board's name
    reset_cause  in words, e.g. "power-on"
    emulated     True where no real motor can be behind it
    clock_ratio  device seconds for one second of the host; fixed for the run
    round_trip_s fastest exchange seen while opening, s; nan where it means nothing
    supply_V     motor supply as the device measures it, V; nan where it does not
    supply_at_least  that reading is at the end of its range: the supply may be higher
    drive_units  steps of the drive at full duty: u_V of a sample is a whole number of them; None: no such steps
    remarks      what people should know of this device before it drives, a sentence each
    acknowledged codes of the faults that the device had latched before, and that opening it has cleared
    """

    build: str
    board: str
    reset_cause: str
    emulated: bool
    clock_ratio: float = 1.0
    round_trip_s: float = math.nan
    supply_V: float = math.nan
    supply_at_least: bool = False
    drive_units: int | None = None
    acknowledged: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # these texts come from the device and go to terminals
        for name in ("build", "board", "reset_cause"):
            object.__setattr__(self, name, plain(getattr(self, name)))
        # a driver of another package may hold numpy's numbers
        for name in ("clock_ratio", "round_trip_s", "supply_V"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if self.drive_units is not None:
            object.__setattr__(self, "drive_units", index(self.drive_units))


@dataclass(frozen=True)
class DriverSettings:
    """What a driver from another package is constructed with; all of it comes from the config.

    options      daq.options unchanged: numbers, text, true/false, lists and mappings of these
    calibration  position sensor, raw reading to rad
    drive_map    V at the motor to drive units; the driver puts its own ``full_units`` in with ``dataclasses.replace``
    rail_counts  (low, high): readings at or beyond are a broken sensor
    counts_max   largest raw reading that the calibration was made for
    timeout_s    longest wait for one reply
    period_s     the loop's period: ``read`` and ``write`` together must fit into it, with room to spare
    watchdog_s   silence of the host after which the device should set 0 V, where it can
    """

    options: Mapping[str, Any]
    calibration: Calibration
    drive_map: DriveMap
    rail_counts: tuple[int, int]
    counts_max: int
    timeout_s: float
    period_s: float
    watchdog_s: float


class RelayRow(NamedTuple):
    """One tick of a law in the device, the relay or the strokes.

    t_s       when the position was sampled, s in host time
    t_u_s     time from which the drive decided on it acts, s
    y_rad, y_counts   the position
    u_V       that drive, V
    block     number of the block that brought it, modulo 2**16
    """

    t_s: float
    t_u_s: float
    y_rad: float
    y_counts: int
    u_V: float
    block: int


@dataclass(frozen=True)
class RelayCommand:
    """The relay u = -h1 sgn(y) - h2 sgn(z) for a device, in counts and V.

    drives_V             drive of each state: y >= 0 and z >= 0, y >= 0 > z, y < 0 <= z, both < 0
    count_tick_rad_s     integral of one count over one tick of the device
    centre_counts        reading at y = 0
    z_bound_count_ticks  bound on the integral
    direction            +1 where counts rise with the position, else -1
    """

    drives_V: tuple[float, float, float, float]
    count_tick_rad_s: float
    centre_counts: float
    z_bound_count_ticks: float
    direction: int


class Stopped(NamedTuple):
    """When a device set 0 V by itself, s in the host's clock, and the sample that told of it."""

    t_s: float
    sample: Sample


@dataclass(frozen=True)
class StrokesCommand:
    """A stroke test for a device, in counts, ticks and V.

    strokes        (drive, V; turning point, counts) of each, to and fro
    centre_counts  reading at y = 0, rounded: the first stroke is that of the first two that drives towards it
    direction      +1 where counts rise with the position, else -1
    stroke_ticks   longest time of a stroke
    still_ticks    longest time for which the reading may stand still under one drive
    still_counts   readings less than this apart are one position
    """

    strokes: tuple[tuple[float, int], ...]
    centre_counts: int
    direction: int
    stroke_ticks: int
    still_ticks: int
    still_counts: int


class StrokeTimes(NamedTuple):
    """Longest times of one stroke in a device, s: until its turning point, and with a reading that stands still."""

    stroke_s: float
    still_s: float


class Timeouts(NamedTuple):
    """How long a driver waits for its device.

    reply_s  longest wait for one reply, s
    open_s   longest wait for the device to introduce itself, its restart on opening included, s
    period_s of the loop; 0: not known
    """

    reply_s: float = 0.03
    open_s: float = 5.0
    period_s: float = 0.0


class DeviceWatchdog(NamedTuple):
    """After ``time_s`` seconds without the host the device sets 0 V by itself and latches a fault."""

    time_s: float


@runtime_checkable
class Clock(Protocol):
    """The time that a loop lives in: the machine's monotonic clock, or a virtual one."""

    def now_s(self) -> float:
        """Seconds since an arbitrary zero; never decreases."""

    def sleep_until(self, t_s: float) -> float:
        """Return at ``t_s``, or as soon after it as possible; the time then, s."""


class Transport(Protocol):
    """A port that carries bytes, and the clock that its time-outs are counted in."""

    def write(self, data: bytes) -> None:
        """Send all of ``data``. Raises Fault LINK_LOST when the port is dead."""

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at least one byte; b"" after ``timeout_s`` without any.

        ``timeout_s`` >= 0. Raises Fault LINK_LOST when the port is dead.
        """

    def now_s(self) -> float:
        """Monotonic clock of the host, s."""

    def close(self) -> None:
        """Give the port back. May be called twice."""


class Driver(Protocol):
    """A bench behind a link. Times of samples are in the host's clock, s.

    The host's clock is ``time.monotonic``. A driver in virtual time has an attribute ``clock``, a ``Clock``. If the
    device latches an e-stop by itself, armed or not, the driver has an attribute ``latches_stops`` that is true. Any
    other driver is read throughout the pauses of a run, from another thread, while nothing else uses it. A driver on a
    link that another process can inherit has an attribute ``descriptor``, the number of its open file or socket: that
    process stops the device where a law of a user's own never returns (``Backend.stopper``). What a run's end must say
    of the device stands in an attribute ``end_words``, what `rig doctor` says of the link, by topic, in ``link_words``;
    a wait before each answer that no config knows, s, in ``waits_s``.
    Constructing a driver touches no device. ``rig.testing.conformance`` tests a driver against this interface.
    """

    @property
    def order(self) -> Order:
        """When the drive of a tick goes out.

        "sample_first": at once, in ``write``. "write_first": in the next tick's ``read``, just before its sample.
        """

    @property
    def failsafe(self) -> DeviceWatchdog | None:
        """What sets 0 V when the host is silent; None: the device holds its last output."""

    @property
    def backend(self) -> str:
        """What is behind this driver, in words; complete once opened."""

    @property
    def link_statistics(self) -> Mapping[str, int]:
        """Counts of exchanges and of what went wrong in them, by name; empty where there is no link.

        All but ``exchanges`` count errors: who watches the run is told of them.
        """

    def open(self) -> DeviceInfo:
        """Open the device. Raises Fault LINK_* when it is absent, or not the expected one."""

    def arm(self, limits: Limits) -> None:
        """Give the device its limits and allow drive. Clears no fault that the device has latched since ``open``.

        Raises Fault when the device refuses, ValueError when it cannot hold such limits.
        """

    def read(self) -> Sample:
        """Sample the bench, armed or not. Raises Fault on any fault of link or device."""

    def write(self, u_V: float) -> None:
        """Set the drive. The next ``read`` reports when it took effect, and how much drive acts after quantisation.

        Raises ValueError beyond the drive's range, or where ``u_V`` is not a number. A device that is not armed, or is
        armed for less, does not drive: it refuses at once, or in the next ``read``.
        """

    def safe_stop(self) -> bool:
        """Set 0 V and disarm. True if the device confirmed it; never raises on a dead link, nor before ``open``."""

    def close(self) -> None:
        """Give the link back, stopped. May be called twice."""


@runtime_checkable
class RelayRules(Protocol):
    """What a device that runs the dual-channel relay by itself makes of gains: a replay asks it again."""

    @property
    def tick_s(self) -> float:
        """The device's tick in host time, s."""

    def relay_command(self, h1_V: float, h2_V: float, z_bound_rad_s: float) -> RelayCommand:
        """The command for these gains. Raises Fault or ValueError where the device cannot run them."""


@runtime_checkable
class ReckonedTimes(Protocol):
    """A driver that reckons its times from those of its exchanges."""

    @property
    def times_shift_s(self) -> float:
        """By how much all drives so far may have acted earlier, or later, against the readings than it says, s."""


@runtime_checkable
class PulseDriver(Driver, Protocol):
    """A driver whose device may end a drive by itself, after a time and without a fault, whatever the host does.

    pulses  whether this device does; known once it is open
    """

    pulses: bool

    def write_pulse(self, u_V: float, longest_s: float) -> None:
        """As ``write``, but the drive ends ``longest_s`` after the first ``write_pulse`` since the last ``write``.

        After that no further one drives, until a ``write`` has come. Raises ValueError where the device has no pulses.
        """


@runtime_checkable
class EncoderDriver(Driver, Protocol):
    """A driver whose device counts an encoder, from wherever it was switched on.

    homing   while true, ``arm`` asks for no zero: the limits count from where the device was switched on
    stopped  how the device last stopped by itself; None: it has not
    """

    homing: bool
    stopped: Stopped | None

    def forget_zero(self) -> None:
        """Forget the zero of a disarmed device: only a homing arms it until ``set_zero``. Raises Fault LINK_*."""

    def set_zero(self, here_rad: float) -> None:
        """Tell a disarmed device that its shaft stands at ``here_rad``, until its next reset.

        Raises Fault LINK_*, and the fault of the encoder that the device has latched: it takes no zero then.
        """

    def leave_switch(self) -> None:
        """Acknowledge the end switch that a homing has reached. Raises Fault where another fault is latched."""


@runtime_checkable
class StrokeRules(RelayRules, Protocol):
    """What a device that runs strokes by itself makes of them: a replay asks it again."""

    def strokes_command(
        self, strokes: Sequence[tuple[float, float]], times: StrokeTimes, motion_rad: float
    ) -> StrokesCommand:
        """The command for these strokes.

        strokes     (drive, V; turning point, rad) of each, to and fro
        motion_rad  readings within this span stand still, rad
        Raises Fault CONFIG_MISMATCH or ValueError where the device cannot run them.
        """


@runtime_checkable
class RelayDriver(Driver, RelayRules, Protocol):
    """A driver whose device can run the dual-channel relay by itself, at each of its ticks."""

    def start_relay(self, command: RelayCommand) -> None:
        """Let the relay drive. Raises Fault where the device refuses, or on any fault of the link."""

    def keep(self) -> None:
        """Tell the device that the host lives. Without this the relay ends after the watchdog time."""

    def read_rows(self) -> list[RelayRow]:
        """The ticks since the last call; does not wait. Raises Fault on any fault of link or device.

        Call it once after ``safe_stop``: it returns the last ticks before the stop, and raises nothing.
        """

    def stop_relay(self) -> list[RelayRow]:
        """End the relay with 0 V, still armed; returns its last ticks. Raises Fault on any fault of the link."""


@runtime_checkable
class StrokeDriver(RelayDriver, StrokeRules, Protocol):
    """A driver whose device can run strokes, too. ``keep``, ``read_rows`` and ``stop_relay`` serve both laws."""

    def start_strokes(self, command: StrokesCommand) -> None:
        """Let the strokes drive. Raises Fault where the device refuses, or on any fault of the link."""

    def row_after_stop(self) -> RelayRow | None:
        """After ``stop_relay``: the shaft now, and since when 0 V acts, which is before that; None: unknown.

        Raises Fault as ``read``.
        """
