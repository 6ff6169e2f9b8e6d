"""Friction that drifts over the run"""

from __future__ import annotations

from rig.identify.departures.departure import Bench, Departure


class Drift(Departure):
    """Friction that drifts over the run."""

    name = "drift"
    title = "drift of the friction"
    cause = "a bench that warms up?"
    unit = "1"
    numbers = ("drift",)
    told_by = "the same relay test again, after the bench has warmed up"

    def range_of(self, bench: Bench) -> float:
        """15 % in a run."""
        return 0.15


class DriftEach(Drift):
    """Friction that drifts in the course of each recording, and begins each anew."""

    name = "drift_each"
    title = "drift of the friction in the course of each recording"
    cause = "a bench that warms up, and cools down between them?"
    told_by = "one long recording after the bench has warmed up"
