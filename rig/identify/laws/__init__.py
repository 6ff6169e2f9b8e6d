"""The friction laws that the data are asked about, the simplest first: another one is a file, and a line here."""

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
