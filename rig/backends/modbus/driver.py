"""A Modbus device as a ``Driver``: a device on a register bus, with what Modbus alone has.

The config says what each register means; ``rig.backends.registers.bus`` exchanges the requests.

With FC23 a tick is one exchange: the drive of the previous tick goes out, and the position at that instant comes back
(order "write_first"). With separate requests a tick is a read, then a write that its reply confirms ("sample_first").
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from typing_extensions import override

from rig.backends.driver import DeviceInfo, DeviceWatchdog, Timeouts, Transport
from rig.backends.modbus.client import Modbus, ModbusLine
from rig.backends.modbus.registers import RegisterMap
from rig.backends.modbus.requests import (
    Request,
    identification,
    identity_of,
    reading,
    reading_and_writing,
    registers_of,
    writing,
)
from rig.backends.registers.bus import BusClient, Reply
from rig.backends.registers.driver import RegisterDriver
from rig.backends.registers.map import OFF, Register, RegisterSpan
from rig.backends.tick_waits import REACTS_TICKS, TickWaits
from rig.core.calibration import Scaling
from rig.core.faults import Fault
from rig.core.signals import Limits, Order

_SILENCE_MARGIN_S = 0.1  # beyond a watchdog's time: a device has its own clock, and its own cycle
_OWN_ECHOES = 2  # what echoes of a late reply, or of a write that was not executed, differ by at most
_STOP_BYTES = 11  # FC16 of one register
_EMULATED = ("rig", "emulated I/O block")  # vendor and product of the emulated block


class ModbusDriver(RegisterDriver[Request]):
    """A Modbus device behind a transport. Times of samples are in the transport's clock, s.

    line    how the device is reached
    The rest is as of ``RegisterDriver``.
    """

    _map: RegisterMap

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
        super().__init__(
            transport,
            BusClient(transport, Modbus(line)),
            registers,
            scaling,
            timeouts,
            name=name,
            emulated=emulated,
            answered=answered,
        )
        if self.failsafe is None and registers.device_watchdog_s is not None:
            self.failsafe = DeviceWatchdog(registers.device_watchdog_s)
        self._line = line
        if self.failsafe is not None:
            self._lost_reply_s -= line.pause_s + line.wire_s(_STOP_BYTES)  # a stop waits for silence, and takes time
        self._waits = TickWaits(REACTS_TICKS + self._writes_in_reading, timeouts.period_s)
        self._sequence = 0  # as last written with a drive; its echo must be this
        self._echo: float | None = None  # as last read since it was armed, or since the stop after that
        self._fresh = False  # the drive has not gone out yet

    @property
    @override
    def order(self) -> Order:
        """With FC23 "write_first": one exchange writes, then reads. Else "sample_first"."""
        return "write_first" if self._writes_in_reading else "sample_first"

    @property
    def _writes_in_reading(self) -> bool:
        return self._line.requests == "read-write"

    # ------------------------------------------------------------------ the life of a run

    @override
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
        seen, round_trip_s = self._introduced()
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
            round_trip_s=round_trip_s,
            drive_units=self._map.full_units,
        )

    @override
    def arm(self, limits: Limits) -> None:
        self._fresh = False
        super().arm(limits)

    @override
    def safe_stop(self) -> bool:
        self._fresh = False
        return super().safe_stop()

    # ------------------------------------------------------------------ requests

    @property
    @override
    def _refusal(self) -> str:
        return "MODBUS_EXCEPTION"

    @override
    def _reading(self, span: RegisterSpan) -> Request:
        return reading(span)

    @override
    def _writing(self, what: Register | RegisterSpan, cells: list[int]) -> Request:
        return writing(what, cells)

    @override
    def _cells(self, reply: Reply) -> Sequence[int]:
        return registers_of(reply.pdu)

    @override
    def _tick_reading(self) -> Reply:
        if not self._writes_in_reading:
            return super()._tick_reading()
        reply = self._exchange(reading_and_writing(self._read_span, self._written_span, self._drive_cells(self._units)))
        self._driven_s = reply.executed_s
        if self._fresh:
            self._t_u_s, self._fresh = reply.executed_s, False
        return reply

    @override
    def _tick_writing(self, units: int) -> None:
        if self._writes_in_reading:
            self._fresh = True
        else:
            super()._tick_writing(units)

    @override
    def _drive_cells(self, units: int) -> list[int]:
        self._sequence = self._sequence % 0xFFFF + 1
        return self._written_span.pack({"drive": self._map.drive_value(units), "sequence": self._sequence})

    def _identity(self) -> tuple[str, str, str]:
        """Vendor, product and revision by FC43; empty where the device does not report them."""
        try:
            return identity_of(self._client.asked(identification(), self._unhurried_s).pdu)
        except Fault as fault:
            if fault.code == "LINK_LOST":
                raise
            return "", "", ""

    # ------------------------------------------------------------------ settings

    @override
    def _bounds_of(self, hard_counts: tuple[int, int]) -> Iterator[tuple[Register, float]]:
        m = self._map
        if m.limits is not None:
            yield from zip(m.limits, self._bounds(hard_counts, inward=True), strict=True)
        if m.rails is not None:
            yield from zip(m.rails, self._bounds(self._rail_counts, inward=False), strict=True)

    def _bounds(self, counts: tuple[int, int], *, inward: bool) -> tuple[float, float]:
        """Two readings as values of the position's register, rounded the given way where it is whole."""
        low, high = sorted(self._map.position_value(c) for c in counts)
        if not self._map.position.is_whole:
            return low, high
        if inward:
            return math.ceil(low - 1e-9), math.floor(high + 1e-9)
        return math.floor(low + 1e-9), math.ceil(high - 1e-9)

    # ------------------------------------------------------------------ what the values mean

    @property
    @override
    def _range_words(self) -> str:
        return "check its type, scale and offset_counts, daq.modbus.word_order, and the sensor's wire"

    @override
    def _check_armed(self, values: Mapping[str, float]) -> None:
        super()._check_armed(values)
        self._check_echo(values)

    @override
    def _check_pause(self, values: Mapping[str, float]) -> None:
        """Raise the fault in the status of a stopped device, unless the status is off; or that somebody wrote to it."""
        echo = self._map.echo
        if echo is not None:
            before, self._echo = self._echo, values["echo"]
            if before is not None and self._echo not in (before, self._sequence, 0.0):  # 0: it was reset
                words = f"{echo} went from {before:g} to {self._echo:g} while rig only read; at {self._counts(values)}"
                raise Fault("SECOND_MASTER", words)
        super()._check_pause(values)

    @override
    def _forget_echo(self) -> None:
        self._echo = None

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
        if self._writes_in_reading:
            return False
        apart = abs(echo - self._sequence)
        return min(apart, 0xFFFF - apart) > _OWN_ECHOES
