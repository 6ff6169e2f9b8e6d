"""Who advises while tests run: the loop's own process, another one, or a recording (docs/until.md)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Protocol

from rig.backends.clock import MonotonicClock
from rig.control.guard import Guard
from rig.design.advisor import Advice, Advisor, AdvisorSettings
from rig.design.planned_test import Design
from rig.identification.live import NORMAL_95, LiveSettings
from rig.identification.noise import noise_at_rest
from rig.identification.stated_errors import StatedErrors
from rig.model.real_motor import FramedMotor
from rig.running.experiment.live_process import ADVICE_EVERY_S, LiveProcess
from rig.running.preflight.planned_tests import reading_of, room_of_tests
from rig.running.session import Session

SMALLEST_TURN_LSB = 20.0  # as a relay test's smallest cycle


class Advisers(Protocol):
    """Who advises: in virtual time the loop's own process, in real time another one, in a replay the recording."""

    @property
    def trouble(self) -> str:
        """What is wrong with it, in words; empty if nothing is."""

    @property
    def last_words(self) -> str:
        """What it wrote last before it failed; empty without that."""

    def begin(self, settings: AdvisorSettings) -> None:
        """The breakaway check of a run is over: this is what it showed. A replay does not say it."""

    def advice(self, row: int, t_s: float) -> Advice | None:
        """New advice after row number ``row``, which was sampled at ``t_s``; never waits."""

    def braked(self) -> None:
        """The guard had to brake in the last designed test: the next ones must use less room."""


class InTheLoop:
    """The advisor in the loop's own process, at fixed times of the run: for virtual time, which waits for it.

    session  whose rows it reads
    """

    trouble = last_words = ""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._advisor: Advisor | None = None
        self._due_s = -math.inf

    def begin(self, settings: AdvisorSettings) -> None:
        """As ``Advisers``."""
        self._advisor = Advisor(settings)

    def advice(self, row: int, t_s: float) -> Advice | None:
        """As ``Advisers``: once in ``ADVICE_EVERY_S``."""
        if self._advisor is None or t_s < self._due_s:
            return None
        self._due_s = t_s + ADVICE_EVERY_S
        self._session.recorder.drain()
        self._advisor.take(self._session.read())
        return self._advisor.advise()

    def braked(self) -> None:
        """As ``Advisers``."""
        self._due_s = -math.inf
        if self._advisor is not None:
            self._advisor.braked()


class AtTurns:
    """The advice of another, whose tests begin where the shaft turns or stands.

    A test is designed for a shaft that begins at rest, anywhere in the room. In its own process the design takes a
    while. Meanwhile the shaft moves on, and a test that begins in full motion may swing farther than designed.

    of     who advises
    guard  of the loop: it knows the velocity
    """

    def __init__(self, of: Advisers, guard: Guard) -> None:
        self._of, self._guard = of, guard
        self._design: Design | None = None  # it waits for a turn
        self._before_rad_s = math.nan  # velocity at the row before

    @property
    def trouble(self) -> str:
        """As ``Advisers``."""
        return self._of.trouble

    @property
    def last_words(self) -> str:
        """As ``Advisers``."""
        return self._of.last_words

    def begin(self, settings: AdvisorSettings) -> None:
        """As ``Advisers``."""
        self._of.begin(settings)

    def advice(self, row: int, t_s: float) -> Advice | None:
        """As ``Advisers``: the estimate and the end at once, a test once the shaft turns."""
        new = self._of.advice(row, t_s)
        if new is not None and (new.stop is not None or new.design is not None or new.rest_s > 0.0):
            self._design = new.design
        v_rad_s, before_rad_s = self._guard.velocity_rad_s, self._before_rad_s
        self._before_rad_s = v_rad_s
        if self._design is None or not v_rad_s * before_rad_s <= 0.0:
            return new if new is None else replace(new, design=None)
        design, self._design = self._design, None
        return Advice(None, design) if new is None else replace(new, design=design)

    def braked(self) -> None:
        """As ``Advisers``: a test that waits was designed for more room."""
        self._design = None
        self._of.braked()


@contextmanager
def advisers_of(session: Session) -> Iterator[Advisers]:
    """Who advises in a run: in real time another process, which ends with the block."""
    guard = session.loop.guard
    if isinstance(session.bench.clock, MonotonicClock):
        with closing(LiveProcess(session.folder)) as process:
            yield AtTurns(process, guard)
    else:
        yield AtTurns(InTheLoop(session), guard)


def advisor_settings(session: Session, known: FramedMotor | None) -> AdvisorSettings:
    """What the advisor has to know, after the breakaway check. Raises ValueError without one."""
    e, check = session.experiment, session.found.breakaway
    if check is None or e.relay.until is None:
        raise ValueError("tests until the motor is known need relay.until and a breakaway check")
    session.recorder.drain()
    noise = noise_at_rest(session.read())
    # a delay that no device reports is fitted, from the sample on: then nothing comes to it
    late = session.delay is not None and session.delay.is_shown
    return AdvisorSettings(
        e.relay.until.interval_percent,
        LiveSettings(
            period_s=e.period_s,
            noise_rad=noise.std_rad,
            lsb_rad=e.sensor.curve.lsb_rad,
            largest_V=e.drive.max_V,
            prior=known,
            stated=StatedErrors.of(session.meta),
            prior_percent=e.relay.until.model_doubt_percent / NORMAL_95,
            delay_s=session.delay.range_s if session.delay is not None and late else None,
        ),
        room_of_tests(e, check.moves_V, session.delay),
        reading_of(e, noise.std_rad, 0.0 if late else session.loop.latency_s),
        SMALLEST_TURN_LSB * e.sensor.curve.lsb_rad,
        noise.error,
        knows_static=e.relay.where == "host",  # a device calls a stroke that sticks a sensor that is stuck
    )
