"""One row of the campaign: a random motor with departures, identified, beside its truth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from campaign_real.kinds import KINDS, Case, Kind, case
from rig.config.campaign import Campaign
from rig.core.estimators import LEADING
from rig.identification import IdentifyError, identify

OF = ("tau_s", "K_rad_s_V", "fc_V")


@dataclass(frozen=True)
class Row:
    """What came of one motor.

    number, kinds   which motor, and the names of its kinds
    verdict         ok, doubtful, refused; failed: an exception, which ``reasons`` says
    error           relative error of tau, K and fc, 1; None where there is no estimate
    inside          whether u95 holds the truth of each
    u95             relative u95 of each, 1
    found           names of the laws that were found
    groups          names that are not told apart
    """

    number: int
    kinds: tuple[str, ...]
    verdict: str
    error: tuple[float, ...] | None
    inside: tuple[bool, ...] | None
    u95: tuple[float, ...] | None
    found: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    reasons: str
    seconds: float

    def is_same(self, other: Row) -> bool:
        """Whether the other row says the same of the same motor; another machine rounds otherwise."""
        words = ("number", "kinds", "verdict", "inside", "found", "groups")
        numbers = [(mine or (), theirs or ()) for mine, theirs in ((self.error, other.error), (self.u95, other.u95))]
        return all(getattr(self, name) == getattr(other, name) for name in words) and all(
            len(mine) == len(theirs) and np.allclose(mine, theirs, rtol=1e-4, atol=1e-7, equal_nan=True)
            for mine, theirs in numbers
        )

    def as_json(self) -> dict[str, object]:
        """As a line of rows.jsonl."""
        return asdict(self)


def kinds_of(number: int, pair: bool, seed: int) -> tuple[Kind, ...]:
    """The departures of motor ``number``: every kind in turn, or two kinds of different laws at random."""
    if not pair:
        return (KINDS[number % len(KINDS)],)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, 99)))
    while True:
        a, b = rng.choice(len(KINDS) - 1, 2, replace=False) + 1
        if KINDS[a].law != KINDS[b].law:
            return KINDS[a], KINDS[b]


def row(campaign: Campaign, number: int, pair: bool) -> Row:
    """The row of motor ``number`` of the campaign. An exception becomes its verdict."""
    began = time.perf_counter()
    kinds = kinds_of(number, pair, campaign.seed)
    names = tuple(kind.name for kind in kinds)
    try:
        return _identified(case(campaign, number, kinds), number, names)
    except IdentifyError as error:
        return _without(number, names, "refused", error.cause, began)
    except Exception as error:  # noqa: BLE001 - no error of one motor may end the thousands of others
        return _without(number, names, "failed", f"{type(error).__name__}: {error}", began)


def _identified(one: Case, number: int, names: tuple[str, ...]) -> Row:
    recordings = one.recordings()
    began = time.perf_counter()
    found = identify(recordings, (LEADING,))
    took = time.perf_counter() - began
    law = found.motor_law
    estimate = (None if law is None else law.estimate) or found.estimates[LEADING]
    truth = np.array([getattr(one.truth, name) for name in OF])
    value = np.array([getattr(estimate, name) for name in OF])
    u95 = np.array([law.budget.u95[name] for name in OF]) if law is not None else np.full(3, np.nan)
    return Row(
        number,
        names,
        estimate.verdict,
        tuple((value / truth - 1.0).tolist()),
        tuple((np.abs(value - truth) <= u95).tolist()),
        tuple((u95 / value).tolist()),
        tuple(one.law.name for one in law.found) if law is not None else (),
        law.not_told_apart if law is not None else (),
        " | ".join(estimate.reasons),
        took,
    )


def _without(number: int, names: Sequence[str], verdict: str, reason: str, began: float) -> Row:
    return Row(number, tuple(names), verdict, None, None, None, (), (), reason, time.perf_counter() - began)
