"""Sixty fixed motors that are not what the plain model says: `make campaign-real` in small, by `make evidence`.

One motor of each law is in test_identify_departures.py.

Nothing here was chosen by its outcome: the motors are the first ones of a seed of their own.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from campaign_real.__main__ import called_ok, is_wrong, named_of
from campaign_real.rows import Row, kinds_of, row
from campaign_real.shown import expected_gains
from rig.config.campaign import Campaign

CAMPAIGN = Campaign(name="sixty", experiments=44, seed=60)
SINGLES, PAIRS = 44, 16  # the kinds in turn, and two at random

pytestmark = [pytest.mark.long, pytest.mark.evidence]


@cache
def rows() -> tuple[Row, ...]:
    singles = [row(CAMPAIGN, number, False) for number in range(SINGLES)]
    return (*singles, *(row(CAMPAIGN, number, True) for number in range(PAIRS)))


def test_none_fails() -> None:
    assert [one.reasons for one in rows() if one.verdict == "failed"] == []


def test_none_is_called_ok_and_wrong() -> None:
    assert [one for one in rows() if is_wrong(one)] == []


def test_u95_of_those_called_ok_hold_the_truth() -> None:
    held = [inside for one in called_ok(list(rows())) for inside in one.inside or ()]
    assert np.mean(held) >= 0.93


def test_most_are_called_ok() -> None:
    singles, pairs = list(rows()[:SINGLES]), list(rows()[SINGLES:])
    assert len(called_ok(singles)) >= 0.75 * SINGLES
    assert len(called_ok(pairs)) >= 0.5 * PAIRS


def test_what_can_be_seen_is_named() -> None:
    singles = rows()[:SINGLES]
    shown = {
        (False, one.number): expected_gains(CAMPAIGN, one.number, kinds_of(one.number, False, 60)) for one in singles
    }
    named, seen = named_of(singles, shown)
    assert seen >= 0.7 * SINGLES
    assert named >= 0.9 * seen


def test_plain_motors_get_no_law() -> None:
    plain = [one for one in rows() if one.kinds == ("plain",)]
    assert len(plain) == 2
    assert all(not one.found for one in plain)
