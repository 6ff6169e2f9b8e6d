"""Where the emulated bench differs from the bench that the rest of the config describes."""

from __future__ import annotations

from collections.abc import Iterator
from math import isclose

from rig.backends.registry import backend_of
from rig.config.problems import bracketed
from rig.config.schema import DeadBand, DeviceSetup
from rig.core.motor_numbers import RealMotor

_SLACK = 1e-6  # relative: numbers closer than this are equal but for their digits
_BENT_COUNTS = 1.0  # largest distance of a calibration table from a straight line that is left unsaid
_SCALED = "K and f_c will come out scaled"


def differences(d: DeviceSetup) -> Iterator[str]:
    """A sentence for each difference between the emulated bench and the config; none for a real motor."""
    if d.emulated is None or not backend_of(d).is_emulated(d):
        return
    yield from _bridge(d)
    yield from _sensor(d)
    if d.tachometer is not None and d.emulated.tachometer is False:
        yield "the emulated bench has no velocity channel (emulated.tachometer); the config has a section tachometer"
    parts = d.emulated.motor.parts
    given = [] if parts is None else [(name, value) for name, value in parts if name in RealMotor._fields and value]
    if given:
        yield (
            f"the emulated motor has parts that tau, K and f_c leave out (emulated.motor.parts: "
            f"{', '.join(f'{name} {value:g}' for name, value in given)}): estimates without these laws may be off"
        )
    stops, hard = d.emulated.motor.stop_rad, d.limits.hard_rad
    if not d.limits.is_endless and not (stops[0] <= hard[0] and hard[1] <= stops[1]):
        yield (
            f"the emulated shaft meets its mechanical stops at {bracketed(stops)} rad, inside limits.hard_rad "
            f"{bracketed(hard)}: its motion there is not free"
        )


def _bridge(d: DeviceSetup) -> Iterator[str]:
    emulated, drive = d.emulated, d.drive
    if emulated is None or emulated.supply_V is None or emulated.bridge_drop_V is None:
        return
    full_V, config_V = emulated.supply_V - emulated.bridge_drop_V, drive.supply_V - drive.bridge_drop_V
    if not isclose(full_V, config_V, rel_tol=_SLACK):
        yield f"the emulated bridge gives {full_V:g} V, by the config it gives {config_V:g} V: {_SCALED}"
    if emulated.dead_band_duty != drive.dead_band_duty:
        yield (
            f"the emulated bridge passes nothing below {_shares(emulated.dead_band_duty)}, drive.dead_band_duty says "
            f"{_shares(drive.dead_band_duty)}: the true drive differs from the recorded one, and {_SCALED}"
        )
    if emulated.reversed != drive.reversed:
        yield "the emulated bridge turns the shaft the opposite way to drive.reversed"


def _sensor(d: DeviceSetup) -> Iterator[str]:
    if d.emulated is None:
        return
    true, (rad_per_count, centre_counts) = d.emulated.potentiometer, d.sensor.straight
    if true.rad_per_count is None or true.centre_counts is None:
        return
    if not isclose(true.rad_per_count, rad_per_count, rel_tol=_SLACK):
        yield (
            f"one count of the emulated potentiometer is {true.rad_per_count:.6g} rad, sensor.calibration says "
            f"{rad_per_count:.6g} rad: every position and K will come out {rad_per_count / true.rad_per_count:.4g} "
            "times the true one"
        )
    if not isclose(true.centre_counts, centre_counts, rel_tol=_SLACK):
        yield (
            f"the emulated potentiometer reads {true.centre_counts:g} counts at position 0, sensor.calibration says "
            f"{centre_counts:g}: every position is off by {abs(true.centre_counts - centre_counts):.3g} counts"
        )
    bent_counts = max(abs(centre_counts + rad / rad_per_count - counts) for counts, rad in d.sensor.points)
    if bent_counts > _BENT_COUNTS:
        yield (
            f"sensor.calibration is a table that bends by up to {bent_counts:.3g} counts, but the emulated "
            "potentiometer is straight: K will come out too large where the table is too steep, too small where it is "
            "too flat"
        )
    if d.sensor.encoder is None and true.counts_max != d.sensor.counts_max:
        yield (
            f"the emulated potentiometer reads 0 to {true.counts_max} counts, sensor.counts_max is "
            f"{d.sensor.counts_max}: describe it in emulated.potentiometer"
        )


def _shares(dead: DeadBand | None) -> str:
    return "" if dead is None else f"{dead.plus:.3g} and {dead.minus:.3g} of full duty"
