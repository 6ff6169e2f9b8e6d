"""What a friction law is, to the fit and to the choice. Each is a file of its own and one entry of ``LAWS``.

All laws have tau, K, fc and, where it is not known, the delay; all but plain Coulomb friction have the asymmetry asym.
What a law has beyond these is its ``parameters``. Their vector is called ``own`` here, in the fit's units: natural
logarithms where a parameter says so. The first is the law's strength: at 0 the law is asymmetric Coulomb friction.
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

CLEAR = 10.0  # difference of criterion that decides ("very strong", Kass & Raftery, J. Am. Stat. Assoc. 90, 1995)
SECOND_AMPLITUDE = "record a second relay test of another amplitude"


class LawParameter(NamedTuple):
    """One that a law has beyond tau, K, fc, asym and delay.

    name         with its unit
    step         of forward differences, in the fit's unit
    logarithmic  whether its logarithm is fitted
    fitted       by least squares; else it is only scanned: the motion depends on it in steps
    """

    name: str
    step: float
    logarithmic: bool = False
    fitted: bool = True


@dataclass(frozen=True)
class Plain:
    """The tests as asymmetric Coulomb friction explains them: what a law starts from.

    positions_rad  of each window, predicted
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
    """Parameters as a result reports them, and their standard errors, by name."""

    parameters: dict[str, float]
    errors: dict[str, float]


class Fitted(Protocol):
    """A law that was fitted, as its ``report`` reads it."""

    def value(self, name: str) -> float:
        """A parameter in its unit."""

    def error(self, *names: str) -> float | None:
        """Standard error of a parameter, or of the sum of several; None where one is not fitted."""


class Doubt(NamedTuple):
    """Why a law cannot be told from the chosen one, and what to record instead."""

    reason: str
    record: str


class LawComparison(NamedTuple):
    """A law beside the simpler one that is chosen so far.

    title   of the law; gained   what it gains, in words
    gain    of the criterion
    seen    whether the tests depend on what the law adds
    ramps   static levels from breakaway ramps, if there are any
    """

    title: str
    gained: str
    gain: float
    seen: bool
    ramps: Ramps | None


class CandidateLaw(Protocol):
    """A friction law that may be what the data ask for.

    name              as results have it
    title             in words
    asymmetric        whether the two directions may differ
    parameters        what it adds; () for Coulomb friction
    has_static_level  whether it holds the motor at rest more strongly than in motion
    confounded_with   parameters and laws that look like it from one kind of motion
    """

    name: str
    title: str
    asymmetric: bool = True
    parameters: tuple[LawParameter, ...] = ()
    has_static_level: bool = False
    confounded_with: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number of its parameters, an unknown delay not counted: the larger is the richer law."""
        return 3 + self.asymmetric + len(self.parameters)

    @abstractmethod
    def position(self, theta: Theta, own: Sequence[float], window: Window) -> Array:
        """Its part of the model: the positions of a window, rad."""

    def position_and_jacobian(self, theta: Theta, own: Sequence[float], window: Window) -> tuple[Array, Array] | None:
        """The same with the derivatives by ``Theta``, (n, 7); None: they are taken by differences."""
        return None

    def trials(self, plain: Plain) -> list[list[float]]:
        """Values of ``own`` to start from, or to scan. The strength to start from follows from the residual."""
        return [[0.0] * len(self.parameters)]

    def ranges(self, plain: Plain) -> list[Range]:
        """Range of each parameter, in the fit's unit."""
        return [(0.0, plain.largest_V)] * len(self.parameters)

    def known(self, plain: Plain, ramps: Ramps | None) -> list[float] | None:
        """``own`` where the breakaway record gives it; None where it does not."""
        return None

    def report(self, fit: Fitted, ramps: Ramps | None) -> Values:
        """Its own parameters, as far as they were fitted."""
        own = {p.name: fit.error(p.name) for p in self.parameters}
        errors = {name: error for name, error in own.items() if error is not None}
        return Values({name: fit.value(name) for name in errors}, errors)

    def needs(self, against: LawComparison) -> str | Doubt | None:
        """What it takes before criterion and prediction are asked: a sentence that decides for it, or a doubt."""
        return None

    def from_one_amplitude(self, against: LawComparison) -> str | Doubt | None:
        """The same where there is no test of another amplitude to be predicted; None: it is not needed."""
        if against.gain <= CLEAR:
            return None
        return Doubt(f"{against.gained}, without a second amplitude", SECOND_AMPLITUDE)
