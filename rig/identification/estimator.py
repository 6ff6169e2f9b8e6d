"""The interface of an estimator. Each estimator is one file, and one line in rig/core/estimators.py."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Protocol

from rig.identification.estimate import Estimate
from rig.identification.measurements import Measurements
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries


class Estimator(Protocol):
    """From measurements to an estimate with a verdict.

    name               its name in commands, results and reports
    reads_relay_tests  True: it reads relay tests, or any drive of a plain file; False: runs of hysteretic relays
    """

    name: str
    reads_relay_tests: bool = True

    def series(self, data: Measurements) -> Sequence[TimeSeries]:
        """The series that it reads. Without any, the estimator is left out, unless the caller asked for it by name."""
        return data.tests if self.reads_relay_tests else data.hysteretic

    def applies(self, data: Measurements) -> IdentifyError | None:
        """Why it cannot work on these measurements, and what to record for it; None if it can."""
        return None

    @abstractmethod
    def fit(self, data: Measurements) -> Estimate:
        """The estimate; its verdict is "ok" unless the fit failed. Raises IdentifyError if nothing can be fitted."""

    @abstractmethod
    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        """The estimate with its verdict and reasons. plausibility.py judges units, columns and gaps for all estimators.

        earlier  estimates of the estimators before it in the list, by name
        Raises IdentifyError if the data are too short for a judgement.
        """

    def notes(self, estimate: Estimate, data: Measurements) -> list[str]:
        """Further sentences for the user. They change no verdict."""
        return []
