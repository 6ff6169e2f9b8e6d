"""A law while it runs in the device: start it, take its blocks, stop it."""

from __future__ import annotations

from typing import Self

from rig.backends.driver import RelayRow
from rig.backends.serial import frames
from rig.backends.serial.exchange import ATTEMPTS, Exchange
from rig.backends.serial.firmware_laws import TICK_S
from rig.backends.serial.frames import DeviceState, Kind, RelaySetup, StrokesSetup
from rig.backends.serial.introduction import STALE_READS, refusal
from rig.backends.serial.law_stream import LawStream
from rig.core.faults import Fault


class LawRun:
    """One run of the relay or the strokes in the device. ``start`` constructs it.

    exchange  with the device
    stream    of its blocks
    """

    def __init__(self, exchange: Exchange, stream: LawStream) -> None:
        self._exchange = exchange
        self._stream = stream

    @classmethod
    def start(cls, exchange: Exchange, setup: RelaySetup | StrokesSetup, stream: LawStream) -> Self:
        """Let the law drive from the device's next tick on, from 0 V.

        Raises Fault ARM_READBACK, LINK_TIMEOUT, or the refusal of the device.
        """
        kind, reply = (
            (Kind.RELAY, Kind.RELAY_REPLY) if isinstance(setup, RelaySetup) else (Kind.STROKES, Kind.STROKES_REPLY)
        )
        for _ in range(ATTEMPTS):
            # a law whose confirmation was lost runs already: this ends it
            exchange.send(Kind.DRIVE, frames.pack_drive(0))
            packet = exchange.answer(exchange.send(kind, setup.pack()), reply)
            if packet is None:
                continue
            if packet.kind == Kind.NACK:
                raise refusal(packet)
            stored = setup.unpack(packet.body)
            if stored != setup:
                raise Fault("ARM_READBACK", f"sent {setup}, stored {stored}")
            stream.heard_s = exchange.now_s()
            return cls(exchange, stream)
        raise exchange.silence(kind)

    def rows(self) -> list[RelayRow]:
        """The ticks, since the last call, of the blocks taken so far."""
        return self._stream.rows()

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
            if self._stream.ended:
                return
        raise self._exchange.silence(Kind.DRIVE)

    @property
    def ended(self) -> DeviceState | None:
        """The state in the last block of a law that has ended; None while it runs."""
        block = self._stream.last
        if block is None or not self._stream.ended:
            return None
        counts, drive = block.rows[-1] if block.rows else (0, 0)
        return DeviceState(
            block.t_first_us, counts, frames.NO_TACHOMETER, 0, drive, 0, block.status, block.fault, block.session
        )

    @property
    def missed_s(self) -> float:
        """Time since the last block, s, if it is longer than allowed; else 0."""
        silent_s = self._exchange.now_s() - self._stream.heard_s
        if silent_s > frames.BLOCK_ROWS * TICK_S + self._exchange.timeout_s:
            return silent_s
        return 0.0

    def _until_ended(self, until_s: float) -> None:
        while not self._stream.ended and (left_s := until_s - self._exchange.now_s()) > 0.0:
            self._exchange.listen(left_s)
            self._take_blocks()

    def _take_blocks(self) -> None:
        now_s = self._exchange.now_s()
        for packet in self._exchange.blocks():
            self._exchange.stale_replies += not self._stream.take(packet, now_s)
