"""Friction that drifts over the run"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


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
    beyond = 0.0  # gain that it must bring, beyond Schwarz's criterion


class LevelEach(Drift):
    """A level of friction of its own in each recording: the drift of frames that ``Cut.with_levels`` makes."""

    name = "level_each"
    title = "level of friction in each recording of its own, at most"
    cause = "recordings of different days?"
    told_by = "all of it in one recording"
    beyond = 10.0  # something else that differs between recordings may look like it: a dead band, another amplitude

    def __init__(self, recordings: int = 2) -> None:
        self.recordings = recordings

    @property
    def costs(self) -> int:
        """A level of each, and the mean is f_c."""
        return self.recordings - 1
