"""`make stopping`: one motor from rest until it is known, and its page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from campaign_real.kinds import KINDS
from rig.config.campaign import Campaign
from stopping import __main__ as command
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
    assert row(CAMPAIGN, 3, (), Asked()).error == one.error  # a seed gives the same run


def test_a_motor_with_a_departure_is_identified_with_its_law() -> None:
    sag = next(kind for kind in KINDS if kind.name == "sag 3")
    one = row(CAMPAIGN, 3, (sag,), Asked(identified=True))
    assert one.fault is None
    assert one.verdict is not None
    assert one.final_error is not None
    assert np.max(np.abs(one.final_error)) < 0.05


def test_the_page_counts_a_motor_that_is_not_known_as_the_slowest() -> None:
    known = row(CAMPAIGN, 3, (), Asked())
    told = {
        command.PLAIN: {
            0: known,
            1: replace(known, number=1, known=False, fault="NO_MOTION"),
            2: replace(known, number=2),
        }
    }
    text = command.page(told, 1.0, "seed 3", 3)
    assert "| stopped because known | 2 |" in text
    assert ", inf s |" in text
    assert "| ended otherwise: NO_MOTION | 1 |" in text
