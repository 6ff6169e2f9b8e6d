"""What the firmware makes of gains and strokes: the commands of the laws that run in the device."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rig.backends.driver import RelayCommand, StrokesCommand, StrokeTimes
from rig.backends.serial.frames import BLOCK_ROWS, MAX_STROKE_TICKS, MAX_STROKES, RelaySetup, StrokesSetup
from rig.core.calibration import Calibration, DriveMap
from rig.core.faults import Fault

TICK_S = 1e-3  # of the device, in its own time
_CENTRE_STEPS = 16  # to a count
_INTEGRAL_STEPS = 32  # to a count tick
_LARGEST_INTEGRAL = 2**30


@dataclass(frozen=True)
class FirmwareRelay(RelayCommand):
    """The command, with the ``setup`` that goes over the wire."""

    setup: RelaySetup


@dataclass(frozen=True)
class FirmwareStrokes(StrokesCommand):
    """The command, with the ``setup`` that goes over the wire."""

    setup: StrokesSetup


@dataclass(frozen=True)
class FirmwareLawRules:
    """What the firmware makes of gains and strokes: drives in whole units, positions in counts, times in ticks.

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

    def strokes_command(
        self, strokes: Sequence[tuple[float, float]], times: StrokeTimes, motion_rad: float
    ) -> FirmwareStrokes:
        """The command for these strokes (drive, V; turning point, rad).

        Raises ValueError for drives beyond the bridge's, or so small that no unit drives; Fault CONFIG_MISMATCH for
        more strokes than the device takes.
        """
        if len(strokes) > MAX_STROKES:
            raise Fault(
                "CONFIG_MISMATCH",
                f"the device takes {MAX_STROKES} strokes, not {len(strokes)}: take fewer, or relay.where: host",
            )
        calibration, drive_map = self.calibration, self.drive_map
        units = [drive_map.to_units(u_V) for u_V, _ in strokes]
        volts = [drive_map.to_volts(each) for each in units]
        if 0.0 in volts:
            raise ValueError(f"a stroke of {strokes[volts.index(0.0)][0]:g} V is less than the drive's smallest step")
        turns = [round(calibration.to_counts(turn_rad)) for _, turn_rad in strokes]
        # a stroke that may take longer than the device lets it is given up sooner there
        stroke_ticks, still_ticks = (min(math.ceil(time_s / self.tick_s), MAX_STROKE_TICKS) for time_s in times)
        setup = StrokesSetup(
            strokes=tuple(zip(units, turns, strict=True)),
            stroke_ticks=stroke_ticks,
            still_ticks=still_ticks,
            still_counts=max(round(motion_rad / calibration.lsb_rad), 1),
            rows=BLOCK_ROWS,
        )
        return FirmwareStrokes(
            strokes=tuple(zip(volts, turns, strict=True)),
            centre_counts=round(calibration.to_counts(0.0)),
            direction=calibration.direction,
            stroke_ticks=setup.stroke_ticks,
            still_ticks=setup.still_ticks,
            still_counts=setup.still_counts,
            setup=setup,
        )
