"""`make stopping`: one motor from rest until it is known, and its page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from evidence import evidence

from campaign_real.departing_bench import REACH_RAD, config_of, open_bench
from campaign_real.departing_motor import Bench
from campaign_real.kinds import KINDS, departures_of
from rig.campaign.random_motors import draw
from rig.config.campaign import Campaign
from rig.config.schema import RelaySection, UntilSection
from rig.control.law import Rest
from rig.identification.departures.choice import ASKED
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.model.real_motor import Frame, FramedMotor, plain
from rig.running.experiment import until
from stopping import __main__ as command
from stopping.in_memory import driven
from stopping.rows import Asked, row

CAMPAIGN = Campaign(name="stopping", experiments=4, seed=3)


def test_a_plain_motor_is_known_within_seconds_and_its_intervals_hold() -> None:
    one = row(CAMPAIGN, 3, (), Asked())
    assert one.known, one.why
    assert one.run_s is not None
    assert one.run_s < 25.0  # of virtual time
    assert one.error is not None
    assert max(map(abs, one.error)) < 0.015
    assert one.beyond_rad == 0.0


@pytest.mark.parametrize(
    ("number", "most_s"),
    [
        *evidence(
            (122, 8.0),  # fast: the breakaway check sees it only because its strokes repeat the largest level
            (40, 12.0),  # fast: breakaway strokes show its friction at 1.7 times what it is; 25 s with that level
            (186, 20.0),  # slow: noise looked like a first motion at 0.75 of its friction; the guard said SENSOR_STUCK
            (307, 10.0),  # its noise at rest comes out at 0.84 of what it is; without another look 41.5 s, not known
        )
    ],
)
def test_healthy_motors_that_are_hard_to_see_are_known_in_time(number: int, most_s: float) -> None:
    one = row(CAMPAIGN, number, (), Asked())
    assert one.fault is None and one.known, one.why
    assert one.tests_s is not None and one.tests_s < most_s  # of virtual time
    assert one.error is not None and max(map(abs, one.error)) < 0.02
    assert one.beyond_rad == 0.0


@pytest.mark.parametrize("number", [12, *evidence(37, 55)])
@pytest.mark.parametrize("brakes", [True, *evidence(False)])
def test_a_test_that_is_broken_off_leaves_the_shaft_within_the_soft_limits(
    monkeypatch: pytest.MonkeyPatch, number: int, *, brakes: bool
) -> None:
    """A model with a third of the motor's gain: the shaft is too far out and too fast when rig notices."""
    if not brakes:  # the shaft would coast out
        monkeypatch.setattr(until, "SlowDown", lambda guard, rest_s, *more: Rest(rest_s))
    one = draw(CAMPAIGN, number)
    bench = Bench(0.01, one.delay_s, 0.003, CAMPAIGN.sensor.lsb_rad, one.offset_rad)
    tests = RelaySection(until=UntilSection(interval_percent=1.0, longest_s=6.0))
    e = config_of(one, bench).model_copy(update={"relay": tests})
    opened, shaft = open_bench(e, one, departures_of(CAMPAIGN, one, ()), bench, 60.0, 5)
    wrong = FramedMotor(plain(Motor(one.tau_s, one.K_rad_s_V / 3.0, coulomb(one.fc_V), 0.0)), Frame())
    session, fault = driven(e, opened, lambda session: until.drive_until(session, wrong))
    assert fault is None and any("was broken off" in note for note in session.found.notes)
    beyond_rad = shaft.furthest_rad - REACH_RAD
    assert beyond_rad <= 0.0 if brakes else beyond_rad > 0.05


@pytest.mark.evidence
def test_a_motor_with_a_departure_is_identified_with_its_law() -> None:
    sag = next(kind for kind in KINDS if kind.name == "sag 3")
    one = row(CAMPAIGN, 3, (sag,), Asked(identified=True))
    assert one.fault is None
    assert one.verdict is not None
    assert one.final_error is not None
    assert np.max(np.abs(one.final_error)) < 0.05
    assert one.gain is not None and one.gain > ASKED.entry and one.found == ("sag",)


@pytest.mark.evidence
def test_a_law_that_the_runs_own_tests_cannot_show_is_expected_to_gain_nothing() -> None:
    """Two long relay tests would show this curve of the sensor, by 107: the run ends after 6 s."""
    campaign = Campaign(name="stopping", experiments=41, seed=8)
    curved = next(kind for kind in KINDS if kind.name == "linearity 3")
    one = row(campaign, 34, (curved,), Asked(0.4, identified=True))
    assert one.known and one.found == ()
    assert one.gain is not None and one.gain < 0.0


@pytest.mark.evidence
def test_the_page_counts_a_motor_that_is_not_known_as_the_slowest() -> None:
    known = row(CAMPAIGN, 3, (), Asked())
    told = {
        command.PLAIN: {
            0: known,
            1: replace(known, number=1, known=False, fault="NO_MOTION"),
            2: replace(known, number=2),
        }
    }
    text = command.page(told, 1.0, "make stopping", "seed 3", 3)
    assert "| stopped because known | 2 |" in text
    assert ", never known |" in text
    assert "| ended otherwise: NO_MOTION | 1 |" in text


@pytest.mark.evidence
def test_the_page_says_which_laws_are_named_and_how_many_departures_are_ok() -> None:
    one = replace(row(CAMPAIGN, 3, (), Asked()), verdict="ok", final_error=(0.0,) * 3, final_inside=(True,) * 3)
    rows = [
        replace(one, number=0, kinds=("plain",)),
        replace(one, number=1, kinds=("sag 3",), found=("sag",), gain=1e3),
        replace(one, number=2, kinds=("sag 3",), found=("drag",), gain=1.0),  # its own tests were too short
        replace(one, number=3, kinds=("lag 2",), gain=1.0),  # too small to be seen
        replace(one, number=4, kinds=("sag 1",), verdict=None, fault="POLARITY"),  # neither named nor ok
    ]
    gains = {0: {}, 1: {"sag": 1e3}, 2: {"sag": 1e3}, 3: {"lag": 1.0}, 4: {"sag": 1e3}}
    shown = {(False, number): those for number, those in gains.items()}
    told: command.Told = {group: {} for group in command.TITLES} | {
        command.DEPARTING: {one.number: one for one in rows}
    }
    text = command.page(told, 0.4, "make stopping", "", 5, shown)
    assert "| departures called ok | 75.0 % of 4 |" in text
    assert "| laws named, of those that the run's tests can show | 1 of 1: 100.0 % |" in text
    assert "| laws named, of those that two relay tests can show | 1 of 3: 33.3 % |" in text
    assert "| sag 3 | 2 | 2 | 2 | 0 | 1 of 1 |" in text
