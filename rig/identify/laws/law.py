"""The interface of a friction law, for the fit and for the choice. Each law is one file, and one entry of ``LAWS``.

All laws have tau, K, fc and an unknown delay. All but plain Coulomb friction have the asymmetry asym. A law's further
parameters are its ``parameters``. The vector ``own`` holds their values in the units of the fit: natural logarithms for
logarithmic ones. The first is the law's strength: at 0 the law is asymmetric Coulomb friction.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rig.identify.breakaway import Ramps
from rig.model.sensitivity import Theta
from rig.recording.series import Window

Array = NDArray[np.float64]
Range = tuple[float, float]

CLEAR = 10.0  # decisive difference of criterion ("very strong", Kass & Raftery, J. Am. Stat. Assoc. 90, 1995)
SECOND_AMPLITUDE = "record a second relay test of another amplitude"


class LawParameter(NamedTuple):
    """A parameter of a law beyond tau, K, fc, asym and delay.

    name         with its unit
    step         of forward differences, in the fit's unit
    logarithmic  whether its logarithm is fitted
    fitted       True: least squares fits it; False: it is only scanned, because the motion depends on it in steps
    """

    name: str
    step: float
    logarithmic: bool = False
    fitted: bool = True


class LawNumber(NamedTuple):
    """A number that a law reports.

    name     as in ``Values``, with its unit
    unit     for people
    meaning  in words
    """

    name: str
    unit: str
    meaning: str


STATIC_LEVEL = LawNumber("fs_V", "V", "static friction")


@dataclass(frozen=True)
class Plain:
    """The fit of asymmetric Coulomb friction to the tests. A law starts from it.

    positions_rad  predicted positions of each window, rad
    """

    windows: Sequence[Window]
    fc_V: float
    asym_V: float
    positions_rad: Sequence[Array]

    @cached_property
    def largest_V(self) -> float:
        """Largest drive, V."""
        return max(float(np.abs(window.steps.u_V).max()) for window in self.windows)

    @cached_property
    def top_rad_s(self) -> float:
        """Largest speed, rad/s."""
        pairs = zip(self.positions_rad, self.windows, strict=True)
        return max(float(np.abs(np.diff(y) / np.diff(window.t_s)).max()) for y, window in pairs)


class Values(NamedTuple):
    """Parameters for the result, and their standard errors, by name."""

    parameters: dict[str, float]
    errors: dict[str, float]


class Fitted(Protocol):
    """A fitted law, for its ``report``."""

    def value(self, name: str) -> float:
        """A parameter in its unit."""

    def error(self, *names: str) -> float | None:
        """Standard error of a parameter, or of the sum of several; None if one of them is not fitted."""


class Doubt(NamedTuple):
    """Why the tests cannot decide between a law and the chosen one, and what to record instead."""

    reason: str
    record: str


class LawComparison(NamedTuple):
    """A law compared with the simpler one that is chosen so far.

    title   of the law
    gained  its gain, as words
    gain    of the criterion
    seen    whether the tests depend on the parameters that the law adds
    ramps   static levels from breakaway ramps; None without ramps
    """

    title: str
    gained: str
    gain: float
    seen: bool
    ramps: Ramps | None


class CandidateLaw(Protocol):
    """A candidate friction law.

    name              its name in results
    title             its name in sentences
    adds              its name in tables, below the simpler laws; default: the title
    asymmetric        whether the two directions may differ
    parameters        its further parameters; () for Coulomb friction
    reports           the numbers of its ``report``: each has a row in terminal, report and result.json
    has_static_level  whether it holds the motor at rest more strongly than in motion
    confounded_with   parameters and laws that one kind of motion cannot separate from it
    """

    name: str
    title: str
    adds: str = ""
    asymmetric: bool = True
    parameters: tuple[LawParameter, ...] = ()
    reports: tuple[LawNumber, ...] = ()
    has_static_level: bool = False
    confounded_with: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number of its parameters without the delay. The richer law has more."""
        return 3 + self.asymmetric + len(self.parameters)

    @abstractmethod
    def position(self, theta: Theta, own: Sequence[float], window: Window) -> Array:
        """The predicted positions of a window, rad. ``own``: its own parameters, in the fit's units."""

    def position_and_jacobian(self, theta: Theta, own: Sequence[float], window: Window) -> tuple[Array, Array] | None:
        """``position`` for ``own``, and its derivatives by ``Theta``, (n, 7). None: the fit takes differences."""
        return None

    def trials(self, plain: Plain) -> list[list[float]]:
        """Values of ``own`` to start from or to scan. The fit finds the first strength from the residual."""
        return [[0.0] * len(self.parameters)]

    def ranges(self, plain: Plain) -> list[Range]:
        """Range of each parameter, in the fit's unit."""
        return [(0.0, plain.largest_V)] * len(self.parameters)

    def known(self, plain: Plain, ramps: Ramps | None) -> list[float] | None:
        """``own`` from the breakaway ramps; None if they do not show it."""
        return None

    def report(self, fit: Fitted, ramps: Ramps | None) -> Values:
        """Its own parameters, those that were fitted."""
        own = {p.name: fit.error(p.name) for p in self.parameters}
        errors = {name: error for name, error in own.items() if error is not None}
        return Values({name: fit.value(name) for name in errors}, errors)

    def needs(self, against: LawComparison) -> str | Doubt | None:
        """A first check, before criterion and prediction: a sentence that decides for the law, a doubt, or None."""
        return None

    def from_one_amplitude(self, against: LawComparison) -> str | Doubt | None:
        """The decision without a test of another amplitude: as ``needs``. None: the law is not needed."""
        if against.gain <= CLEAR:
            return None
        return Doubt(f"{against.gained}, without a second amplitude", SECOND_AMPLITUDE)
