"""What a test is expected to do: the same motion as its law on the exact motor, the same bound as Cramer and Rao's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from design_tasks import DEMO, READING, ROOM, task

from rig.control.law import OwnLaw
from rig.control.relay import DualChannelRelay
from rig.control.simulation import Sampling, simulate
from rig.control.strokes import Stroke, StrokeTest, StrokeTiming
from rig.design import compiled
from rig.design.outlook import information_of, law_of, outcome, told
from rig.design.planned_test import RelayGains
from rig.identification.cramer_rao import PositionNoise, cramer_rao
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.model.sensitivity import Theta
from rig.run_folder.recording.series import Steps

STROKES = (Stroke(1.1, 0.2), Stroke(-0.8, -0.3), Stroke(0.65, 0.35), Stroke(-1.6, 0.1))
GAINS = RelayGains(0.4, 0.7)
TESTS: dict[str, tuple[compiled.Law, Callable[[], OwnLaw]]] = {
    "strokes": (law_of(STROKES), lambda: StrokeTest(STROKES, StrokeTiming(100.0, 10.0, 10.0), 0.02)),
    "relay": (law_of(GAINS), lambda: DualChannelRelay(GAINS.h1_V, GAINS.h2_V, 100.0)),
}
SECONDS = 3.0


@pytest.mark.parametrize("name", TESTS)
@pytest.mark.parametrize("start_rad", [0.0, 0.3, -0.3])
def test_it_simulates_the_law_on_the_exact_motor(name: str, start_rad: float) -> None:
    """A relay takes over from a first reading of zero, strokes from both sides."""
    law, make = TESTS[name]
    tau_s, K, fc_V, asym_V = DEMO
    u_V, states, _ = compiled.drive(task().belief.plant(0.0), law, (0.01, 0.004), (0.0, start_rad, 0.0), 0, 300)
    own = make()
    motor = Motor(tau_s, K, coulomb(fc_V), asym_V)
    seen = simulate(motor, own, SECONDS, Sampling(0.01, 0.004, start_rad=start_rad))
    assert u_V.tolist() == seen.u_V.tolist()
    np.testing.assert_allclose(states[:, 1], seen.y_rad, atol=1e-12)


@pytest.mark.parametrize("latency_s", [0.004, 0.013, 0.03])
def test_a_drive_acts_when_its_delay_is_over(latency_s: float) -> None:
    """Of the rows of a test, the drive before the first one is 0 V, and each later one acts a latency after its row."""
    law = law_of((Stroke(2.0, 1e3), Stroke(-2.0, -1e3)))
    _, states, _ = compiled.drive(task().belief.plant(0.0), law, (0.01, latency_s), (0.0, 0.0, 0.0), 0, 40)
    tau_s, K, fc_V, asym_V = DEMO
    times = 0.01 * np.arange(40.0)
    by_motor = Motor(tau_s, K, coulomb(fc_V), asym_V).response(State(), times, [-1.0, latency_s], [0.0, 2.0])
    np.testing.assert_allclose(states, by_motor[:, :2], atol=1e-12)


@pytest.mark.parametrize("name", TESTS)
@pytest.mark.parametrize("is_known", [False, True])
def test_its_interval_is_the_bound_of_cramer_and_rao(name: str, is_known: bool) -> None:
    law, _ = TESTS[name]
    n = round(SECONDS / 0.01)
    wish = task()
    if is_known:
        wish = replace(wish, belief=replace(wish.belief, covariance=np.diag([0.01, 0.01, 0.01, 0.01, 0.0])))
    u_V, _, _ = compiled.drive(wish.belief.plant(0.0), law, (0.01, wish.delay_s), (0.0, 0.0, 0.0), 0, n)
    times = 0.01 * np.arange(float(n))
    steps = Steps(np.append(-1.0, times + wish.delay_s), np.append(0.0, u_V))
    noise = PositionNoise(READING.noise_rad, READING.lsb_rad)
    bound = cramer_rao(Theta(*DEMO), steps, times, noise, delay_known=is_known)
    percent = 100.0 * 1.959964 * np.max(bound[:3] / np.array(DEMO[:3]))
    assert wish.percent(wish.before + information_of(wish, law, SECONDS)) == pytest.approx(percent, rel=1e-3)


def test_seconds_are_those_after_which_the_interval_is_there() -> None:
    law, _ = TESTS["strokes"]
    wish = task(wanted_percent=2.0)
    found = told(wish, law)
    assert wish.percent(information_of(wish, law, found.seconds)) == pytest.approx(2.0, rel=0.05)
    # what is known beforehand shortens it; a wider interval needs less
    again = replace(wish, seen=information_of(wish, law, 0.7 * found.seconds))
    assert told(again, law).seconds < found.seconds
    assert told(replace(wish, wanted_percent=5.0), law).seconds < found.seconds


def test_a_test_that_takes_longer_than_it_is_simulated_is_counted_on() -> None:
    law, _ = TESTS["strokes"]
    wish = task(wanted_percent=0.2)
    assert told(wish, law, 4.0).seconds == pytest.approx(told(wish, law, 12.0).seconds, rel=0.35)


def test_outcome_says_how_far_the_shaft_goes_and_by_how_much_that_is_too_far() -> None:
    law, _ = TESTS["strokes"]
    wish = task()
    motors = [wish.belief.plant(0.0)]
    far = outcome(wish, law, motors, len(STROKES))
    assert far.excess == 0.0
    assert -0.55 < far.reach.low_rad < -0.3
    assert 0.35 < far.reach.high_rad < 0.55
    assert 0.1 < far.longest_stroke_s < 1.5
    tighter = replace(wish, room=replace(ROOM, high_rad=0.5 * far.reach.high_rad))
    assert outcome(tighter, law, motors, len(STROKES)).excess == pytest.approx(1.0)
    # a guard that looks half a second ahead would brake
    watched = replace(wish, room=replace(ROOM, stop_rad=(-1.0, 1.0), horizon_s=0.5))
    assert outcome(watched, law, motors, len(STROKES)).excess > 0.0
    # a stroke that its motor cannot finish is too much, too
    weak = law_of((Stroke(0.3, 0.2), Stroke(-0.3, -0.2)))
    assert outcome(wish, weak, motors, 2).excess > 0.0
    assert math.isclose(outcome(wish, law_of(GAINS), motors, 0).longest_stroke_s, 12.0)
