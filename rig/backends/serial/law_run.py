"""A law while it runs in the device: start it, take its ticks, which come back in blocks, stop it."""

from __future__ import annotations

from rig.backends.driver import RelayRow
from rig.backends.serial import frames
from rig.backends.serial.device_clock import DeviceClock
from rig.backends.serial.exchange import ATTEMPTS, Exchange
from rig.backends.serial.firmware_laws import TICK_S
from rig.backends.serial.frames import Block, DeviceState, Kind, Packet, RelaySetup, StrokesSetup
from rig.backends.serial.introduction import STALE_READS, refusal
from rig.core.calibration import Calibration, DriveMap
from rig.core.faults import Fault


class LawRun:
    """One run of the relay or the strokes in the device, which ``start`` begins.

    exchange  with the device
    session   number that each block must carry
    """

    def __init__(
        self, exchange: Exchange, calibration: Calibration, drive_map: DriveMap, clock: DeviceClock, session: int
    ) -> None:
        self._exchange = exchange
        self._calibration, self._drive_map, self._clock, self._session = calibration, drive_map, clock, session
        self._heard_s = exchange.now_s()  # host time at which the last block came; before the first, of the start
        self._last: Block | None = None
        self._expected = 0
        self._rows: list[RelayRow] = []

    def start(self, setup: RelaySetup | StrokesSetup) -> None:
        """Let the law drive from the device's next tick on, from 0 V.

        Raises Fault ARM_READBACK, LINK_TIMEOUT, or the refusal of the device.
        """
        kind, reply = (
            (Kind.RELAY, Kind.RELAY_REPLY) if isinstance(setup, RelaySetup) else (Kind.STROKES, Kind.STROKES_REPLY)
        )
        for _ in range(ATTEMPTS):
            # a law whose confirmation was lost runs already: this ends it
            self._exchange.send(Kind.DRIVE, frames.pack_drive(0))
            packet = self._exchange.answer(self._exchange.send(kind, setup.pack()), reply)
            if packet is None:
                continue
            if packet.kind == Kind.NACK:
                raise refusal(packet)
            stored = setup.unpack(packet.body)
            if stored != setup:
                raise Fault("ARM_READBACK", f"sent {setup}, stored {stored}")
            self._heard_s = self._exchange.now_s()
            return
        raise self._exchange.silence(kind)

    def rows(self) -> list[RelayRow]:
        """The ticks, since the last call, of the blocks taken so far, in order."""
        rows, self._rows = self._rows, []
        return rows

    def hear(self) -> None:
        """Take the blocks that have arrived; does not wait. Raises Fault LINK_GAP, LINK_LOST, DEVICE_RESET."""
        for _ in range(STALE_READS):
            if not self._exchange.listen(0.0):
                break
        self._take_blocks()

    def hear_last(self, until_s: float) -> None:
        """Take the last blocks of a law that was stopped, up to the first missing one. Raises nothing."""
        try:
            self._take_blocks()
            self._until_ended(until_s)
        except Fault:  # the run has ended for a reason of its own
            return

    def stop(self) -> None:
        """End it with 0 V, and take its last blocks. Raises Fault LINK_GAP, LINK_LOST, LINK_TIMEOUT."""
        for _ in range(ATTEMPTS):
            self._exchange.send(Kind.DRIVE, frames.pack_drive(0))
            self._until_ended(self._exchange.now_s() + self._exchange.timeout_s)
            if self._has_ended:
                return
        raise self._exchange.silence(Kind.DRIVE)

    @property
    def ended(self) -> DeviceState | None:
        """The state in the last block of a law that has ended; None while it runs."""
        block = self._last
        if block is None or not self._has_ended:
            return None
        counts, drive = block.rows[-1] if block.rows else (0, 0)
        return DeviceState(
            block.t_first_us, counts, frames.NO_TACHOMETER, 0, drive, 0, block.status, block.fault, block.session
        )

    @property
    def missed_s(self) -> float:
        """Time since the last block, s, if it is longer than allowed; else 0."""
        silent_s = self._exchange.now_s() - self._heard_s
        if silent_s > frames.BLOCK_ROWS * TICK_S + self._exchange.timeout_s:
            return silent_s
        return 0.0

    @property
    def _has_ended(self) -> bool:
        """Whether the last block of the run has come."""
        return self._last is not None and not self._last.status & frames.STATUS_LAW

    def _until_ended(self, until_s: float) -> None:
        while not self._has_ended and (left_s := until_s - self._exchange.now_s()) > 0.0:
            self._exchange.listen(left_s)
            self._take_blocks()

    def _take_blocks(self) -> None:
        now_s = self._exchange.now_s()
        for packet in self._exchange.blocks():
            self._exchange.stale_replies += not self._take(packet, now_s)

    def _take(self, packet: Packet, now_s: float) -> bool:
        """Take a packet of kind BLOCK; False if it is a repeated one.

        Raises Fault LINK_GAP where a block is missing, DEVICE_RESET where it is of another session.
        """
        ahead = (packet.seq - self._expected) % 2**16
        if ahead >= 2**15:
            return False
        if ahead:
            raise Fault("LINK_GAP", f"block {packet.seq} came where {self._expected} was due: {ahead} missing")
        self._expected = (packet.seq + 1) % 2**16
        block = Block.unpack(packet.body)
        if block.session != self._session:
            raise Fault("DEVICE_RESET", f"block {packet.seq} is of another session")
        self._last = block
        self._heard_s = now_s
        t_s = self._clock.to_host_s(block.t_first_us, now_s)
        step_s = 1e-6 * block.period_us / self._clock.ratio
        delay_s = 1e-6 * block.delay_us / self._clock.ratio
        for counts, drive in block.rows:
            y_rad, u_V = self._calibration.to_rad(counts), self._drive_map.to_volts(drive)
            self._rows.append(RelayRow(t_s, t_s + delay_s, y_rad, counts, u_V, packet.seq))
            t_s += step_s
        return True
