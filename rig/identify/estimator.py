"""What an estimator is. Each is a file of its own and one entry of ``ESTIMATORS`` in identification.py."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Protocol

from rig.identify.estimate import Estimate
from rig.identify.measurements import Measurements
from rig.recording.errors import IdentifyError
from rig.recording.series import TimeSeries


class Estimator(Protocol):
    """From measurements to an estimate with a verdict.

    name               as commands, results and reports have it
    reads_relay_tests  whether it reads relay tests, or any drive of a plain file; else the runs of hysteretic relays
    """

    name: str
    reads_relay_tests: bool = True

    def series(self, data: Measurements) -> Sequence[TimeSeries]:
        """What it reads of the measurements. Without anything to read it is left out, unless it was asked for."""
        return data.tests if self.reads_relay_tests else data.hysteretic

    def applies(self, data: Measurements) -> IdentifyError | None:
        """Why it cannot work on these measurements, and what to record for it; None where it can."""
        return None

    @abstractmethod
    def fit(self, data: Measurements) -> Estimate:
        """The estimate, verdict "ok" unless the fit itself failed. Raises IdentifyError where nothing can be fitted."""

    @abstractmethod
    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        """The estimate with its verdict and reasons. Units, columns and holes are judged by plausibility.py for all.

        earlier  estimates of the estimators before it in the list, by name
        Raises IdentifyError where the data are too short to judge it.
        """

    def notes(self, estimate: Estimate, data: Measurements) -> list[str]:
        """What else there is to say, in words: it changes no verdict."""
        return []
