"""The descent to a least sum of squares."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from rig.identification import lost_counts
from rig.identification.departures import fit
from rig.identification.descent import Damping, Point, descend
from rig.model.sensitivity import Theta

FREE = np.array([True, True])


def valley(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rosenbrock's, with its bottom at (1, 1)."""
    residual = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
    return residual, np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def down(
    rows: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], free: np.ndarray = FREE, most: int = 60
) -> tuple[Point, bool]:
    return descend(
        Point.of(np.array([-1.2, 1.0]), rows),
        lambda at: lambda share: Point.of(at.x + at.step(free, share), rows),
        lambda before, after: before.cost - after.cost <= 1e-12,
        most,
        Damping(tries=20),
    )


def test_it_arrives_at_the_bottom_of_a_bent_valley() -> None:
    found, arrived = down(valley)
    assert arrived and found.x == pytest.approx([1.0, 1.0], abs=1e-8)


def test_it_has_not_arrived_where_its_steps_run_out() -> None:
    found, arrived = down(valley, most=3)
    assert not arrived and found.cost < Point.of(np.array([-1.2, 1.0]), valley).cost


def test_a_number_that_is_held_stays() -> None:
    found, arrived = down(valley, np.array([True, False]))
    assert arrived and found.x[1] == 1.0 and found.x[0] == pytest.approx(-math.sqrt(0.995), rel=0.01)


def test_it_never_ends_where_the_rows_are_no_numbers() -> None:
    def walled(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residual, jacobian = valley(x)
        return (residual if x[0] < 0.5 else residual * math.nan), jacobian

    found, arrived = down(walled)
    assert arrived and found.x[0] < 0.5 and math.isfinite(found.cost)


def test_without_derivatives_there_is_no_step() -> None:
    begun = Point.of(np.array([-1.2, 1.0]), valley)
    assert descend(begun, lambda at: None, lambda before, after: True, 5) == (begun, False)


@pytest.mark.parametrize(
    ("tries", "expected"), [(1, [True, False, False]), (2, [False, True, False]), (4, [False, True, False])]
)
def test_derivatives_come_with_the_step_that_leads_on_as_it_did_at_the_last_place(
    tries: int, expected: list[bool]
) -> None:
    """Where the first step is in vain again and again, its derivatives were, too."""
    promise = fit._Promise()
    promise.made(10.0, 1.0)
    for _ in range(tries):
        promise.goes_on()
    promise.made(10.0, 1.0)
    assert [promise.goes_on() for _ in expected] == expected


def test_a_fit_of_a_share_of_lost_counts_begins_where_the_last_one_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    begun_s = []

    def refit(_tests: object, begin: Theta, *_more: object) -> Any:
        begun_s.append(begin.tau_s)
        return SimpleNamespace(fit=SimpleNamespace(motor=(begin.tau_s + 1.0, 1.0, 0.1, 0.0, 0.0)), rms_rad=1.0)

    monkeypatch.setattr(lost_counts, "refit", refit)
    monkeypatch.setattr(lost_counts, "plain_residual_rad", lambda *_: 1.0)
    monkeypatch.setattr(lost_counts, "delays_of_all_s", lambda _: None)
    law = SimpleNamespace(found=[SimpleNamespace(law=SimpleNamespace(name=lost_counts.LAWS[0]))], growth=[(1.0, 1.0)])
    plain = SimpleNamespace(tau_s=1.0, K_rad_s_V=1.0, fc_V=0.1, asym_V=0.0, delay_s=0.0)
    lost_counts.lost_share([], cast(Any, plain), cast(Any, law))
    assert len(begun_s) > 3 and begun_s == [1.0 + k for k in range(len(begun_s))]
