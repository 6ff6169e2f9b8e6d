"""The laws that a real motor may have beyond the plain one (docs/theory.md 12). Each is one file, and one line here."""

from __future__ import annotations

from rig.identification.departures.backlash import Backlash
from rig.identification.departures.bristle import Bristle
from rig.identification.departures.cogging import Cogging
from rig.identification.departures.dead_band import DeadBand
from rig.identification.departures.departure import Departure
from rig.identification.departures.drag import Drag
from rig.identification.departures.drift import Drift
from rig.identification.departures.force_over_position import ForceOverPosition
from rig.identification.departures.friction_over_position import FrictionOverPosition
from rig.identification.departures.friction_wave import FrictionWave
from rig.identification.departures.gain_by_sign import GainBySign
from rig.identification.departures.lag import Lag
from rig.identification.departures.linearity import Linearity
from rig.identification.departures.load_friction import LoadFriction
from rig.identification.departures.sag import Sag
from rig.identification.departures.sag_by_current import SagByCurrent
from rig.identification.departures.soft_coupling import SoftCoupling
from rig.identification.departures.source import Source
from rig.identification.departures.static import Static
from rig.identification.departures.stribeck import Stribeck
from rig.identification.departures.viscous_by_direction import ViscousByDirection

DEPARTURES: list[Departure] = [
    DeadBand(),
    GainBySign(),
    Sag(),
    Lag(),
    ViscousByDirection(),
    Static(),
    Stribeck(),
    Drag(),
    Bristle(),
    ForceOverPosition(),
    FrictionOverPosition(),
    Cogging(),
    Backlash(),
    Linearity(),
    Drift(),
    LoadFriction(),
    Source(),
]

OUTSIDE: list[Departure] = [SagByCurrent(), SoftCoupling(), FrictionWave()]
"""Laws that a bench may have and the motor's model has not: lines of the budget only."""
