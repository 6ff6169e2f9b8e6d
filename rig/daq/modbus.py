"""A Modbus device as a ``Driver``: one request and one reply at a time, and a reply that does not fit is a fault.

Modbus Application Protocol 1.1b3; RTU by Modbus over Serial Line 1.02. Registers mean what the config says.

Asked by FC23 a tick is one exchange: the drive decided in the tick before goes out, and the position of that same
instant comes back (order "write_first"). Asked separately it is a read, then a write that its reply confirms
("sample_first").
Nothing is asked again within a tick: the first time-out, and the first reply that does not fit, ends the run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest, ReadDeviceInformationResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from rig.daq.calibration import Calibration, DriveMap, hard_limits_in_counts, largest_drive_in_units
from rig.daq.driver import DeviceInfo, DeviceWatchdog, Transport
from rig.daq.modbus_frames import Damaged, Frame, Framing, RtuFraming, TcpFraming, is_exception
from rig.daq.modbus_registers import ARMED, OFF, Register, RegisterMap, Span
from rig.faults import Fault
from rig.signals import Limits, Order, Sample

_ATTEMPTS = 3  # of a request outside the tick
_UNHURRIED_S = 0.1  # least time-out of a request outside the tick; stopping keeps to the tick's
_INTRODUCTIONS = 20  # reads that measure the round trip
_LATE_TIMEOUTS = 2  # by when the latest reply has come
_UNASKED_BYTES = 5  # the shortest reply; fewer between two exchanges are noise on the line
_ENDLESS_BYTES = 2000  # of a line that is never quiet
_LONGEST_WATCHDOG_S = 1.0  # that the config takes
_EMULATED = ("rig", "emulated I/O block")  # vendor and product of ours

_EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledge",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not answer",
}


@dataclass(frozen=True)
class ModbusLine:
    """How the device is reached.

    tcp           Modbus TCP; else RTU
    unit          unit id of the device, 1 to 247
    requests      "read-write": FC23 in a tick; "separate": FC03 (FC04), then FC16 (FC06)
    baud, bits_per_byte, silence_s   of an RTU line
    turnaround_s  the device's own time, as the config has it
    """

    tcp: bool = False
    unit: int = 1
    requests: Literal["read-write", "separate"] = "read-write"
    baud: int = 115200
    bits_per_byte: int = 10
    silence_s: float = 0.00175
    turnaround_s: float = 0.0005

    def wire_s(self, n_bytes: int) -> float:
        """Time that bytes take on the wire; of TCP nothing that counts."""
        return 0.0 if self.tcp else n_bytes * self.bits_per_byte / self.baud

    @property
    def pause_s(self) -> float:
        """Least silence between two frames."""
        return 0.0 if self.tcp else self.silence_s


class _Reply(NamedTuple):
    """A reply that fits its request, and when the device executed that, host time s.

    reckoned_s  what the exchange takes by the config
    """

    pdu: bytes
    executed_s: float
    round_trip_s: float
    reckoned_s: float


class ModbusDriver:
    """A Modbus device behind a transport. Times of samples are in the transport's clock, s.

    transport         an open port; closed by ``close``, never reopened
    line              how the device is reached
    registers         what is at which address
    calibration, drive_map   sensor and H-bridge; the map's ``full_units`` are replaced by the drive register's
    rail_counts       (low, high): readings at or beyond are a broken sensor
    timeout_s         longest wait for the reply in a tick
    open_timeout_s    longest wait for the first reply
    device_watchdog_s output time-out that is set on the device itself, where no register sets it
    counts_max        largest reading of the sensor; None: unknown
    name              of the port, for ``backend``
    emulated          True where it is known that no real motor is behind the port
    """

    def __init__(
        self,
        transport: Transport,
        line: ModbusLine,
        registers: RegisterMap,
        calibration: Calibration,
        drive_map: DriveMap,
        rail_counts: tuple[int, int],
        timeout_s: float = 0.0095,
        open_timeout_s: float = 5.0,
        *,
        device_watchdog_s: float | None = None,
        counts_max: int | None = None,
        name: str = "modbus",
        emulated: bool = False,
    ) -> None:
        self.calibration = calibration
        self.drive_map = replace(drive_map, full_units=registers.full_units)
        self.backend = name
        self.failsafe: DeviceWatchdog | None = None
        if registers.watchdog is not None:
            self.failsafe = DeviceWatchdog(_LONGEST_WATCHDOG_S)  # until armed with less
        elif device_watchdog_s is not None:
            self.failsafe = DeviceWatchdog(device_watchdog_s)
        self._transport = transport
        self._framing: Framing = TcpFraming() if line.tcp else RtuFraming()
        self._line = line
        self._map = registers
        self._read_span, self._written_span = registers.read, registers.written
        self._rail_counts = rail_counts
        self._counts_max = counts_max
        self._timeout_s = timeout_s
        self._open_timeout_s = open_timeout_s
        self._name = name
        self._emulated = emulated
        self._met = False
        self._pace = 1.0  # share of what the config says that the fastest exchange took, at most 1
        self._armed = False
        self._suspect = False  # something may still be on its way
        self._quiet_until_s = -math.inf  # a new request must not begin before
        self._number = 0  # of the request, TCP
        self._max_units = 0
        self._seq = 0
        self._sequence = 0  # as last written with a drive; its echo must be this
        self._units = 0  # drive as last commanded
        self._fresh = False  # it has not gone out yet
        self._t_u_s = math.nan
        self._counts = dict.fromkeys(("exchanges", "timeouts", "bad_replies", "exceptions", "stale_bytes"), 0)

    @property
    def order(self) -> Order:
        """One exchange writes, then reads; separate ones read, then write."""
        return "write_first" if self._line.requests == "read-write" else "sample_first"

    @property
    def link_statistics(self) -> Mapping[str, int]:
        """Counts since construction.

        exchanges    requests that were waited for
        timeouts     of these, without a whole reply in time
        bad_replies  damaged, of another unit, or of another request
        exceptions   refusals by the device
        stale_bytes  that came when nothing was asked
        """
        return dict(self._counts)

    # ------------------------------------------------------------------ the life of a run

    def open(self) -> DeviceInfo:
        """Read the device's registers until it answers, ask who it is, and measure the round trip.

        Raises Fault LINK_TIMEOUT, LINK_UNIT, LINK_REPLY, MODBUS_EXCEPTION or LINK_LOST; CONFIG_MISMATCH for a position
        that no sensor of the config gives.
        """
        request, about = self._reading(self._read_span)
        self._until_answered(request, about)
        self._met = True
        vendor, product, revision = self._identity()
        # a device that does not know that question may be deaf for a while after it: one on libmodbus for 0.5 s
        self._until_answered(request, about)
        replies = [self._patiently(request, about, self._unhurried_s) for _ in range(_INTRODUCTIONS)]
        fastest = min(replies, key=lambda reply: reply.round_trip_s)
        if fastest.reckoned_s > 0.0:
            self._pace = min(fastest.round_trip_s / fastest.reckoned_s, 1.0)
        self._check_range(self._values(self._read_span, replies[-1])["position"])
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
        """Stop, write what the device takes of the limits and read it back, drive 0, arm.

        Raises ValueError where sensor, drive or a register cannot hold such limits; Fault ARM_READBACK, LINK_*,
        MODBUS_EXCEPTION, or what the device's status says then.
        """
        settings, max_units = self._settings(limits)
        self._armed = False
        self._settle()
        self._write_stop(self._patiently, self._unhurried_s)
        for register, value in settings:
            self._set(register, value)
        self._max_units = max_units
        if self._map.watchdog is not None:
            self.failsafe = DeviceWatchdog(limits.watchdog_s)
        self._units, self._fresh, self._t_u_s = 0, False, math.nan
        self._patiently(*self._writing_drive(0), self._unhurried_s)
        if self._map.control is not None:
            self._patiently(*self._writing(self._map.control, self._map.arm), self._unhurried_s)
        self._await_armed()
        self._armed = True

    def read(self) -> Sample:
        """Sample the bench; asked by FC23, the drive of the last ``write`` goes out with the same request.

        ``u_V`` is the device's word for what acts where it has such a register, else what was commanded.
        Raises Fault LINK_TIMEOUT, LINK_REPLY, LINK_UNIT, LINK_LOST, MODBUS_EXCEPTION, DEVICE_RESET, or the fault
        that the device's status names.
        """
        if self._armed and self._line.requests == "read-write":
            reply = self._exchange(*self._reading_and_writing(), self._timeout_s)
            if self._fresh:
                self._t_u_s, self._fresh = reply.executed_s, False
        else:
            reply = self._exchange(*self._reading(self._read_span), self._timeout_s)
        values = self._values(self._read_span, reply)
        if self._armed:
            self._check_status(values)
            self._check_echo(values)
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
        """Set the drive: asked by FC23 it goes out with the next ``read``, else now, confirmed.

        Raises ValueError beyond supply and bridge, or beyond what the device was armed for; Fault DEVICE_NOT_ARMED;
        asked separately also what ``read`` raises of the link.
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
            self._t_u_s = self._exchange(*self._writing_drive(units), self._timeout_s).executed_s

    def safe_stop(self) -> bool:
        """Drive 0, control to stop, up to three times; True once the replies and the registers confirm it.

        Where an exchange went wrong before, a first request to stop goes out at once and unheard; then whatever is
        late is waited for and thrown away, so that it does not pass for the confirmation.
        """
        self._armed = False
        self._fresh = False
        if not self._met:
            return False  # nothing is written to a device that was never found
        for _ in range(_ATTEMPTS):
            try:
                self._settle()
                self._write_stop(self._asked, self._timeout_s)
                if self._is_stopped():
                    return True
            except Fault as fault:
                if fault.code == "LINK_LOST":
                    return False
                self._suspect = True
        return False

    def close(self) -> None:
        """Close the port, after a ``safe_stop`` if still armed. May be called twice."""
        if self._armed:
            self.safe_stop()
        self._transport.close()

    # ------------------------------------------------------------------ arming and stopping

    def _settings(self, limits: Limits) -> tuple[list[tuple[Register, float]], int]:
        """What each register is set to, and the largest drive, units. Raises ValueError."""
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
        for register, value in settings:
            register.pack(value)
        return settings, max_units

    def _await_armed(self) -> None:
        """Until the status says so: a device with a program of its own sees the request in its next cycle only."""
        if self._map.status is None:
            return
        until_s = self._transport.now_s() + self._unhurried_s
        while True:
            reply = self._patiently(*self._reading(self._read_span), self._unhurried_s)
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

    def _set(self, register: Register, value: float) -> None:
        """Write a setting and read it back."""
        words = register.pack(value)
        self._patiently(*self._writing(register, value), self._unhurried_s)
        span = Span((register,))
        stored = _registers(self._patiently(*self._reading(span), self._unhurried_s).pdu)
        if stored != words:
            raise Fault("ARM_READBACK", f"{register}: sent {value:g}, stored {register.unpack(stored):g}")

    def _write_stop(self, asked: Callable[[ModbusPDU, str, float], _Reply], timeout_s: float) -> None:
        """Control to stop, drive 0, both confirmed by their replies; drive 0 also where the device refuses to stop.

        Raises Fault.
        """
        control = self._map.control
        refused: Fault | None = None
        if control is not None:
            try:
                asked(*self._writing(control, self._map.stop), timeout_s)
            except Fault as fault:
                if fault.code != "MODBUS_EXCEPTION":
                    raise
                refused = fault
        try:
            asked(*self._writing(self._map.drive, 0.0), timeout_s)
        except Fault as fault:
            # some devices take no drive at all, not even 0, while they are stopped
            if fault.code != "MODBUS_EXCEPTION" or control is None:
                raise
        if refused is not None:
            raise refused
        self._units = 0

    def _is_stopped(self) -> bool:
        """Whether the device's own registers say so, where it has such."""
        if self._map.applied is None and self._map.status is None:
            return True
        values = self._values(self._read_span, self._asked(*self._reading(self._read_span), self._timeout_s))
        driven = values.get("applied", 0.0) != 0.0
        armed = self._map.control is not None and values.get("status") == ARMED
        return not driven and not armed

    def _settle(self) -> None:
        """After an exchange that went wrong: ask for a stop unheard, then let everything late come and go."""
        if not self._suspect:
            return
        m = self._map
        request, _ = self._writing(m.drive, 0.0) if m.control is None else self._writing(m.control, m.stop)
        self._drain()
        self._send(request)
        until_s = self._transport.now_s() + _LATE_TIMEOUTS * self._timeout_s
        while (left_s := until_s - self._transport.now_s()) > 0.0:
            self._throw_away(self._transport.read(left_s))
        self._suspect = False

    def _until_answered(self, request: ModbusPDU, about: str) -> None:
        """Read again and again, for as long as a device may take to introduce itself; raises the last fault."""
        until_s = self._transport.now_s() + self._open_timeout_s
        while True:
            try:
                self._values(self._read_span, self._asked(request, about, self._unhurried_s))
                return
            except Fault as fault:
                if fault.code in ("LINK_LOST", "MODBUS_EXCEPTION") or self._transport.now_s() >= until_s:
                    raise

    def _identity(self) -> tuple[str, str, str]:
        """Vendor, product and revision as FC43 tells them; empty where the device does not."""
        request = ReadDeviceInformationRequest(read_code=1, object_id=0)
        try:
            pdu = self._asked(request, "identification", self._unhurried_s).pdu
        except Fault as fault:
            if fault.code == "LINK_LOST":
                raise
            return "", "", ""
        told = ReadDeviceInformationResponse()
        try:
            told.decode(pdu[1:])
        except (ValueError, IndexError, OverflowError):
            return "", "", ""
        texts = (told.information.get(k, b"") for k in range(3))
        vendor, product, revision = (
            text.decode("ascii", "replace") if isinstance(text, bytes) else "" for text in texts
        )
        return vendor, product, revision

    # ------------------------------------------------------------------ what the values say

    def _values(self, span: Span, reply: _Reply) -> dict[str, float]:
        return span.values(_registers(reply.pdu))

    def _check_range(self, value: float) -> None:
        """Raises Fault CONFIG_MISMATCH for a position beyond what the sensor reads: another type, order or scale."""
        position = self._map.position
        counts = self._checked(position, self._map.counts, value)
        if self._counts_max is not None and not 0 <= counts <= self._counts_max:
            raise Fault(
                "CONFIG_MISMATCH",
                f"{position} reads {value:g}: {counts:g} counts, of 0 to {self._counts_max} (sensor.counts_max); "
                "see its type, scale and offset_counts, and daq.modbus.word_order; or the sensor's wire is open",
            )

    def _check_status(self, values: Mapping[str, float]) -> None:
        status = self._map.status
        if status is None or values["status"] == ARMED:
            return
        value = int(values["status"])
        code = (self._map.faults or {}).get(value)
        at = f"{self._map.scale * values['position'] + self._map.offset_counts:g} counts"
        if code is not None:
            raise Fault(code, f"{status} reads {value}, at {at}")
        words = "not armed" if value == OFF else "neither armed (1) nor a fault of daq.modbus.registers.status"
        raise Fault("DEVICE_RESET", f"{status} reads {value}: {words}; at {at}")

    def _check_echo(self, values: Mapping[str, float]) -> None:
        echo = self._map.echo
        if echo is not None and values["echo"] != self._sequence:
            raise self._misfit(
                f"{echo} reads {values['echo']:g}, but drive {self._sequence} went out: a late reply, or "
                "the drive was not executed"
            )

    def _checked(self, register: Register, convert: Callable[[float], int], value: float) -> int:
        try:
            return convert(value)
        except ValueError as error:
            raise self._misfit(f"{register}: {error}") from error

    # ------------------------------------------------------------------ requests

    def _reading(self, span: Span) -> tuple[ModbusPDU, str]:
        kind = ReadInputRegistersRequest if span.registers[0].table == "input" else ReadHoldingRegistersRequest
        return kind(address=span.address, count=span.words), str(span)

    def _writing(self, register: Register, value: float) -> tuple[ModbusPDU, str]:
        return self._writing_words(register.address, register.pack(value)), str(register)

    def _writing_drive(self, units: int) -> tuple[ModbusPDU, str]:
        span = self._written_span
        return self._writing_words(span.address, self._drive_words(units)), str(span)

    def _reading_and_writing(self) -> tuple[ModbusPDU, str]:
        read, written = self._read_span, self._written_span
        request = ReadWriteMultipleRegistersRequest(
            read_address=read.address,
            read_count=read.words,
            write_address=written.address,
            write_registers=self._drive_words(self._units),
        )
        return request, f"{written} and {read}"

    def _drive_words(self, units: int) -> list[int]:
        self._sequence = self._sequence % 0xFFFF + 1
        return self._written_span.pack({"drive": self._map.drive_value(units), "sequence": self._sequence})

    @staticmethod
    def _writing_words(address: int, words: list[int]) -> ModbusPDU:
        if len(words) == 1:
            return WriteSingleRegisterRequest(address=address, registers=words)
        return WriteMultipleRegistersRequest(address=address, registers=words)

    # ------------------------------------------------------------------ exchanges

    @property
    def _unhurried_s(self) -> float:
        return max(self._timeout_s, _UNHURRIED_S)

    def _patiently(self, request: ModbusPDU, about: str, timeout_s: float) -> _Reply:
        """``_asked`` up to three times, for what may be said twice."""
        for _ in range(_ATTEMPTS - 1):
            try:
                return self._asked(request, about, timeout_s)
            except Fault as fault:
                if fault.code not in ("LINK_TIMEOUT", "LINK_REPLY"):
                    raise
        return self._asked(request, about, timeout_s)

    def _asked(self, request: ModbusPDU, about: str, timeout_s: float) -> _Reply:
        """Outside the tick: whatever is not the reply is thrown away, until the time is over."""
        self._drain()
        return self._await(request, about, timeout_s, self._send(request), strict=False)

    def _exchange(self, request: ModbusPDU, about: str, timeout_s: float) -> _Reply:
        """Within the tick: anything but the reply is a fault, and whatever may follow it is suspect."""
        try:
            unasked = self._drain()
            if self._armed and unasked >= _UNASKED_BYTES:
                raise self._misfit(
                    f"{unasked} bytes that nobody asked for: another master, or two answers to one request"
                )
            return self._await(request, about, timeout_s, self._send(request), strict=True)
        except Fault:
            self._suspect = True
            raise

    def _send(self, request: ModbusPDU) -> tuple[float, int]:
        """Send a request; when, and how many bytes."""
        self._number = self._number % 0xFFFF + 1
        data = self._framing.encode(request, self._line.unit, self._number)
        sent_s = self._transport.now_s()
        self._transport.write(data)
        self._quiet_until_s = sent_s + self._line.wire_s(len(data)) + self._line.pause_s
        return sent_s, len(data)

    def _drain(self) -> int:
        """Throw away what came unasked, and let the line be silent as long as it must; how many bytes."""
        thrown = 0
        while True:
            data = self._transport.read(max(self._quiet_until_s - self._transport.now_s(), 0.0))
            if not data:
                if self._transport.now_s() >= self._quiet_until_s:
                    return thrown
                continue
            thrown += len(data)
            self._throw_away(data)
            if thrown > _ENDLESS_BYTES:
                raise self._misfit(f"{thrown} bytes that nobody asked for, and more: the line is never quiet")

    def _throw_away(self, data: bytes) -> None:
        if data:
            self._counts["stale_bytes"] += len(data)
            self._quiet_until_s = self._transport.now_s() + self._line.pause_s

    def _await(
        self, request: ModbusPDU, about: str, timeout_s: float, sent: tuple[float, int], *, strict: bool
    ) -> _Reply:
        """The reply to a request. Raises Fault LINK_TIMEOUT, LINK_REPLY, LINK_UNIT, LINK_LOST, MODBUS_EXCEPTION.

        strict  the first thing that comes is the reply, or a fault; else what does not fit is thrown away
        """
        transport = self._transport
        sent_s, sent_bytes = sent
        self._counts["exchanges"] += 1
        until_s = sent_s + timeout_s
        data = b""
        objection: Fault | None = None
        while True:
            left_s = until_s - transport.now_s()
            # when the time is over whatever is there still counts: it is this process that was late, then
            more = transport.read(max(left_s, 0.0))
            if not more and left_s <= 0.0:
                break
            data += more
            received_s = transport.now_s()
            self._quiet_until_s = received_s + self._line.pause_s
            try:
                frame = self._framing.take(data)
                if frame is None:
                    continue
                self._check(frame, request, about)
            except Damaged as damaged:
                objection = self._misfit(f"asked for {about}: {damaged}")
            except Fault as fault:
                if fault.code == "MODBUS_EXCEPTION":
                    raise
                objection = fault
            else:
                return self._accepted(frame, data, sent_s, sent_bytes, received_s, strict=strict)
            if strict:
                raise objection
            self._counts["stale_bytes"] += len(data)
            data = b""
        self._counts["timeouts"] += 1
        if data:
            raise self._misfit(f"asked for {about}: {len(data)} bytes that are no whole reply, {data[:24].hex(' ')}")
        raise objection or Fault(
            "LINK_TIMEOUT", f"no reply from unit {self._line.unit} within {timeout_s * 1e3:g} ms, asked for {about}"
        )

    def _accepted(
        self, frame: Frame, data: bytes, sent_s: float, sent_bytes: int, received_s: float, *, strict: bool
    ) -> _Reply:
        extra = len(data) - frame.length
        if extra:
            self._counts["stale_bytes"] += extra
            if strict and extra >= _UNASKED_BYTES:
                raise self._misfit(
                    f"{extra} bytes beyond the reply: another master, or two answers to one request; the reply is "
                    f"{data[: frame.length].hex(' ')}"
                )
        took_s = received_s - sent_s
        to_device_s, reckoned_s = self._reckoned_s(sent_bytes, frame.length)
        # what it took beyond the sum is taken for the way back: a request leaves at once, but a reply waits for the
        # adapter, the system's buffers and this process (measured in docs/modbus.md); of an exchange quicker than the
        # sum both ways were
        until_executed_s = self._pace * to_device_s
        if reckoned_s > 0.0:
            until_executed_s = min(until_executed_s, took_s * to_device_s / reckoned_s)
        return _Reply(frame.pdu, sent_s + until_executed_s, took_s, reckoned_s)

    def _reckoned_s(self, sent_bytes: int, received_bytes: int) -> tuple[float, float]:
        """What an exchange takes by the config: until the device executes it, and until the reply is here."""
        half_s = 0.5 * self._line.turnaround_s
        to_device_s = self._line.wire_s(sent_bytes) + self._line.pause_s + half_s
        return to_device_s, to_device_s + half_s + self._line.wire_s(received_bytes)

    def _check(self, frame: Frame, request: ModbusPDU, about: str) -> None:
        """Whether a frame is the reply to a request, by everything that it says."""
        if frame.number is not None and frame.number != self._number:
            raise self._misfit(f"asked for {about}: the reply is to request {frame.number}, not to {self._number}")
        if frame.unit != self._line.unit:
            self._counts["bad_replies"] += 1
            raise Fault("LINK_UNIT", f"unit {frame.unit} answered, unit {self._line.unit} was asked for {about}")
        if is_exception(frame, request):
            self._counts["exceptions"] += 1
            code = frame.pdu[1]
            way_out = "; try daq.modbus.requests: separate" if code == 1 and request.function_code == 23 else ""
            raise Fault(
                "MODBUS_EXCEPTION",
                f"{_EXCEPTIONS.get(code, 'exception')} ({code}) at {about}, FC{request.function_code:02d}{way_out}",
            )
        if frame.pdu[0] != request.function_code:
            raise self._misfit(
                f"asked for {about} by FC{request.function_code:02d}: the reply is of FC{frame.pdu[0]:02d}"
            )
        expected = _expected(request)
        if isinstance(expected, int):
            if len(frame.pdu) != expected or frame.pdu[1] != expected - 2:
                raise self._misfit(f"asked for {about}: {len(frame.pdu) - 2} bytes came, not {expected - 2}")
        elif expected is not None and frame.pdu != expected:
            raise self._misfit(f"asked for {about}: confirmed is {frame.pdu.hex(' ')}, not {expected.hex(' ')}")

    def _misfit(self, detail: str) -> Fault:
        self._counts["bad_replies"] += 1
        return Fault("LINK_REPLY", detail)


def _expected(request: ModbusPDU) -> int | bytes | None:
    """The reply to a request: its length where registers come back, all of it where a write is confirmed."""
    if isinstance(request, ReadWriteMultipleRegistersRequest):
        return 2 + 2 * request.read_count
    if isinstance(request, ReadHoldingRegistersRequest):
        return 2 + 2 * request.count
    if isinstance(request, WriteSingleRegisterRequest | WriteMultipleRegistersRequest):
        return bytes((request.function_code,)) + request.encode()[:4]
    return None


def _registers(pdu: bytes) -> list[int]:
    """Registers of a reply that was checked."""
    reply = ReadHoldingRegistersResponse()
    reply.decode(pdu[1:])
    return list(reply.registers)
