"""A device behind a serial port: frames, arming, and device time mapped to the host's.

``SerialDriver`` takes its port, and with it its clock, as a ``Transport``: ``links.serial_port`` for a board or an
emulated device behind a pseudo-terminal, or a virtual board in virtual time.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import NamedTuple

from rig.backends.driver import (
    DeviceInfo,
    DeviceWatchdog,
    RelayCommand,
    RelayRow,
    Stopped,
    StrokesCommand,
    StrokeTimes,
    Timeouts,
    Transport,
)
from rig.backends.serial import frames
from rig.backends.serial.device_clock import DeviceClock, TimedExchange, fit_device_clock
from rig.backends.serial.exchange import ATTEMPTS, Exchange
from rig.backends.serial.firmware_laws import FirmwareLawRules, FirmwareRelay, FirmwareStrokes
from rig.backends.serial.fit import PLAIN_BOARD, Board, Expected, check_fit, measured_supply_V, other_version
from rig.backends.serial.frames import Code, DeviceState, Hello, Kind, Packet, RelaySetup, Setup, StrokesSetup
from rig.backends.serial.introduction import refusal
from rig.backends.serial.law_run import LawRun
from rig.backends.tick_waits import REACTS_TICKS, TickWaits
from rig.core.calibration import (
    ALL_COUNTS,
    Calibration,
    DriveMap,
    Scaling,
    hard_limits_in_counts,
    largest_drive_in_units,
    polarity,
)
from rig.core.faults import Fault
from rig.core.signals import Limits, Order, Sample

_PATIENCE = Timeouts()
LONGEST_WATCHDOG_S = 1.0  # that the device accepts
_SYNCHRONISE_S = 1.0
_SLOW_SYNCHRONISE_S = 3.0  # where exchanges are few, or differ
_FEW_EXCHANGES = 100
_STEADY_S = 0.0005  # from the fastest exchange to the median; USB frames make it longer
_SHORTEST_PAUSE_S = 0.001  # between two of the exchanges that measure the clock
_LONGEST_PAUSE_S = 0.020  # meets every phase of an FTDI's 16 ms timer
_GOLDEN = 0.618034  # its multiples, modulo 1, spread evenly over 0 to 1
_ASK_AGAIN = 2 / 3  # of the time-out, after which a tick asks for the state again; from then on once in a time-out
_READS_AT_ONCE = 3  # a damaged frame lets a tick ask again at once, at most so often
_READ_AGAIN = 3  # repeated readings in a row: the link is not fit for the period
_LONGEST_PULSE_MS = 0xFFFF
_LOST_DRIVES = 3  # in a row: the drive that acts is no longer the host's

# Share of the wire time of a HELLO exchange that passes before the device reads its clock.
_REQUEST_SHARE = len(frames.encode(Kind.HELLO, 1)) / (
    len(frames.encode(Kind.HELLO, 1))
    + len(frames.encode(Kind.HELLO_REPLY, 1, bytes(frames.BODY_LENGTH[Kind.HELLO_REPLY])))
)

_FAULT_OF_CODE: dict[int, str] = {
    Code.VERSION: "LINK_VERSION",
    Code.NOT_ARMED: "DEVICE_NOT_ARMED",
    Code.WATCHDOG: "DEVICE_WATCHDOG",
    Code.TRAVEL: "DEVICE_TRAVEL",
    Code.SENSOR_RAIL: "DEVICE_SENSOR",
    Code.DRIVE_RANGE: "DEVICE_DRIVE_RANGE",
    Code.POLARITY: "POLARITY",
    Code.E_STOP: "DEVICE_ESTOP",
    Code.END_SWITCH: "DEVICE_END_SWITCH",
    Code.NO_SETUP: "DEVICE_RESET",
    Code.RESET: "DEVICE_RESET",
    Code.SESSION: "DEVICE_RESET",
    Code.ENCODER_LOST: "DEVICE_ENCODER_LOST",
    Code.ENCODER_RATE: "DEVICE_ENCODER_RATE",
    Code.ENCODER_STILL: "DEVICE_ENCODER_STILL",
    Code.NO_ZERO: "DEVICE_NO_ZERO",
    Code.E_STOP_UNTRIED: "DEVICE_ESTOP_UNTRIED",
}
_MOST_LATCHED = 16  # faults that a device can have latched
_RESET_BEFORE_S = 0.25  # opening a port takes less: a device that started since then was reset by it


def setup_for(
    limits: Limits, calibration: Calibration, drive_map: DriveMap, rail_counts: tuple[int, int], session: int
) -> Setup:
    """The limits as the device takes them, before arming.

    session  number of this session, 1 to 2**32 - 1
    Raises ValueError for limits that the device cannot hold: as ``hard_limits_in_counts`` and
    ``largest_drive_in_units``, and for a watchdog time outside 1 ms to 1 s.
    """
    hard_lo, hard_hi = hard_limits_in_counts(limits, calibration, drive_map, rail_counts)
    rail_lo, rail_hi = (0, 0) if rail_counts == ALL_COUNTS else rail_counts
    max_drive = largest_drive_in_units(limits, drive_map)
    watchdog_ms = round(1000.0 * limits.watchdog_s)
    if not 1 <= watchdog_ms <= round(1000.0 * LONGEST_WATCHDOG_S):
        raise ValueError(f"watchdog time {limits.watchdog_s:g} s is not within 0.001 to {LONGEST_WATCHDOG_S:g} s")
    return Setup(
        session=session,
        hard_lo=hard_lo,
        hard_hi=hard_hi,
        rail_lo=rail_lo,
        rail_hi=rail_hi,
        centre=round(calibration.to_counts(0.0)),
        max_drive=max_drive,
        watchdog_ms=watchdog_ms,
        polarity=polarity(calibration, drive_map),
    )


class _Pulse(NamedTuple):
    """A drive that the device ends by itself: when it was sent, s, and how long after the first one, s."""

    u_V: float
    sent_s: float
    longest_s: float
    is_first: bool


class _Ended(NamedTuple):
    """A pulse that the device has ended by itself: its drive, V, and when it ended, s of the host."""

    u_V: float
    t_s: float


@dataclass(frozen=True)
class ByHand:
    """What a hand has done to the shaft of an encoder before the device is opened.

    here_rad     position at which the shaft stands
    tried_estop  of an emulated bench: the e-stop, since the device's start
    """

    here_rad: float
    tried_estop: bool = False


class SerialDriver:
    """The firmware behind a transport, as a ``Driver``. Times of samples are in the transport's clock, s.

    transport  an open port; closed by ``close``, never reopened
    scaling    what the device's numbers mean; the drive map's ``full_units`` are replaced by what the device says
    timeouts   how long to wait
    board      the board as the config describes it
    session    number of this session, 1 to 2**32 - 1; None: a random one
    name       of the port, for ``backend``
    emulated   True where it is known that no real motor is behind the port
    by_hand    what is known of an encoder's shaft when the device is opened. None: what ``set_zero`` has told the
               device since its reset, else ``arm`` raises Fault DEVICE_NO_ZERO
    """

    order: Order = "sample_first"
    latches_stops = True

    def __init__(
        self,
        transport: Transport,
        scaling: Scaling,
        timeouts: Timeouts = _PATIENCE,
        *,
        board: Board = PLAIN_BOARD,
        session: int | None = None,
        name: str = "serial",
        emulated: bool = False,
        by_hand: ByHand | None = None,
    ) -> None:
        self.calibration = scaling.calibration
        self.drive_map = scaling.drive_map
        self.tachometer = scaling.tachometer
        self.backend = name
        self.failsafe: DeviceWatchdog | None = DeviceWatchdog(LONGEST_WATCHDOG_S)  # until armed with less
        self._exchange = Exchange(transport, timeouts.reply_s)
        self._made_s = transport.now_s()  # just after the port was opened
        self._expected = Expected(board, scaling, emulated)
        self._timeout_s = timeouts.reply_s
        self._open_timeout_s = timeouts.open_s
        self._name = name
        self._by_hand = by_hand
        self.homing = False
        self.pulses = False
        self.stopped: Stopped | None = None
        self._clock = DeviceClock(0.0, 0, 1.0)
        self._session = secrets.randbelow(2**32 - 1) + 1 if session is None else session
        self._setup: Setup | None = None  # that the device has confirmed
        self._armed = False
        self._heard_s = -math.inf  # when the device was last told a drive, at the latest
        self._asked_s = math.inf  # when it was last asked for a reading
        self._waits = TickWaits(REACTS_TICKS, timeouts.period_s)
        self._unconfirmed: int | None = None  # seq of a DRIVE frame that no STATE has told of yet
        self._driven = False  # the device has accepted a DRIVE since arming
        self._t_drive_us = -1  # as last reported, and the same in host time: an old drive is mapped once
        self._t_u_s = math.nan
        self._pulse: _Pulse | None = None  # sent last, if no other drive was
        self._ended: _Ended | None = None  # and that the device has ended it is not reported yet
        self._asked_again = 0
        self._again_in_a_row = 0
        self._drives_lost = 0
        self._lost_in_a_row = 0
        self._law: LawRun | None = None  # while it runs

    @property
    def descriptor(self) -> int | None:
        """Number of the open port, as of ``Driver``; None in virtual time."""
        return getattr(self._exchange.transport, "descriptor", None)

    @property
    def link_statistics(self) -> Mapping[str, int]:
        """Counts since construction, by name.

        exchanges: requests whose reply the driver waited for; timeouts: those without a reply in time;
        asked_again: readings asked for more than once, because a reply was damaged or did not come;
        stale_replies: intact replies that are not the awaited one (late, repeated, of another request);
        bad_frames: damaged frames from the device; drives_lost: DRIVE frames that the device never accepted.
        """
        return {
            "exchanges": self._exchange.exchanges,
            "timeouts": self._exchange.timeouts,
            "asked_again": self._asked_again,
            "stale_replies": self._exchange.stale_replies,
            "bad_frames": self._exchange.reader.bad_frames,
            "drives_lost": self._drives_lost,
        }

    def open(self) -> DeviceInfo:
        """Wait for the device to introduce itself, clear the faults it has latched, and measure its clock for 1 to 3 s.

        Two faults stay latched, and ``arm`` raises them: one whose cause lasts, and one that came during ``open``.
        Raises Fault LINK_HELLO, LINK_VERSION, LINK_TIMEOUT, DEVICE_RESET or LINK_LOST; CONFIG_MISMATCH where the config
        does not fit the device (converter range, rails, tachometer, bridge).
        """
        hello = self._meet()
        check_fit(hello, self._expected)
        self.pulses = bool(hello.features & frames.FEATURE_PULSE)
        acknowledged = self._acknowledge(hello)
        if self._by_hand is not None and self._expected.scaling.is_encoder:
            self.set_zero(self._by_hand.here_rad)
        self.drive_map = replace(self.drive_map, full_units=hello.drive_full)
        exchanges = self._time_exchanges()
        try:
            self._clock = fit_device_clock(exchanges, _REQUEST_SHARE)
        except ValueError as error:
            raise Fault("DEVICE_RESET", f"while its clock was measured: {error}") from error
        supply_V, supply_at_least = self._measured_supply_V(hello)
        version = other_version(hello, self._expected.board)
        remarks = [] if version is None else [version]
        if (
            self._by_hand is None
            and self._expected.scaling.is_encoder
            and not self._exchange.state().status & frames.STATUS_ZERO
        ):
            remarks.append("the device does not know where its encoder stands: it arms after `rig home CONFIG`")
        told_board = frames.BOARDS.get(hello.board, f"number {hello.board}")
        emulated = self._expected.emulated or hello.board in frames.EMULATED_BOARDS
        self.backend = f"{self._name} ({'emulated ' if emulated else ''}{told_board} board, build {hello.build_text})"
        return DeviceInfo(
            build=hello.build_text,
            board=told_board,
            reset_cause=hello.reset_words,
            emulated=emulated,
            clock_ratio=self._clock.ratio,
            round_trip_s=min(e.received_s - e.sent_s for e in exchanges),
            supply_V=supply_V,
            supply_at_least=supply_at_least,
            drive_units=hello.drive_full,
            acknowledged=acknowledged,
            remarks=tuple(remarks),
        )

    def forget_zero(self) -> None:
        """Forget the zero of a disarmed device with an encoder: nothing but a homing arms it until ``set_zero``.

        The set-up of a homing does that. This one nobody arms with. Raises Fault LINK_TIMEOUT, or the
        refusal of the device; LINK_VERSION where its firmware keeps the zero.
        """
        self._setup = None
        self._store(Setup(self._session, -1, 1, 0, 0, 0, max_drive=1, watchdog_ms=1, polarity=1, homing=1))
        if self._exchange.state().status & frames.STATUS_ZERO:
            flashing = self._expected.board.flashing
            raise Fault("LINK_VERSION", f"this firmware keeps an old zero where a homing fails; {flashing}")

    def set_zero(self, here_rad: float) -> None:
        """Tell a disarmed device with an encoder that its shaft stands at ``here_rad``, until its next reset.

        Raises Fault LINK_TIMEOUT, the refusal of the device, or the fault of the encoder that it has latched.
        """
        counts = round(self.calibration.to_counts(here_rad))
        try:
            packet = self._exchange.request(Kind.ZERO, frames.pack_zero(counts), Kind.ZERO_REPLY)
        except Fault as fault:
            if fault.code == "LINK_REJECTED":
                self._check_latched()
            raise
        state = DeviceState.unpack(packet.body)
        if not state.status & frames.STATUS_ZERO:
            raise self._device_fault(state)

    def leave_switch(self) -> None:
        """Acknowledge the end switch that a homing has reached. Raises the fault that is latched besides."""
        if not self._exchange.is_cleared(Code.END_SWITCH):
            raise Fault("DEVICE_END_SWITCH", "both end switches are open")
        self._check_latched()

    def arm(self, limits: Limits) -> None:
        """Stop, send the limits if the device does not have them yet, read them back, arm.

        It refuses if the device has latched a fault since it was opened, or has lost this session: it was reset.
        Raises ValueError as ``setup_for``; Fault ARM_READBACK, LINK_TIMEOUT, or the refusal of the device.
        """
        setup = setup_for(limits, self.calibration, self.drive_map, self._expected.scaling.rail_counts, self._session)
        setup = setup._replace(homing=int(self.homing))
        self._armed = False
        state = self._exchange.state(Kind.STOP, Kind.STOP_REPLY)
        self._check_pause(state)
        if setup != self._setup:
            self._store(setup)
            self._setup = setup
        self._asked_s = math.inf
        self._heard_s = self._exchange.now_s()
        code = self._exchange.arm(self._session)
        if code != Code.NONE:
            raise Fault(_FAULT_OF_CODE.get(code, "LINK_REJECTED"), f"arming refused, {frames.code_name(code)}")
        self.failsafe = DeviceWatchdog(1e-3 * setup.watchdog_ms)
        self._waits.restart(self._timeout_s + self.failsafe.time_s, self._heard_s)
        self._unconfirmed = None
        self._pulse = self._ended = None
        self._lost_in_a_row = 0
        self._again_in_a_row = 0
        self._driven = False
        self._law = None
        self._exchange.blocks()  # of an earlier run
        self._armed = True

    def _store(self, setup: Setup) -> None:
        stored = Setup.unpack(self._exchange.request(Kind.SETUP, setup.pack(), Kind.SETUP_REPLY).body)
        if stored != setup:
            raise Fault("ARM_READBACK", f"sent {_fields(setup, stored)}, stored {_fields(stored, setup)}")

    def read(self) -> Sample:
        """Ask for the state and wait for it; ask again if a reply is damaged or missing, within one time-out.

        ``u_V`` is the drive that the device reports at its pin, even if the last ``write`` was lost on the way
        (``link_statistics`` counts that). It also reads before arming.
        Raises Fault LINK_TIMEOUT, LINK_LOST, DEVICE_RESET, the refusal of the device, or the fault that it latched.
        """
        packet = self._ask_state()
        if packet.kind == Kind.NACK:
            raise refusal(packet)
        state = DeviceState.unpack(packet.body)
        if self._armed:
            if (
                state.status & frames.STATUS_FAULT
                or not state.status & frames.STATUS_ARMED
                or state.session != self._session
            ):
                raise self._device_fault(state)
        elif self._unconfirmed is not None and state.fault:
            raise self._device_fault(state)
        elif self._setup is not None and not self.homing:
            self._check_pause(state)

        if self._unconfirmed is not None:
            if state.drive_seq == self._unconfirmed:
                self._driven = True
                self._lost_in_a_row = 0
            else:
                self._drives_lost += 1
                self._lost_in_a_row += 1
                if self._lost_in_a_row >= _LOST_DRIVES:
                    # this reading goes into no row, so the fault names it
                    raise Fault(
                        "LINK_TIMEOUT", f"{self._lost_in_a_row} drives in a row were not accepted; {self._where(state)}"
                    )
            self._unconfirmed = None
        now_s = self._exchange.now_s()
        u_V = self.drive_map.to_volts(state.drive)
        if self._driven and state.t_drive_us != self._t_drive_us:
            self._t_drive_us = state.t_drive_us
            self._note_drive(self._clock.to_host_s(state.t_drive_us, now_s), u_V)
        tachometer = self.tachometer
        return Sample(
            self._clock.to_host_s(state.t_sample_us, now_s),
            self.calibration.to_rad(state.counts),
            state.counts,
            math.nan
            if tachometer is None or state.tach == frames.NO_TACHOMETER
            else tachometer.to_rad_per_s(state.tach),
            self._t_u_s if self._driven else math.nan,
            u_V if self._ended is None else self._ended.u_V,
            packet.seq,
        )

    def _note_drive(self, t_u_s: float, u_V: float) -> None:
        """Take a new time of effect, and the drive since then, V.

        A pulse that the device has ended is reported as it acted, until the next drive is sent: then its end is.
        """
        pulse, self._ended = self._pulse, None
        if u_V == 0.0 and pulse is not None and pulse.u_V != 0.0 and pulse.sent_s < t_u_s:
            self._t_u_s = t_u_s - pulse.longest_s if pulse.is_first else max(pulse.sent_s, self._t_u_s)
            self._ended = _Ended(pulse.u_V, t_u_s)
        else:
            self._t_u_s = t_u_s

    def _ask_state(self) -> Packet:
        """READ, until the device answers: again at once after a damaged frame, or when most of the time-out is over.

        A late answer to an earlier READ is good too, since a state carries the time of its sample. While armed this
        waits for as long as the device's watchdog lets the last drive act. Raises Fault LINK_TIMEOUT without an answer,
        and when three readings in a row had to be repeated; LATE where ticks came too late together.
        """
        begun_s = self._asked_s = self._exchange.now_s()
        self._waits.read(begun_s)
        if self._is_over(begun_s):
            raise Fault("LATE", self._waits.words)
        seqs = [self._exchange.send(Kind.READ)]
        sent_s = self._exchange.now_s()  # a host that stood still may have sent it late
        ends_s = self._ends_s(begun_s, sent_s)
        until_s = sent_s + _ASK_AGAIN * self._timeout_s
        while True:
            damage_ends = len(seqs) < _READS_AT_ONCE
            packet = self._exchange.wait(seqs, Kind.STATE, min(until_s, ends_s), damage_ends=damage_ends)
            if packet is not None:
                self._again_in_a_row = 0 if len(seqs) == 1 else self._again_in_a_row + 1
                is_over = self._is_over(self._exchange.now_s())  # also where this process stood still
                if self._again_in_a_row < _READ_AGAIN and not is_over:
                    return packet
                again = f"{_READ_AGAIN} readings in a row had to be asked for again"
                state = "refused" if packet.kind == Kind.NACK else self._where(DeviceState.unpack(packet.body))
                raise self._exchange.silence(Kind.READ, f"{self._waits.words if is_over else again}; {state}")
            now_s = self._exchange.now_s()
            if now_s >= ends_s:
                break
            self._asked_again += len(seqs) == 1  # however often
            seqs.append(self._exchange.send(Kind.READ))
            until_s = max(sent_s, now_s) + self._timeout_s
        self._exchange.timeouts += 1
        raise self._exchange.silence(Kind.READ, f"no reply to {len(seqs)} READ within {1e3 * (ends_s - sent_s):.0f} ms")

    def _is_over(self, now_s: float) -> bool:
        """Whether late ticks have taken more than is counted, while the watchdog may still let the last drive act."""
        return self._armed and now_s < self._heard_s + self._watchdog_s and self._waits.is_over(now_s)

    def _ends_s(self, begun_s: float, sent_s: float) -> float:
        """Until when a tick that began then waits for the answer to what it sent, s: the watchdog bounds the drive.

        All ticks in which a loop reacts wait together for as long as preflight counts.
        """
        if not self._armed:
            return sent_s + self._timeout_s
        acts_s = self._heard_s + self._watchdog_s - sent_s
        if acts_s <= 0.0:
            return sent_s + self._timeout_s  # nothing drives: the answer says why
        longest_s = max(self._timeout_s, acts_s)
        return min(sent_s + longest_s, max(begun_s + self._waits.left_s(begun_s), sent_s))

    @property
    def _watchdog_s(self) -> float:
        return LONGEST_WATCHDOG_S if self._setup is None else 1e-3 * self._setup.watchdog_ms

    def write(self, u_V: float) -> None:
        """Send the drive; there is no reply. Raises ValueError beyond supply and bridge, Fault LINK_LOST.

        Beyond the drive that it is armed for, the device sets 0 V and the next ``read`` raises DEVICE_DRIVE_RANGE.
        """
        self._pulse = None
        self._send_drive(Kind.DRIVE, frames.pack_drive(self.drive_map.to_units(u_V)))

    def write_pulse(self, u_V: float, longest_s: float) -> None:
        """As ``write``; the device ends the drive ``longest_s`` after the first of them, in whole ms, rounded up.

        Raises ValueError where the device has no pulses, and for a time that is not 0 to 65 s.
        """
        if not self.pulses:
            raise ValueError(f"no pulses behind {self.backend}")
        longest_ms = math.ceil(1e3 * longest_s - 1e-6)
        if not 0 <= longest_ms <= _LONGEST_PULSE_MS:
            raise ValueError(f"a pulse lasts 0 to {_LONGEST_PULSE_MS} ms, not {longest_ms}")
        units = self.drive_map.to_units(u_V)
        self._send_drive(Kind.PULSE, frames.pack_pulse(units, longest_ms))
        self._pulse = _Pulse(
            self.drive_map.to_volts(units), self._exchange.now_s(), 1e-3 * longest_ms, is_first=self._pulse is None
        )

    def _send_drive(self, kind: Kind, body: bytes) -> None:
        if self._ended is not None:
            self._t_u_s, self._ended = self._ended.t_s, None
        if self._is_over(self._exchange.now_s()):
            raise Fault("LATE", self._waits.words)
        silent_s = self._exchange.now_s() - self._asked_s
        if self._armed and silent_s > self._watchdog_s + self._timeout_s:  # not even a late frame fed it
            raise Fault("DEVICE_WATCHDOG", f"the host stood still for {1e3 * silent_s:.0f} ms")
        self._waits.drive()
        self._unconfirmed = self._exchange.send(kind, body)
        self._heard_s = self._exchange.now_s()

    def safe_stop(self) -> bool:
        """Tell the device to stop, up to three times; True once it confirms 0 drive, disarmed.

        If False (or if the host dies) the device's watchdog stops it. ``read_rows`` returns the last ticks of a law
        that ran in the device.
        """
        self._armed = False
        self._unconfirmed = None
        stopped = self._is_stopped()
        if self._law is not None:
            self._law.hear_last(self._exchange.now_s() + (self._timeout_s if stopped else 0.0))
        return stopped

    def _is_stopped(self) -> bool:
        try:
            for _ in range(ATTEMPTS):
                packet = self._exchange.answer(self._exchange.send(Kind.STOP), Kind.STOP_REPLY)
                if packet is not None and packet.kind == Kind.STOP_REPLY:
                    state = DeviceState.unpack(packet.body)
                    if state.drive == 0 and not state.status & frames.STATUS_ARMED:
                        return True
        except Fault:  # a dead port
            return False
        return False

    def close(self) -> None:
        """Close the port, after a ``safe_stop`` if still armed. May be called twice."""
        if self._armed:
            self.safe_stop()
        self._exchange.transport.close()

    # ------------------------------------------------------------------ the laws in the device

    @property
    def tick_s(self) -> float:
        """The device's tick in host time, s."""
        return self._law_rules.tick_s

    def relay_command(self, h1_V: float, h2_V: float, z_bound_rad_s: float) -> RelayCommand:
        """The command for these gains; raises as ``FirmwareLawRules.relay_command``."""
        return self._law_rules.relay_command(h1_V, h2_V, z_bound_rad_s)

    def strokes_command(
        self, strokes: Sequence[tuple[float, float]], times: StrokeTimes, motion_rad: float
    ) -> StrokesCommand:
        """The command for these strokes; raises as ``FirmwareLawRules.strokes_command``."""
        return self._law_rules.strokes_command(strokes, times, motion_rad)

    @property
    def _law_rules(self) -> FirmwareLawRules:
        return FirmwareLawRules(self.calibration, self.drive_map, self._clock.ratio)

    def start_relay(self, command: RelayCommand) -> None:
        """Let the device's relay drive from its next tick on, from 0 V. Call ``keep`` regularly from then on.

        Raises Fault ARM_READBACK, LINK_TIMEOUT, or the refusal of the device; TypeError for another driver's command.
        """
        if not isinstance(command, FirmwareRelay):
            raise TypeError("a command of another driver")
        self._start_law(command.setup)

    def start_strokes(self, command: StrokesCommand) -> None:
        """Let the device's stroke test drive; as ``start_relay``. Raises as that, TypeError included."""
        if not isinstance(command, FirmwareStrokes):
            raise TypeError("a command of another driver")
        self._start_law(command.setup)

    def _start_law(self, setup: RelaySetup | StrokesSetup) -> None:
        self._unconfirmed = None
        self._law = None
        law = LawRun(self._exchange, self.calibration, self.drive_map, self._clock, self._session)
        self._waits.restart(self._waits.longest_s, self._exchange.now_s())  # its ticks are the device's
        law.start(setup)
        self._law = law

    def keep(self) -> None:
        """Tell the device that the host lives. Without this its watchdog ends the law that runs there."""
        self._exchange.send(Kind.KEEP)

    def read_rows(self) -> list[RelayRow]:
        """The ticks of the law since the last call; does not wait. After a ``safe_stop``: its last ticks.

        If there are none, it raises Fault LINK_GAP, LINK_LOST, LINK_TIMEOUT where blocks stay away, DEVICE_RESET, or
        the fault that the device latched.
        """
        law = self._running_law()
        if not self._armed:
            self._law = None
            return law.rows()
        law.hear()
        rows = law.rows()
        if rows:
            return rows
        if law.ended is not None:
            raise self._device_fault(law.ended)
        if silent_s := law.missed_s:
            sample = self.read()  # the device may say why
            raise Fault(
                "LINK_TIMEOUT",
                f"the device runs its law, but no block came for {1e3 * silent_s:.0f} ms; {sample.y_rad:.4f} rad, "
                f"{sample.y_counts} counts",
            )
        return rows

    def stop_relay(self) -> list[RelayRow]:
        """End the device's law, relay or strokes, with 0 V, still armed. Returns its last ticks.

        If the device has latched a fault meanwhile, the next ``read`` raises it. Raises Fault LINK_GAP, LINK_LOST,
        LINK_TIMEOUT.
        """
        law = self._running_law()
        law.stop()
        self._law = None
        return law.rows()

    def row_after_stop(self) -> RelayRow | None:
        """The shaft now, and since when the 0 V of ``stop_relay`` act. Raises Fault as ``read``."""
        self._driven = True  # the law has ended: so the device has accepted the DRIVE that ended it
        sample = self.read()
        return RelayRow(sample.t_s, sample.t_u_s, sample.y_rad, sample.y_counts, sample.u_V, sample.seq)

    def _running_law(self) -> LawRun:
        if self._law is None:
            raise ValueError("no law runs in the device")
        return self._law

    # ------------------------------------------------------------------ meeting the device

    def _meet(self) -> Hello:
        try:
            return self._exchange.meet(self._open_timeout_s)
        except Fault as fault:
            if fault.code != "LINK_VERSION":
                raise
            raise Fault(fault.code, f"{fault.detail}; {self._expected.board.flashing}") from fault

    def _acknowledge(self, hello: Hello) -> tuple[str, ...]:
        """Clear the faults that the device latched before it was opened. Returns their codes, without the reset.

        Later faults stay, and ``arm`` raises them: a code that latches again, and every fault but the reset where
        opening resets the device, as it does an Uno.
        """
        known_s = self._exchange.now_s() - self._made_s + _RESET_BEFORE_S
        was_reset_now = 1e-6 * hello.now_us < known_s
        cleared: list[int] = []
        for _ in range(_MOST_LATCHED):
            state = self._exchange.state()
            code = state.fault
            if not state.status & frames.STATUS_FAULT or code in cleared or not self._exchange.is_cleared(code):
                break
            cleared.append(code)
            tried_estop = self._by_hand is not None and self._by_hand.tried_estop
            if code == Code.RESET and was_reset_now and not tried_estop:
                break
        return tuple(_FAULT_OF_CODE.get(code, "LINK_REJECTED") for code in cleared if code != Code.RESET)

    def _measured_supply_V(self, hello: Hello) -> tuple[float, bool]:
        """The motor supply as the device measures it now, not in its first millisecond, V; whether it may be higher.

        nan if the device does not measure it. A small difference ends nothing: the run reports it.
        """
        if not hello.features & frames.FEATURE_SUPPLY:
            return math.nan, False
        return measured_supply_V(self._exchange.hello(), self.drive_map.supply_V)

    def _time_exchanges(self) -> list[TimedExchange]:
        """Ask for the device's time repeatedly, for one second, or up to three over a slow link or USB.

        The reply to HELLO carries the time of that reply; a sample's time may be a device tick old. The pauses vary, up
        to the longest exchange: with equal pauses each reply would meet a USB adapter's timer at the same phase.
        """
        now_s = self._exchange.now_s
        exchanges: list[TimedExchange] = []
        longest_s = 0.0
        began_s = sent_s = now_s()
        while sent_s < began_s + _SYNCHRONISE_S or (sent_s < began_s + _SLOW_SYNCHRONISE_S and _is_vague(exchanges)):
            packet = self._exchange.answer(self._exchange.send(Kind.HELLO), Kind.HELLO_REPLY)
            received_s = now_s()
            if packet is not None and packet.kind == Kind.HELLO_REPLY:
                exchanges.append(TimedExchange(sent_s, received_s, Hello.unpack(packet.body).now_us))
                longest_s = min(max(longest_s, received_s - sent_s), _LONGEST_PAUSE_S)
            pause_s = _SHORTEST_PAUSE_S + longest_s * (_GOLDEN * len(exchanges) % 1.0)
            self._exchange.ignore(pause_s)
            sent_s = now_s()
        if len(exchanges) < 4:
            raise self._exchange.silence(Kind.HELLO)
        return exchanges

    # ------------------------------------------------------------------ what a state means

    def _where(self, state: DeviceState) -> str:
        return f"{self.calibration.to_rad(state.counts):.4f} rad, {state.counts} counts"

    def _check_latched(self) -> None:
        state = self._exchange.state()
        if state.status & frames.STATUS_FAULT:
            raise self._device_fault(state)

    def _check_pause(self, state: DeviceState) -> None:
        """Raise the fault that a disarmed device has latched since it was opened."""
        if state.status & frames.STATUS_FAULT or (self._setup is not None and state.session != self._session):
            raise self._device_fault(state)

    def _device_fault(self, state: DeviceState) -> Fault:
        """The fault in a STATE, with the numbers of this case; notes when the device stopped."""
        now_s = self._exchange.now_s()
        sample = Sample(
            self._clock.to_host_s(state.t_sample_us, now_s), self.calibration.to_rad(state.counts), state.counts
        )
        self.stopped = Stopped(self._clock.to_host_s(state.t_drive_us, now_s), sample)
        if self._setup is not None and state.session != self._session:
            return Fault("DEVICE_RESET", f"the device has lost its session; at {self._where(state)}")
        if self._armed and not state.status & frames.STATUS_FAULT:
            return Fault("DEVICE_RESET", f"no longer armed and no fault latched; at {self._where(state)}")
        detail = f"{frames.code_name(state.fault)} at {self._where(state)}"
        setup = self._setup
        if setup is not None:
            if state.fault == Code.WATCHDOG:
                detail += f", watchdog {setup.watchdog_ms} ms"
            elif state.fault == Code.TRAVEL:
                detail += f", limits {setup.hard_lo} to {setup.hard_hi} counts"
            elif state.fault == Code.SENSOR_RAIL:
                detail += f", rails {setup.rail_lo} and {setup.rail_hi} counts"
            elif state.fault == Code.DRIVE_RANGE:
                detail += f", largest drive {setup.max_drive} units"
        return Fault(_FAULT_OF_CODE.get(state.fault, "LINK_REJECTED"), detail)


def _is_vague(exchanges: Sequence[TimedExchange]) -> bool:
    """Whether the exchanges of one second are too few, or differ too much, to fit the device's clock."""
    if len(exchanges) <= _FEW_EXCHANGES:
        return True
    took_s = [exchange.received_s - exchange.sent_s for exchange in exchanges]
    return median(took_s) - min(took_s) > _STEADY_S


def _fields(setup: Setup, other: Setup) -> str:
    """The fields in which two set-ups differ, with the values of the first."""
    return ", ".join(f"{name} {a}" for name, a, b in zip(Setup._fields, setup, other, strict=True) if a != b)
