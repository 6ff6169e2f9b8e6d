"""When it is enough: each thing that an estimate may lack, and two in a row."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import pytest

from rig.design.stop_rule import StopRule


@dataclass(frozen=True)
class Seen:
    worst_percent: float = 0.9
    residual_over_noise: float = 1.0
    residual_error: float = 0.02
    drives_differ: bool = True
    laws: tuple[str, ...] = ()


def test_two_estimates_in_a_row_are_enough_and_one_is_not() -> None:
    rule = StopRule(1.0)
    assert rule.take(Seen()) is None
    assert rule.take(Seen(worst_percent=1.01)) is None
    assert rule.take(Seen()) is None
    why = rule.take(Seen(worst_percent=0.8))
    assert why is not None and "0.80 % by their scatter" in why and "1 % were asked for" in why


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"worst_percent": 1.2}, "known to 1.2 %"),
        ({"worst_percent": math.nan}, "known to"),
        ({"residual_over_noise": 1.2}, "the residual is 1.20"),
        ({"residual_over_noise": math.nan}, "the residual"),
        ({"drives_differ": False}, "too much alike"),
    ],
)
def test_estimates_that_agree_are_not_enough_while_something_lacks(change: dict[str, float], words: str) -> None:
    rule, seen = StopRule(1.0), replace(Seen(), **change)  # type: ignore[arg-type]
    assert words in (rule.lacks(seen) or "")
    assert all(rule.take(seen) is None for _ in range(20))


def test_beside_a_law_the_interval_must_be_narrower() -> None:
    rule = StopRule(1.0)
    for percent, is_enough in ((0.9, False), (0.61, False), (0.59, True)):
        assert (rule.lacks(Seen(percent, laws=("sag",))) is None) is is_enough
    assert rule.lacks(Seen(0.9)) is None


def test_estimates_with_other_laws_do_not_count_together() -> None:
    rule = StopRule(1.0)
    assert rule.take(Seen()) is None
    assert rule.take(Seen(0.5, laws=("sag",))) is None
    assert rule.take(Seen(0.5, laws=("sag",))) is not None
    assert rule.confirm(Seen(0.5, laws=("dead_band",))) is None
    assert rule.take(Seen(0.5, laws=("dead_band",))) is not None
    assert rule.confirm(Seen(0.7, laws=("dead_band",))) is None


def test_the_residual_may_be_larger_by_what_few_rows_make_of_it() -> None:
    few, many = Seen(residual_over_noise=1.09, residual_error=0.03), Seen(residual_over_noise=1.09, residual_error=0.01)
    assert StopRule(1.0).lacks(few) is None and StopRule(1.0).lacks(many) is not None
    assert StopRule(1.0, noise_error=0.04).lacks(many) is None  # so does a noise at rest that few rows tell


def test_a_residual_that_is_a_little_too_large_may_be_the_noises_fault_and_is_judged_again() -> None:
    """The noise at rest, known to 6 %, came out 15 % too small."""
    rule, seen = StopRule(1.0, 0.06), Seen(residual_over_noise=1.0 / 0.85)
    doubts = []
    for _ in range(2):
        assert rule.take(seen) is None
        doubts.append(rule.noise_in_doubt)
    assert doubts == [False, True]  # one estimate is not enough
    rule.learn(1.0 / 0.85, 0.04)
    why = rule.enough()
    assert why is not None and "the residual is 1.00 of the noise" in why
    rule.learn(1.0, 0.02)  # it was right
    doubts.append(rule.noise_in_doubt)
    assert rule.enough() is None and not doubts[-1]


@pytest.mark.parametrize(
    "change",
    [{"worst_percent": 1.2}, {"drives_differ": False}, {"residual_over_noise": 1.0}, {"residual_over_noise": 1.6}],
)
def test_the_noise_is_in_doubt_only_if_nothing_else_lacks_and_it_may_be_to_blame(change: dict[str, float]) -> None:
    rule = StopRule(1.0, 0.06)
    for _ in range(2):
        rule.take(replace(Seen(residual_over_noise=1.0 / 0.85), **change))  # type: ignore[arg-type]
    assert not rule.noise_in_doubt
