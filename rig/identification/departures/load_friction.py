"""Friction that grows with the torque that a gear transmits"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.identification.departures.departure import Bench, Departure

MOST = 0.6  # of the torque: a gear that loses more hardly drives back
VISCOUS = 0.1  # of 1/K, to begin with: nearly all of it is back-EMF
MOST_VISCOUS = 0.9


class LoadFriction(Departure):
    """Friction that grows with the torque that a gear transmits: driving it costs some of it, braking helps."""

    name = "load_friction"
    title = "friction that grows with the torque"
    cause = "a gear of several stages, or a worm?"
    unit = "1"
    numbers = ("load_friction",)
    shape = ("viscous_share", "load_outside")
    one_sided = True
    told_by = "strokes of several drives, with coasting at 0 V between them"
    may_hide = False  # few benches have it: beside a dead band it would make f_c of every relay test unknown to 1 %

    def range_of(self, bench: Bench) -> float:
        """A tenth of the torque."""
        return 0.1

    def most(self, bench: Bench) -> float:
        """More is another gear."""
        return MOST

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """Of the motor's torque alone, and of a force on the shaft as well."""
        return [{"viscous_share": VISCOUS, "load_outside": share} for share in (0.0, 1.0)]

    def limits(self, bench: Bench) -> Mapping[str, tuple[float, float]]:
        """What shares may be."""
        return {"viscous_share": (0.0, MOST_VISCOUS), "load_outside": (0.0, 1.0)}
