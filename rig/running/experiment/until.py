"""The tests that end when the answer is known: a start without a model, then the tests that tell most (docs/until.md).

Who advises sees the rows, and says which test comes next or that it is enough. This stage drives: it may end a test at
any row, by advice, by the guard or by the bounds of the config. So the guard and the bounds hold whatever the advice.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from typing import NamedTuple

from rig.backends.driver import RelayCommand, StrokeDriver, StrokesCommand, StrokeTimes
from rig.config.schema import UntilSection
from rig.control.bounded import Bounded, Bounds
from rig.control.law import Law, Rest
from rig.control.rising_gains import FIRST, RisingGains, SwingRoom
from rig.control.slow_down import SlowDown
from rig.control.strokes import StrokeTest, StrokeTiming
from rig.control.strokes_on_counts import StrokesOnCounts
from rig.control.unshown import STILL_S, STRONGEST, Pushes
from rig.core.faults import Fault
from rig.core.signals import BenchDelay
from rig.design.advisor import Advice
from rig.design.planned_test import PlannedTest, RelayGains, Strokes
from rig.identification.live import LiveEstimate
from rig.model.real_motor import FramedMotor
from rig.run_folder.recording.stage import Stage, StageKind
from rig.run_folder.results import LiveResult, StoppedResult
from rig.running.experiment import stages
from rig.running.experiment.advisers import Advisers, advisers_of, advisor_settings
from rig.running.preflight.room_to_stop import expected_delay_s, swing_rad
from rig.running.session import MOST_TESTS, Session

AWAIT_DESIGN_S = 10.0  # at rest, for the first test of a known model
AFTER_BRAKING_S = 3.0  # at rest, for another test than the one in which the guard had to brake
REACH = 0.85  # of the distance to the nearer soft limit, for the start without a model
FAST = 0.95  # of the largest speed
FIRST_FRICTION = 0.5  # of the breakaway level: friction of a fast motor may be that low
FIRST_SPEED = 2.0  # of the largest speed: where the first gains of the start would end
TOO_FAST = 1.05  # of it: more than the noise of a velocity; at 1.2 the guard ends the run
SPARE_REST_S = 1.5  # beyond a rest that the advisers asked for: they say at once what follows
LONG_S = 3600.0  # a test goes on until something ends it
MOST_STILL = 3  # starts in a row in which the shaft stood still, although pushes before each had moved it


def drive_until(session: Session, known: FramedMotor | None = None, advisers: Advisers | None = None) -> None:
    """Breakaway check, tests until the motor is known, hysteretic runs if the config has some.

    known     the motor, as far as an earlier run knows it: the first test comes at once
    advisers  of a replay; None: those of a run
    """
    e = session.experiment
    with advisers_of(session) if advisers is None else nullcontext(advisers) as who, stages.prepared(session):
        stages.armed_check(session)
        if known is not None:
            session.note("known", **known.numbers)  # a replay begins with a rest, too
        if advisers is None:
            who.begin(advisor_settings(session, known))  # in the pause: it takes longer than a tick
        with session.loop.armed(e.device.arming):
            tests = _Tests(session, who, known is not None)
            tests.run()
            session.loop.run(tests.last_rest(), "rest")
            stages.test_hysteretic(session)


class _Next(NamedTuple):
    """What follows a law: a test, a rest of so many seconds, the start without a model; or the end, and why.

    at_once   whether the law ends now, and not where the shaft may coast
    proves    whether pushes prove the sensor first: the last law gave up
    way       direction of the first of them, +1 or -1: against the last drive; 0: inward
    """

    test: PlannedTest | None = None
    rest_s: float = 0.0
    stop: str = ""
    at_once: bool = False
    proves: bool = False
    way: int = 0


class _Tests:
    """The tests of one run, one after another, until they end."""

    def __init__(self, session: Session, who: Advisers, is_known: bool) -> None:
        e = session.experiment
        self._session = session
        self._who = who
        self._until = e.relay.until or UntilSection()
        self._relay, self._detector = stages.relay_and_detector(e)
        self._bounds = Bounds(self._until.longest_s, self._until.most_cycles, self._detector.min_amplitude_rad)
        self._number = 0
        self._searched = False
        self._still = 0  # starts in a row that ended because the shaft stood still
        self._first_sum_V = math.nan  # of the next search
        self._last: LiveEstimate | None = None
        self._next = _Next(rest_s=AWAIT_DESIGN_S if is_known else 0.0)
        self._live: list[LiveResult] = []
        self._trouble = ""  # of the advisers, as noted last

    def run(self) -> None:
        """Drive until the end."""
        while not self._next.stop:
            are_all = self._number > MOST_TESTS
            if are_all and self._next.rest_s == 0.0:  # a shaft that still swings is first slowed down
                why = f"{self._number} tests and pushes are driven, the most of one run; its notes say why"
                self._end(self._session.loop.rows - 1, why, known=False)
            elif self._next.proves and not are_all:
                self._prove(self._numbered(StageKind.STROKES), math.inf, self._next.way)
                self._next = self._next._replace(proves=False)
            elif self._next.rest_s > 0.0:
                awaits = self._number == 0 and not self._searched  # the bounds are those of the tests
                law = Bounded(self._rest(self._next), None if awaits else self._bounds)
                self._drive(law, str(StageKind.REST))
            elif self._next.test is None:
                self._search()
            else:
                self._test(self._next.test)

    def last_rest(self) -> Law:
        """The rest after the tests."""
        return self._rest(self._next._replace(rest_s=stages.REST_S))

    def _rest(self, what: _Next) -> Law:
        """A rest: after a test that was broken off in its swing, the shaft is first kept from coasting too far."""
        e, guard = self._session.experiment, self._session.loop.guard
        if not what.at_once or e.motor is None:
            return Rest(what.rest_s)
        slope_V_s_rad = e.drive.supply_V / e.motor.no_load_speed_rad_s
        return SlowDown(
            guard, what.rest_s, self._session.found.checked.moves_V, slope_V_s_rad, e.drive.max_V, e.period_s
        )

    def _prove(self, stage: str, first_V: float, way: int = 0) -> float:
        """Prove by pushes that the reading shows the shaft's motion. Returns the level that moved it, V.

        stage    of their rows: a stage is never taken up again, as a record is read stage by stage
        first_V  first level, V; inf: the level at which no healthy shaft stands still
        way      direction of the first push; 0: inward
        Raises Fault SENSOR_STUCK.
        """
        session, e, check = self._session, self._session.experiment, self._session.found.checked
        moves_V, settings = check.moves_V, session.loop.guard.settings
        # noise may have looked like a first motion: then the drives just above that level need not move the shaft
        last_V = min(max(check.surely_V, STRONGEST * moves_V if math.isinf(first_V) else moves_V), e.drive.max_V)
        law = Pushes(
            last_V if math.isinf(first_V) else min(first_V, e.drive.max_V),
            last_V,
            STILL_S + settings.delay_s,
            e.breakaway.motion_rad,
            stages.flicker_of(session),
            way,
        )
        session.loop.run(Bounded(law, self._bounds), stage)
        return law.moved_V

    def _search(self) -> None:
        """The start without a model."""
        session, e, found = self._session, self._session.experiment, self._session.found
        check = found.checked
        friction_V = 0.5 * (check.plus_V + check.minus_V)
        if math.isnan(self._first_sum_V):
            # short strokes show a fast motor's friction too high
            sheet_V = math.inf if e.motor is None else e.drive.supply_V / e.motor.no_load_speed_rad_s
            fast_V = FIRST_FRICTION * friction_V + FIRST_SPEED * e.limits.max_speed_rad_s * sheet_V
            self._first_sum_V = min(FIRST * friction_V, fast_V)
        stage = self._numbered(StageKind.RELAY) if self._searched else str(StageKind.SEARCH)
        first_sum_V = self._prove(stage, self._first_sum_V)
        self._relay.restart()
        law = RisingGains(
            self._relay,
            self._detector,
            SwingRoom(
                friction_V,
                REACH * swing_rad(e.device),
                FAST * e.limits.max_speed_rad_s,
                e.relay.search.h_max_V,
                e.drive.max_V,
                e.breakaway.motion_rad,
                first_sum_V,
            ),
        )
        law.ahead_s = expected_delay_s(e.device, session.delay or BenchDelay())
        if not self._searched:
            self._searched, found.search = True, law
        bounded = Bounded(law, self._bounds, stages.unshown_motion(session))
        self._drive(bounded, stage, stages.watch_steps(session, law))
        last_sum_V = law.relay.h1_V + law.relay.h2_V
        self._first_sum_V = max(first_sum_V, last_sum_V)
        self._still = self._still + 1 if bounded.failed else 0
        if self._still >= MOST_STILL and not self._next.stop:
            # each start lets such a shaft creep on, and none is stronger than the last
            why = (
                f"pushes move the shaft a little, but in {self._still} starts, the last with up to {last_sum_V:.2f} V, "
                f"it stood still: it may bend before it breaks away, at more than the {friction_V:.2f} V that the "
                "breakaway check found. Give relay.gains above its friction, in place of relay.until"
            )
            self._end(session.loop.rows - 1, why, known=False)

    def _test(self, test: PlannedTest) -> None:
        """A designed test."""
        stage = self._numbered(StageKind.RELAY if isinstance(test, RelayGains) else StageKind.STROKES)
        law, command = self._relay_law(test, stage) if isinstance(test, RelayGains) else self._stroke_law(test)
        bounded = Bounded(law, self._bounds, stages.unshown_motion(self._session))
        self._drive(bounded, stage, guarded=True, command=command)

    def _relay_law(self, test: RelayGains, stage: str) -> tuple[Law, RelayCommand | None]:
        """The law of a relay test, which is noted; and the command where the device runs it."""
        self._session.note("gains", stage=stage, h1_V=test.h1_V, h2_V=test.h2_V)
        self._relay.restart()  # as designed, and as in a device: its integral begins at 0
        shared, gains_V = (self._relay, self._detector), (test.h1_V, test.h2_V)
        return stages.relay_law(self._session, shared, gains_V, cycles=10**9, timeout_s=LONG_S)

    def _stroke_law(self, test: Strokes) -> tuple[Law, StrokesCommand | None]:
        """The same of a stroke test, which goes on until something ends it. Raises Fault CONFIG_MISMATCH."""
        session, e, timing = self._session, self._session.experiment, StrokeTiming(LONG_S, test.longest_stroke_s)
        if e.relay.where == "device":
            driver, times = session.bench.driver, StrokeTimes(timing.stroke_s, timing.still_s)
            if not isinstance(driver, StrokeDriver):
                words = f"relay.where is device, but {driver.backend} runs no strokes: set it to host"
                raise Fault("CONFIG_MISMATCH", words)
            command = driver.strokes_command(test.strokes, times, e.breakaway.motion_rad)
            return StrokesOnCounts(command), command
        # a test may be designed for a shaft that breaks away sooner than the check has seen it to
        moves_V = session.found.checked.moves_V
        return StrokeTest(test.strokes, timing, e.breakaway.motion_rad, moves_V), None

    def _numbered(self, kind: StageKind) -> str:
        self._number += 1
        return str(Stage.test(kind, self._number))

    def _drive(
        self,
        law: Bounded,
        stage: str,
        watch: Callable[[float], None] | None = None,
        *,
        guarded: bool = False,
        command: RelayCommand | StrokesCommand | None = None,
    ) -> None:
        """Run a law until something ends it, and decide what comes next.

        guarded  whether the guard may not brake in it: then the design was for another motor
        command  of a law that the device runs; None: the loop runs it
        """
        session, guard = self._session, self._session.loop.guard
        before = guard.braked_ticks + guard.clipped_ticks
        self._next = _Next()

        def after(t_s: float) -> None:
            if watch is not None:
                watch(t_s)
            if law.finished and not law.failed:
                return  # of a law in the device some more rows come
            decide(t_s)
            coasts = self._next.rest_s > 0.0 or self._next.stop != ""
            ends = self._next.test is not None or self._next.at_once or (coasts and self._may_coast())
            law.finished = ends or law.failed != ""

        def decide(t_s: float) -> None:
            row, pending = session.loop.rows - 1, self._next
            if pending.at_once:
                return  # decided: of a law in the device some more rows come
            why = law.failed or (misfit() if guarded else "")
            if why and pending.stop:
                self._next = pending._replace(at_once=True)  # it is known: no other test
            elif why and guarded:
                self._give_up(row, why)
                self._next = self._next._replace(proves=law.failed != "", way=against())
            elif why:
                self._next = _Next(proves=True, way=against())
            elif pending.stop or pending.test is not None:
                return
            elif self._bounds.reached:
                self._end(row, self._bounds.reached, known=False)
            elif pending == _Next():
                self._take(self._who.advice(row, t_s), row)
                self._note_trouble()

        def against() -> int:
            return 0 if law.last_V == 0.0 else -int(math.copysign(1.0, law.last_V))

        def misfit() -> str:
            """Why the motor is another one than that of the design, in words; empty if it need not be."""
            if guard.braked_ticks + guard.clipped_ticks > before:
                return "the guard had to brake: the motor is another one than that of the design"
            if abs(guard.velocity_rad_s) > TOO_FAST * guard.settings.max_speed_rad_s:
                return "the shaft got too fast: the motor is another one than that of the design"
            return ""

        if command is None:
            session.loop.run(law, stage, after)
        else:
            session.loop.run_in_device(law, command, stage, after, guard_ends_run=False)

    def _may_coast(self) -> bool:
        """Whether the shaft, if the drive ends now, stops within the soft limits, as the guard predicts it."""
        guard = self._session.loop.guard
        low_rad, high_rad = guard.settings.limits.soft_rad
        return low_rad <= guard.predicted_stop_rad <= high_rad

    def _give_up(self, row: int, why: str) -> None:
        """Break a designed test off: rest, and let the next one be designed for less room."""
        self._who.braked()
        self._session.note("decided", row=row, by="loop", what="rest", why=why)
        self._session.found.notes.append(f"a designed test was broken off: {why}")
        self._next = _Next(rest_s=AFTER_BRAKING_S, at_once=True)

    def _end(self, row: int, why: str, *, known: bool) -> None:
        """The tests end."""
        session, last = self._session, self._last
        session.note("decided", row=row, by="advice" if known else "loop", what="stop", why=why)
        trouble = f"; there was no live estimate: {self._who.trouble}" if self._who.trouble and not known else ""
        session.found.stopped = StoppedResult(
            why=why + trouble,
            known=known,
            t_s=session.loop.now_s,
            tests_s=self._bounds.elapsed_s,
            cycles=self._bounds.cycles,
            wanted_percent=self._until.interval_percent,
            interval_percent=None if last is None else last.worst_percent,
            live=tuple(self._live),
        )
        self._next = _Next(stop=why)

    def _take(self, advice: Advice | None, row: int) -> None:
        """Note the advice, and follow it."""
        if advice is None:
            return
        if (
            advice.estimate is not None and advice.estimate.seconds_of_data > 0.0
        ):  # else it is what was known beforehand
            self._last = advice.estimate
            live = live_result(advice.estimate)
            self._live.append(live)
            self._session.note("live", **live.model_dump())
        if advice.stop is not None:
            self._end(row, advice.stop, known=True)
        elif advice.rest_s > 0.0:
            why = "the residual is a little too large: rig measures the noise at rest again"
            self._session.note("decided", row=row, by="advice", what="rest", why=why, rest_s=advice.rest_s)
            self._next = _Next(rest_s=advice.rest_s + SPARE_REST_S)
        elif advice.design is not None and self._number < MOST_TESTS:
            test, design = advice.design.test, advice.design
            what = "relay" if isinstance(test, RelayGains) else "strokes"
            for stroke in () if isinstance(test, RelayGains) else test.strokes:
                self._session.note("stroke", u_V=stroke.u_V, turn_rad=stroke.turn_rad)
            self._session.note(
                "decided", row=row, by="advice", what=what, test=self._number + 1, **numbers_of(test),
                expected_s=design.seconds, expected_percent=design.percent,
            )  # fmt: skip
            self._next = _Next(test)

    def _note_trouble(self) -> None:
        """Note what is wrong with the advisers, once."""
        trouble = self._who.trouble
        if trouble not in ("", self._trouble):
            self._session.note("no_advice", why=trouble, last_words=self._who.last_words)
        self._trouble = trouble


def live_result(estimate: LiveEstimate) -> LiveResult:
    """A live estimate as result.json and events.jsonl have it."""
    return LiveResult.of(
        estimate,
        of_s=estimate.t_s,
        tau_percent=estimate.half_percent["tau_s"],
        K_percent=estimate.half_percent["K_rad_s_V"],
        fc_percent=estimate.half_percent["fc_V"],
        laws=", ".join(estimate.laws),
    )


def numbers_of(test: PlannedTest) -> dict[str, float]:
    """What a replay needs of a test, but for its strokes, which are events of their own."""
    if isinstance(test, RelayGains):
        return {"h1_V": test.h1_V, "h2_V": test.h2_V}
    return {"longest_stroke_s": test.longest_stroke_s}
