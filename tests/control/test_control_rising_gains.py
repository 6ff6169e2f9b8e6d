"""The start without a target: on motors of the campaign's grid, and with a shaft that sticks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evidence import evidence

from rig.campaign.random_motors import Draw, draw
from rig.config.campaign import Campaign
from rig.control.motion import Swings
from rig.control.relay import DualChannelRelay
from rig.control.rising_gains import RisingGains, SwingRoom
from rig.control.simulation import Sampling, simulate
from rig.core.signals import Sample
from rig.model.cycle_detector import CycleDetector

GRID = Campaign(name="grid", experiments=1)
PERIOD_S = 0.01
LSB_RAD = 0.0041
REACH_RAD, SOFT_RAD, HARD_RAD = 0.47, 0.55, 0.7
TOP_RAD_S = 4.65


def rising(friction_V: float) -> RisingGains:
    room = SwingRoom(friction_V, REACH_RAD, TOP_RAD_S, h_max_V=3.0, sum_max_V=3.0, motion_rad=0.02)
    return RisingGains(DualChannelRelay(0.0, 0.0, 2.0), CycleDetector(0.3, 20 * LSB_RAD), room)


@pytest.mark.parametrize("number", [0, 1, *evidence(*range(2, 12))])
def test_any_motor_of_the_grid_swings_widely_within_some_seconds_and_hardly_beyond_its_reach(number: int) -> None:
    one: Draw = draw(GRID, number)
    law = rising(1.05 * one.fc_V + 0.01)  # a breakaway check finds a little more than friction
    run = simulate(one.motor(), law, 30.0, Sampling(PERIOD_S, 0.005, 0.003, LSB_RAD, one.offset_rad, seed=number))
    late = run.t_s > 8.0
    assert 0.5 * np.ptp(run.y_rad[late]) > 0.25 * REACH_RAD
    assert float(np.abs(run.y_rad).max()) < HARD_RAD
    gains_V = {round(step.h2_V, 6) for step in law.steps if step.t_s > 8.0}
    assert len(gains_V | {round(law.relay.h2_V, 6)}) > 1  # two sizes of the cycle take turns, so that the drives differ
    assert np.max(np.abs(run.u_V)) <= 3.0


@pytest.mark.parametrize("too_high", [1.3, 1.8])
@pytest.mark.parametrize("number", [6, 23, 28])
def test_a_fast_motor_whose_friction_was_shown_too_high_stays_within_the_soft_limits(
    number: int, too_high: float
) -> None:
    one: Draw = draw(GRID.model_copy(update={"seed": 3}), number)
    assert one.K_rad_s_V > 8.0 or number == 6
    law = rising(too_high * one.fc_V)
    run = simulate(one.motor(), law, 12.0, Sampling(PERIOD_S, one.delay_s, 0.003, LSB_RAD, one.offset_rad, seed=number))
    assert float(np.abs(run.y_rad).max()) < SOFT_RAD
    assert float(np.abs(np.diff(run.y_rad[::5])).max()) / (5 * PERIOD_S) < 1.05 * TOP_RAD_S
    assert 0.5 * np.ptp(run.y_rad[run.t_s > 6.0]) > 0.1 * REACH_RAD  # and it still swings


def test_while_the_shaft_sticks_the_gains_grow_to_the_largest_drive_and_it_never_gives_up() -> None:
    law = rising(0.3)
    drives = [law.step(Sample(k * PERIOD_S, 0.1, 512)) for k in range(6000)]
    assert drives[0] == pytest.approx(-(0.4 * 0.3 + 1.15 * 0.3))  # inward, just above the breakaway level
    assert min(drives) == pytest.approx(-3.0) and max(drives) < 0.0
    assert not law.finished
    assert {step.outcome for step in law.steps} == {"no swing"}


def test_a_swing_too_wide_takes_the_gains_back_once_for_each_swing() -> None:
    law = rising(0.3)
    for k in range(100):
        law.step(Sample(k * PERIOD_S, 0.6 * math.sin(2.0 * math.pi * k * PERIOD_S), 512))
    retreats = [step for step in law.steps if step.outcome == "too wide or too fast"]
    assert len(retreats) == 2  # at 0.15 s and at 0.65 s
    assert retreats[1].h2_V < retreats[0].h2_V


def test_swings_are_counted_without_those_of_the_noise() -> None:
    swings, noise = Swings(0.05), np.random.default_rng(1).normal(0.0, 0.003, 1000)
    turned = [swings.step(0.3 * math.cos(0.02 * k) + float(noise[k])) for k in range(1000)]
    assert sum(turned) == swings.count == 6  # 1000 ticks are 3.2 periods; it begins at a turning point
    assert swings.half_way_rad == pytest.approx(0.3, abs=0.01)
    assert not any(Swings(0.05).step(float(one)) for one in noise)
