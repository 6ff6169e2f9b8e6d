"""A smart servo as a ``Driver``: a device on a register bus, with what servos alone have.

A tick is a read, then a write of the duty that its answer confirms. The servo works in steps of 1 ms: a position is
that of its last step, a duty acts from its next one. No manual says so. Where the servo tells its clock rig knows the
steps; else it asks at another place within them in each tick, and takes the mean for true.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from typing_extensions import override

from rig.backends.driver import DeviceInfo, DeviceWatchdog, Timeouts, Transport
from rig.backends.registers.bus import LATE_TIMEOUTS, BusClient, Reply
from rig.backends.registers.driver import UNHURRIED_S, RegisterDriver
from rig.backends.registers.map import Register, RegisterSpan
from rig.backends.servo.before import BeforeStore, put_back
from rig.backends.servo.bus import Ask, ServoLink, bus_of
from rig.backends.servo.guardian import Guardian, beat, stopped_by_keeper
from rig.backends.servo.opening import (
    ServoSetup,
    error_words,
    leave_no_trace,
    look,
    other_mode,
    set_to_0,
    set_up,
    switch_on,
    try_switch,
)
from rig.backends.servo.registers import ServoMap, bus_register, servo_map
from rig.backends.servo.steps import STEP_S, WRAPS, Steps
from rig.core import person
from rig.core.calibration import Scaling
from rig.core.faults import Fault
from rig.core.link_turn import turn_on
from rig.core.signals import Limits, Sample

_new = tuple.__new__  # of a named tuple, without a call in between

_REST_COUNTS: Final = 1  # that a shaft at rest may move by
_REST_S: Final = 0.04  # for which it must
_COASTS_S: Final = 1.0  # longest wait for rest
_LOOK_S: Final = 0.005
_BURST_S: Final = 0.2  # longest wait while the servo's keeper stops it
_TURN_S: Final = 3.0  # longest wait for the servo's keeper: it stops, and puts back
_CUTS_S: Final = 0.02  # until torque off shows in the duty that acts
_IN_A_ROW: Final = 2  # readings that must say the same before it is a fault: one can be damaged
_SAG_SHARE: Final = 0.25  # of the supply that may be lost under load, or come back while it brakes
_STEPS_OFF: Final = 2.0  # of the drive, by which the duty that acts may differ from what was written
_STAMPED_S: Final = 0.004  # before now a duty was told, at most: the servo's step, and the way of its answer
_LATE_S: Final = 0.002  # from here on an answer is later than the quickest one, and than its adapter makes it
_WAYS: Final = 8  # drives within that time, at most
_GOLDEN: Final = 0.5 * (math.sqrt(5.0) - 1.0)  # its multiples are spread evenly over a step
_STAGGERED: Final = 24  # readings that find where within its step the servo is
_TICK_SLACK_S: Final = 0.1  # by which the servo's clock may differ from the host's between two readings
_ERROR_FAULTS: Final = {
    "dynamixel": ((0x04, "SERVO_HOT"), (0x20, "SERVO_OVERLOAD"), (0x01, "SERVO_SUPPLY"), (0x08, "DEVICE_SENSOR")),
    "feetech": (
        (0x04, "SERVO_HOT"),
        (0x20, "SERVO_OVERLOAD"),
        (0x08, "SERVO_OVERLOAD"),
        (0x01, "SERVO_SUPPLY"),
        (0x02, "DEVICE_SENSOR"),
    ),
}


class _Way(NamedTuple):
    """A drive of the servo: from a time on, s, its duty is ramped from one to another, steps, by ``slope`` steps/s."""

    begins_s: float
    start: float
    end: float
    slope: float

    def at(self, t_s: float) -> float:
        """The duty at a time, steps."""
        if t_s <= self.begins_s:
            return self.start
        way = self.slope * (t_s - self.begins_s)
        if abs(self.end - self.start) <= way:
            return self.end
        return self.start + math.copysign(way, self.end - self.start)


class _Places(NamedTuple):
    """Where in a reading each number is; -1: the servo has none."""

    position: int
    applied: int
    voltage: int
    temperature: int
    torque: int
    tick: int


class ServoDriver(RegisterDriver[Ask]):
    """A servo on a bus behind a transport. Times of samples are in the transport's clock, s.

    setup     what the config says of it
    baud      of the bus
    store     keeps the values that its registers held before
    guardian  starts who stops the servo if this process dies or hangs; None: in virtual time nobody does
    The rest is as of ``RegisterDriver``.
    """

    _map: ServoMap

    def __init__(
        self,
        transport: Transport,
        setup: ServoSetup,
        baud: int,
        scaling: Scaling,
        timeouts: Timeouts,
        store: BeforeStore,
        *,
        guardian: Callable[[ServoLink, BeforeStore], Guardian] | None = None,
        name: str = "servo",
        emulated: bool = False,
        answered: bool = False,
    ) -> None:
        bus = bus_of(setup.model, setup.id, baud)
        super().__init__(
            transport,
            BusClient(transport, bus),
            servo_map(setup.model, setup.zero_counts),
            scaling,
            timeouts,
            name=name,
            emulated=emulated,
            answered=answered,
        )
        self._bus, self._setup, self._store = bus, setup, store
        self._link = ServoLink(transport, self._client, bus, setup.model, max(timeouts.reply_s, UNHURRIED_S))
        self._start_guardian = guardian
        self._only_stops = answered
        self._is_switch_tried = setup.supply_switch == ""
        self.end_words = ""
        self._guardian: Guardian | None = None
        self._voltage_scale = setup.model.role("voltage").scale
        self._weak_V, self._strong_V = ((1.0 + share) * setup.supply_V for share in (-_SAG_SHARE, _SAG_SHARE))
        self._is_changed = False  # its registers are not as before
        self._slope_units_s = math.inf  # by which the duty is ramped
        self._ways: deque[_Way] = deque(maxlen=_WAYS)  # the latest drives since it was armed
        self._steady_s = math.inf  # from then on the duty is the last drive's
        self._drives: dict[int, Ask] = {}  # what writes each drive
        self._volts: dict[float, float] = {}  # of each duty
        self._position: int | None = None  # as last read
        self._errors = 0  # error byte of the last answer
        self._strange = 0  # readings in a row of a duty that is not what was written
        self._doubted = 0  # alerts in a row that the servo's own register denies
        self._bad = 0  # readings in a row of heat or of a supply that is out of range
        self._tick = self._tick_s = math.nan  # the servo's clock as last read, ms, and the host's, s
        self._steps, self._waits_s = Steps(), math.inf  # and how long the quickest reply waited on its way back, s
        self._dithered = 0.0  # share of a step
        self._late_s = _LATE_S + setup.adapter_s
        self._glance = RegisterSpan(tuple(r for r in self._map.read.registers if r.name in ("applied", "tick")))
        self._before_s = math.nan  # when the drive before the last one acted
        self._numbers, self._turn = self._read_span.numbers, setup.model.counts_per_turn
        places = {name: place for place, name in enumerate(self._read_span.names)}
        self._places = _Places(*(places.get(name, -1) for name in _Places._fields))
        self._reckons = self._places.tick < 0

    # ------------------------------------------------------------------ requests

    @property
    @override
    def _refusal(self) -> str:
        return "SERVO_REFUSED"

    @override
    def _reading(self, span: RegisterSpan) -> Ask:
        return self._bus.reading(span.address, span.words, str(span))

    @override
    def _writing(self, what: Register | RegisterSpan, cells: list[int]) -> Ask:
        return self._bus.writing(what.address, bytes(cells), str(what))

    @override
    def _writing_drive(self, units: int) -> Ask:
        """Made once for each drive: a servo has two thousand at most."""
        if units not in self._drives:
            self._drives[units] = super()._writing_drive(units)
        return self._drives[units]

    @override
    def _cells(self, reply: Reply) -> Sequence[int]:
        self._errors = reply.pdu[0]
        return reply.pdu[1:]

    @override
    def _explain(self, fault: Fault) -> None:
        if self._keeper_acted:  # it speaks on the bus, too
            raise stopped_by_keeper() from fault

    @property
    def _keeper_acted(self) -> bool:
        return self._guardian is not None and self._guardian.has_acted

    def _check_alert(self, reply: Reply) -> None:
        """An answer that tells of an error is a fault by its name."""
        if self._bus.alerts(reply.pdu):
            self._raise_alert(reply.pdu[0])
        else:
            self._doubted = 0

    # ------------------------------------------------------------------ the life of a run

    @override
    def open(self) -> DeviceInfo:
        """Find the servo, look at everything, keep what its registers hold, set it up, prove its watchdog.

        Raises Fault LINK_*, CONFIG_MISMATCH, SECOND_MASTER, and those of ``rig.backends.servo.opening``.
        """
        self._until_there()
        left = leave_no_trace(self._link, self._setup, self._store)
        remarks = look(self._link, self._setup, left.others)
        if self._setup.supply_switch and person.asks is not None:
            try_switch(self._link, self._setup, self._store, person.asks)
            look(self._link, self._setup, remarks)  # it has started anew
            self._is_switch_tried = True
        opened = set_up(self._link, self._setup, self._store, self._have_it_watched)
        self._map = replace(self._map, watchdog=self._map.watchdog if opened.has_watchdog else None)
        self.failsafe = DeviceWatchdog(self._setup.watchdog_s) if opened.has_watchdog else None
        if opened.slope_V_s is not None:
            self._slope_units_s = opened.slope_V_s / self._setup.supply_V * self._map.full_units
        _, round_trip_s = self._introduced()
        model = self._setup.model
        self.backend = f"{self._name} (id {self._setup.id}, {model.name}, firmware {opened.firmware})"
        return DeviceInfo(
            build=str(opened.firmware),
            board=model.name,
            reset_cause="not told",
            emulated=self._emulated,
            round_trip_s=round_trip_s,
            supply_V=opened.supply_V,
            drive_units=self._map.full_units,
            acknowledged=left.acknowledged,
            remarks=(*left.remarks, *remarks, *opened.remarks),
        )

    @override
    def arm(self, limits: Limits) -> None:
        """As of ``RegisterDriver``; torque on with duty 0 alone, which is read back before.

        Raises also Fault SERVO_SWITCH_UNTRIED.
        """
        if not self._is_switch_tried:
            raise Fault("SERVO_SWITCH_UNTRIED", self._setup.supply_switch)
        self._tick = self._tick_s = math.nan
        self._strange = self._bad = self._doubted = 0
        super().arm(limits)
        self._find_steps()
        self._ways.clear()
        self._steady_s = self._transport.now_s()
        self._ways.append(_Way(self._steady_s, 0.0, 0.0, self._slope_units_s))

    @override
    def read(self) -> Sample:
        """As of ``RegisterDriver``. While armed it is one function, for the reason that ``BusClient.asked`` is one.

        What is unusual is looked at by a method of its own. Where the servo tells no clock, it is asked at another
        place within its step each tick: the mean is then the truth. Raises Fault also by what ``_check_duty``,
        ``_check_health`` and the servo's clock say.
        """
        if not self._armed:
            return super().read()
        guardian, setup, idle_s = self._guardian, self._setup, 0.0
        if guardian is not None:
            guardian.waits()  # for as long as the servo's own watchdog may: else the keeper acts just before
        if self._reckons:
            self._dithered = (self._dithered + _GOLDEN) % 1.0
            idle_s = self._dithered * STEP_S
        self._waits.read(self._transport.now_s())
        reply = self._exchange(self._sampling, idle_s)
        if reply.pdu[0] or self._doubted:
            self._check_alert(reply)
        told = self._told(reply)
        _, at_applied, at_voltage, at_temperature, at_torque, at_tick = self._places
        assert self._position is not None
        now_s, units, counts = self._transport.now_s(), self._units, self._position - setup.zero_counts
        applied = told[at_applied]
        try:
            if at_torque >= 0 and told[at_torque] != 1:
                self._check_torque()
            if self._steady_s <= now_s + STEP_S and abs(applied - units) <= _STEPS_OFF:
                self._strange = 0
            else:
                self._check_duty(applied)
            voltage, temperature = told[at_voltage], told[at_temperature]
            if temperature < setup.hot_degC and self._weak_V <= voltage * self._voltage_scale <= self._strong_V:
                self._bad = 0
            else:
                self._check_health(voltage, temperature)
            if at_tick >= 0:
                tick = told[at_tick]
                passed_s, took_s = STEP_S * ((tick - self._tick) % WRAPS), reply.executed_s - self._tick_s
                self._tick, self._tick_s = tick, reply.executed_s
                if abs(passed_s - took_s) > _TICK_SLACK_S:  # its clock begins anew where it restarts
                    words = f"its clock went on by {passed_s:.3f} s, the host's by {took_s:.3f} s: it has restarted"
                    raise Fault("DEVICE_RESET", words)
        except Fault as fault:
            if fault.code.startswith("LINK_"):
                raise
            raise Fault(fault.code, f"{fault.detail}; at {counts:g} counts") from fault
        self._end_exchange()
        # as the servo reports it; where it ramps its duty, what it ramps to: the ramp is in ``t_u_s``
        duty = applied if self._strange or self._slope_units_s == math.inf else units
        if (u_V := self._volts.get(duty)) is None:
            assert self._map.applied is not None
            acting = self._checked(self._map.applied, self._map.drive_units, duty)
            u_V = self._volts[duty] = self.drive_map.to_volts(acting)
        self._seq = (self._seq + 1) & 0xFFFF
        y_rad = self.calibration.to_rad(counts)
        return _new(Sample, (self._sampled_s, y_rad, counts, math.nan, self._t_u_s, u_V, self._seq))

    @override
    def safe_stop(self) -> bool:
        """Duty 0 until the shaft rests, or torque off at once; True once duty 0 and torque off are confirmed.

        Where another process has opened the servo, torque off alone, at once: its keeper may have put all else back.
        """
        if self._only_stops:
            with turn_on(self.descriptor, _TURN_S):
                return super().safe_stop() and self._torque_off()
        if self._keeper_acted:
            self.end_words = stopped_by_keeper().detail  # whatever else ends the run: a guard, or Ctrl-C
            # its answers would be taken for ours; the turn is let go at once: if this process stood still, and had it,
            # the keeper would wait
            with turn_on(self.descriptor, _BURST_S):
                pass
        stopped = super().safe_stop() or (self._met and self._cut_off())
        if self._guardian is not None and stopped:
            self._guardian.rest()  # the duty is 0
        self._is_off = stopped and self._torque_off()
        return self._is_off

    @override
    def close(self) -> None:
        """Stop if armed, put the registers back, and close the port. May be called twice."""
        if self._armed:
            self.safe_stop()
        restored = not self._is_changed
        if self._is_changed:
            try:
                put_back(self._link, self._store)
                restored = True
            except Fault:
                restored = False  # the file keeps the values: the keeper, or who opens it next, does it
            self._is_changed = False
        if self._guardian is not None:
            guardian, self._guardian = self._guardian, None
            guardian.end(restored=restored)
        if not restored and self._store.is_kept:
            words = (
                "the servo's registers are not as before: the next run puts them back, or `rig servo restore PORT ID`"
            )
            self.end_words = f"{self.end_words}; {words}" if self.end_words else words
        self._transport.close()

    @property
    @override
    def times_shift_s(self) -> float:
        """0 where the servo's clock tells them."""
        return super().times_shift_s if self._reckons else 0.0

    @property
    def link_words(self) -> Mapping[str, str]:
        """Echo and return delay, by topic, in words; once it is open."""
        delay_s = self._found_delay_s
        echo = "nothing of what rig sends comes back"
        if self._bus.echoes:
            echo = "the adapter ties TX to RX: what rig sends comes back, and rig compares it"
        waits = f"the servo waits {1e6 * delay_s:g} us before it answers, twice in a tick"
        if self.waits_s != delay_s:
            delay = self._setup.model.role("return_delay")
            waits += f"; too long here: each run sets 0 and puts it back, two writes of the EEPROM for {delay}"
        return {"echo": echo, "return delay": waits}

    @property
    def waits_s(self) -> float:
        """For how long the servo waits before each answer, s; once it is open."""
        return self._found_delay_s if self._found_delay_s <= self._setup.longest_delay_s else 0.0

    @property
    def _found_delay_s(self) -> float:
        delay = self._setup.model.role("return_delay")
        return delay.scale * (self._store.load(self._setup.model) or {})[delay.name]

    # ------------------------------------------------------------------ opening and arming

    def _until_there(self) -> None:
        """Read the model's number until the servo answers, or ``timeouts.open_s`` is over; raises the last fault."""
        until_s = self._transport.now_s() + self._open_timeout_s
        while True:
            try:
                self._link.value(self._setup.model.roles["model_number"])
                return
            except Fault as fault:
                if fault.code != "LINK_TIMEOUT" or self._transport.now_s() >= until_s:
                    raise

    def _have_it_watched(self) -> None:
        self._met = self._is_changed = True  # from here on it is ours to stop, and to put back
        if self._start_guardian is not None:
            self._guardian = self._start_guardian(self._link, self._store)

    @override
    def _set(self, register: Register, words: list[int]) -> None:
        """Written only where it holds another value: EEPROM wears out. A watchdog is set from 0."""
        if self._stored(register) == words:
            return
        if register.name == "watchdog":
            super()._set(register, register.pack(0))
        super()._set(register, words)

    def _find_steps(self) -> None:
        """Readings at other places within the servo's step each."""
        self._steps, self._waits_s = Steps(), math.inf
        if self._reckons:
            return
        began_s, apart_s = self._transport.now_s(), STEP_S * (2.0 + 1.0 / _STAGGERED)
        for number in range(_STAGGERED + 1):
            self._client.wait(began_s + number * apart_s - self._transport.now_s())
            reply = self._client.patiently(self._sampling, self._timeout_s)  # its watchdog does not wait longer
            applied = self._values(self._read_span, reply)["applied"]
            if abs(applied) > _STEPS_OFF:
                raise Fault("SECOND_MASTER", f"{self._map.applied} reads {applied:g}, and rig has written 0 alone")

    @override
    def _disarm(self) -> None:
        self._client.patiently(self._off, self._unhurried_s)

    @override
    def _switch_on(self) -> None:
        set_to_0(self._link)
        self._driven_s = self._transport.now_s()
        self._check_settings()  # its watchdog, too, is forgotten with the supply
        switch_on(self._link)

    @override
    def _await_armed(self) -> None:
        control = self._map.control
        assert control is not None
        held = control.unpack(self._stored(control))
        if self._bus.alerts(bytes((self._errors,))):  # why it takes no torque
            self._raise_alert(self._errors)
        if held != self._map.arm:
            raise Fault("ARM_READBACK", f"{control}: sent {self._map.arm}, stored {held:g}")

    # ------------------------------------------------------------------ stopping

    @property
    def _off(self) -> Ask:
        """Torque off."""
        assert self._map.control is not None
        return self._setting(self._map.control, self._map.stop)

    @override
    def _write_stop(self, asked: Callable[[Ask, float], Reply], timeout_s: float) -> None:
        """Duty 0; where the servo takes none, as after its watchdog has acted, torque off first.

        In another mode, as after its supply has failed, torque off alone: there the write of a duty may switch it on.
        """
        if self._only_stops or self._has_forgotten(asked, timeout_s):
            asked(self._off, timeout_s)
            return
        try:
            asked(self._setting(self._map.drive, 0.0), timeout_s)
        except Fault as fault:
            if fault.code != self._refusal:
                raise
            self._write_torque_off(asked, timeout_s)
        if not self._setup.brakes:
            self._write_torque_off(asked, timeout_s)
        self._units = 0

    def _has_forgotten(self, asked: Callable[[Ask, float], Reply], timeout_s: float) -> bool:
        """Whether it has lost its mode with its supply, as one with a lock does."""
        model = self._setup.model
        if "lock" not in model.roles:
            return False
        mode = bus_register(model, model.roles["mode"])
        return mode.unpack(self._cells(asked(self._reading(RegisterSpan((mode,))), timeout_s))) != model.pwm_mode

    def _write_torque_off(self, asked: Callable[[Ask, float], Reply], timeout_s: float) -> None:
        watchdog = servo_map(self._setup.model).watchdog
        asked(self._off, timeout_s)
        if watchdog is not None:  # one that has acted holds a duty, and takes none
            self._written = [one for one in self._written if one[0].name != "watchdog"]  # also where no answer comes
            asked(self._setting(watchdog, 0.0), timeout_s)
            asked(self._setting(self._map.drive, 0.0), timeout_s)

    def _cut_off(self) -> bool:
        """Torque off at once, where no duty 0 was confirmed: in another mode it says nothing to a servo."""

        def cut(_: int) -> bool | None:
            self._write_torque_off(self._client.asked, self._timeout_s)
            until_s = self._transport.now_s() + _CUTS_S
            return self._is_stopped(until_s, until_s) or None

        return self._tried(cut)

    def _torque_off(self) -> bool:
        """Wait until the shaft rests, torque off; True once that is read back. One lost reply is none."""
        control = self._map.control
        assert control is not None

        def off(_: int) -> bool:
            if self._setup.brakes and not self._only_stops:
                self._await_rest()
            self._client.asked(self._off, self._timeout_s)
            return control.unpack(self._stored(control)) == self._map.stop

        return self._tried(off)

    def _await_rest(self) -> None:
        """Until the shaft has stood for a while, or for as long as any shaft takes."""
        until_s = self._transport.now_s() + _COASTS_S
        stood_s, stood = self._transport.now_s(), math.nan
        while (now_s := self._transport.now_s()) < until_s:
            values = self._values(self._read_span, self._client.asked(self._sampling, self._timeout_s))
            if values["applied"] != 0.0:  # it would be waited for while somebody else drives it
                words = (
                    f"{self._map.applied} read {values['applied']:g} behind the stop: does another program drive it?"
                )
                self.end_words = self.end_words or words
                return
            if not abs(values["position"] - stood) <= _REST_COUNTS:
                stood_s, stood = now_s, values["position"]
            elif now_s - stood_s >= _REST_S:
                return
            self._client.wait(_LOOK_S)

    @override
    def _settle(self) -> None:
        if not self._client.is_suspect:
            return
        is_drive_safe = not self._only_stops and "lock" not in self._setup.model.roles  # else it may have lost its mode
        stop = self._setting(self._map.drive, 0.0) if is_drive_safe else self._off
        self._client.unheard(stop, LATE_TIMEOUTS * self._timeout_s)

    # ------------------------------------------------------------------ what the values mean

    def _told(self, reply: Reply) -> Sequence[int]:
        """What a reading holds, in the order of addresses; ``_position`` and ``_sampled_s`` are its from now on.

        The position goes on over turns, the first one is within half a turn of zero. Raises Fault SENSOR_JUMP.
        """
        self._errors = reply.pdu[0]
        try:
            told = self._numbers(reply.pdu[1:])
        except ValueError as error:
            raise self._client.misfit(str(error)) from error
        position, turn, last = told[self._places.position], self._turn, self._position
        if last is None:
            self._position = position - turn * math.floor((position - self._setup.zero_counts) / turn + 0.5)
        else:
            step = (position - last + turn // 2) % turn - turn // 2
            if 2 * abs(step) >= turn // 2 and self._armed:
                from_zero = last - self._setup.zero_counts
                words = f"from {from_zero} to {from_zero + step} counts in one tick: {step / turn:+.2f} turns"
                raise Fault("SENSOR_JUMP", words)
            self._position = last + step
        tick = self._places.tick
        self._sampled_s = self._step_of(told[tick], reply) if tick >= 0 else reply.executed_s - 0.5 * STEP_S
        return told

    @override
    def _values(self, span: RegisterSpan, reply: Reply) -> dict[str, float]:
        values: dict[str, float] = dict(zip(span.names, self._told(reply), strict=True))
        assert self._position is not None
        values["position"] = self._position
        return values

    def _step_of(self, tick: int, reply: Reply) -> float:
        """When the servo's step was that a reading tells, s."""
        # every reply waits on its way back as long as the quickest; what one takes beyond that may be before, too
        waits_s = reply.latest_s - reply.executed_s
        if waits_s < self._waits_s:
            self._waits_s = waits_s
        earliest_s = reply.executed_s - (reply.at_most_s - reply.round_trip_s)  # it left as soon as it could
        return self._steps.take(tick, earliest_s, reply.latest_s - self._waits_s)

    @override
    def _tick_writing(self, units: int) -> None:
        self._before_s = self._t_u_s
        if self._guardian is not None:
            beat(self._guardian)
        try:
            reply = self._exchange(self._drives.get(units) or self._writing_drive(units))
            if reply.pdu[0] or self._doubted:
                self._check_alert(reply)
        except Fault as fault:
            raise self._why_refused(fault) from fault
        self._driven_s = reply.executed_s
        steps = self._steps
        begins_s = steps.next_s(self._driven_s) if steps.is_known else self._driven_s + 0.5 * STEP_S
        # until then the drive of before is ramped on
        before = self._units if begins_s >= self._steady_s else self._ways[-1].at(begins_s)
        self._take(_new(_Way, (begins_s, before, units, self._slope_units_s)))
        if steps.is_known and reply.latest_s - reply.executed_s - self._waits_s > self._late_s:
            self._look_when_it_began()

    def _take(self, way: _Way) -> None:
        """The last drive: when it acts, and until when it is ramped."""
        self._ways.append(way)
        # a ramp gives what a step in its middle gives
        way_s = abs(way.end - way.start) / self._slope_units_s
        acts_s = way.begins_s + 0.5 * way_s
        # of a ramp that was ended early its drive never acted: it ends where it began
        self._t_u_s = self._before_s if self._before_s > acts_s else acts_s  # the first one is nan
        self._steady_s = way.begins_s + way_s

    def _look_when_it_began(self) -> None:
        """Read the duty behind a drive whose answer was late: the way on which it is tells the step that began it.

        Where it is over, nothing comes, or there is no time left to lose an answer, all that took long is taken for the
        answer's way back. What is read is no tick's: if it comes later still, it is not taken for the next reading.
        A drive that hardly changes has no way to look at: a further exchange would make the next tick late.
        """
        way = self._ways[-1]
        if abs(way.end - way.start) <= _STEPS_OFF or self._steady_s <= way.begins_s:
            return
        if self._waits.left_s(self._transport.now_s()) < LATE_TIMEOUTS * self._timeout_s:
            return
        if self._guardian is not None:
            self._guardian.waits()
        try:
            reply = self._client.asked(self._reading(self._glance), self._timeout_s, in_tick=True)
            values = self._glance.values(self._cells(reply))
        except Fault as fault:
            if fault.code not in ("LINK_TIMEOUT", "LINK_REPLY"):
                raise
            self._client.wait(self._timeout_s)
            self._replied_s = self._transport.now_s()
            return
        self._replied_s = reply.latest_s
        at_s = self._step_of(round(values["tick"]), reply) + STEP_S  # it may be one step ahead
        applied = values["applied"]
        if abs(applied - way.end) <= _STEPS_OFF:
            return
        self._ways.pop()
        steps = range(math.ceil(max(at_s - way.begins_s, 0.0) / STEP_S) + 1)
        starts = [(start_s, self._ways[-1].at(start_s)) for start_s in (way.begins_s + k * STEP_S for k in steps)]
        ways = [way._replace(begins_s=begins_s, start=start) for begins_s, start in starts]
        self._take(min(ways, key=lambda one: abs(one.at(at_s) - applied)))

    def _may_act(self) -> tuple[float, float]:
        """Least and largest duty that a reading of now may tell, steps: by each drive of the last milliseconds."""
        now_s = self._transport.now_s()
        since_s = min(now_s - _STAMPED_S, self._sampled_s - STEP_S)
        end_s = now_s + STEP_S  # a servo may be a step ahead on its ramp
        duties = []
        for way in reversed(self._ways):
            duties += [way.at(max(way.begins_s, since_s)), way.at(end_s)]
            end_s = way.begins_s
            if end_s <= since_s:
                break
        return min(duties), max(duties)

    @override
    def _check_pause(self, values: Mapping[str, float]) -> None:
        """Whether it still has no error, and nobody has switched its torque on."""
        if self._bus.alerts(bytes((self._errors,))):
            self._raise_alert(self._errors)
        control = self._map.control
        assert control is not None
        if control.unpack(self._stored(control)) != self._map.stop:
            words = f"{control} is on, although rig switched it off"
            raise Fault("SECOND_MASTER" if self._is_off else "STOP_UNCONFIRMED", words)
        self._check_health(values["voltage"], values["temperature"])

    @property
    def _asking(self) -> ServoLink:
        """Registers that tell what a reading means: within a tick no longer than that may wait, while a drive acts."""
        return self._link.asking(lambda ask, _: self._exchange(ask)) if self._armed else self._link

    def _check_torque(self) -> None:
        """A servo whose torque is off has restarted. One with a lock has lost its mode, too: no duty may follow."""
        if self._asking.value(self._setup.model.roles["torque"]) != 0:
            return  # that reading was damaged
        if self._keeper_acted:
            raise stopped_by_keeper()
        raise Fault("DEVICE_RESET", f"{self._map.control} reads 0: its torque is off")

    def _check_duty(self, applied: float) -> None:
        """A servo that drives otherwise than it was told has restarted, protects itself, or has another master."""
        low, high = self._may_act()
        is_strange = not low - _STEPS_OFF <= applied <= high + _STEPS_OFF
        self._strange = self._strange + 1 if is_strange else 0
        if not is_strange:
            return
        if self._keeper_acted:
            raise stopped_by_keeper()
        words = f"{self._map.applied} reads {applied:g}, but {self._units} was written"
        if self._watchdog_has_acted():
            raise Fault("DEVICE_WATCHDOG", words)
        if self._strange < _IN_A_ROW:
            return
        if self._asking.value(self._setup.model.roles["torque"]) == 0:
            raise Fault("DEVICE_RESET", f"{words}: its torque is off")
        if (other := other_mode(self._asking)) is not None:
            raise Fault("DEVICE_RESET", f"{words}: {other}")
        raise Fault("SERVO_OVERLOAD", f"{words}: it protects itself, or somebody else drives it")

    def _check_health(self, voltage: float, temperature: float) -> None:
        setup, supply_V = self._setup, voltage * self._voltage_scale
        hot, is_fed = temperature >= setup.hot_degC, self._weak_V <= supply_V <= self._strong_V
        self._bad = self._bad + 1 if hot or not is_fed else 0
        if self._bad < _IN_A_ROW:
            return
        if hot:
            raise Fault("SERVO_HOT", f"{temperature:g} degC, daq.servo.hot_degC is {setup.hot_degC}")
        raise Fault("SERVO_SUPPLY", f"{supply_V:.1f} V, of {setup.supply_V:g} V")

    def _raise_alert(self, said: int) -> None:
        """Raise the fault that the servo's error register names, or LINK_*.

        Where the register holds none, the byte of the answer may be damaged: one check sum in 256 lets it pass. A
        second in a row is believed.

        said  that byte
        """
        model = self._setup.model
        errors = self._asking.value(model.roles["errors"])
        self._errors = errors
        self._doubted += 1
        if not errors and self._doubted < _IN_A_ROW:
            return
        raise self._fault_of((errors or said) if model.protocol == "feetech" else errors)

    def _fault_of(self, errors: int) -> Fault:
        """The fault of these bits of the error register."""
        model = self._setup.model
        words = f"{model.role('errors')} reads {errors}: {error_words(model, errors)}"
        for bit, code in _ERROR_FAULTS[model.protocol]:
            if errors & bit:
                return Fault(code, words)
        return Fault("SERVO_ERROR", words)

    def _why_refused(self, fault: Fault) -> Fault:
        """A goal that the servo refuses: its watchdog has acted, or it has restarted in another mode."""
        if fault.code != self._refusal:
            return fault
        if self._watchdog_has_acted():
            return Fault("DEVICE_WATCHDOG", fault.detail)
        other = other_mode(self._asking)
        return fault if other is None else Fault("DEVICE_RESET", f"{fault.detail}; {other}")

    def _watchdog_has_acted(self) -> bool:
        name = self._setup.model.roles.get("watchdog")
        return name is not None and self._asking.value(name) == -1
