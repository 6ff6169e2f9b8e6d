"""The relay loop in continuous time: u = -h1 sgn(y) - h2 sgn(z), switched at the very instants of the crossings.

Nothing is sampled and nothing is stepped. A motion under constant drive comes in pieces within which the velocity keeps
its sign (``shared.physics.pieces``), so within each the position is monotone, and between its zeros so is its integral:
no crossing can be missed, and each is found by bracketing to rounding. For any friction law, from any state; the cycle
that it settles in is that of Theorem 2.1, where the law is Coulomb's. With hysteresis on the position and h2 = 0 it is
the single hysteretic relay of docs/theory.md 5.1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from rig.model.limit_cycle import NoLimitCycle
from rig.model.motor import Motor, State
from shared.physics import Glide, Piece, pieces

Array = NDArray[np.float64]
Kind = Literal["velocity", "position", "integral", "held"]
End = Literal["time", "held", "chatter"]

LOOK_AHEAD = 20.0  # tau: length of the motion in which crossings are looked for at a time
PATIENCE = 1e4  # tau
CHATTER = 1e-9  # tau: relays that switch faster, CHATTERS times in a row, have come to rest on their plane
CHATTERS = 6
SIMPLE: tuple[Kind, ...] = ("velocity", "position", "integral")  # RA, RB, RC: each once a half period


class Relay(NamedTuple):
    """u = -h1 s_y - h2 s_z.

    h1_V, h2_V       gains, V, >= 0
    hysteresis_rad   s_y becomes +1 when y exceeds it, -1 when y falls below its negative; 0: s_y = sgn(y)
    A sign of exactly 0 keeps the previous one (docs/theory.md 2.2).
    """

    h1_V: float
    h2_V: float = 0.0
    hysteresis_rad: float = 0.0


class Event(NamedTuple):
    """Something that happened at an instant.

    kind    "velocity" reverses (RA), "position" (RB) or "integral" (RC) crosses its plane and its relay switches;
            "held": the velocity has come to zero and friction holds the motor
    state   then, with what crosses exactly 0 (or on the hysteresis)
    u_V     drive from then on
    """

    t_s: float
    kind: Kind
    state: State
    u_V: float


class Step(NamedTuple):
    """A piece of motion from ``begin_s`` on under the drive ``u_V``, and the event that ends it, if one does."""

    begin_s: float
    u_V: float
    piece: Piece
    event: Event | None


@dataclass(frozen=True)
class RelayRun:
    """A run of the loop: its motion, piece by piece.

    steps   without gaps from 0 s on
    end     why it is over: "time"; "held": friction holds the motor, and no relay will switch; "chatter": the relay
            switches ever faster: the motor has come to rest on its plane
    """

    steps: tuple[Step, ...]
    end: End

    @property
    def events(self) -> tuple[Event, ...]:
        """Everything that happened, in order."""
        return tuple(step.event for step in self.steps if step.event is not None)

    @property
    def duration_s(self) -> float:
        """Time of its end, s."""
        last = self.steps[-1]
        return last.begin_s + last.piece.duration_s

    def states(self, t_s: Array) -> Array:
        """(n, 3): v, y, z at the times ``t_s`` (n, s). Raises ValueError outside the run."""
        steps = [self.steps[k] for k in self._at(t_s)]
        rows = [step.piece.at(t - step.begin_s) for step, t in zip(steps, t_s.tolist(), strict=True)]
        return np.array(rows, dtype=float).reshape(-1, 3)

    def drive_V(self, t_s: Array) -> Array:
        """(n,): drive at the times ``t_s``; at a switching, the one after it. Raises ValueError outside the run."""
        return np.array([self.steps[k].u_V for k in self._at(t_s)])

    def _at(self, t_s: Array) -> NDArray[np.intp]:
        if t_s.size and not (t_s.min() >= 0.0 and t_s.max() <= self.duration_s):
            raise ValueError(f"times must lie within the run, 0 to {self.duration_s:g} s")
        begins = np.array([step.begin_s for step in self.steps])
        return np.searchsorted(begins, t_s, side="right") - 1


class HalfPeriod(NamedTuple):
    """From one switching of the integral's relay to the next, mirrored so that the drive is +h1 + h2 at its start.

    start_s        of the first
    durations_s    from each event to the next: t1, t2, t3 where ``is_simple``
    kinds          of the events: ("velocity", "position", "integral") where ``is_simple``
    start          state at its start, mirrored likewise: y < 0
    y_events_rad   position at the start and at each event, mirrored likewise: y(0), y(t1), 0, y(T/2)
    """

    start_s: float
    durations_s: tuple[float, ...]
    kinds: tuple[Kind, ...]
    start: State
    y_events_rad: tuple[float, ...]

    @property
    def is_simple(self) -> bool:
        """Each relay switches once, RA, RB, RC, and friction holds the motor nowhere (docs/theory.md 3.1)."""
        return self.kinds == SIMPLE

    @property
    def duration_s(self) -> float:
        """T/2, s."""
        return sum(self.durations_s)


def ideal_relay(
    motor: Motor, relay: Relay, start: State, duration_s: float, signs: tuple[float, float] = (1.0, 1.0)
) -> RelayRun:
    """Run the loop for ``duration_s`` (s, > 0) from ``start``.

    signs   s_y and s_z, +-1, where ``start`` does not decide them: it is on the plane, or within the hysteresis
    Raises ValueError on gains, hysteresis or a duration out of range.
    """
    loop = _Loop(motor, relay, start, signs)
    if not 0.0 < duration_s < math.inf:
        raise ValueError("duration_s must be > 0 and finite")
    steps = tuple(loop.steps(duration_s))
    return RelayRun(steps, "chatter" if loop.chatters else "held" if loop.held else "time")


def half_periods(events: tuple[Event, ...]) -> list[HalfPeriod]:
    """The half periods that the events complete, in order."""
    found = []
    edges = [k for k, event in enumerate(events) if event.kind == "integral"]
    for a, b in pairwise(edges):
        found.append(_half_period(events[a : b + 1]))
    return found


def settled_cycle(
    motor: Motor, h1_V: float, h2_V: float, start: State, tolerance: float = 1e-12, most: int = 500
) -> HalfPeriod:
    """The half period that the dual-channel relay loop settles in from ``start``.

    tolerance   largest change of state from one half period to the next, relative to the largest speed and position
                within it
    most        half periods that are waited for, and switchings within one of them
    Raises NoLimitCycle with the reason if it does not settle: the motor comes to rest, or the cycle keeps changing.
    """
    loop = _Loop(motor, Relay(h1_V, h2_V), start, (1.0, 1.0))
    events: list[Event] = []
    last: HalfPeriod | None = None
    number = 0
    for step in loop.steps(math.inf):
        if step.event is None:
            if step.begin_s > (events[-1].t_s if events else 0.0) + PATIENCE * motor.tau_eff_s:
                raise NoLimitCycle(f"no relay switches within {PATIENCE:g} tau: the motor runs away, or all but rests")
            continue
        events.append(step.event)
        if step.event.kind != "integral":
            # Where h1 > h2 + fc the position's relay alone can draw the motor to y = 0, without friction ever slower.
            if len(events) > most:
                raise NoLimitCycle(
                    f"{most} switchings without one of the integral's relay: the motor comes to rest on y = 0"
                )
            continue
        if events[0].kind == "integral" and len(events) > 1:
            half = _half_period(tuple(events))
            slow = half.duration_s > CHATTER * motor.tau_eff_s
            if last is not None and slow and half.kinds == last.kinds and _change(half, last) <= tolerance:
                return half
            last = half
            number += 1
            if number > most:
                raise NoLimitCycle(f"no two half periods in a row were alike within {most}")
        events = [step.event]
    if loop.held:
        raise NoLimitCycle(f"friction holds the motor at y = {loop.state.y:.3g} rad for good: it sticks")
    raise NoLimitCycle("the relays switch ever faster: the motor comes to rest on the switching plane")


class _Loop:
    """The loop in progress."""

    def __init__(self, motor: Motor, relay: Relay, start: State, signs: tuple[float, float]) -> None:
        if not (min(relay) >= 0.0 and math.isfinite(sum(relay))):
            raise ValueError("h1, h2 and the hysteresis must be >= 0")
        if not (set(signs) <= {1.0, -1.0} and math.isfinite(sum(start))):
            raise ValueError("signs must be +1 or -1, and the start finite")
        self.motor, self.relay, self.state = motor, relay, start
        self.sign_y = math.copysign(1.0, start.y) if abs(start.y) > relay.hysteresis_rad else signs[0]
        self.sign_z = math.copysign(1.0, start.z) if start.z != 0.0 else signs[1]
        self.now_s = 0.0
        self.chatters = False
        self.held = False

    @property
    def u_V(self) -> float:
        return -self.relay.h1_V * self.sign_y - self.relay.h2_V * self.sign_z

    def steps(self, duration_s: float) -> Iterator[Step]:
        """The motion up to ``duration_s``, or until it chatters; where that is infinite, until it is held for good."""
        tau = self.motor.tau_eff_s
        fast, last_s = 0, -math.inf
        while self.now_s < duration_s and not self.chatters and not (self.held and math.isinf(duration_s)):
            step = None
            for step in self._until_switching(min(LOOK_AHEAD * tau, duration_s - self.now_s)):
                yield step
                self.now_s = step.begin_s + step.piece.duration_s
            if step is None:
                return
            if step.event is None:
                y_says = self.sign_z * self.state.y  # the integral moves away from zero, or not at all
                self.held = _is_rest(step.piece) and (self.relay.h2_V == 0.0 or y_says >= 0.0)
            else:
                fast = fast + 1 if self.now_s - last_s < CHATTER * tau else 0
                last_s = self.now_s
                self.chatters = fast >= CHATTERS

    def _until_switching(self, span_s: float) -> Iterator[Step]:
        u_V, begin_s = self.u_V, self.now_s
        for piece, following in _with_next(pieces(self.motor, self.state, u_V, span_s)):
            crossing = self._first_crossing(piece)
            if crossing is not None:
                h, kind = crossing
                state = piece.at(h)
                if kind == "position":
                    state = state._replace(y=-self.sign_y * self.relay.hysteresis_rad)
                    self.sign_y = -self.sign_y
                else:
                    state = state._replace(z=0.0)
                    self.sign_z = -self.sign_z
                self.state = state
                yield Step(begin_s, u_V, piece._replace(duration_s=h), Event(begin_s + h, kind, state, self.u_V))
                return
            event = None
            self.state = piece.at(piece.duration_s) if following is None else following.start
            if following is not None and following.start.v == 0.0 and not _is_rest(piece):
                what: Kind = "held" if _is_rest(following) else "velocity"
                event = Event(begin_s + piece.duration_s, what, self.state, u_V)
            yield Step(begin_s, u_V, piece, event)
            begin_s += piece.duration_s

    def _first_crossing(self, piece: Piece) -> tuple[float, Kind] | None:
        """When a relay first switches within a piece, and which; None if none does."""
        plane = -self.sign_y * self.relay.hysteresis_rad

        def above(h: float) -> float:
            return self.sign_y * (piece.at(h).y - plane)

        def integral(h: float) -> float:
            return self.sign_z * piece.at(h).z

        end = piece.duration_s
        kind: Kind | None = None
        if above(end) < 0.0:
            end, kind = _zero(above, 0.0, end), "position"
        if self.relay.h2_V > 0.0:
            # the integral is monotone on each side of the position's zero, which hysteresis may let pass
            knots = [0.0, end]
            if piece.start.y * piece.at(end).y < 0.0:
                knots.insert(1, _zero(lambda h: piece.at(h).y, 0.0, end))
            for a, b in pairwise(knots):
                if integral(b) < 0.0:
                    return _zero(integral, a, b), "integral"
        return None if kind is None else (end, kind)


def _with_next(all_pieces: Iterator[Piece]) -> Iterator[tuple[Piece, Piece | None]]:
    """Each piece with the one after it."""
    piece = next(all_pieces, None)
    while piece is not None:
        following = next(all_pieces, None)
        yield piece, following
        piece = following


def _is_rest(piece: Piece) -> bool:
    """Whether friction holds the motor during the piece."""
    return isinstance(piece, Glide) and piece.start.v == 0.0 == piece.target


def _zero(function: Callable[[float], float], a: float, b: float) -> float:
    """The zero of a monotone function between a and b, to rounding."""
    at_a = function(a)
    if at_a == 0.0 or (at_a > 0.0) == (function(b) > 0.0):
        return a
    return float(brentq(function, a, b, xtol=1e-17 * b, rtol=1e-15, maxiter=500))


def _half_period(events: tuple[Event, ...]) -> HalfPeriod:
    """From its first event, a switching of the integral's relay, to its last, the next."""
    first = events[0]
    mirror = 1.0 if first.u_V > 0.0 else -1.0
    times = [event.t_s for event in events]
    return HalfPeriod(
        first.t_s,
        tuple(b - a for a, b in pairwise(times)),
        tuple(event.kind for event in events[1:]),
        State(*(mirror * value for value in first.state)),
        tuple(mirror * event.state.y for event in events),
    )


def _change(half: HalfPeriod, last: HalfPeriod) -> float:
    size_rad = max(map(abs, half.y_events_rad))
    speed = max(abs(half.start.v), size_rad / half.duration_s)
    return max(abs(half.start.v - last.start.v) / speed, abs(half.start.y - last.start.y) / size_rad)
