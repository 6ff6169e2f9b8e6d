"""A reading that freezes, or no longer follows, at each step of the tests: how far the true shaft turns unseen."""

from __future__ import annotations

import copy
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from evidence import evidence

import rig.running.session
from campaign_real.departing_bench import DepartingShaft, config_of, open_bench
from campaign_real.departing_motor import Bench
from campaign_real.kinds import KINDS, departures_of
from rig import config
from rig.backends.registry import Bench as OpenBench
from rig.backends.simulated.backend import SIMULATED
from rig.backends.simulated.driver import SimulatedDriver
from rig.campaign.random_motors import Draw, draw
from rig.config import Experiment
from rig.config.campaign import Campaign
from rig.config.schema import RelayGainsSection, RelaySection, UntilSection
from rig.control.law import Law
from rig.control.strokes import Stroke, StrokeTest, StrokeTiming
from rig.control.unshown import FRICTION, START, STILL_S
from rig.core.faults import Fault
from rig.design.advisor import Advice
from rig.design.planned_test import Design, PlannedTest, Reach, RelayGains, Strokes
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.model.real_motor import Frame, FramedMotor, plain
from rig.run_folder.recording.reader import read_run
from rig.running.experiment import script, stages, until
from rig.running.experiment.stages import armed_check, prepared
from rig.running.session import Session
from stopping.in_memory import driven
from stopping.rows import Asked, checked, row

ROOT = Path(__file__).resolve().parents[2]
CAMPAIGN = Campaign(name="stopping", experiments=4, seed=3)
FAST = 40  # its breakaway level is 1.7 times its friction
Failure = Literal["frozen", "uncoupled"]


class Sensor:
    """The sensor of a simulated bench, which fails at a given time: its reading freezes, or only flickers."""

    def __init__(self, driver: SimulatedDriver, failure: Failure, noise_counts: float) -> None:
        self.bench = driver.bench
        self.failure, self.noise_counts = failure, noise_counts
        self.shaft_rad: list[float] = []  # where the shaft really was since the failure, at each reading
        self.drive_V: list[float] = []
        self._reads, self._rng = driver.bench.read_counts, random.Random(5)
        self._held: int | None = None
        self.has_failed = False
        driver.bench.read_counts = self.read  # type: ignore[method-assign]

    def read(self) -> int:
        counts = self._reads()
        if not self.has_failed:
            return counts
        if self._held is None:
            self._held = counts
        self.shaft_rad.append(self.bench.shaft_rad)
        self.drive_V.append(self.bench.pin_counts / self.bench.parameters.drive_counts * 12.0)
        return self._held if self.failure == "frozen" else round(self._rng.gauss(self._held, self.noise_counts))

    def coasted_rad(self) -> float:
        """How far the shaft turned since the failure, rad, once it has coasted at 0 V."""
        self.bench.pin_counts = 0.0
        self.bench.advance(2.0)
        self.shaft_rad.append(self.bench.shaft_rad)
        return float(np.abs(np.array(self.shaft_rad) - self.shaft_rad[0]).max())


def opened(which: str) -> tuple[Experiment, OpenBench, SimulatedDriver]:
    """config/quick.yaml, or a fast motor of `make stopping`, open."""
    if which == "fast":
        one = draw(CAMPAIGN, FAST)
        bench = Bench(0.01, one.delay_s, 0.003, CAMPAIGN.sensor.lsb_rad, one.offset_rad)
        e = checked(config_of(one, bench))
        device, _ = open_bench(e, one, departures_of(CAMPAIGN, one, ()), bench, 60.0, FAST)
    else:
        e = config.load(ROOT / "config/quick.yaml")
        with SIMULATED.unopened(e.device) as un:
            device = OpenBench(un.driver, un.clock, un.driver.open(), un.truth)
    e = e.model_copy(update={"relay": RelaySection(until=UntilSection(longest_s=20.0)), "tracking": None})
    assert isinstance(device.driver, SimulatedDriver)
    return e, device, device.driver


class Says:
    """Advisers that say one thing, after so many rows of the tests; once, or again each ``say_again`` rows."""

    trouble = last_words = ""

    def __init__(self, advice: Advice | None = None, rows: int = 0) -> None:
        self.say, self.rows = advice, rows
        self.broken_off = 0
        self.say_again = 0

    def begin(self, settings: object) -> None:
        pass

    def advice(self, row: int, t_s: float) -> Advice | None:
        self.rows -= 1
        if self.rows == -1 and self.say_again:
            self.rows = self.say_again
            return self.say
        return self.say if self.rows == -1 else None

    def braked(self) -> None:
        self.broken_off += 1


def fail_at(session: Session, sensor: Sensor, stage: str, after_s: float = 0.0) -> None:
    """Let the sensor fail so long after the begin of a stage."""
    run = session.loop.run

    def run_on(law: Law, name: str, watch: Callable[[float], None] | None = None) -> None:
        begun_s = math.nan

        def look(t_s: float) -> None:
            nonlocal begun_s
            begun_s = t_s if math.isnan(begun_s) else begun_s
            sensor.has_failed = sensor.has_failed or (name == stage and t_s - begun_s >= after_s)
            if watch is not None:
                watch(t_s)

        sensor.has_failed = sensor.has_failed or (name == stage and after_s == 0.0)
        run(law, name, look)

    session.loop.run = run_on  # type: ignore[assignment,method-assign]


def unseen_V_s(drive_V: list[float], moves_V: float) -> float:
    """The largest sum over time of what the drives exceed half of the breakaway level by, V s, either way."""
    beyond = [math.copysign(max(abs(u) - FRICTION * moves_V, 0.0), u) for u in drive_V]
    sums = np.concatenate(([0.0], np.cumsum(beyond)))
    return float(np.ptp(sums)) * 0.01


@pytest.mark.parametrize("failure", ["frozen", "uncoupled"])
@pytest.mark.parametrize("which", ["simulated", "fast"])
def test_a_reading_that_fails_as_the_search_begins_hides_no_more_than_one_push_as_the_guard_would_end_it(
    which: str, failure: Failure
) -> None:
    e, bench, driver = opened(which)
    sensor = Sensor(driver, failure, 0.003 / e.sensor.curve.lsb_rad)

    def script(session: Session) -> None:
        fail_at(session, sensor, "search")
        until.drive_until(session, advisers=Says())

    session, fault = driven(e, bench, script)
    assert fault is not None and fault.code == "SENSOR_STUCK"
    travel_rad = sensor.coasted_rad()
    # what the guard alone would let pass: the relay's first drive, START times the breakaway level, for STILL_S
    check = session.found.breakaway
    assert check is not None
    _, _, other = opened(which)
    alone = other.bench
    alone.pin_counts = START * 0.5 * (check.plus_V + check.minus_V) / 12.0 * alone.parameters.drive_counts
    if sensor.drive_V[2] < 0.0:
        alone.pin_counts *= -1.0
    from_rad = alone.shaft_rad
    alone.advance(STILL_S + e.period_s)
    alone.pin_counts = 0.0
    alone.advance(2.0)
    assert travel_rad <= 1.01 * abs(alone.shaft_rad - from_rad)


@pytest.mark.parametrize("after_s", [0.0, 0.41, *evidence(0.13)])
@pytest.mark.parametrize("failure", ["frozen", "uncoupled"])
@pytest.mark.parametrize("level", [0.8, *evidence(1.2)])
def test_a_reading_that_fails_in_strokes_or_a_relay_test_ends_the_run(
    level: float, failure: Failure, after_s: float
) -> None:
    """The drives are weaker than those that the guard watches, some than the breakaway level: the shaft still moves."""
    e, bench, driver = opened("fast")
    sensor = Sensor(driver, failure, 0.003 / e.sensor.curve.lsb_rad)
    says = Says()

    def script(session: Session) -> None:
        fail_at(session, sensor, "relay-1" if after_s == 0.13 else "strokes-1", after_s)
        check_and_test(session)

    def check_and_test(session: Session) -> None:
        with prepared(session):
            armed_check(session)
            u_V = level * session.loop.guard.static_V
            test: PlannedTest = Strokes((Stroke(u_V, 0.2), Stroke(-u_V, -0.2)), 2.0)
            if after_s == 0.13:
                test = RelayGains(0.2 * u_V, 0.8 * u_V)
            with session.loop.armed(e.device.arming):
                tests = until._Tests(session, says, is_known=True)
                tests._next = until._Next(test)
                tests.run()

    session, fault = driven(e, bench, script)
    assert fault is not None and fault.code == "SENSOR_STUCK"
    check = session.found.breakaway
    assert check is not None and sensor.drive_V
    moves_V = max(check.plus_V, check.minus_V)
    assert len(sensor.drive_V) * e.period_s < until.AFTER_BRAKING_S  # the proof comes at once
    # one standstill in the test, and one push of the proof after it
    most_V_s = (2.0 * STILL_S * (START - FRICTION) + 4.0 * e.period_s) * moves_V
    assert unseen_V_s(sensor.drive_V, moves_V) <= most_V_s


def test_pushes_after_a_test_that_was_broken_off_are_a_stage_of_their_own_so_that_the_record_can_be_read() -> None:
    e, bench, _ = opened("simulated")
    e = e.model_copy(update={"relay": RelaySection(until=UntilSection(longest_s=12.0))})
    weak = Strokes((Stroke(0.3, 0.2), Stroke(-0.3, -0.2)), 2.0)
    too_weak = Advice(None, Design(weak, 1.0, 1.0, Reach(-0.5, 0.5, 2.0)))

    def script(session: Session) -> None:
        until.drive_until(session, advisers=Says(too_weak, 20))
        stages.identify_recorded(session)

    session, fault = driven(e, bench, script)
    assert fault is None, fault
    run = session.read()
    driven_stages = [name for name in run.stages() if name != "rest"]
    assert driven_stages[:2] == ["breakaway", "search"] and driven_stages[2:5] == ["strokes-1", "strokes-2", "relay-3"]
    for name in driven_stages:
        assert set(run.stage[run.stage_rows(name)]) == {name}
    assert session.found.identification is not None


def test_tests_that_are_all_broken_off_end_before_their_numbers_do(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (until, rig.running.session):
        monkeypatch.setattr(module, "MOST_TESTS", 3)
    e, bench, _ = opened("simulated")
    weak = Strokes((Stroke(0.3, 0.2), Stroke(-0.3, -0.2)), 2.0)
    says = Says(Advice(None, Design(weak, 1.0, 1.0, Reach(-0.5, 0.5, 2.0))), 20)
    says.say_again = 20
    session, fault = driven(e, bench, lambda session: until.drive_until(session, advisers=says))
    assert fault is None and session.found.stopped is not None
    assert session.found.stopped.why.startswith("4 tests and pushes are driven, the most of one run")
    assert np.all(session.read().u_V[-20:] == 0.0)
    assert not session.found.stopped.known


@pytest.mark.parametrize("after_s", [0.0, 3.0, *evidence(1.1)])
@pytest.mark.parametrize(("failure", "flickers"), [("frozen", True), ("frozen", False), ("uncoupled", True)])
def test_a_reading_that_fails_in_the_gain_search_ends_the_run_before_the_shaft_is_at_its_stop(
    failure: Failure, flickers: bool, after_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not flickers:  # as an encoder: a reading that stays the same says nothing by itself
        monkeypatch.setattr(stages, "FLICKERS_LSB", math.inf)
    e, bench, driver = opened("simulated")
    e = e.model_copy(update={"relay": config.load(ROOT / "config/simulated.yaml").relay})
    sensor = Sensor(driver, failure, 0.003 / e.sensor.curve.lsb_rad)

    def script(session: Session) -> None:
        fail_at(session, sensor, "search", after_s)
        with prepared(session):
            armed_check(session)
            with session.loop.armed(e.device.arming):
                stages.search_gains(session, *stages.relay_and_detector(e), both=False)

    session, fault = driven(e, bench, script)
    assert fault is not None and fault.code == "SENSOR_STUCK"
    sensor.coasted_rad()
    assert max(map(abs, sensor.shaft_rad)) < e.limits.hard_rad[1]
    if failure == "frozen" and flickers:
        assert len(sensor.drive_V) * e.period_s <= stages.flicker_of(session).longest_s + 3.0 * e.period_s


@pytest.mark.parametrize(
    ("flickers", "where"), [(False, "device"), *evidence((True, "host"), (True, "device"), (False, "host"))]
)
def test_a_relay_test_whose_first_cycle_never_comes_ends_with_a_stuck_sensor(
    where: Literal["host", "device"], flickers: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drives of 1.05 to 1.4 times the breakaway level, by the firmware's own relay or the loop's."""
    if not flickers:  # as an encoder: a reading that stays the same says nothing by itself
        monkeypatch.setattr(stages, "FLICKERS_LSB", math.inf)
    e = config.load(ROOT / "config/device-relay.yaml")
    relay = RelaySection(where=where, gains=(RelayGainsSection(h1_V=0.15, h2_V=0.5),), cycles=5)
    e = e.model_copy(update={"relay": relay})
    check = read_run(script.run_breakaway(e, tmp_path).folder)
    fails_s = float(check.t_s[-1])
    assert e.emulated is not None
    wires = e.emulated.wiring.model_copy(update={"sensor": "stuck", "fault_after_s": fails_s})
    e = e.model_copy(update={"emulated": e.emulated.model_copy(update={"wiring": wires})})
    outcome = script.run_relay(e, tmp_path)
    run = read_run(outcome.folder)
    assert outcome.failure.startswith("SENSOR_STUCK"), outcome.failure
    rows = run.stage_rows("relay-1")
    unseen_s = float(run.t_s[rows.stop - 1] - run.t_s[rows.start])
    level = 0.65 / 0.544  # of the breakaway level
    assert unseen_s < STILL_S * (START - FRICTION) / (level - FRICTION) + 4.0 * e.period_s
    assert ("at rest it flickered" in outcome.failure) == flickers


def test_bounds_end_the_tests_although_a_rest_waits_for_the_shaft(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(until._Tests, "_may_coast", lambda self: self._bounds.elapsed_s > 6.0)
    e, bench, _ = opened("simulated")
    e = e.model_copy(update={"relay": RelaySection(until=UntilSection(longest_s=5.0))})
    rest = Says(Advice(None, rest_s=2.0), 5)
    session, fault = driven(e, bench, lambda session: until.drive_until(session, advisers=rest))
    assert fault is None and session.found.stopped is not None
    assert "longest_s, 5 s" in session.found.stopped.why
    assert session.found.stopped.tests_s == pytest.approx(5.0, abs=0.02)


@pytest.mark.parametrize("ends", ["brakes", "too fast"])
@pytest.mark.parametrize("pending", ["rest", "stop"])
def test_a_test_that_does_not_fit_is_broken_off_although_its_end_waits_for_the_shaft(
    monkeypatch: pytest.MonkeyPatch, pending: str, ends: str
) -> None:
    e, bench, _ = opened("simulated")
    waits = Advice(None, rest_s=2.0) if pending == "rest" else Advice(None, stop="it is known")
    says = Says(waits, 5)
    seen: list[float] = []

    def not_yet(self: until._Tests) -> bool:
        guard = self._session.loop.guard
        seen.append(self._session.loop.now_s)
        if len(seen) == 3 and ends == "brakes":
            guard.braked_ticks += 1
        elif len(seen) == 3:
            monkeypatch.setattr(until, "TOO_FAST", -1.0)
        elif len(seen) > 3:
            raise Fault("LAW_FAILED", "the test went on")
        return False

    monkeypatch.setattr(until._Tests, "_may_coast", not_yet)

    def script(session: Session) -> None:
        with prepared(session):
            armed_check(session)
            with session.loop.armed(e.device.arming):
                tests = until._Tests(session, says, is_known=True)
                tests._next = until._Next(Strokes((Stroke(1.2, 0.5), Stroke(-1.2, -0.5)), 2.0))
                tests._test(tests._next.test)  # type: ignore[arg-type]
                session.found.notes.append(f"next: {tests._next}")

    session, fault = driven(e, bench, script)
    assert fault is None, fault
    assert says.broken_off == (pending == "rest")
    assert "at_once=True" in session.found.notes[-1]
    assert ("stop='it is known'" in session.found.notes[-1]) == (pending == "stop")


def stopped_at_each_reading(e: Experiment, shaft: DepartingShaft) -> list[float]:
    """How far a copy of the shaft turns in all if the run stops at that reading while it drives, rad; grows by itself.

    Nothing brakes then, and the pin keeps the last drive for two more periods.
    """
    furthest_rad: list[float] = []
    reads = shaft.read_counts

    def read_and_stop_a_copy() -> int:
        if shaft.pin_counts != 0.0 and len(furthest_rad) < 2000:
            stopped = copy.copy(shaft)
            stopped._shaft = copy.deepcopy(shaft._shaft)
            stopped.furthest_rad = 0.0
            stopped.advance(2.0 * e.period_s)
            stopped.pin_counts = 0.0
            for _ in range(20):
                stopped.advance(0.1)
            furthest_rad.append(stopped.furthest_rad)
        return reads()

    shaft.read_counts = read_and_stop_a_copy  # type: ignore[method-assign]
    return furthest_rad


def plain_bench(number: int) -> tuple[Draw, Bench, Experiment]:
    """A motor of the campaign, what its bench is, and its config."""
    one = draw(CAMPAIGN, number)
    bench = Bench(0.01, one.delay_s, 0.003, CAMPAIGN.sensor.lsb_rad, one.offset_rad)
    return one, bench, config_of(one, bench)


@pytest.mark.evidence
def test_where_designed_tests_are_stopped_the_shaft_coasts_as_far_beyond_the_soft_limits_as_the_docs_say() -> None:
    one, bench, e = plain_bench(5)
    e = e.model_copy(update={"relay": RelaySection(until=UntilSection(longest_s=6.0))})
    device, shaft = open_bench(e, one, departures_of(CAMPAIGN, one, ()), bench, 60.0, 5)
    furthest_rad = stopped_at_each_reading(e, shaft)
    model = FramedMotor(plain(Motor(one.tau_s, one.K_rad_s_V, coulomb(one.fc_V), 0.0)), Frame())
    session, fault = driven(e, device, lambda session: until.drive_until(session, model))
    assert fault is None and "strokes-1" in session.read().stages()
    assert 0.0 < max(furthest_rad) - e.limits.soft_rad[1] < 0.24


def test_wherever_a_test_is_stopped_the_shaft_coasts_within_the_hard_limits() -> None:
    """Strokes that would go far beyond them, and would end there without the guard's brake."""
    one, bench, e = plain_bench(5)
    hard_rad = e.limits.soft_rad[1] + 0.3
    e = e.model_copy(update={"limits": e.limits.model_copy(update={"hard_rad": (-hard_rad, hard_rad)})})
    device, shaft = open_bench(e, one, departures_of(CAMPAIGN, one, ()), bench, 60.0, 5)
    furthest_rad = stopped_at_each_reading(e, shaft)
    u_V = one.fc_V + 0.7 * e.limits.max_speed_rad_s / one.K_rad_s_V

    def script(session: Session) -> None:
        with prepared(session):
            armed_check(session)
            with session.loop.armed(e.device.arming):
                strokes = (Stroke(u_V, 9.0), Stroke(-u_V, -9.0))
                law = StrokeTest(strokes, StrokeTiming(8.0, 1.5), e.breakaway.motion_rad)
                session.loop.run(law, "strokes-1")

    driven(e, device, script)
    assert e.limits.soft_rad[1] < max(furthest_rad) < hard_rad


@pytest.mark.evidence
def test_a_shaft_that_only_bends_ends_the_tests_after_three_starts_and_says_why() -> None:
    """Its friction bends before it slides: strokes far below the friction move it by more than breakaway.motion_rad."""
    campaign = Campaign(name="stopping", experiments=1, seed=6)
    bends = [kind for kind in KINDS if kind.name == "bristle 100"]
    found = row(campaign, 22, bends, Asked(0.4, True, False))
    assert "in 3 starts" in found.why and not found.known
    assert found.beyond_rad == 0.0 and found.tests_s is not None and found.tests_s < 5.0
    assert found.verdict == "refused"
