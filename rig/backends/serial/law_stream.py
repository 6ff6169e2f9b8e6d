"""The ticks of a law in the device, which come back in blocks."""

from __future__ import annotations

from rig.backends.driver import RelayRow
from rig.backends.serial import frames
from rig.backends.serial.device_clock import DeviceClock
from rig.backends.serial.frames import Block, Packet
from rig.core.calibration import Calibration, DriveMap
from rig.core.faults import Fault


class LawStream:
    """The blocks of one run of a law in the device.

    heard_s  host time at which the last block came, s; before the first block, that of the start
    last     the last block; None before the first
    session  number that each block must carry
    """

    def __init__(
        self, calibration: Calibration, drive_map: DriveMap, clock: DeviceClock, session: int, started_s: float
    ) -> None:
        self.heard_s = started_s
        self.last: Block | None = None
        self._calibration = calibration
        self._drive_map = drive_map
        self._clock = clock
        self._session = session
        self._expected = 0
        self._rows: list[RelayRow] = []

    @property
    def ended(self) -> bool:
        """Whether the last block of the run has come."""
        return self.last is not None and not self.last.status & frames.STATUS_LAW

    def take(self, packet: Packet, now_s: float) -> bool:
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
        self.last = block
        self.heard_s = now_s
        t_s = self._clock.to_host_s(block.t_first_us, now_s)
        step_s = 1e-6 * block.period_us / self._clock.ratio
        delay_s = 1e-6 * block.delay_us / self._clock.ratio
        for counts, drive in block.rows:
            y_rad, u_V = self._calibration.to_rad(counts), self._drive_map.to_volts(drive)
            self._rows.append(RelayRow(t_s, t_s + delay_s, y_rad, counts, u_V, packet.seq))
            t_s += step_s
        return True

    def rows(self) -> list[RelayRow]:
        """The rows since the last call, in order."""
        rows, self._rows = self._rows, []
        return rows
