"""A device on a register bus as a ``Driver``: what it reads and writes when, and what the values mean.

A register map says what each register means; a client (``rig.backends.registers.bus``) exchanges the requests. A tick
is a read, then a write that its reply confirms ("sample_first"), unless the device's own driver does it otherwise.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Generic

from rig.backends.driver import DeviceInfo, DeviceWatchdog, Timeouts, Transport
from rig.backends.registers.bus import ATTEMPTS, LATE_TIMEOUTS, BusClient, Reply, Req
from rig.backends.registers.map import ARMED, OFF, Register, RegisterMap, RegisterSpan
from rig.backends.tick_waits import REACTS_TICKS, TickWaits, unwatched_s
from rig.core.calibration import Scaling, hard_limits_in_counts, largest_drive_in_units
from rig.core.faults import Fault
from rig.core.signals import Limits, Order, Sample

_new = tuple.__new__  # of a named tuple, without a call in between
UNHURRIED_S = 0.1  # least time-out of a request outside the tick; a stop uses the tick's time-out
_STOPPING_S = 0.02  # longest wait for a stop: three of them are shorter than most watchdogs
_INTRODUCTIONS = 20  # reads that measure the round trip
_MISTAKEN = 2  # of the fastest ones: a reply that came twice may be taken for the next one
_LATE_REPLIES = 3  # in a row: the link is not fit for the period
LONGEST_WATCHDOG_S = 1.0  # that the config allows

_STOOD_STILL_S = 0.002  # beyond the sum an exchange was held up by this process, and counts as so much

Setting = tuple[Register, list[int]]  # a register, and its cells


class _Beyond:
    """What exchanges of one kind took beyond what the config says, s: in the mean, and at least."""

    def __init__(self) -> None:
        self.count, self._sum_s, self.least_s = 0, 0.0, math.inf

    def take(self, beyond_s: float) -> None:
        self.count += 1
        self._sum_s += beyond_s if beyond_s < _STOOD_STILL_S else _STOOD_STILL_S
        if beyond_s < self.least_s:
            self.least_s = beyond_s

    @property
    def mean_s(self) -> float:
        return self._sum_s / max(self.count, 1)


class RegisterDriver(ABC, Generic[Req]):
    """A device behind a transport. Times of samples are in the transport's clock, s.

    transport  an open port; closed by ``close``, never reopened
    client     asks the device on it
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
        client: BusClient[Req],
        registers: RegisterMap,
        scaling: Scaling,
        timeouts: Timeouts,
        *,
        name: str,
        emulated: bool,
        answered: bool,
    ) -> None:
        self.calibration = scaling.calibration
        self.drive_map = replace(scaling.drive_map, full_units=registers.full_units)
        self.backend = name
        self.failsafe: DeviceWatchdog | None = None
        if registers.watchdog is not None:
            self.failsafe = DeviceWatchdog(LONGEST_WATCHDOG_S)  # until armed with less
        self._transport = transport
        self._client = client
        self._client.is_suspect = answered
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
        self._written: list[Setting] = []  # settings that it has confirmed in this session
        self._max_units = 0
        self._seq = 0
        self._late_in_a_row = 0  # replies that took longer than this
        self._unfit_s = timeouts.reply_s + timeouts.period_s
        self._units = 0  # drive as last commanded
        self._t_u_s = math.nan
        self._sampled_s = math.nan  # when the position of the last reading was
        self._driven_s = -math.inf  # when the device last executed a drive
        # when its watchdog ends the last drive, at the latest: a servo's begins anew whenever it hears anything
        self._ends_s = -math.inf
        # when it last heard anything, of an exchange of a reading or drive that is not over
        self._replied_s = -math.inf
        self._acts_s = 0.0  # for so long its watchdog lets that act, or, without one, this driver
        self._lost_reply_s = (
            self._timeout_s
        )  # as preflight counts: a drive may act so much longer by what a reply waits
        self._waits = TickWaits(REACTS_TICKS, timeouts.period_s)
        self._beyond = {True: _Beyond(), False: _Beyond()}  # of readings, of drives
        self._reckons = True  # its times are by the exchanges; False: the device tells them

    @property
    def order(self) -> Order:
        """A read, then a write that its reply confirms."""
        return "sample_first"

    @property
    def descriptor(self) -> int | None:
        """Number of the open port or connection, as of ``Driver``; None in virtual time."""
        return getattr(self._transport, "descriptor", None)

    @property
    def times_shift_s(self) -> float:
        """As of ``ReckonedTimes``.

        What an exchange took beyond the quickest one is taken for its way back. It may have been on the way there, of
        readings another part than of drives.
        """
        kinds = self._beyond.values()
        if not all(kind.count for kind in kinds):
            return 0.0  # one exchange does both
        return max(kind.mean_s for kind in kinds) - min(kind.least_s for kind in kinds)

    @property
    def link_statistics(self) -> Mapping[str, int]:
        """Counts since construction, as ``BusClient.statistics``."""
        return self._client.statistics

    # ------------------------------------------------------------------ what a device's own driver says

    @abstractmethod
    def open(self) -> DeviceInfo:
        """As of ``Driver``. ``_introduced`` measures the round trip."""

    @abstractmethod
    def _reading(self, span: RegisterSpan) -> Req:
        """The request that reads registers."""

    @abstractmethod
    def _writing(self, what: Register | RegisterSpan, cells: list[int]) -> Req:
        """The request that writes them, and whose reply confirms it."""

    @abstractmethod
    def _cells(self, reply: Reply) -> Sequence[int]:
        """What the reply to a reading holds."""

    @property
    @abstractmethod
    def _refusal(self) -> str:
        """Code of the fault by which the device refuses a request."""

    def _bounds_of(self, hard_counts: tuple[int, int]) -> Iterator[tuple[Register, float]]:
        """Settings for the travel limits, in counts, and for what else the device checks of the position."""
        yield from ()

    def _check_armed(self, values: Mapping[str, float]) -> None:
        """Look at what a reading of an armed device says. Raises Fault."""
        self._check_status(values)

    def _disarm(self) -> None:
        """Before it is armed. Raises Fault."""
        self._write_stop(self._client.patiently, self._unhurried_s)

    def _switch_on(self) -> None:
        """Drive 0, and armed, where there is a register for that. Raises Fault."""
        self._driven_s = self._client.patiently(self._writing_drive(0), self._unhurried_s).executed_s
        if self._map.control is not None:
            self._client.patiently(self._setting(self._map.control, self._map.arm), self._unhurried_s)

    def _acting_V(self, values: Mapping[str, float]) -> float:
        """The drive that acts since the last write, V: as the device reports it, else as commanded."""
        units = self._units if self._armed else 0
        if self._map.applied is not None:
            units = self._checked(self._map.applied, self._map.drive_units, values["applied"])
        return self.drive_map.to_volts(units)

    # ------------------------------------------------------------------ the life of a run

    def arm(self, limits: Limits) -> None:
        """Stop, write the limits that have registers and read them back, drive 0, arm.

        A device that is armed again must still hold what was written before. If it does not, it was reset: nothing is
        written, and Fault DEVICE_RESET is raised. Registers are written again only for other limits.
        Raises ValueError where sensor, drive or a register cannot hold the limits; Fault ARM_READBACK, DEVICE_RESET,
        LINK_*, the device's refusal, or the fault in its status.
        """
        settings, max_units = self._settings(limits)
        self._armed = False
        self._settle()
        if self._is_off:  # read first: another stop would clear what the device may have latched
            self.read()
        self._is_off = False
        self._forget_echo()
        self._disarm()
        self._check_settings()
        if settings != self._written:
            for register, words in settings:
                self._set(register, words)
            self._written = settings
        self._max_units = max_units
        if self._map.watchdog is not None:
            self.failsafe = DeviceWatchdog(limits.watchdog_s)
        self._units, self._t_u_s = 0, math.nan
        self._switch_on()
        self._await_armed()
        self._armed = True
        if self.failsafe is None:
            self._acts_s = longest_s = unwatched_s(self._timeout_s, limits.watchdog_s)
        else:
            self._acts_s = min(self.failsafe.time_s, LONGEST_WATCHDOG_S)
            longest_s = self._lost_reply_s + self._acts_s
        self._replied_s = self._transport.now_s()
        self._ends_s = math.inf if self.failsafe is None else self._replied_s + self._acts_s
        self._waits.restart(longest_s, self._replied_s)

    def read(self) -> Sample:
        """Sample the bench.

        ``u_V`` is the drive that the device reports, if it has a register for that; else the commanded drive.
        Raises Fault LINK_TIMEOUT, LINK_REPLY, LINK_UNIT, LINK_LOST, DEVICE_RESET, the device's refusal, or the fault
        that its status names.
        """
        self._waits.read(self._transport.now_s())
        reply = self._tick_reading() if self._armed else self._unhurried_reading()
        self._sampled_s = reply.executed_s
        values = self._values(self._read_span, reply)
        if self._armed:
            self._check_armed(values)
            self._end_exchange(reply.executed_s)
        elif self._max_units > 0:  # armed before: a fault in a pause must not go unseen
            self._check_pause(values)
        try:
            counts = self._map.counts(values["position"])
        except ValueError as error:
            raise self._client.misfit(f"{self._map.position}: {error}") from error
        self._seq = (self._seq + 1) & 0xFFFF
        y_rad, u_V = self.calibration.to_rad(counts), self._acting_V(values)
        return _new(Sample, (self._sampled_s, y_rad, counts, math.nan, self._t_u_s, u_V, self._seq))

    def write(self, u_V: float) -> None:
        """Set the drive.

        Raises ValueError beyond supply and bridge, or beyond the drive that the device is armed for; Fault
        DEVICE_NOT_ARMED; the link faults of ``read``.
        """
        units = self.drive_map.to_units(u_V)
        if not self._armed:
            raise Fault("DEVICE_NOT_ARMED", f"{u_V:.3f} V")
        if abs(units) > self._max_units:
            raise ValueError(f"drive {u_V:g} V is beyond the {self.drive_map.to_volts(self._max_units):g} V armed for")
        self._tick_writing(units)
        self._waits.drive()
        self._units = units
        self._end_exchange()

    def safe_stop(self) -> bool:
        """Drive 0, control to stop, up to three times. True once replies and registers confirm it.

        If an exchange went wrong before, a first stop goes out at once and its reply is ignored. Then the driver waits
        for late bytes and throws them away, so that they do not look like the confirmation. A device with a program of
        its own sees the request in its next cycle only: the driver waits for it, 0.06 s in all.
        """
        self._armed = False
        self._forget_echo()
        if not self._met:
            return False  # never write to a device that has not answered yet, or that somebody else drives
        begin_s = self._transport.now_s()

        def stopped(attempt: int) -> bool | None:
            self._write_stop(self._client.asked, self._timeout_s)
            return self._is_stopped(begin_s + attempt * _STOPPING_S, begin_s + ATTEMPTS * _STOPPING_S) or None

        if self._tried(stopped):
            self._is_off = True
            return True
        return False

    def _tried(self, once: Callable[[int], bool | None]) -> bool:
        """What ``once`` says of attempt 1, 2, ...: None asks for another. False after the last, or on a lost link."""
        for attempt in range(1, ATTEMPTS + 1):
            try:
                self._settle()
                said = once(attempt)
                if said is not None:
                    return said
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

    # ------------------------------------------------------------------ opening

    def _until_answered(self) -> None:
        """Read until the device answers or ``timeouts.open_s`` is over; raises the last fault then."""
        until_s = self._transport.now_s() + self._open_timeout_s
        while True:
            try:
                self._values(self._read_span, self._client.asked(self._sampling, self._unhurried_s))
                return
            except Fault as fault:
                if fault.code in ("LINK_LOST", self._refusal) or self._transport.now_s() >= until_s:
                    raise
                self._client.wait((LATE_TIMEOUTS - 1) * self._unhurried_s)

    def _introduced(self) -> tuple[list[Mapping[str, float]], float]:
        """Some readings, and the fastest round trip among them that counts, s; the client's pace from now on.

        The line is quiet after each: so a reply that came twice spoils one round trip, and not all that follow.

        Raises Fault CONFIG_MISMATCH for a position that no sensor of the config gives.
        """
        replies = []
        for _ in range(_INTRODUCTIONS):
            replies.append(self._unhurried_reading())
            self._client.wait(replies[-1].reckoned_s)
        fast = sorted(replies, key=lambda reply: reply.at_most_s)[_MISTAKEN]
        self._client.set_pace(fast)
        seen: list[Mapping[str, float]] = [self._values(self._read_span, reply) for reply in replies]
        self._check_range(seen[-1]["position"])
        return seen, fast.at_most_s

    def _check_range(self, value: float) -> None:
        """Raises Fault CONFIG_MISMATCH for a position beyond the sensor's range: wrong type, order or scale."""
        position = self._map.position
        counts = self._checked(position, self._map.counts, value)
        if self._counts_max is not None and not 0 <= counts <= self._counts_max:
            raise Fault(
                "CONFIG_MISMATCH",
                f"{position} reads {value:g}: {counts:g} counts, of 0 to {self._counts_max} (sensor.counts_max); "
                f"{self._range_words}",
            )

    @property
    def _range_words(self) -> str:
        """What to check where the position is none of the sensor."""
        return "check the sensor"

    # ------------------------------------------------------------------ arming and stopping

    def _settings(self, limits: Limits) -> tuple[list[Setting], int]:
        """The cells for each register, and the largest drive, units. Raises ValueError."""
        m = self._map
        hard = hard_limits_in_counts(limits, self.calibration, self.drive_map, self._rail_counts)
        max_units = largest_drive_in_units(limits, self.drive_map)
        settings: list[tuple[Register, float]] = []
        if m.watchdog is not None:
            settings.append((m.watchdog, round(limits.watchdog_s / m.unit_s)))
        settings += self._bounds_of(hard)
        if m.max_drive is not None:
            settings.append((m.max_drive, m.drive_value(max_units)))
        return [(register, register.pack(value)) for register, value in settings], max_units

    def _await_armed(self) -> None:
        """Wait until the status is armed: a device with its own program sees the request in its next cycle only."""
        if self._map.status is None:
            return
        until_s = self._transport.now_s() + self._unhurried_s
        while True:
            reply = self._client.patiently(self._sampling, self._unhurried_s)
            values = self._values(self._read_span, reply)
            if values["status"] != OFF or self._transport.now_s() >= until_s:
                self._check_status(values)
                return

    def _set(self, register: Register, words: list[int]) -> None:
        """Write a setting and read it back."""
        self._client.patiently(self._writing(register, words), self._unhurried_s)
        stored = self._stored(register)
        if stored != words:
            raise Fault(
                "ARM_READBACK", f"{register}: sent {register.unpack(words):g}, stored {register.unpack(stored):g}"
            )

    def _stored(self, register: Register) -> list[int]:
        """The cells that a setting's register holds now."""
        reading = self._reading(RegisterSpan((register,)))
        return list(self._cells(self._client.patiently(reading, self._unhurried_s)))

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

    def _write_stop(self, asked: Callable[[Req, float], Reply], timeout_s: float) -> None:
        """Control to stop, drive 0, both confirmed by their replies; drive 0 also where the device refuses to stop.

        Raises Fault.
        """
        control = self._map.control
        refused: Fault | None = None
        if control is not None:
            try:
                asked(self._setting(control, self._map.stop), timeout_s)
            except Fault as fault:
                if fault.code != self._refusal:
                    raise
                refused = fault
        try:
            asked(self._setting(self._map.drive, 0.0), timeout_s)
        except Fault as fault:
            # some devices take no drive at all, not even 0, while they are stopped
            if fault.code != self._refusal or control is None:
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
            reply = self._client.asked(self._sampling, self._timeout_s)
            values = self._values(self._read_span, reply)
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
        stop = self._setting(m.drive, 0.0) if m.control is None else self._setting(m.control, m.stop)
        self._client.unheard(stop, LATE_TIMEOUTS * self._timeout_s)

    # ------------------------------------------------------------------ what the values mean

    def _values(self, span: RegisterSpan, reply: Reply) -> dict[str, float]:
        return span.values(self._cells(reply))

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
        """Raise the fault in the status of a stopped device, unless the status is off."""
        status = self._map.status
        if status is None or values["status"] == OFF:
            return
        if self._is_armed_by(values["status"]):
            words = f"{status} reads {ARMED}: armed, although rig stopped it; at {self._counts(values)}"
            raise Fault("SECOND_MASTER" if self._is_off else "STOP_UNCONFIRMED", words)
        self._check_status(values)

    def _forget_echo(self) -> None:
        """The device is stopped, or armed anew: what it echoes from now on says nothing of the drives before."""

    def _checked(self, register: Register, convert: Callable[[float], int], value: float) -> int:
        try:
            return convert(value)
        except ValueError as error:
            raise self._client.misfit(f"{register}: {error}") from error

    # ------------------------------------------------------------------ requests

    @cached_property
    def _sampling(self) -> Req:
        """Reads all that a tick needs: made once."""
        return self._reading(self._read_span)

    @property
    def _unhurried_s(self) -> float:
        return max(self._timeout_s, UNHURRIED_S)

    def _unhurried_reading(self) -> Reply:
        """A reading while disarmed: there is time to repeat it."""
        return self._client.patiently(self._sampling, self._unhurried_s)

    def _tick_reading(self) -> Reply:
        """The reading of a tick."""
        return self._exchange(self._sampling)

    def _tick_writing(self, units: int) -> None:
        """The drive of a tick."""
        self._t_u_s = self._driven_s = self._exchange(self._writing_drive(units)).executed_s

    def _exchange(self, request: Req, idle_s: float = 0.0) -> Reply:
        """The exchange of a tick, after ``idle_s`` in which nothing is asked.

        It waits for as long as the device's watchdog lets the last drive act, and as all late ticks while a loop reacts
        may take together: that is what preflight counts. One request is under way at a time, so what comes late can
        only be its reply. Where one reply after the other is late, the link is not fit for the period: LINK_TIMEOUT.
        Where ticks came too late before it: LATE.
        """
        begun_s, left_s = self._transport.now_s(), math.inf
        if begun_s < self._ends_s:  # else the device says so
            left_s = self._waits.until_s - begun_s
            if left_s < 0.0:
                self._check_late("LATE")
                left_s = 0.0
        longest_s = self._driven_s + self._acts_s - begun_s
        if longest_s < self._timeout_s:
            longest_s = self._timeout_s
        waits_s = left_s if left_s < longest_s else longest_s
        try:
            reply = self._client.asked(request, waits_s, in_tick=True, idle_s=idle_s if idle_s < waits_s else waits_s)
        except Fault as fault:
            self._explain(fault)
            if fault.code == "LINK_TIMEOUT" and left_s < longest_s:
                raise Fault(fault.code, f"{fault.detail}; {self._waits.words}") from fault
            raise
        self._replied_s = reply.latest_s
        if self._reckons:
            self._beyond[request is self._sampling].take(reply.latest_s - reply.executed_s)
        self._late_in_a_row = self._late_in_a_row + 1 if reply.round_trip_s > self._unfit_s else 0
        if self._late_in_a_row >= _LATE_REPLIES:
            ends = Fault("LINK_TIMEOUT", f"{_LATE_REPLIES} replies in a row took over {1e3 * self._unfit_s:g} ms")
            self._explain(ends)
            raise ends
        return reply

    def _check_late(self, code: str) -> None:
        """Raise that fault where late ticks and replies have taken more than is counted, and a drive may act."""
        now_s = self._transport.now_s()
        if self._waits.is_over(now_s) and now_s < self._ends_s:
            ends = Fault(code, self._waits.words)
            self._explain(ends)
            raise ends

    def _end_exchange(self, armed_s: float = -math.inf) -> None:
        """The device has not said that its watchdog has acted: it waits anew. Raises Fault LINK_TIMEOUT.

        One whose status tells has heard this before that could act, though its answer was taken much later; unless it
        was armed at ``armed_s``, which is later: then its watchdog does not do what it must.
        """
        is_sure = self._map.status is None or armed_s >= self._ends_s
        heard_s = self._replied_s if is_sure else min(self._replied_s, self._ends_s)
        if self.failsafe is not None:
            self._ends_s = heard_s + self._acts_s
        if self._transport.now_s() > self._waits.until_s:
            self._check_late("LINK_TIMEOUT")

    def _explain(self, fault: Fault) -> None:
        """Raise the fault that is behind one of the link, where the driver knows it."""

    def _writing_drive(self, units: int) -> Req:
        return self._writing(self._written_span, self._drive_cells(units))

    def _drive_cells(self, units: int) -> list[int]:
        return self._written_span.pack({"drive": self._map.drive_value(units)})

    def _setting(self, register: Register, value: float) -> Req:
        return self._writing(register, register.pack(value))
