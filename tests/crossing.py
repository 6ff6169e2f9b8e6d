"""An event for ``scipy.integrate.solve_ivp``: one component of the state passes zero."""

from __future__ import annotations

import numpy as np


class Crossing:
    """Ends the integration where ``x[component]`` passes zero; ``direction`` as solve_ivp has it: +1 rising only."""

    terminal = True

    def __init__(self, component: int, direction: float = 0.0) -> None:
        self.component, self.direction = component, direction

    def __call__(self, t: float, x: np.ndarray) -> float:
        return float(x[self.component])
