"""The one way down to a least sum of squares: Levenberg's and Marquardt's, for every problem that rig fits."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array


class HasCost(Protocol):
    """A place of a descent."""

    @property
    def cost(self) -> float:
        """The sum of squares there; nan or inf: out of reach."""
        ...


Place = TypeVar("Place", bound=HasCost)


class Damping(NamedTuple):
    """The share of the diagonal that is added to it: the first one, and how it changes after a try.

    up, down   factors after a step that leaves more squares, and after one that does not
    least      smallest share
    tries      steps that are tried from one place
    """

    first: float = 1e-3
    up: float = 8.0
    down: float = 0.2
    least: float = 1e-9
    tries: int = 12


def descend(
    place: Place,
    linearised: Callable[[Place], Callable[[float], Place] | None],
    is_enough: Callable[[Place, Place], bool],
    most: int,
    damping: Damping = Damping(),  # noqa: B008 (it cannot change)
) -> tuple[Place, bool]:
    """Where a descent from ``place`` ends, and whether it has arrived: no step leads on, or the last one is enough.

    linearised  of a place: by a damping, where the damped step of Gauss and Newton leads; None: it has no derivatives
    is_enough   of the places before and after a step
    most        steps
    """
    share = damping.first
    for _ in range(most):
        moved = linearised(place)
        if moved is None:
            return place, False
        for _ in range(damping.tries):
            trial = moved(share)
            if trial.cost <= place.cost:  # false for nan
                break
            share = max(damping.least, share * damping.up)
        else:
            return place, True
        before, place = place, trial
        share = max(damping.least, share * damping.down)
        if is_enough(before, place):
            return place, True
    return place, False


class Point(NamedTuple):
    """A place of a small problem: its numbers (p,), residual (n,), Jacobian (n, p) and sum of squares."""

    x: Array
    residual: Array
    jacobian: Array
    cost: float

    @classmethod
    def of(cls, x: Array, rows: Callable[[Array], tuple[Array, Array]]) -> Point:
        """At the numbers ``x``, each in its unit, where ``rows`` gives residual and Jacobian."""
        residual, jacobian = rows(x)
        return cls(x, residual, jacobian, float(residual @ residual))

    def step(self, free: NDArray[np.bool_], damping: float) -> Array:
        """The step (p,) of the numbers that are free, by a damping from 0 on; the others stay. Each in its unit."""
        jacobian = self.jacobian[:, free]
        normal = jacobian.T @ jacobian
        normal += np.diag(damping * np.maximum(np.diag(normal), 1e-30))
        step = np.zeros(self.x.size)
        step[free] = -np.linalg.solve(normal, jacobian.T @ self.residual)
        return step
