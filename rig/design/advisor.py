"""The advisor: from the rows so far to an estimate, the next test, and whether it is enough. It reads no clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rig.control.motion import Swings
from rig.core.arrays import Array
from rig.design.belief import Belief
from rig.design.best_test import KINDS, Kind, best_test
from rig.design.outlook import Task, law_of, told
from rig.design.planned_test import Design, PlannedTest, Reading, RelayGains, Room
from rig.design.stop_rule import RestNoise, StopRule
from rig.identification.breakaway import breakaway
from rig.identification.departures.laws import LONG_DELAY_S
from rig.identification.estimate import PARAMETERS, Estimate
from rig.identification.live import LiveEstimate, LiveFit, LiveRows, LiveSettings
from rig.identification.preprocessing import from_recording
from rig.model.step import State
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.stage import Stage, StageKind

KNOWN_PERCENT = 20.0  # tau, K and f_c must be known so well before a test is designed
WIDE = 0.15  # of the room: swings so wide show what a first test would meet
LONG_ENOUGH_S = 10.0  # of the start without a model: where its speed is bounded, its swings stay small
LEAST_S = 1.2  # of a test before another one takes its place
LEAST_TURNS = 2  # turning points in that test
TOO_SLOW_S = 5.0  # a test that has not swung by then tells too little
BETTER = 0.8  # another test must need less than this share of the time that the present one still needs
LESS_ROOM = 0.85  # after the guard had to brake
REST_S = 2.0  # at rest, to know its noise better
MOST_RESTS = 3
STATIC = (
    1.1  # times friction in motion: level that the shaft breaks away at, where the strokes do not show a higher one
)


@dataclass(frozen=True)
class AdvisorSettings:
    """What the advisor knows before the first row of a test.

    interval_percent  wanted half width of the 95 % intervals of tau, K and f_c, % of the value
    live              of the live fit, which may know the motor beforehand
    room, reading     of the designs
    turn_rad          a way back shorter than this is no turning point
    noise_error       standard error of the noise at rest, as a share of it
    kinds             of tests that the bench can drive
    knows_static      whether a test may count on a shaft that breaks away below ``room.static_V``, if the estimate says
                      so; a test that sticks must then be no fault
    """

    interval_percent: float
    live: LiveSettings
    room: Room
    reading: Reading
    turn_rad: float
    noise_error: float = 0.0
    kinds: tuple[Kind, ...] = KINDS
    knows_static: bool = True


@dataclass(frozen=True)
class Advice:
    """What the rows so far say.

    estimate  the motor by the rows so far, or as it was known before; None: the advice is a recorded one
    design    the test to go over to, and what it should bring; None: go on with the present one
    stop      why it is enough, in words; None: it is not
    rest_s    rest for so long, s, so that the noise at rest is known better; 0: no need to
    """

    estimate: LiveEstimate | None
    design: Design | None = None
    stop: str | None = None
    rest_s: float = 0.0


class Advisor:
    """Takes the rows of a run as they come, and advises."""

    def __init__(self, settings: AdvisorSettings) -> None:
        self._settings = settings
        self._room = settings.room
        self._fit = LiveFit(settings.live)
        self._rule = StopRule(settings.interval_percent, settings.noise_error)
        self._noise = RestNoise(max(settings.live.noise_rad, 1e-12), settings.noise_error)
        self._recording: Recording | None = None
        self._rests = 0  # that were asked for
        self._rests_from: int | None = None  # row after which the last one was, until its rows have come
        self._rows = 0
        self._stage = ""
        self._stage_s = math.nan  # its first row
        self._last_s = math.nan
        self._swings = Swings(settings.turn_rad)  # of the stage
        self._y_rad = 0.0  # at the last row
        self._given: Design | None = None  # the design given last
        self._given_in = ""  # the stage at that time: rows of another one are of the test given
        self._must_change = False
        self._knows_static = settings.knows_static

    def take(self, recording: Recording) -> None:
        """Take the rows that have come since the last call; ``recording``: all rows so far."""
        new = slice(self._rows, len(recording))
        if new.start >= new.stop:
            return
        self._rows, self._recording = new.stop, recording
        stages = recording.stage[new]
        columns = (recording.t_s[new].tolist(), recording.y_rad[new].tolist(), stages.tolist())
        for t_s, y_rad, name in zip(*columns, strict=True):
            if name != self._stage:
                self._stage, self._stage_s = name, t_s
                self._swings = Swings(self._settings.turn_rad)
            self._swings.step(y_rad)
        self._last_s = float(recording.t_s[new.stop - 1])
        self._y_rad = float(recording.y_rad[new.stop - 1])
        self._fit.take(
            LiveRows(
                row=np.arange(new.start, new.stop),
                t_s=recording.t_s[new],
                y_rad=recording.y_rad[new],
                t_u_s=recording.t_u_s[new],
                u_V=recording.u_V[new],
            )
        )

    def braked(self) -> None:
        """A test was broken off: from now on design for less room, and another test at once.

        It may have stuck, too: from now on the shaft breaks away where the check has seen it to.
        """
        self._knows_static = False
        room = self._room
        self._room = replace(
            room,
            low_rad=LESS_ROOM * room.low_rad,
            high_rad=LESS_ROOM * room.high_rad,
            max_speed_rad_s=LESS_ROOM * room.max_speed_rad_s,
        )
        self._must_change = True

    def advise(self) -> Advice | None:
        """The advice after all rows so far; None if there is nothing to say yet."""
        estimate = self._fit.estimate()
        if estimate is None:
            return None
        if self._rests_from is not None:
            if not self._has_rested():
                return Advice(estimate)
            stop = self._rule.enough()
        else:
            stop = self._rule.take(estimate)
        if stop is not None:
            estimate = self._fit.estimate(seeks_laws=True) or estimate
            stop = self._rule.confirm(estimate)
        if stop is not None:
            return Advice(estimate, stop=stop + _beside(estimate))
        if self._rule.noise_in_doubt and self._can_rest:
            self._rests += 1
            self._rests_from = self._rows
            return Advice(estimate, rest_s=REST_S)
        return Advice(estimate, self._next(estimate))

    @property
    def _can_rest(self) -> bool:
        """Whether a rest would tell the noise: not where the sensor's steps hide it, and not again and again."""
        live = self._settings.live
        return self._rests < MOST_RESTS and self._settings.noise_error > 0.0 and live.noise_rad >= 0.5 * live.lsb_rad

    def _has_rested(self) -> bool:
        """Whether the rest that was asked for is over; then its noise is known."""
        recording, first = self._recording, self._rests_from
        if recording is None or first is None:
            return False
        rests = np.flatnonzero((recording.stage[first:] == str(StageKind.REST)) & (recording.u_V[first:] == 0.0))
        if rests.size == 0:
            return False  # the test goes on until the shaft may coast
        y_rad, t_s = recording.y_rad[first:][rests], recording.t_s[first:][rests]
        if self._stage == str(StageKind.REST) and t_s[-1] - t_s[0] < REST_S - 2.0 * self._settings.live.period_s:
            return False
        self._rests_from = None
        if self._noise.take(y_rad):
            self._rule.learn(self._noise.std_rad / self._settings.live.noise_rad, self._noise.error)
        return True

    def _next(self, estimate: LiveEstimate) -> Design | None:
        """The test to go over to; None: go on with the present one."""
        s = self._settings
        if not estimate.fc_V > 0.0:
            return None  # a model without friction: no test can be designed for its intervals in %
        if s.live.prior is None and not estimate.worst_percent <= KNOWN_PERCENT:
            return None
        if self._extrapolates():
            return None
        if not self._must_change and self._given is not None and not self._has_run():
            return None
        wanted_percent, kinds = self._rule.wanted_percent(estimate), s.kinds
        if estimate.worst_percent <= wanted_percent:
            if estimate.drives_differ or self._given is None:
                return None  # the next estimate may say that it is enough
            # known well by drives that are too much alike: now the other kind
            wanted_percent = LESS_ROOM * estimate.worst_percent
            kinds = tuple(kind for kind in s.kinds if kind != kind_of(self._given.test)) or s.kinds
        belief = belief_of(estimate)
        room = replace(self._room, static_V=self._static_V(estimate))
        task = Task(belief, information_of(belief), room, s.reading, wanted_percent, self._start())
        design = best_test(task, kinds)
        if design is None or (kinds == s.kinds and not self._is_better(design, task)):
            return None
        self._given, self._given_in, self._must_change = design, self._stage, False
        return design

    def _extrapolates(self) -> bool:
        """Whether a first test would go far beyond the swings so far.

        A law that shows in wide swings only, or in small ones only, makes an estimate that explains the small ones and
        is three times off in wide ones: bristles bend in small swings. A shaft that turns without end leaves nothing.
        """
        if self._given is not None or self._settings.live.prior is not None or self._room.is_endless:
            return False
        if self._last_s - self._stage_s > LONG_ENOUGH_S:
            return False
        least_rad = WIDE * min(-self._room.low_rad, self._room.high_rad)
        return not self._swings.half_way_rad >= least_rad

    def _static_V(self, estimate: LiveEstimate) -> float:
        """The level that the shaft breaks away at, V, at most.

        The strokes of the breakaway check show a fast motor's too high: each moves it little. Beside the estimate they
        say more: a level below which the shaft would have moved in them, as it did.
        """
        seen_V, recording = self._room.static_V, self._recording
        if recording is None or not (self._knows_static and estimate.worst_percent <= KNOWN_PERCENT):
            return seen_V
        stage = str(StageKind.BREAKAWAY)
        if stage not in recording.stages():
            return seen_V
        try:
            strokes, _ = from_recording(recording, recording.stage_rows(stage), stage)
        except IdentifyError:
            return seen_V
        motor = Estimate("live", *(getattr(estimate, name) for name in PARAMETERS))
        found = breakaway(strokes, motor, self._noise.std_rad)
        if found.plus is None or found.minus is None:
            return seen_V
        moving_V = estimate.fc_V - estimate.asym_V, estimate.fc_V + estimate.asym_V
        levels_V = (
            ramp.high_V if ramp.low_V > moving else min(ramp.high_V, STATIC * moving)
            for ramp, moving in zip((found.plus, found.minus), moving_V, strict=True)
        )
        return min(seen_V, max(levels_V))

    def _start(self) -> State:
        """Where a test would begin: at rest, where the shaft stands, or about where it turns next."""
        turn_rad = self._swings.last_turn_rad
        return State(y=self._y_rad if math.isnan(turn_rad) else -turn_rad)

    def _has_run(self) -> bool:
        """Whether the test given last runs, and has run for a while."""
        runs_s = self._last_s - self._stage_s
        runs = self._stage != self._given_in and Stage.parse(self._stage).is_test and runs_s >= LEAST_S
        return runs and (self._swings.count >= LEAST_TURNS or runs_s >= TOO_SLOW_S)

    def _is_better(self, design: Design, task: Task) -> bool:
        """Whether a design needs clearly less time than the test that runs still does."""
        if self._given is None or self._must_change:
            return True
        test = self._given.test
        law = law_of(test if isinstance(test, RelayGains) else test.strokes)
        return design.seconds <= BETTER * told(task, law).seconds


def _beside(estimate: LiveEstimate) -> str:
    """What to say beside why it is enough: its laws, and what the answer will not know however long the tests are."""
    laws = " and ".join(estimate.laws).replace("_", " ")
    late = "; so long a lag may be of the readings, and then f_c is not known"
    return (f"; with {laws}" if laws else "") + (late if estimate.framed.motor.lag_s >= LONG_DELAY_S else "")


def kind_of(test: PlannedTest) -> Kind:
    """The kind of a test."""
    return "relay" if isinstance(test, RelayGains) else "strokes"


def information_of(belief: Belief) -> Array:
    """(5, 5): what is known already, as information; of a delay that is known for certain it says nothing."""
    known = np.zeros((5, 5))
    free = 4 if belief.delay_is_known else 5
    known[:free, :free] = np.linalg.inv(belief.covariance[:free, :free])
    return known


def belief_of(estimate: LiveEstimate) -> Belief:
    """The motor as far as an estimate knows it."""
    return Belief(
        estimate.tau_s,
        estimate.K_rad_s_V,
        estimate.fc_V,
        estimate.asym_V,
        estimate.delay_s,
        np.asarray(estimate.covariance),
    )
