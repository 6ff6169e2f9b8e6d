"""The relay in the device, seen from the host: its command, and its ticks, which come back in blocks."""

from __future__ import annotations

from dataclasses import dataclass

from rig.backends.driver import RelayCommand, RelayRow
from rig.backends.serial import frames
from rig.backends.serial.device_clock import DeviceClock
from rig.backends.serial.frames import BLOCK_ROWS, Block, Packet, RelaySetup
from rig.calibration import Calibration, DriveMap
from rig.faults import Fault

TICK_S = 1e-3  # of the device, in its own time
_CENTRE_STEPS = 16  # to a count
_INTEGRAL_STEPS = 32  # to a count tick
_LARGEST_INTEGRAL = 2**30


@dataclass(frozen=True)
class FirmwareRelay(RelayCommand):
    """The command, with the ``setup`` that goes over the wire."""

    setup: RelaySetup


@dataclass(frozen=True)
class FirmwareLawRules:
    """What the firmware makes of the gains of a relay: drives in whole units, the integral in counts and ticks.

    calibration  a straight line
    drive_map    with the device's units
    clock_ratio  device seconds in a second of the host
    """

    calibration: Calibration
    drive_map: DriveMap
    clock_ratio: float

    @property
    def tick_s(self) -> float:
        """The device's tick in host time, s."""
        return TICK_S / self.clock_ratio

    def relay_command(self, h1_V: float, h2_V: float, z_bound_rad_s: float) -> FirmwareRelay:
        """The command for these gains.

        Raises ValueError for drives beyond the bridge's; Fault CONFIG_MISMATCH where the integral does not fit the
        device.
        """
        calibration, drive_map = self.calibration, self.drive_map
        count_tick_rad_s = calibration.lsb_rad * self.tick_s
        z_bound = round(_INTEGRAL_STEPS * z_bound_rad_s / count_tick_rad_s)
        if not 1 <= z_bound <= _LARGEST_INTEGRAL:
            raise Fault(
                "CONFIG_MISMATCH",
                f"the bound on the relay's integral, {z_bound_rad_s:g} rad s, is not within what the device can hold, "
                f"{_LARGEST_INTEGRAL / _INTEGRAL_STEPS * count_tick_rad_s:g} rad s: use a shorter cycle, or "
                "relay.where: host",
            )
        units = tuple(drive_map.to_units(-h1_V * y - h2_V * z) for y, z in ((1, 1), (1, -1), (-1, 1), (-1, -1)))
        drive = (units[0], units[1], units[2], units[3])
        volts = tuple(map(drive_map.to_volts, drive))
        centre = round(_CENTRE_STEPS * calibration.to_counts(0.0))
        setup = RelaySetup(drive, centre, z_bound, calibration.direction, BLOCK_ROWS)
        return FirmwareRelay(
            drives_V=(volts[0], volts[1], volts[2], volts[3]),
            count_tick_rad_s=count_tick_rad_s,
            centre_counts=setup.centre / _CENTRE_STEPS,
            z_bound_count_ticks=setup.z_bound / _INTEGRAL_STEPS,
            direction=calibration.direction,
            setup=setup,
        )


class LawStream:
    """The blocks of one run of the relay in the device.

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
