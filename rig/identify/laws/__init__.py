"""The candidate friction laws, the simplest first. To add one, write one file, and one line here."""

from rig.identify.laws.asymmetric import Asymmetric
from rig.identify.laws.coulomb import Coulomb
from rig.identify.laws.law import CandidateLaw
from rig.identify.laws.static import Static
from rig.identify.laws.stribeck import Stribeck

LAWS: list[CandidateLaw] = [
    Coulomb(),
    Asymmetric(),
    Static(),
    Stribeck(),
]
