"""A device behind a serial port: frames, arming, and device time mapped to the host's.

``SerialDriver`` takes its port, and with it its clock, as a ``Transport``: ``links.serial_port`` for a board or an
emulated device behind a pseudo-terminal, or a virtual board in virtual time.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median

from rig.backends.driver import DeviceInfo, DeviceWatchdog, Transport
from rig.backends.serial import frames
from rig.backends.serial.device_clock import DeviceClock, TimedExchange, fit_device_clock
from rig.backends.serial.frames import Code, Hello, Kind, Packet, RelaySetup, Setup, State
from rig.backends.serial.introduction import STALE_READS, await_introduction, refusal
from rig.backends.serial.relay_stream import TICK_S, RelayCommand, RelayRow, RelayStream, relay_command
from rig.calibration import (
    Calibration,
    DriveMap,
    TachometerScale,
    hard_limits_in_counts,
    largest_drive_in_units,
    polarity,
)
from rig.faults import Fault
from rig.signals import Limits, Order, Sample

LONGEST_WATCHDOG_S = 1.0  # that the device accepts
_SYNCHRONISE_S = 1.0
_SLOW_SYNCHRONISE_S = 3.0  # where exchanges are few, or differ
_FEW_EXCHANGES = 100
_STEADY_S = 0.0005  # between the fastest exchange and the median: more is the frames of USB
_SHORTEST_PAUSE_S = 0.001  # between two of the exchanges that measure the clock
_LONGEST_PAUSE_S = 0.020  # of an FTDI's timer of 16 ms every phase is met
_GOLDEN = 0.618034  # its multiples fall everywhere between 0 and 1
_ATTEMPTS = 3  # of a request outside the loop
_READ_SHARES = (2 / 3, 1.0, 1.0)  # of the time-out: until when each of a tick's requests for the state is waited for
_READ_AGAIN = 3  # readings in a row that had to be asked for again: the link is not fit for the period
_LOST_DRIVES = 3  # in a row: the drive that acts is no longer the host's
_LEAST_FULL_UNITS = 50  # coarser, and no drive is near what was asked for
_FLASHING = "flash it with the options that its wiring asks for: docs/real-bench.md"
_SUPPLY_TOLERANCE = 0.15  # of the divider in front of the converter, and of a loaded supply

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
}
_MOST_LATCHED = 16  # faults that a device can have latched
_RESET_BEFORE_S = 0.25  # opening a port takes less, and what began to run since then was reset by it


def setup_for(
    limits: Limits, calibration: Calibration, drive_map: DriveMap, rail_counts: tuple[int, int], session: int
) -> Setup:
    """What the device is told before arming. session  1 to 2**32 - 1.

    Raises ValueError where the device could not hold such limits: as ``hard_limits_in_counts`` and
    ``largest_drive_in_units``, watchdog outside 1 ms to 1 s.
    """
    hard_lo, hard_hi = hard_limits_in_counts(limits, calibration, drive_map, rail_counts)
    rail_lo, rail_hi = rail_counts
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


class SerialDriver:
    """The firmware behind a transport, as a ``Driver``. Times of samples are in the transport's clock, s.

    transport       an open port; closed by ``close``, never reopened
    calibration     position sensor
    drive_map       H-bridge; its ``full_units`` are replaced by what the device says
    rail_counts     (low, high): readings at or beyond are a broken sensor
    timeout_s       longest wait for one reply
    open_timeout_s  longest wait for the device to introduce itself, its restart on opening included
    tachometer      scale of the velocity channel; None: not used
    counts_max      the ADC's largest reading that the calibration was made for; None: not checked
    bridge          what the board's outputs are wired for, a value of ``frames.BRIDGES``; None: not told
    flashing        what a person has to do to flash this board, the whole command in it; "": not told
    session         number of this session, 1 to 2**32 - 1; None: a random one
    name            of the port, for ``backend``
    emulated        True where it is known that no real motor is behind the port
    """

    order: Order = "sample_first"
    latches_stops = True

    def __init__(
        self,
        transport: Transport,
        calibration: Calibration,
        drive_map: DriveMap,
        rail_counts: tuple[int, int],
        timeout_s: float = 0.03,
        open_timeout_s: float = 5.0,
        tachometer: TachometerScale | None = None,
        *,
        counts_max: int | None = None,
        bridge: str | None = None,
        flashing: str = "",
        session: int | None = None,
        name: str = "serial",
        emulated: bool = False,
    ) -> None:
        self.calibration = calibration
        self.drive_map = drive_map
        self.tachometer = tachometer
        self.backend = name
        self.failsafe: DeviceWatchdog | None = DeviceWatchdog(LONGEST_WATCHDOG_S)  # until armed with less
        self._transport = transport
        self._made_s = transport.now_s()  # just after the port was opened
        self._rail_counts = rail_counts
        self._timeout_s = timeout_s
        self._open_timeout_s = open_timeout_s
        self._counts_max = counts_max
        self._bridge = bridge
        self._flashing = flashing or _FLASHING
        self._name = name
        self._emulated = emulated
        self._reader = frames.FrameReader()
        self._clock = DeviceClock(0.0, 0, 1.0)
        self._seq = 0
        self._session = secrets.randbelow(2**32 - 1) + 1 if session is None else session
        self._setup: Setup | None = None  # that the device has confirmed
        self._armed = False
        self._unconfirmed: int | None = None  # seq of a DRIVE frame that no STATE has told of yet
        self._driven = False  # the device has accepted a DRIVE since arming
        self._t_drive_us = -1  # as last reported, and the same in host time: an old drive is mapped once
        self._t_u_s = math.nan
        self._exchanges = 0
        self._stale_replies = 0
        self._timeouts = 0
        self._asked_again = 0
        self._again_in_a_row = 0
        self._drives_lost = 0
        self._lost_in_a_row = 0
        self._stream: RelayStream | None = None  # while the relay in the device runs
        self._blocks: list[Packet] = []  # that came while something else was waited for

    @property
    def link_statistics(self) -> Mapping[str, int]:
        """Counts since construction.

        exchanges      requests that were waited for
        timeouts       of these, without a reply in time
        asked_again    readings that were asked for more than once, since a reply was damaged or did not come
        stale_replies  intact replies that were not the awaited one: late, repeated, of another request
        bad_frames     damaged frames from the device
        drives_lost    DRIVE frames that the device never accepted
        """
        return {
            "exchanges": self._exchanges,
            "timeouts": self._timeouts,
            "asked_again": self._asked_again,
            "stale_replies": self._stale_replies,
            "bad_frames": self._reader.bad_frames,
            "drives_lost": self._drives_lost,
        }

    def open(self) -> DeviceInfo:
        """Wait for the device to introduce itself, clear what it has latched, and measure its clock for one to three s.

        A fault whose cause lasts stays latched, and one that has come since the opening began: ``arm`` raises it.
        Raises Fault LINK_HELLO, LINK_VERSION, LINK_TIMEOUT, DEVICE_RESET or LINK_LOST; CONFIG_MISMATCH where the config
        does not fit the device (converter range, rails, tachometer, bridge).
        """
        hello = self._meet()
        self._check(hello)
        acknowledged = self._acknowledge(hello)
        self.drive_map = replace(self.drive_map, full_units=hello.drive_full)
        exchanges = self._time_exchanges()
        try:
            self._clock = fit_device_clock(exchanges, _REQUEST_SHARE)
        except ValueError as error:
            raise Fault("DEVICE_RESET", f"while its clock was measured: {error}") from error
        supply_V, supply_at_least = self._measured_supply_V(hello)
        board = frames.BOARDS.get(hello.board, f"number {hello.board}")
        emulated = self._emulated or hello.board in frames.EMULATED_BOARDS
        self.backend = f"{self._name} ({'emulated ' if emulated else ''}{board} board, build {hello.build_text})"
        return DeviceInfo(
            build=hello.build_text,
            board=board,
            reset_cause=hello.reset_words,
            emulated=emulated,
            clock_ratio=self._clock.ratio,
            round_trip_s=min(e.received_s - e.sent_s for e in exchanges),
            supply_V=supply_V,
            supply_at_least=supply_at_least,
            drive_units=hello.drive_full,
            acknowledged=acknowledged,
        )

    def arm(self, limits: Limits) -> None:
        """Stop, send the limits where the device has not got them yet, read them back, arm.

        What the device has latched since it was opened refuses, and a device that has lost this session: it was reset.
        Raises ValueError as ``setup_for``; Fault ARM_READBACK, LINK_TIMEOUT, or what the device refuses with.
        """
        setup = setup_for(limits, self.calibration, self.drive_map, self._rail_counts, self._session)
        self._armed = False
        state = State.unpack(self._request(Kind.STOP, b"", Kind.STOP_REPLY).body)
        self._check_pause(state)
        if setup != self._setup:
            stored = Setup.unpack(self._request(Kind.SETUP, setup.pack(), Kind.SETUP_REPLY).body)
            if stored != setup:
                raise Fault("ARM_READBACK", f"sent {_fields(setup, stored)}, stored {_fields(stored, setup)}")
            self._setup = setup
        code = self._request(Kind.ARM, frames.pack_arm(self._session), Kind.ARM_REPLY).body[0]
        if code != Code.NONE:
            raise Fault(_FAULT_OF_CODE.get(code, "LINK_REJECTED"), f"arming refused, {frames.code_name(code)}")
        self.failsafe = DeviceWatchdog(1e-3 * setup.watchdog_ms)
        self._unconfirmed = None
        self._lost_in_a_row = 0
        self._again_in_a_row = 0
        self._driven = False
        self._stream = None
        self._blocks.clear()
        self._armed = True

    def read(self) -> Sample:
        """Ask for the state and wait for it; ask again where a reply was damaged or stays away, within one time-out.

        ``u_V`` is what acts at the pin by the device's own word, even if the last ``write`` was lost on the
        way (which ``link_statistics`` counts). Before arming it reads, too.
        Raises Fault LINK_TIMEOUT, LINK_LOST, DEVICE_RESET, or the fault that the device latched.
        """
        packet = self._ask_state()
        if packet.kind == Kind.NACK:
            raise refusal(packet)
        state = State.unpack(packet.body)
        if self._armed:
            if (
                state.status & frames.STATUS_FAULT
                or not state.status & frames.STATUS_ARMED
                or state.session != self._session
            ):
                raise self._device_fault(state)
        elif self._unconfirmed is not None and state.fault:
            raise self._device_fault(state)
        elif self._setup is not None:
            self._check_pause(state)

        if self._unconfirmed is not None:
            if state.drive_seq == self._unconfirmed:
                self._driven = True
                self._lost_in_a_row = 0
            else:
                self._drives_lost += 1
                self._lost_in_a_row += 1
                if self._lost_in_a_row >= _LOST_DRIVES:
                    # the reading that came with it is in no row: it is here
                    raise Fault(
                        "LINK_TIMEOUT", f"{self._lost_in_a_row} drives in a row were not accepted; {self._where(state)}"
                    )
            self._unconfirmed = None
        now_s = self._transport.now_s()
        if self._driven and state.t_drive_us != self._t_drive_us:
            self._t_drive_us = state.t_drive_us
            self._t_u_s = self._clock.to_host_s(state.t_drive_us, now_s)
        tachometer = self.tachometer
        return Sample(
            self._clock.to_host_s(state.t_sample_us, now_s),
            self.calibration.to_rad(state.counts),
            state.counts,
            math.nan
            if tachometer is None or state.tach == frames.NO_TACHOMETER
            else tachometer.to_rad_per_s(state.tach),
            self._t_u_s if self._driven else math.nan,
            self.drive_map.to_volts(state.drive),
            packet.seq,
        )

    def _ask_state(self) -> Packet:
        """READ, up to three times within one time-out: again at once where a damaged frame came, or when most is over.

        A late answer to an earlier one of them will do: a state tells itself when it was sampled. Raises Fault
        LINK_TIMEOUT without any, and where the two readings before had to be asked for again, too.
        """
        start_s = self._transport.now_s()
        seqs: list[int] = []
        for share in _READ_SHARES:
            seqs.append(self._send(Kind.READ))
            last = len(seqs) == len(_READ_SHARES)
            packet = self._await(seqs, Kind.STATE, start_s + share * self._timeout_s, damage_ends=not last)
            if packet is not None:
                self._again_in_a_row = 0 if len(seqs) == 1 else self._again_in_a_row + 1
                if self._again_in_a_row < _READ_AGAIN:
                    return packet
                state = "refused" if packet.kind == Kind.NACK else self._where(State.unpack(packet.body))
                raise self._timeout(Kind.READ, f"{_READ_AGAIN} readings in a row had to be asked for again; {state}")
            if self._transport.now_s() - start_s >= self._timeout_s:
                break
            self._asked_again += len(seqs) == 1  # however often
        self._timeouts += 1
        raise self._timeout(Kind.READ)

    def write(self, u_V: float) -> None:
        """Send the drive, one way. Raises ValueError beyond supply and bridge, Fault LINK_LOST.

        Beyond what it was armed for, the device sets 0 V and the next ``read`` raises DEVICE_DRIVE_RANGE.
        """
        self._unconfirmed = self._send(Kind.DRIVE, frames.pack_drive(self.drive_map.to_units(u_V)))

    def safe_stop(self) -> bool:
        """Tell the device to stop, up to three times; True once it confirms 0 drive, disarmed.

        On False (or without the host at all) the device's watchdog does it. The last ticks of a relay that ran are for
        ``read_rows``.
        """
        self._armed = False
        self._unconfirmed = None
        stopped = self._is_stopped()
        if self._stream is not None:
            self._take_last(self._stream, until_s=self._transport.now_s() + (self._timeout_s if stopped else 0.0))
        return stopped

    def _is_stopped(self) -> bool:
        try:
            for _ in range(_ATTEMPTS):
                packet = self._answer(self._send(Kind.STOP), Kind.STOP_REPLY)
                if packet is not None and packet.kind == Kind.STOP_REPLY:
                    state = State.unpack(packet.body)
                    if state.drive == 0 and not state.status & frames.STATUS_ARMED:
                        return True
        except Fault:  # a dead port
            return False
        return False

    def close(self) -> None:
        """Close the port, after a ``safe_stop`` if still armed. May be called twice."""
        if self._armed:
            self.safe_stop()
        self._transport.close()

    # ------------------------------------------------------------------ the relay in the device

    @property
    def tick_s(self) -> float:
        """The device's tick in host time, s."""
        return TICK_S / self._clock.ratio

    def relay_command(self, h1_V: float, h2_V: float, z_bound_rad_s: float) -> RelayCommand:
        """What the device is to be told for these gains; raises as ``relay_stream.relay_command``."""
        return relay_command(h1_V, h2_V, z_bound_rad_s, self.calibration, self.drive_map, self.tick_s)

    def start_relay(self, command: RelayCommand) -> None:
        """Let the device's relay drive from its next tick on, from 0 V. It needs ``keep`` from then on.

        Raises Fault ARM_READBACK, LINK_TIMEOUT, or what the device refuses with.
        """
        setup = command.setup
        self._unconfirmed = None
        self._stream = None
        for _ in range(_ATTEMPTS):
            # a relay whose confirmation was lost runs already: this ends it
            self._send(Kind.DRIVE, frames.pack_drive(0))
            packet = self._answer(self._send(Kind.RELAY, setup.pack()), Kind.RELAY_REPLY)
            if packet is None:
                continue
            if packet.kind == Kind.NACK:
                raise refusal(packet)
            if RelaySetup.unpack(packet.body) != setup:
                raise Fault("ARM_READBACK", f"sent {setup}, stored {RelaySetup.unpack(packet.body)}")
            now_s = self._transport.now_s()
            self._stream = RelayStream(self.calibration, self.drive_map, self._clock, self._session, now_s)
            return
        raise self._timeout(Kind.RELAY)

    def keep(self) -> None:
        """Tell the device that the host lives: without this its relay ends when the watchdog time is over."""
        self._send(Kind.KEEP)

    def _take_last(self, stream: RelayStream, until_s: float) -> None:
        """What has come of a relay that was stopped, up to the first block that is missing."""
        try:
            self._take_blocks(stream)
            while not stream.ended and (left_s := until_s - self._transport.now_s()) > 0.0:
                self._sort(self._reader.feed(self._transport.read(left_s)))
                self._take_blocks(stream)
        except Fault:  # the run has ended for a reason of its own
            return

    def read_rows(self) -> list[RelayRow]:
        """The relay's ticks that have come since the last call; does not wait. After a ``safe_stop``: the last ones.

        Once there are no more:
        Raises Fault LINK_GAP, LINK_LOST, LINK_TIMEOUT where blocks stay away, DEVICE_RESET, or what the device latched.
        """
        stream = self._running_stream()
        if not self._armed:
            self._stream = None
            return stream.rows()
        for _ in range(STALE_READS):
            if not (data := self._transport.read(0.0)):
                break
            self._sort(self._reader.feed(data))
        self._take_blocks(stream)
        rows = stream.rows()
        if rows:
            return rows
        if stream.ended:
            raise self._relay_fault(stream)
        silent_s = self._transport.now_s() - stream.heard_s
        if silent_s > frames.BLOCK_ROWS * TICK_S + self._timeout_s:
            sample = self.read()  # the device may say why
            raise Fault(
                "LINK_TIMEOUT",
                f"the relay runs, but no block came for {1e3 * silent_s:.0f} ms; {sample.y_rad:.4f} rad, "
                f"{sample.y_counts} counts",
            )
        return rows

    def stop_relay(self) -> list[RelayRow]:
        """End the device's relay with 0 V; still armed. Returns its last ticks.

        What the device may have latched meanwhile, the next ``read`` raises. Raises Fault LINK_GAP, LINK_LOST,
        LINK_TIMEOUT.
        """
        stream = self._running_stream()
        for _ in range(_ATTEMPTS):
            self._send(Kind.DRIVE, frames.pack_drive(0))
            until_s = self._transport.now_s() + self._timeout_s
            while not stream.ended and (left_s := until_s - self._transport.now_s()) > 0.0:
                self._sort(self._reader.feed(self._transport.read(left_s)))
                self._take_blocks(stream)
            if stream.ended:
                self._stream = None
                return stream.rows()
        raise self._timeout(Kind.DRIVE)

    def _running_stream(self) -> RelayStream:
        if self._stream is None:
            raise ValueError("no relay runs in the device")
        return self._stream

    def _sort(self, packets: list[Packet]) -> None:
        """Keep blocks; nothing else is waited for."""
        for packet in packets:
            if packet.kind == Kind.BLOCK and packet.version == frames.VERSION:
                self._blocks.append(packet)
            else:
                self._stale_replies += 1

    def _take_blocks(self, stream: RelayStream) -> None:
        blocks, self._blocks = self._blocks, []
        now_s = self._transport.now_s()
        for packet in blocks:
            self._stale_replies += not stream.take(packet, now_s)

    def _relay_fault(self, stream: RelayStream) -> Fault:
        """Why the relay ended without being told to."""
        block = stream.last
        if block is None:
            raise ValueError("the relay has not ended")
        counts, drive = block.rows[-1] if block.rows else (0, 0)
        return self._device_fault(
            State(block.t_first_us, counts, frames.NO_TACHOMETER, 0, drive, 0, block.status, block.fault, block.session)
        )

    # ------------------------------------------------------------------ meeting the device

    def _meet(self) -> Hello:
        try:
            introduction = await_introduction(self._transport, self._reader, self._open_timeout_s)
        except Fault as fault:
            if fault.code != "LINK_VERSION":
                raise
            raise Fault(fault.code, f"{fault.detail}; {self._flashing}") from fault
        self._seq = introduction.requests
        self._stale_replies += introduction.stale_replies
        return introduction.hello

    def _check(self, hello: Hello) -> None:
        """Raise where config and device do not fit."""
        if not _LEAST_FULL_UNITS <= hello.drive_full <= 32767:
            raise Fault(
                "LINK_HELLO",
                f"the device says full drive is {hello.drive_full} units; {_LEAST_FULL_UNITS} to 32767 are a drive",
            )
        if self._counts_max is not None and hello.counts_max != self._counts_max:
            raise Fault(
                "CONFIG_MISMATCH",
                f"sensor.counts_max is {self._counts_max}, but the device reads 0 to {hello.counts_max}: "
                "calibrate with this device",
            )
        low, high = self._rail_counts
        if not 0 <= low < high <= hello.counts_max:
            raise Fault(
                "CONFIG_MISMATCH",
                f"sensor.rail_counts {low}, {high} must lie within the device's 0 to {hello.counts_max}",
            )
        if self.tachometer is not None and not hello.features & frames.FEATURE_TACHOMETER:
            raise Fault("CONFIG_MISMATCH", "the config has a section `tachometer`, but the device has no such channel")
        self._check_bridge(hello)

    def _check_bridge(self, hello: Hello) -> None:
        """With the wrong bridge a drive of 0 V can be full drive: the config has to say what is wired."""
        bridge = frames.BRIDGES.get(hello.bridge)
        emulated = self._emulated or hello.board in frames.EMULATED_BOARDS
        if bridge == self._bridge or (self._bridge is None and emulated) or (hello.bridge == 0 and emulated):
            return
        if hello.bridge == 0:
            raise Fault(
                "CONFIG_MISMATCH",
                f"drive.bridge is {self._bridge}, but the device's firmware does not say which bridge it is for, and "
                f"with the wrong one 0 V can be full drive: {self._flashing}",
            )
        if bridge is None:
            raise Fault(
                "CONFIG_MISMATCH", f"the device drives a bridge of kind {hello.bridge}, which this rig does not know"
            )
        if self._bridge is None:
            raise Fault(
                "CONFIG_MISMATCH",
                f"drive.bridge is missing, and the device's firmware is for {bridge}: with the motor's supply off, see "
                f"that the bridge is wired so (docs/real-bench.md), then write bridge: {bridge}",
            )
        raise Fault(
            "CONFIG_MISMATCH",
            f"drive.bridge is {self._bridge}, but the device's firmware is for {bridge}, and 0 V can be full drive: "
            f"{self._flashing}",
        )

    def _acknowledge(self, hello: Hello) -> tuple[str, ...]:
        """Clear what the device had latched before the command that opens it; codes of the faults, its reset left out.

        What came after that command stays, for ``arm`` to raise: a code that latches again, and where the device was
        reset by the opening, as an Uno is, everything but the reset.
        """
        known_s = self._transport.now_s() - self._made_s + _RESET_BEFORE_S
        was_reset_now = 1e-6 * hello.now_us < known_s
        cleared: list[int] = []
        for _ in range(_MOST_LATCHED):
            state = State.unpack(self._request(Kind.READ, b"", Kind.STATE).body)
            code = state.fault
            if not state.status & frames.STATUS_FAULT or code in cleared or not self._is_cleared(code):
                break
            cleared.append(code)
            if code == Code.RESET and was_reset_now:
                break
        return tuple(_FAULT_OF_CODE.get(code, "LINK_REJECTED") for code in cleared if code != Code.RESET)

    def _is_cleared(self, code: int) -> bool:
        """Acknowledge one fault; False where its cause lasts."""
        for _ in range(_ATTEMPTS):
            packet = self._answer(self._send(Kind.ACK, frames.pack_ack(code)), Kind.ACK_REPLY)
            if packet is not None:
                return packet.kind == Kind.ACK_REPLY
        raise self._timeout(Kind.ACK)

    def _measured_supply_V(self, hello: Hello) -> tuple[float, bool]:
        """The motor supply as the device measures it now, not in its first millisecond; and whether it may be more.

        nan if it does not. A little off is for the run to say: it ends nothing.
        """
        if not hello.features & frames.FEATURE_SUPPLY:
            return math.nan, False
        now = Hello.unpack(self._request(Kind.HELLO, b"", Kind.HELLO_REPLY).body)
        measured_V, believed_V = frames.SUPPLY_UNIT_V * now.supply, self.drive_map.supply_V
        at_least = now.supply >= frames.SUPPLY_FULL
        off_V = measured_V - believed_V
        if (max(off_V, 0.0) if at_least else abs(off_V)) > _SUPPLY_TOLERANCE * believed_V:
            raise Fault(
                "CONFIG_MISMATCH",
                f"the device measures a motor supply of {'at least ' if at_least else ''}{measured_V:.1f} V, "
                f"drive.supply_V is {believed_V:g} V: switch it on, or correct the config",
            )
        return measured_V, at_least

    def _time_exchanges(self) -> list[TimedExchange]:
        """Ask for the device's time again and again, for a second, or up to three over a slow link or USB.

        HELLO carries the time at which it is answered; a sample's time may be a device tick old. The pauses differ, up
        to the longest exchange: with equal ones each reply would meet a USB adapter's timer at the same phase.
        """
        now_s = self._transport.now_s
        exchanges: list[TimedExchange] = []
        longest_s = 0.0
        began_s = sent_s = now_s()
        while sent_s < began_s + _SYNCHRONISE_S or (sent_s < began_s + _SLOW_SYNCHRONISE_S and _is_vague(exchanges)):
            packet = self._answer(self._send(Kind.HELLO), Kind.HELLO_REPLY)
            received_s = now_s()
            if packet is not None and packet.kind == Kind.HELLO_REPLY:
                exchanges.append(TimedExchange(sent_s, received_s, Hello.unpack(packet.body).now_us))
                longest_s = min(max(longest_s, received_s - sent_s), _LONGEST_PAUSE_S)
            pause_s = _SHORTEST_PAUSE_S + longest_s * (_GOLDEN * len(exchanges) % 1.0)
            self._stale_replies += len(self._reader.feed(self._transport.read(pause_s)))
            sent_s = now_s()
        if len(exchanges) < 4:
            raise self._timeout(Kind.HELLO)
        return exchanges

    # ------------------------------------------------------------------ requests and replies

    def _send(self, kind: Kind, body: bytes = b"") -> int:
        """Send a request; its seq."""
        self._seq = seq = (self._seq + 1) & 0xFFFF
        self._transport.write(frames.encode(kind, seq, body))
        return seq

    def _answer(self, seq: int, kind: Kind) -> Packet | None:
        """The reply of that seq and kind, or the refusal; None after the time-out, which is counted."""
        packet = self._await([seq], kind, self._transport.now_s() + self._timeout_s)
        self._timeouts += packet is None
        return packet

    def _await(self, seqs: list[int], kind: Kind, until_s: float, damage_ends: bool = False) -> Packet | None:
        """The reply of that kind to one of ``seqs``, or the refusal; None at ``until_s``. Anything else is stale.

        ``damage_ends``: None as soon as a damaged frame has come, too, which may have been it.
        """
        transport = self._transport
        self._exchanges += 1
        bad_frames = self._reader.bad_frames
        while (left_s := until_s - transport.now_s()) > 0.0:
            reply = None
            for packet in self._reader.feed(transport.read(left_s)):
                if (
                    reply is None
                    and packet.seq in seqs
                    and (packet.kind == kind or packet.kind == Kind.NACK)
                    and packet.version == frames.VERSION
                ):
                    reply = packet
                    if kind == Kind.RELAY_REPLY:
                        self._blocks.clear()  # of an earlier run
                else:
                    self._sort([packet])
            if reply is not None:
                return reply
            if damage_ends and self._reader.bad_frames > bad_frames:
                return None
        return None

    def _request(self, kind: Kind, body: bytes, reply: Kind) -> Packet:
        """Send until answered, a few times; raises Fault on refusal or silence."""
        for _ in range(_ATTEMPTS):
            packet = self._answer(self._send(kind, body), reply)
            if packet is not None:
                if packet.kind == Kind.NACK:
                    raise refusal(packet)
                return packet
        raise self._timeout(kind)

    def _timeout(self, kind: Kind, what: str = "") -> Fault:
        what = what or f"no reply to {kind.name} within {1e3 * self._timeout_s:g} ms"
        return Fault(
            "LINK_TIMEOUT",
            f"{what}; so far {self._reader.bad_frames} damaged frames, {self._stale_replies} stale replies in "
            f"{self._exchanges} exchanges",
        )

    def _where(self, state: State) -> str:
        return f"{self.calibration.to_rad(state.counts):.4f} rad, {state.counts} counts"

    def _check_pause(self, state: State) -> None:
        """Raise what has happened to a disarmed device since it was opened."""
        if state.status & frames.STATUS_FAULT or (self._setup is not None and state.session != self._session):
            raise self._device_fault(state)

    def _device_fault(self, state: State) -> Fault:
        """What a STATE says that ends the run, with this case's numbers."""
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
    """Whether those of one second are too few, or too unlike, for the device's rate."""
    if len(exchanges) <= _FEW_EXCHANGES:
        return True
    took_s = [exchange.received_s - exchange.sent_s for exchange in exchanges]
    return median(took_s) - min(took_s) > _STEADY_S


def _fields(setup: Setup, other: Setup) -> str:
    """The fields in which two set-ups differ, with the first one's values."""
    return ", ".join(f"{name} {a}" for name, a, b in zip(Setup._fields, setup, other, strict=True) if a != b)
