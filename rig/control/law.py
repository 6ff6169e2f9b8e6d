"""The interface of a law, which turns each sample into a drive; the two simplest; laws that a config names.

A package offers a law in its pyproject.toml:

    [project.entry-points."rig.laws"]
    pid = "mypackage.laws:Pid"

It is a class, or a function, that takes the config's ``law.options`` by name and gives an ``OwnLaw``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from types import FrameType
from typing import Protocol, runtime_checkable

from rig.core.faults import Fault
from rig.core.plug_ins import OptionError, PlugInError, imported, in_words, offered, require_options
from rig.core.signals import Sample

GROUP = "rig.laws"
TUNED = "tuned"
OWN = {TUNED: EntryPoint(TUNED, "rig.control.tuned:tuned", GROUP)}  # of rig itself


class Law(Protocol):
    """A control law. The loop calls ``step`` once a tick until ``finished``.

    z_rad_s (integral of the position) and yd_rad (reference) are recorded beside the drive; nan if the law has none.
    """

    z_rad_s: float
    yd_rad: float

    @property
    def finished(self) -> bool:
        """Whether the law has ended."""

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V. Raises Fault if the law finds something wrong with the bench."""


@runtime_checkable
class Pulsed(Law, Protocol):
    """A law whose drives must not outlast a time: a device that can ends them by itself."""

    @property
    def pulse_s(self) -> float:
        """How long the drive that was just decided may act at most, s; 0.0: it may go on."""


class OwnLaw(Protocol):
    """A law of a user's own: all that it must have is ``step``.

    It may have three attributes more. ``finished``: true ends it. ``z_rad_s`` (an integral of its own, rad s) and
    ``yd_rad`` (the reference, rad) are recorded.
    """

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V. The guard has the last word: the device may get less."""


class BareLaw:
    """What a law begins as: no integral, no reference, not finished; its time counts from its first sample."""

    z_rad_s = math.nan
    yd_rad = math.nan
    finished = False
    _first_s = math.nan

    def _elapsed_s(self, sample: Sample) -> float:
        """Time since the first sample, s."""
        if math.isnan(self._first_s):
            self._first_s = sample.t_s
        return sample.t_s - self._first_s


class Rest(BareLaw):
    """0 V for a given time, s: the shaft coasts to a stop."""

    def __init__(self, duration_s: float) -> None:
        self.duration_s = duration_s

    def step(self, sample: Sample) -> float:
        """Return 0 V; finished once ``duration_s`` has passed since the first sample."""
        self.finished = self._elapsed_s(sample) >= self.duration_s
        return 0.0


class Constant(BareLaw):
    """A constant drive for a given time: `rig jog`."""

    def __init__(self, u_V: float, duration_s: float) -> None:
        self.u_V = u_V
        self._rest = Rest(duration_s)

    def step(self, sample: Sample) -> float:
        """Return the constant drive, V, and 0 V once the time is over."""
        self._rest.step(sample)
        self.finished = self._rest.finished
        return 0.0 if self.finished else self.u_V


class Stopped(BaseException):
    """Raised out of a law of a user's own while it runs: the run ends with ``fault``. No law has to know it."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        super().__init__(str(fault))


def is_of_own_law(frame: FrameType | None) -> bool:
    """Whether a frame is code of a user's own law, at work for ``Timed``: only there a signal may raise ``Stopped``.

    What the loop itself does is in no such frame, nor is the way from the law back to the loop.
    """
    while frame is not None:
        frame = frame.f_back
        if frame is not None and frame.f_code is Timed._asked.__code__:
            return True
    return False


class Timed(BareLaw):
    """A law of a user's own, for a given time at most; 0 V once it has ended.

    law         the user's object; it gets each sample from its first tick on
    duration_s  longest time, s, > 0; ``finished`` of the law can end it sooner
    name        its name in the recording
    Raises ValueError if the time is not > 0 or is infinite, or if ``law`` has no ``step``.
    """

    def __init__(self, law: OwnLaw, duration_s: float, name: str) -> None:
        if not callable(getattr(law, "step", None)):
            raise ValueError(f"{name} is no law: it has no method step(sample) that returns volts")
        if not 0.0 < duration_s < math.inf:
            raise ValueError(f"the law {name} needs a duration > 0 s that ends, not {duration_s}")
        self.law = law
        self.duration_s = duration_s
        self.name = name
        self._rest = Rest(duration_s)

    def step(self, sample: Sample) -> float:
        """Return the law's drive, V.

        Raises Fault LAW_FAILED, with the law's exception as its cause; the fault of ``Stopped``; KeyboardInterrupt.
        """
        self._rest.step(sample)
        self.finished = self._rest.finished
        if self.finished:
            return 0.0
        try:
            u_V = self._asked(sample)
        except (Fault, KeyboardInterrupt):
            raise
        except Stopped as stopped:
            raise stopped.fault from None
        except BaseException as error:  # whatever it is, SystemExit too, the user's law did it
            raise Fault("LAW_FAILED", f"{self.name}: {in_words(error)}") from error
        return 0.0 if self.finished else u_V

    def _asked(self, sample: Sample) -> float:
        """The user's code, and nothing else: each attribute may be a property (``is_of_own_law``)."""
        u_V = float(self.law.step(sample))
        self.z_rad_s = float(getattr(self.law, "z_rad_s", math.nan))
        self.yd_rad = float(getattr(self.law, "yd_rad", math.nan))
        self.finished = bool(getattr(self.law, "finished", False))
        return u_V


def registered() -> dict[str, EntryPoint]:
    """What rig and installed packages offer, by name. Raises PlugInError if two packages offer the same name."""
    return offered(GROUP, "law", entry_points) | OWN


def named_law(name: str, options: Mapping[str, object]) -> OwnLaw:
    """A law by its name, made anew with these options.

    Raises LookupError, which lists the known laws, if none has that name; OptionError if it does not take the options;
    PlugInError if it cannot be imported, fails in another way, or is no law.
    """
    known = registered()
    if name not in known:
        listed = ", ".join(sorted(known)) or "none is installed"
        raise LookupError(f"no law {name!r} in entry point group {GROUP!r}; known: {listed}")
    who, make = imported(known[name], "law")
    if not callable(make):
        raise PlugInError(f"{who} is neither a class nor a function")
    require_options(make, who, options)
    try:
        law: OwnLaw = make(**options)
    except ValueError as error:
        raise OptionError(f"{who}: {error}") from error
    except Exception as error:  # whatever it is, the other package did it
        raise PlugInError(f"{who} cannot be constructed: {in_words(error)}") from error
    if not callable(getattr(law, "step", None)):
        raise PlugInError(f"{who} has no method step(sample) that returns volts")
    return law
