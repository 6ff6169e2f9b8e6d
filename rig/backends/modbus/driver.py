"""A Modbus device as a ``Driver``: what it reads and writes when, and what the values mean.

The config says what each register means; ``rig.backends.modbus.client`` exchanges the requests.

With FC23 a tick is one exchange: the drive of the previous tick goes out, and the position at that instant comes back
(order "write_first"). With separate requests a tick is a read, then a write that its reply confirms ("sample_first").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from rig.backends.driver import DeviceInfo, DeviceWatchdog, Timeouts, Transport
from rig.backends.modbus.client import ATTEMPTS, LATE_TIMEOUTS, ModbusClient, ModbusLine, Reply
from rig.backends.modbus.registers import ARMED, OFF, Register, RegisterMap, RegisterSpan
from rig.backends.modbus.requests import (
    Request,
    identification,
    identity_of,
    reading,
    reading_and_writing,
    registers_of,
    writing,
)
from rig.calibration import Scaling, hard_limits_in_counts, largest_drive_in_units
from rig.faults import Fault
from rig.signals import Limits, Order, Sample

_UNHURRIED_S = 0.1  # least time-out of a request outside the tick; a stop uses the tick's time-out
_STOPPING_S = 0.02  # longest wait for a stop: three of them are shorter than most watchdogs
_INTRODUCTIONS = 20  # reads that measure the round trip
_LATE_REPLIES = 3  # in a row: the link is not fit for the period
_LONGEST_WATCHDOG_S = 1.0  # that the config allows
_SILENCE_MARGIN_S = 0.1  # beyond a watchdog's time: a device has its own clock, and its own cycle
_OWN_ECHOES = 2  # what echoes of a late reply, or of a write that was not executed, differ by at most
_EMULATED = ("rig", "emulated I/O block")  # vendor and product of the emulated block


class ModbusDriver:
    """A Modbus device behind a transport. Times of samples are in the transport's clock, s.

    transport  an open port; closed by ``close``, never reopened
    line       how the device is reached
    registers  what is at which address
    scaling    what its numbers mean; the drive map's ``full_units`` are replaced by the drive register's
    timeouts   how long to wait for the reply in a tick, and for the first reply
    name       of the port, for ``backend``
    emulated   True where it is known that no real motor is behind the port
    answered   another process has opened the device on this link: ``safe_stop`` may write, and late bytes may come
    """

    def __init__(
        self,
        transport: Transport,
        line: ModbusLine,
        registers: RegisterMap,
        scaling: Scaling,
        timeouts: Timeouts,
        *,
        name: str = "modbus",
        emulated: bool = False,
        answered: bool = False,
    ) -> None:
        self.calibration = scaling.calibration
        self.drive_map = replace(scaling.drive_map, full_units=registers.full_units)
        self.backend = name
        self.failsafe: DeviceWatchdog | None = None
        if registers.watchdog is not None:
            self.failsafe = DeviceWatchdog(_LONGEST_WATCHDOG_S)  # until armed with less
        elif registers.device_watchdog_s is not None:
            self.failsafe = DeviceWatchdog(registers.device_watchdog_s)
        self._transport = transport
        self._client = ModbusClient(transport, line)
        self._client.is_suspect = answered
        self._line = line
        self._map = registers
        self._read_span, self._written_span = registers.read, registers.written
        self._rail_counts = scaling.rail_counts
        self._counts_max = scaling.counts_max
        self._timeout_s = timeouts.reply_s
        self._open_timeout_s = timeouts.open_s
        self._name = name
        self._emulated = emulated
        self._met = answered
        self._armed = False
        self._is_off = False  # it has confirmed a stop since it was armed last
        self._written: list[tuple[Register, list[int]]] = []  # settings that it has confirmed in this session
        self._max_units = 0
        self._seq = 0
        self._late_in_a_row = 0  # replies that came after the time-out
        self._sequence = 0  # as last written with a drive; its echo must be this
        self._echo: float | None = None  # as last read since it was armed, or since the stop after that
        self._units = 0  # drive as last commanded
        self._fresh = False  # it has not gone out yet
        self._t_u_s = math.nan
        self._driven_s = -math.inf  # when the device last executed a drive

    @property
    def order(self) -> Order:
        """With FC23 "write_first": one exchange writes, then reads. Else "sample_first"."""
        return "write_first" if self._line.requests == "read-write" else "sample_first"

    @property
    def descriptor(self) -> int | None:
        """Number of the open port or connection, as of ``Driver``; None in virtual time."""
        return getattr(self._transport, "descriptor", None)

    @property
    def link_statistics(self) -> Mapping[str, int]:
        """Counts since construction, as ``ModbusClient.statistics``."""
        return self._client.statistics

    # ------------------------------------------------------------------ the life of a run

    def open(self) -> DeviceInfo:
        """Read the device's registers until it answers, ask who it is, and measure the round trip.

        Raises Fault LINK_TIMEOUT, LINK_UNIT, LINK_REPLY, MODBUS_EXCEPTION or LINK_LOST; CONFIG_MISMATCH for a position
        that no sensor of the config gives; SECOND_MASTER where its registers show that somebody else drives it.
        """
        self._until_answered()
        self._met = True
        vendor, product, revision = self._identity()
        # a device that does not know this request may not answer for a while: libmodbus for 0.5 s
        self._until_answered()
        replies = [self._client.patiently(reading(self._read_span), self._unhurried_s) for _ in range(_INTRODUCTIONS)]
        fastest = min(replies, key=lambda reply: reply.round_trip_s)
        self._client.set_pace(fastest)
        seen = [self._values(self._read_span, reply) for reply in replies]
        self._check_range(seen[-1]["position"])
        try:
            self._check_alone(seen)
        except Fault as fault:
            self._met = fault.code != "SECOND_MASTER"  # what somebody else drives is not ours to stop
            raise
        emulated = self._emulated or (vendor, product) == _EMULATED
        board = " ".join(part for part in (vendor, product) if part) or "Modbus device"
        self.backend = f"{self._name} (unit {self._line.unit}, {board}{revision and f', {revision}'})"
        return DeviceInfo(
            build=revision or "not told",
            board=board,
            reset_cause="not told",
            emulated=emulated,
            round_trip_s=fastest.round_trip_s,
            drive_units=self._map.full_units,
        )

    def arm(self, limits: Limits) -> None:
        """Stop, write the limits that have registers and read them back, drive 0, arm.

        A device that is armed again must still hold what was written before. If it does not, it was reset: nothing is
        written, and Fault DEVICE_RESET is raised. Registers are written again only for other limits.
        Raises ValueError where sensor, drive or a register cannot hold the limits; Fault ARM_READBACK, DEVICE_RESET,
        LINK_*, MODBUS_EXCEPTION, or the fault in the device's status.
        """
        settings, max_units = self._settings(limits)
        self._armed = False
        self._settle()
        if self._is_off:  # read first: another stop would clear what the device may have latched
            self.read()
        self._is_off = False
        self._echo = None
        self._write_stop(self._client.patiently, self._unhurried_s)
        self._check_settings()
        if settings != self._written:
            for register, words in settings:
                self._set(register, words)
            self._written = settings
        self._max_units = max_units
        if self._map.watchdog is not None:
            self.failsafe = DeviceWatchdog(limits.watchdog_s)
        self._units, self._fresh, self._t_u_s = 0, False, math.nan
        self._driven_s = self._client.patiently(self._writing_drive(0), self._unhurried_s).executed_s
        if self._map.control is not None:
            self._client.patiently(_setting(self._map.control, self._map.arm), self._unhurried_s)
        self._await_armed()
        self._armed = True

    def read(self) -> Sample:
        """Sample the bench. With FC23 the same request carries the drive of the last ``write``.

        ``u_V`` is the drive that the device reports, if it has a register for that; else the commanded drive.
        Raises Fault LINK_TIMEOUT, LINK_REPLY, LINK_UNIT, LINK_LOST, MODBUS_EXCEPTION, DEVICE_RESET, or the fault
        that the device's status names.
        """
        if self._armed and self._line.requests == "read-write":
            reply = self._exchange(
                reading_and_writing(self._read_span, self._written_span, self._drive_words(self._units))
            )
            self._driven_s = reply.executed_s
            if self._fresh:
                self._t_u_s, self._fresh = reply.executed_s, False
        else:
            reply = self._exchange(reading(self._read_span)) if self._armed else self._unhurried_reading()
        values = self._values(self._read_span, reply)
        if self._armed:
            self._check_status(values)
            self._check_echo(values)
        elif self._max_units > 0:  # armed before: a fault in a pause must not go unseen
            self._check_pause(values)
        counts = self._checked(self._map.position, self._map.counts, values["position"])
        units = self._units if self._armed else 0
        if self._map.applied is not None:
            units = self._checked(self._map.applied, self._map.drive_units, values["applied"])
        self._seq = (self._seq + 1) & 0xFFFF
        return Sample(
            t_s=reply.executed_s,
            y_rad=self.calibration.to_rad(counts),
            y_counts=counts,
            t_u_s=self._t_u_s,
            u_V=self.drive_map.to_volts(units),
            seq=self._seq,
        )

    def write(self, u_V: float) -> None:
        """Set the drive. With FC23 it goes out with the next ``read``; else now, and its reply confirms it.

        Raises ValueError beyond supply and bridge, or beyond the drive that the device is armed for; Fault
        DEVICE_NOT_ARMED; with separate requests also the link faults of ``read``.
        """
        units = self.drive_map.to_units(u_V)
        if not self._armed:
            raise Fault("DEVICE_NOT_ARMED", f"{u_V:.3f} V")
        if abs(units) > self._max_units:
            raise ValueError(f"drive {u_V:g} V is beyond the {self.drive_map.to_volts(self._max_units):g} V armed for")
        self._units = units
        if self._line.requests == "read-write":
            self._fresh = True
        else:
            self._t_u_s = self._driven_s = self._exchange(self._writing_drive(units)).executed_s

    def safe_stop(self) -> bool:
        """Drive 0, control to stop, up to three times. True once replies and registers confirm it.

        If an exchange went wrong before, a first stop goes out at once and its reply is ignored. Then the driver waits
        for late bytes and throws them away, so that they do not look like the confirmation. A device with a program of
        its own sees the request in its next cycle only: the driver waits for it, 0.06 s in all.
        """
        self._armed = False
        self._fresh = False
        self._echo = None
        if not self._met:
            return False  # never write to a device that has not answered yet, or that somebody else drives
        begin_s = self._transport.now_s()
        for attempt in range(1, ATTEMPTS + 1):
            try:
                self._settle()
                self._write_stop(self._client.asked, self._timeout_s)
                if self._is_stopped(begin_s + attempt * _STOPPING_S, begin_s + ATTEMPTS * _STOPPING_S):
                    self._is_off = True
                    return True
            except Fault as fault:
                if fault.code == "LINK_LOST":
                    return False
                self._client.is_suspect = True
        return False

    def close(self) -> None:
        """Close the port, after a ``safe_stop`` if still armed. May be called twice."""
        if self._armed:
            self.safe_stop()
        self._transport.close()

    # ------------------------------------------------------------------ arming and stopping

    def _settings(self, limits: Limits) -> tuple[list[tuple[Register, list[int]]], int]:
        """The words for each register, and the largest drive, units. Raises ValueError."""
        m = self._map
        hard = hard_limits_in_counts(limits, self.calibration, self.drive_map, self._rail_counts)
        max_units = largest_drive_in_units(limits, self.drive_map)
        settings: list[tuple[Register, float]] = []
        if m.watchdog is not None:
            settings.append((m.watchdog, round(limits.watchdog_s / m.unit_s)))
        if m.limits is not None:
            settings += zip(m.limits, self._bounds(hard, inward=True), strict=True)
        if m.rails is not None:
            settings += zip(m.rails, self._bounds(self._rail_counts, inward=False), strict=True)
        if m.max_drive is not None:
            settings.append((m.max_drive, m.drive_value(max_units)))
        return [(register, register.pack(value)) for register, value in settings], max_units

    def _await_armed(self) -> None:
        """Wait until the status is armed: a device with its own program sees the request in its next cycle only."""
        if self._map.status is None:
            return
        until_s = self._transport.now_s() + self._unhurried_s
        while True:
            reply = self._client.patiently(reading(self._read_span), self._unhurried_s)
            values = self._values(self._read_span, reply)
            if values["status"] != OFF or self._transport.now_s() >= until_s:
                self._check_status(values)
                return

    def _bounds(self, counts: tuple[int, int], *, inward: bool) -> tuple[float, float]:
        """Two readings as values of the position's register, rounded the given way where it is whole."""
        low, high = sorted(self._map.position_value(c) for c in counts)
        if not self._map.position.is_whole:
            return low, high
        if inward:
            return math.ceil(low - 1e-9), math.floor(high + 1e-9)
        return math.floor(low + 1e-9), math.ceil(high - 1e-9)

    def _set(self, register: Register, words: list[int]) -> None:
        """Write a setting and read it back."""
        self._client.patiently(writing(register, words), self._unhurried_s)
        stored = self._stored(register)
        if stored != words:
            raise Fault(
                "ARM_READBACK", f"{register}: sent {register.unpack(words):g}, stored {register.unpack(stored):g}"
            )

    def _stored(self, register: Register) -> list[int]:
        """The words that a setting's register holds now."""
        return registers_of(self._client.patiently(reading(RegisterSpan((register,))), self._unhurried_s).pdu)

    def _check_settings(self) -> None:
        """Raises Fault DEVICE_RESET where a register no longer holds the value written in this session."""
        for register, words in self._written:
            stored = self._stored(register)
            if stored != words:
                raise Fault(
                    "DEVICE_RESET",
                    f"{register} reads {register.unpack(stored):g}, but {register.unpack(words):g} was written at the "
                    "first arming: the device lost its settings in the pause",
                )

    def _write_stop(self, asked: Callable[[Request, float], Reply], timeout_s: float) -> None:
        """Control to stop, drive 0, both confirmed by their replies; drive 0 also where the device refuses to stop.

        Raises Fault.
        """
        control = self._map.control
        refused: Fault | None = None
        if control is not None:
            try:
                asked(_setting(control, self._map.stop), timeout_s)
            except Fault as fault:
                if fault.code != "MODBUS_EXCEPTION":
                    raise
                refused = fault
        try:
            asked(_setting(self._map.drive, 0.0), timeout_s)
        except Fault as fault:
            # some devices take no drive at all, not even 0, while they are stopped
            if fault.code != "MODBUS_EXCEPTION" or control is None:
                raise
        if refused is not None:
            raise refused
        self._units = 0

    def _is_stopped(self, again_s: float, last_s: float) -> bool:
        """Whether the device's registers confirm the stop; True where it has no such registers.

        Reads them until ``again_s`` while they report armed or a drive. Reads until ``last_s`` while the status is an
        unknown value: it may be on its way to off.
        """
        if self._map.applied is None and self._map.status is None:
            return True
        while True:
            values = self._values(self._read_span, self._client.asked(reading(self._read_span), self._timeout_s))
            driven, status = values.get("applied", 0.0) != 0.0, values.get("status", OFF)
            stopped = not driven and not self._is_armed_by(status)
            if stopped and (status in (OFF, ARMED) or status in (self._map.faults or {})):
                return True
            if self._transport.now_s() >= (last_s if stopped else again_s):
                return stopped

    def _is_armed_by(self, status: float) -> bool:
        """Whether a status means armed. Not for a device without control register: nothing disarms it."""
        return status == ARMED and self._map.control is not None

    def _settle(self) -> None:
        """After an exchange that went wrong: send a stop, ignore its reply, and throw away all late bytes."""
        if not self._client.is_suspect:
            return
        m = self._map
        stop = _setting(m.drive, 0.0) if m.control is None else _setting(m.control, m.stop)
        self._client.unheard(stop, LATE_TIMEOUTS * self._timeout_s)

    def _until_answered(self) -> None:
        """Read until the device answers or ``timeouts.open_s`` is over; raises the last fault then."""
        until_s = self._transport.now_s() + self._open_timeout_s
        while True:
            try:
                self._values(self._read_span, self._client.asked(reading(self._read_span), self._unhurried_s))
                return
            except Fault as fault:
                if fault.code in ("LINK_LOST", "MODBUS_EXCEPTION") or self._transport.now_s() >= until_s:
                    raise
                self._client.wait((LATE_TIMEOUTS - 1) * self._unhurried_s)

    def _identity(self) -> tuple[str, str, str]:
        """Vendor, product and revision by FC43; empty where the device does not report them."""
        try:
            return identity_of(self._client.asked(identification(), self._unhurried_s).pdu)
        except Fault as fault:
            if fault.code == "LINK_LOST":
                raise
            return "", "", ""

    # ------------------------------------------------------------------ what the values mean

    def _values(self, span: RegisterSpan, reply: Reply) -> dict[str, float]:
        return span.values(registers_of(reply.pdu))

    def _check_range(self, value: float) -> None:
        """Raises Fault CONFIG_MISMATCH for a position beyond the sensor's range: wrong type, order or scale."""
        position = self._map.position
        counts = self._checked(position, self._map.counts, value)
        if self._counts_max is not None and not 0 <= counts <= self._counts_max:
            raise Fault(
                "CONFIG_MISMATCH",
                f"{position} reads {value:g}: {counts:g} counts, of 0 to {self._counts_max} (sensor.counts_max); "
                "check its type, scale and offset_counts, daq.modbus.word_order, and the sensor's wire",
            )

    def _check_alone(self, seen: Sequence[Mapping[str, float]]) -> None:
        """Raise Fault SECOND_MASTER where the device is driven while rig has only read it.

        What a killed master has left armed, the watchdog ends in a silence; who drives now, feeds it, and counts on.
        """
        echo = self._map.echo
        if echo is not None and len(echoes := {values["echo"] for values in seen}) > 1:
            words = f"{echo} went from {min(echoes):g} to {max(echoes):g} while rig only read"
            raise Fault("SECOND_MASTER", words)
        if self.failsafe is None or not self._is_driven(seen[-1]):
            return
        silent_s = self.failsafe.time_s + _SILENCE_MARGIN_S
        self._client.wait(silent_s)
        values = self._values(self._read_span, self._unhurried_reading())
        if self._is_driven(values):
            what = self._map.status if self._map.applied is None or not values["applied"] else self._map.applied
            raise Fault(
                "SECOND_MASTER",
                f"{what} says that it is driven, though rig was silent for {silent_s:g} s, longer than its watchdog",
            )

    def _is_driven(self, values: Mapping[str, float]) -> bool:
        """Whether a device that rig has not armed is armed, or drives."""
        return values.get("applied", 0.0) != 0.0 or self._is_armed_by(values.get("status", OFF))

    def _check_status(self, values: Mapping[str, float]) -> None:
        status = self._map.status
        if status is None or values["status"] == ARMED:
            return
        value = int(values["status"])
        code = (self._map.faults or {}).get(value)
        at = self._counts(values)
        if code is not None:
            raise Fault(code, f"{status} reads {value}, at {at}")
        words = (
            "not armed"
            if value == OFF
            else "neither off (0), nor armed (1), nor a fault of daq.modbus.registers.status"
        )
        raise Fault("DEVICE_RESET", f"{status} reads {value}: {words}; at {at}")

    def _counts(self, values: Mapping[str, float]) -> str:
        return f"{self._map.scale * values['position'] + self._map.offset_counts:g} counts"

    def _check_pause(self, values: Mapping[str, float]) -> None:
        """Raise the fault in the status of a stopped device, unless the status is off; or that somebody wrote to it."""
        status, echo = self._map.status, self._map.echo
        if echo is not None:
            before, self._echo = self._echo, values["echo"]
            if before is not None and self._echo not in (before, self._sequence, 0.0):  # 0: it was reset
                words = f"{echo} went from {before:g} to {self._echo:g} while rig only read; at {self._counts(values)}"
                raise Fault("SECOND_MASTER", words)
        if status is None or values["status"] == OFF:
            return
        if self._is_armed_by(values["status"]):
            words = f"{status} reads {ARMED}: armed, although rig stopped it; at {self._counts(values)}"
            raise Fault("SECOND_MASTER" if self._is_off else "STOP_UNCONFIRMED", words)
        self._check_status(values)

    def _check_echo(self, values: Mapping[str, float]) -> None:
        echo = self._map.echo
        if echo is None:
            return
        before, self._echo = self._echo, values["echo"]
        if self._echo != self._sequence:
            if before is not None and self._echo != 0.0 and self._is_foreign(self._echo):
                words = f"{echo} reads {self._echo:g}, but rig counts its drives and is at {self._sequence}"
                raise Fault("SECOND_MASTER", words)
            raise self._client.misfit(
                f"{echo} reads {values['echo']:g}, but drive {self._sequence} went out: a late reply, or "
                "the drive was not executed"
            )

    def _is_foreign(self, echo: float) -> bool:
        """Whether an echo can be none of the last drives that rig has written; they are counted from 1 to 65535.

        With FC23 the echo that comes back is that of the drive in the same request, whoever wrote before.
        """
        if self._line.requests == "read-write":
            return False
        apart = abs(echo - self._sequence)
        return min(apart, 0xFFFF - apart) > _OWN_ECHOES

    def _checked(self, register: Register, convert: Callable[[float], int], value: float) -> int:
        try:
            return convert(value)
        except ValueError as error:
            raise self._client.misfit(f"{register}: {error}") from error

    # ------------------------------------------------------------------ requests

    @property
    def _unhurried_s(self) -> float:
        return max(self._timeout_s, _UNHURRIED_S)

    def _unhurried_reading(self) -> Reply:
        """A reading while disarmed: there is time to repeat it."""
        return self._client.patiently(reading(self._read_span), self._unhurried_s)

    def _exchange(self, request: Request) -> Reply:
        """The exchange of a tick. While armed it waits for as long as the device's watchdog lets the last drive act.

        One request is under way at a time, so what comes late can only be its reply. Where one reply after the other is
        late, the link is not fit for the period: LINK_TIMEOUT.
        """
        wait_s = self._timeout_s
        if self._armed and self.failsafe is not None:
            held_s = self._transport.now_s() - self._driven_s
            wait_s = max(wait_s, min(self.failsafe.time_s, _LONGEST_WATCHDOG_S) - held_s)
        reply = self._client.in_tick(request, wait_s, after_silence=self._armed)
        self._late_in_a_row = self._late_in_a_row + 1 if reply.round_trip_s > self._timeout_s else 0
        if self._late_in_a_row >= _LATE_REPLIES:
            raise Fault(
                "LINK_TIMEOUT",
                f"{_LATE_REPLIES} replies in a row took longer than daq.timeout_s, {1e3 * self._timeout_s:g} ms: the "
                f"last one {1e3 * reply.round_trip_s:.0f} ms",
            )
        return reply

    def _writing_drive(self, units: int) -> Request:
        return writing(self._written_span, self._drive_words(units))

    def _drive_words(self, units: int) -> list[int]:
        self._sequence = self._sequence % 0xFFFF + 1
        return self._written_span.pack({"drive": self._map.drive_value(units), "sequence": self._sequence})


def _setting(register: Register, value: float) -> Request:
    return writing(register, register.pack(value))
