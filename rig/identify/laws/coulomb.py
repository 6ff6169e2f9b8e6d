"""Coulomb friction: fc sgn(v)."""

from __future__ import annotations

from collections.abc import Sequence

from rig.identify.laws.law import Array, CandidateLaw
from rig.model.sensitivity import Theta, position, position_and_jacobian
from rig.recording.series import Window


class Coulomb(CandidateLaw):
    """One level in both directions, at rest and in motion."""

    name = "coulomb"
    title = "Coulomb friction"
    adds = "Coulomb"
    asymmetric = False

    def static_V(self, theta: Theta, own: Sequence[float]) -> float:
        """Level that holds the motor at rest, V."""
        return theta.fc_V

    def position(self, theta: Theta, own: Sequence[float], window: Window) -> Array:
        """Exact."""
        return position(theta, *window.steps, window.t_s, self.static_V(theta, own))

    def position_and_jacobian(self, theta: Theta, own: Sequence[float], window: Window) -> tuple[Array, Array] | None:
        """Exact, too."""
        return position_and_jacobian(theta, *window.steps, window.t_s, self.static_V(theta, own))
