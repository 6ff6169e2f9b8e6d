"""The motor without friction as matrices: the motion of its state [v, y, z] is linear (docs/theory.md 1.3)."""

from __future__ import annotations

import numpy as np

from rig.core.arrays import Array
from rig.model.step import State, glide


def transition(tau_s: float, h_s: float) -> Array:
    """Phi(h), (3, 3): from [v, y, z] to [v, y, z] after h seconds without input."""
    v, y, z = glide(State(v=1.0), 0.0, tau_s, h_s)
    return np.array([[v, 0.0, 0.0], [y, 1.0, 0.0], [z, h_s, 1.0]])


def input_vector(tau_s: float, K_rad_s_V: float, h_s: float) -> Array:
    """Gamma(h), (3,): [v, y, z] after h seconds of one volt from zero."""
    return K_rad_s_V * np.array(glide(State(), 1.0, tau_s, h_s))
