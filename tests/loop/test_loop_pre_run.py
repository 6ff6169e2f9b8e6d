"""A model that tracks badly, or whose motion leaves its room, never drives the bench: the simulation refuses it."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from simulated_bench import CALIBRATION, DEMO_MOTOR, GUARD, LIMITS, PERIOD_S, RAILS

from rig.control.loop.pre_run import PreRunBench, pre_run
from rig.control.observer import MotorObserver
from rig.control.tracking import Tracking
from rig.control.trajectory import Reference
from rig.core.calibration import DriveMap
from rig.model.real_motor import Frame, FramedMotor, plain


class Ramp:
    """To a position, in a straight line, within a time."""

    start_rad = 0.0

    def __init__(self, to_rad: float, within_s: float) -> None:
        self.to_rad, self.within_s = to_rad, within_s

    def at(self, t_s: float) -> Reference:
        share = min(t_s / self.within_s, 1.0)
        v = (self.to_rad - self.start_rad) / self.within_s if share < 1.0 else 0.0
        return Reference(self.start_rad + share * (self.to_rad - self.start_rad), v, 0.0)


MOTOR = FramedMotor(plain(DEMO_MOTOR), Frame())
BENCH = PreRunBench(MOTOR, 0.0, 0.003, 0.0012, CALIBRATION, DriveMap(12.0), RAILS, PERIOD_S)


def tracking(to_rad: float, within_s: float = 1.0) -> Tracking:
    observer = MotorObserver(MOTOR, PERIOD_S, 0.003)
    return Tracking(MOTOR, observer, Ramp(to_rad, within_s), 12.0, 40.0, 2.0)


def test_one_that_stays_inside_may_drive_the_bench() -> None:
    assert pre_run(tracking(0.8), BENCH, GUARD) is None


@pytest.mark.parametrize("to_rad", [1.2, -1.2])
def test_one_that_leaves_the_soft_limits_must_not_drive_the_bench(to_rad: float) -> None:
    why = pre_run(tracking(to_rad), BENCH, GUARD)
    assert why is not None and "beyond the soft limits -1.10 to 1.10 rad" in why
    low, high = (float(word) for word in re.findall(r"goes from (\S+) to (\S+) rad", why)[0])
    assert max(-low, high) > 1.1 and min(-low, high) == 0.0  # how far, and on which side


def test_one_that_asks_for_more_than_the_largest_drive_must_not() -> None:
    why = pre_run(tracking(0.8, 0.05), BENCH, GUARD)
    assert why is not None and "more than drive.max_V 3.00 V" in why


def test_one_that_ends_in_a_fault_must_not() -> None:
    slow = replace(GUARD, max_speed_rad_s=0.5)
    why = pre_run(tracking(0.8, 0.5), BENCH, slow)
    assert why is not None and "OVERSPEED" in why and LIMITS is slow.limits
