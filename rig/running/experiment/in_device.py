"""Tests that the device runs by itself: the command that it gets, and the law that must decide as it does."""

from __future__ import annotations

from collections.abc import Sequence

from rig.backends.driver import RelayCommand, RelayDriver, StrokeDriver, StrokesCommand, StrokeTimes
from rig.control.relay import RelayOnCounts
from rig.control.strokes import Stroke, StrokeTiming
from rig.control.strokes_on_counts import StrokesOnCounts
from rig.core.faults import Fault
from rig.running.session import Session


def relay_in_device(
    session: Session, gains_V: tuple[float, float], z_bound_rad_s: float
) -> tuple[RelayCommand, RelayOnCounts]:
    """The relay at gains (h1, h2), V, for the device, and the same on the counts that come back.

     Raises Fault CONFIG_MISMATCH if the device cannot run it.

    z_bound_rad_s  bound on its integral
    """
    driver = session.bench.driver
    if not isinstance(driver, RelayDriver):
        raise Fault("CONFIG_MISMATCH", f"relay.where is device, but {driver.backend} has no relay")
    command = driver.relay_command(*gains_V, z_bound_rad_s)
    return command, RelayOnCounts(command, gains_V)


def strokes_in_device(
    session: Session, strokes: Sequence[Stroke], timing: StrokeTiming
) -> tuple[StrokesCommand, StrokesOnCounts]:
    """A stroke test that goes on until something ends it: for the device, and the same on the counts that come back.

    Raises Fault CONFIG_MISMATCH if the device cannot run it.
    """
    driver, motion_rad = session.bench.driver, session.experiment.breakaway.motion_rad
    if not isinstance(driver, StrokeDriver):
        raise Fault("CONFIG_MISMATCH", f"relay.where is device, but {driver.backend} runs no strokes: set it to host")
    command = driver.strokes_command(strokes, StrokeTimes(timing.stroke_s, timing.still_s), motion_rad)
    return command, StrokesOnCounts(command)
