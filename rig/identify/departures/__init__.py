"""The laws that a real motor may have beyond the plain one (docs/theory.md 12). Each is one file, and one line here."""

from __future__ import annotations

from rig.identify.departures.backlash import Backlash
from rig.identify.departures.bristle import Bristle
from rig.identify.departures.cogging import Cogging
from rig.identify.departures.dead_band import DeadBand
from rig.identify.departures.departure import Departure
from rig.identify.departures.drag import Drag
from rig.identify.departures.drift import Drift
from rig.identify.departures.force_over_position import ForceOverPosition
from rig.identify.departures.friction_over_position import FrictionOverPosition
from rig.identify.departures.friction_wave import FrictionWave
from rig.identify.departures.gain_by_sign import GainBySign
from rig.identify.departures.lag import Lag
from rig.identify.departures.linearity import Linearity
from rig.identify.departures.load_friction import LoadFriction
from rig.identify.departures.sag import Sag
from rig.identify.departures.sag_by_current import SagByCurrent
from rig.identify.departures.soft_coupling import SoftCoupling
from rig.identify.departures.source import Source
from rig.identify.departures.static import Static
from rig.identify.departures.stribeck import Stribeck
from rig.identify.departures.viscous_by_direction import ViscousByDirection

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
