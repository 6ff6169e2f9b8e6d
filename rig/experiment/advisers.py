"""Who advises while tests run: the loop's own process, another one, or a recording (docs/until.md)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rig.backends.clock import MonotonicClock
from rig.design.advisor import Advice, Advisor, AdvisorSettings
from rig.experiment.live_process import LiveProcess
from rig.identify.live import NORMAL_95, LiveSettings
from rig.identify.noise import noise_at_rest
from rig.model.real_motor import FramedMotor
from rig.preflight.planned_tests import reading_of, room_of_tests
from rig.session import Session

ADVICE_EVERY_S = 1.0
SMALLEST_TURN_LSB = 20.0  # as a relay test's smallest cycle


class Advisers(Protocol):
    """Who advises: in virtual time the loop's own process, in real time another one, in a replay the recording."""

    trouble: str
    """What is wrong with it, in words; empty if nothing is."""

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

    trouble = ""

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


@contextmanager
def advisers_of(session: Session) -> Iterator[Advisers]:
    """Who advises in a run: in real time another process, which ends with the block."""
    if isinstance(session.bench.clock, MonotonicClock):
        with LiveProcess(session.folder) as process:
            yield process
    else:
        yield InTheLoop(session)


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
            prior_percent=e.relay.until.model_doubt_percent / NORMAL_95,
            delay_s=session.delay.range_s if session.delay is not None and late else None,
        ),
        room_of_tests(e, max(check.plus_V, check.minus_V), session.delay),
        reading_of(e, noise.std_rad, 0.0 if late else session.loop.latency_s),
        SMALLEST_TURN_LSB * e.sensor.curve.lsb_rad,
        noise.error,
    )
