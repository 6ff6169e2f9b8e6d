"""Velocity, position and an unknown load by a linear observer, with prediction over the latency (docs/theory.md 13.1).

The load is whatever the motor's linear part does not explain: friction, a weight, a wrong gain. It is a state of its
own, so a law that adds it to its drive has integral action.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rig.core.signals import Sample
from rig.model.linear import input_vector, settled, transition
from rig.model.step import State, glide

_WELL_POSED = 1e-9  # process noise of velocity and position beside the load's


class LoadedState(NamedTuple):
    """Velocity rad/s, position rad, and the load, V: the drive that it takes."""

    v_rad_s: float
    y_rad: float
    load_V: float


class DisturbanceObserver:
    """Steady-state Kalman filter of the motor's linear part under a load that wanders.

    tau_s, K_rad_s_V  of the motor, > 0; an estimate within 30 % will do
    period_s          sampling period, s
    bandwidth_1_s     how fast it follows the load: the frequency of its three Butterworth poles, rad/s
    latency_s         from a sample until its drive acts, s

    transition  (3, 3) from a sample to the next, of velocity, position and load
    gain        (3,) of the innovation

    The gain does not depend on the sensor's noise: the wandering of the load is chosen for the bandwidth.
    """

    def __init__(
        self, tau_s: float, K_rad_s_V: float, period_s: float, bandwidth_1_s: float, latency_s: float = 0.0
    ) -> None:
        self.tau_s, self.K_rad_s_V = tau_s, K_rad_s_V
        self.latency_s = latency_s
        self.state = LoadedState(0.0, 0.0, 0.0)
        self._last_t_s = math.nan
        self._acting_V = 0.0
        self._asked_V = 0.0
        # with unit noise on the position; the load's random walk gives the bandwidth (docs/theory.md 13.1)
        wander_V = bandwidth_1_s**3 * tau_s / K_rad_s_V * period_s
        A = np.eye(3)
        A[:2, :2] = transition(tau_s, period_s)[:2, :2]
        A[:2, 2] = -input_vector(tau_s, K_rad_s_V, period_s)[:2]
        C = np.array([[0.0, 1.0, 0.0]])
        Q = np.diag([_WELL_POSED, _WELL_POSED, wander_V**2])
        P = settled(A, C.T @ C, Q)
        gain = P @ C.T / (1.0 + P[1, 1])
        self.transition = A
        self.gain = np.asarray(gain[:, 0], dtype=np.float64)
        self._gains: list[float] = self.gain.tolist()

    def step(self, sample: Sample) -> LoadedState:
        """The state at the instant at which a drive computed now takes effect."""
        if math.isnan(self._last_t_s):
            self.state = LoadedState(0.0, sample.y_rad, self.state.load_V)
            self._acting_V = sample.u_V
        else:
            self._advance(sample)
        v, y, load = self.state
        error = sample.y_rad - y
        gain = self._gains
        self.state = LoadedState(v + gain[0] * error, y + gain[1] * error, load + gain[2] * error)
        self._last_t_s = sample.t_s
        return self._moved(self.state, self._acting_V, self.latency_s)

    def drive(self, asked_V: float) -> None:
        """Take the drive that was sent after the last ``step``, V."""
        self._asked_V = asked_V

    def shift(self, load_V: float) -> None:
        """Add a known change of the load, V: friction that changes its sign."""
        self.state = self.state._replace(load_V=self.state.load_V + load_V)

    def _advance(self, sample: Sample) -> None:
        span = sample.t_s - self._last_t_s
        if math.isnan(sample.t_u_s):
            before, new_V = min(self.latency_s, span), self._asked_V
        else:
            before, new_V = min(max(sample.t_u_s - self._last_t_s, 0.0), span), sample.u_V
        self.state = self._moved(self.state, self._acting_V, before)
        self.state = self._moved(self.state, new_V, span - before)
        self._acting_V = new_V

    def _moved(self, state: LoadedState, u_V: float, dt_s: float) -> LoadedState:
        target = self.K_rad_s_V * (u_V - state.load_V)
        v, y, _ = glide(State(v=state.v_rad_s, y=state.y_rad), target, self.tau_s, dt_s)
        return LoadedState(v, y, state.load_V)
