"""Coulomb friction that differs between the two directions, or a bias: fc sgn(v) - a. Motion does not tell which."""

from __future__ import annotations

from rig.identify.laws.coulomb import Coulomb
from rig.identify.laws.law import CLEAR, Doubt, LawComparison


class Asymmetric(Coulomb):
    """The law of the sampled-data estimate, and what the other laws add to."""

    name = "asymmetric"
    title = "asymmetric Coulomb friction"
    asymmetric = True
    confounded_with = ("bias_V",)

    def from_one_amplitude(self, against: LawComparison) -> str | Doubt | None:
        """Within each cycle the two directions are told apart: the criterion alone decides."""
        return f"{against.title}: {against.gained}" if against.gain > CLEAR else None
