"""The law `tuned`: a loop that `rig tune` made, on a program of moves, steps and a trajectory. A config can name it.

Its options are plain numbers, so that the config in the run folder says all that a replay needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, get_args

from rig.control.observer import MotorObserver
from rig.control.set_point import InTurn, MoveTo, PositionStep, Program, Sines, SpeedSteps
from rig.control.state_feedback import DriveLimits, Gains, Loop, StateFeedback
from rig.model.real_motor import FramedMotor

_OBSERVER: Final = ("period_s", "noise_rad", "latency_s", "further_s")
_GAINS: Final = ("speed_1_s", "place_1_s2", "integral")
_LIMITS: Final = ("largest_V", "shown_rad")


def tuned(
    loop: str,
    motor: Mapping[str, float],
    observer: Mapping[str, float],
    gains: Mapping[str, float],
    limits: Mapping[str, float],
    program: Sequence[Mapping[str, Any]],
) -> StateFeedback:
    """The loop, made anew.

    loop      position or velocity
    motor     numbers of motor and frame, by their names in an export
    observer  period_s, noise_rad, latency_s (that the device reports), further_s (that it does not)
    gains     speed_1_s, place_1_s2, integral
    limits    largest_V, shown_rad
    program   parts in turn: see ``program_of``
    Raises ValueError for what is missing, unknown or out of range.
    """
    if loop not in get_args(Loop):
        raise ValueError(f"loop must be one of {', '.join(get_args(Loop))}, not {loop!r}")
    known: Loop = "position" if loop == "position" else "velocity"
    framed = FramedMotor.of({name: float(value) for name, value in motor.items()})
    watch, of_gains, bounds = (
        _numbers(what, given, names)
        for what, given, names in (
            ("observer", observer, _OBSERVER),
            ("gains", gains, _GAINS),
            ("limits", limits, _LIMITS),
        )
    )
    if not watch["period_s"] > 0.0 or not watch["noise_rad"] > 0.0 or not bounds["largest_V"] > 0.0:
        raise ValueError("the period_s and noise_rad of observer, and the largest_V of limits, must be > 0")
    observed = MotorObserver(framed, watch["period_s"], watch["noise_rad"])
    observed.latency_s, observed.further_s = watch["latency_s"], watch["further_s"]
    return StateFeedback(framed, observed, Gains(known, **of_gains), program_of(program), DriveLimits(**bounds))


def program_of(parts: Sequence[Mapping[str, Any]]) -> InTurn:
    """A program from its parts, each a mapping with ``kind`` and the arguments of that kind's class.

    Kinds: move, step, speeds, sines. Raises ValueError for others, and for arguments that do not fit.
    """
    if not parts:
        raise ValueError("program has no parts")
    return InTurn([_part(one) for one in parts])


def _part(given: Mapping[str, Any]) -> Program:
    arguments = {name: value for name, value in given.items() if name != "kind"}
    kind = given.get("kind")
    if kind not in KINDS:
        raise ValueError(f"program: a part's kind is one of {', '.join(KINDS)}, not {kind!r}")
    try:
        made = KINDS[kind](**arguments)
        duration_s = float(made.duration_s)
    except TypeError as error:
        raise ValueError(f"program: {kind}: {error}") from error
    if not duration_s > 0.0:
        raise ValueError(f"program: {kind}: it must last longer than 0 s")
    return made


KINDS: Final[dict[str, Callable[..., Program]]] = {
    "move": MoveTo,
    "step": PositionStep,
    "speeds": SpeedSteps,
    "sines": Sines,
}


def _numbers(what: str, given: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
    """All numbers that ``what`` must have. Raises ValueError."""
    if set(given) != set(names):
        raise ValueError(f"{what} needs {', '.join(names)}; it has {', '.join(given) or 'none'}")
    return {name: float(given[name]) for name in names}
