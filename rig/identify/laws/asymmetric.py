"""Coulomb friction that differs between the two directions, or a bias: fc sgn(v) - a. Motion cannot show which."""

from __future__ import annotations

from rig.identify.laws.coulomb import Coulomb
from rig.identify.laws.law import CLEAR, Doubt, LawComparison


class Asymmetric(Coulomb):
    """The law of the sampled-data estimate. The other laws add parameters to it."""

    name = "asymmetric"
    title = "asymmetric Coulomb friction"
    adds = "+ asymmetry"
    asymmetric = True
    confounded_with = ("bias_V",)

    def from_one_amplitude(self, against: LawComparison) -> str | Doubt | None:
        """The criterion alone decides: every cycle contains both directions."""
        return f"{against.title}: {against.gained}" if against.gain > CLEAR else None
