"""The rest after a test that was broken off: how long the shaft is slowed down, and when it is not."""

from __future__ import annotations

from dataclasses import replace

import pytest
from simulated_bench import GUARD, PERIOD_S

from rig.control.guard import WINDOW_S, Guard
from rig.control.slow_down import SlowDown
from rig.core.signals import Sample

SPEED_RAD_S = 4.0


def guard_that_sees_it_leave(delay_s: float = 0.0) -> Guard:
    guard = Guard(replace(GUARD, delay_s=delay_s))
    guard.velocity_rad_s, guard.predicted_stop_rad = SPEED_RAD_S, GUARD.limits.soft_rad[1] + 0.1
    return guard


def drives(guard: Guard, ticks_in_motion: int) -> list[float]:
    """What it drives in 30 ticks; the reading stops after some of them, the velocity stays what it was."""
    law = SlowDown(guard, 1.0, 0.5, 0.16, 3.0, PERIOD_S)
    y_rad = [SPEED_RAD_S * PERIOD_S * min(k, ticks_in_motion) for k in range(30)]
    return [law.step(Sample(k * PERIOD_S, y, 0)) for k, y in enumerate(y_rad)]


@pytest.mark.parametrize("ticks_in_motion", [0, 1, 7])
def test_it_ends_one_window_of_the_velocity_after_the_reading_last_went_on(ticks_in_motion: int) -> None:
    """Whatever the velocity says: it may be an old one, of a sensor that froze."""
    driven = drives(guard_that_sees_it_leave(), ticks_in_motion)
    braked = ticks_in_motion + round(WINDOW_S / PERIOD_S)
    assert driven == pytest.approx([-(0.5 + 0.16 * SPEED_RAD_S)] * braked + [0.0] * (30 - braked))


@pytest.mark.parametrize(("periods", "brakes"), [(0.0, True), (2.0, True), (2.1, False), (8.0, False)])
def test_where_drives_act_late_there_is_none(periods: float, brakes: bool) -> None:
    assert any(drives(guard_that_sees_it_leave(periods * PERIOD_S), 30)) is brakes


def test_a_shaft_that_stays_inside_or_hardly_moves_only_rests() -> None:
    inside, slow = guard_that_sees_it_leave(), guard_that_sees_it_leave()
    inside.predicted_stop_rad = 0.0
    slow.velocity_rad_s = 0.01
    assert not any(drives(inside, 30)) and not any(drives(slow, 30))
