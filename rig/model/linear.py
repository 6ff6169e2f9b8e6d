"""The motor without friction as matrices: the motion of its state [v, y, z] is linear (docs/theory.md 1.3)."""

from __future__ import annotations

import math

import numpy as np

from rig.core.arrays import Array
from rig.model.step import State, glide

_DOUBLINGS = 60  # of one step


def transition(tau_s: float, h_s: float) -> Array:
    """Phi(h), (3, 3): from [v, y, z] to [v, y, z] after h seconds without input."""
    v, y, z = glide(State(v=1.0), 0.0, tau_s, h_s)
    return np.array([[v, 0.0, 0.0], [y, 1.0, 0.0], [z, h_s, 1.0]])


def settled(A: Array, G: Array, H: Array) -> Array:
    """The covariance of a filter's prediction in the end, (n, n): X = A X (1 + G X)^-1 A' + H, by doubling.

    A  transition, G  C' R^-1 C of readings C with the noise R, H  the noise of a step; (n, n) each

    So it takes a twentieth of the time of scipy.linalg, which takes longer to load than many a command.
    Raises ArithmeticError where it does not settle: such a filter would drift away.
    """
    one, A, X = np.eye(len(A)), A.T, H
    for _ in range(_DOUBLINGS):
        ahead = np.linalg.inv(one + G @ X)
        more = A.T @ X @ ahead @ A
        A, G, X = A @ ahead @ A, G + A @ ahead @ G @ A.T, X + more
        if np.abs(more).max() <= np.finfo(np.float64).eps * np.abs(X).max() < math.inf:
            return X
    raise ArithmeticError("the covariance of this filter does not settle")


def input_vector(tau_s: float, K_rad_s_V: float, h_s: float) -> Array:
    """Gamma(h), (3,): [v, y, z] after h seconds of one volt from zero."""
    return K_rad_s_V * np.array(glide(State(), 1.0, tau_s, h_s))
