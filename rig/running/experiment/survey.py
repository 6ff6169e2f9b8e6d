"""The survey: plan the sweeps by what the run has shown so far, rehearse them, run them (docs/theory.md 13).

A thorough run adds it, and a third amplitude, where the relay tests leave the motor's law open.
"""

from __future__ import annotations

import math
from dataclasses import asdict

from rig.control.law import Rest
from rig.control.sweep_plan import COUNTS_1_S, EDGE_SHARE, SweepPlan, TooShortError, sweep_plan
from rig.control.sweeps import CrudeMotor, SweepLoop, Sweeps, loop_bandwidth_1_s, slowest_rad_s
from rig.core.faults import Fault
from rig.core.signals import BenchDelay
from rig.identification import Identification
from rig.identification.verdict import PROMISE, RISK
from rig.model.describing_function import Oscillation, linear_part
from rig.model.real_motor import Frame, FramedMotor, RealMotor
from rig.run_folder.recording.stage import StageKind
from rig.run_folder.results import known
from rig.running.experiment.stages import REST_S, driving, identify_recorded, test_further, why_not
from rig.running.preflight.room_to_stop import survey_room
from rig.running.session import Session

FEWEST_V = 0.05  # of the drive beyond friction, for the describing function


def survey(session: Session) -> None:
    """Sweep the travel to and fro at several speeds, after the breakaway check and a relay test.

    Raises Fault NO_SWEEPS if there is no room for sweeps, or if their rehearsal fails; NOT_FOLLOWING, and what the loop
    raises.
    """
    motor = crude_motor(session)
    loop = _sweep_loop(session)
    plan = _plan(session, motor, loop)
    _rehearse(session, Sweeps(motor, plan, loop))
    # a replay sweeps by these numbers: it plans nothing, and rehearses nothing
    session.note(
        "survey", **asdict(motor), low_rad=plan.low_rad, high_rad=plan.high_rad, bandwidth_1_s=plan.bandwidth_1_s,
        latency_s=loop.latency_s, lost_rad=loop.lost_rad,
    )  # fmt: skip
    for speed_rad_s in plan.speeds_rad_s:
        session.note("sweep", speed_rad_s=speed_rad_s)
    sweep(session, Sweeps(motor, plan, loop))


def sweep(session: Session, sweeps: Sweeps) -> None:
    """Run the sweeps, from rest to rest."""
    with driving(session):
        session.loop.run(Rest(REST_S), "rest")
        session.loop.run(sweeps, str(StageKind.SURVEY))
        session.loop.run(Rest(REST_S), "rest")


def crude_motor(session: Session) -> CrudeMotor:
    """The motor by the last live estimate, or by the describing function of the last relay test.

    Raises Fault NO_SWEEPS where tests until the motor is known gave no estimate; ValueError without any test.
    """
    found, breakaway, cycle = session.found, session.found.breakaway, session.found.cycle
    if breakaway is not None and found.stopped is not None:
        if not found.stopped.live:
            raise Fault("NO_SWEEPS", "the tests gave no live estimate to plan sweeps by")
        last = found.stopped.live[-1]
        return CrudeMotor(known(last.tau_s), known(last.K_rad_s_V), breakaway.plus_V, breakaway.minus_V)
    if breakaway is None or cycle is None:
        raise ValueError("a survey needs a breakaway check and a relay test")
    friction_V = 0.45 * (breakaway.plus_V + breakaway.minus_V)
    beyond_V = max(cycle.h2_V - friction_V, FEWEST_V)
    linear = linear_part(
        Oscillation(2.0 * math.pi / cycle.period_s, cycle.amplitude_rad), cycle.h2_V - beyond_V, cycle.h1_V, cycle.h2_V
    )
    return CrudeMotor(linear.tau_s, linear.K_rad_s_V, breakaway.plus_V, breakaway.minus_V)


def _sweep_loop(session: Session) -> SweepLoop:
    e, noise_rad = session.experiment, session.loop.guard.settings.noise_rad
    low, high = e.limits.soft_rad
    lost_rad = max(EDGE_SHARE * (high - low), 12.0 * noise_rad)
    return SweepLoop(e.period_s, session.loop.latency_s, e.drive.max_V, lost_rad, e.sensor.curve.lsb_rad)


def _plan(session: Session, motor: CrudeMotor, loop: SweepLoop) -> SweepPlan:
    e, noise_rad = session.experiment, session.loop.guard.settings.noise_rad
    bandwidth_1_s = loop_bandwidth_1_s(motor, loop, noise_rad)
    slowest = max(COUNTS_1_S * e.sensor.curve.lsb_rad, slowest_rad_s(motor, bandwidth_1_s, e.period_s, noise_rad))
    room = survey_room(e, slowest, bandwidth_1_s)
    try:
        return sweep_plan(room, e.survey.speeds_rad_s or ())
    except TooShortError as error:
        raise Fault("NO_SWEEPS", str(error)) from error


def _rehearse(session: Session, sweeps: Sweeps) -> None:
    """Run the sweeps on a simulated bench with the crude motor. Raises Fault NO_SWEEPS if they must not be run."""
    motor = sweeps.motor
    believed = FramedMotor(RealMotor(motor.tau_s, motor.K_rad_s_V, motor.friction_V), Frame())
    if reason := why_not(session, sweeps, believed, (session.delay or BenchDelay()).shown_s[1]):
        raise Fault("NO_SWEEPS", reason)


ENOUGH = 0.025  # of tau, K and friction: more uncertainty than that is too much
MOST_TESTS = 2  # relay tests; with more the config gives a third amplitude already
TITLES = {"tau_s": "tau", "K_rad_s_V": "K", "fc_V": "friction"}


def tell_apart(session: Session) -> None:
    """Where the tests so far leave the law open: one more relay test and a survey, then identify all of it again.

    Raises what the loop and the stages raise; without room for sweeps it only notes that.
    """
    identification = session.found.identification
    why = None if identification is None else what_is_open(identification)
    if why is None:
        session.found.notes.append("thorough: the relay tests leave nothing open, so there is no survey")
        return
    pair_V = third_gains_V(session)
    check = session.found.breakaway
    starts = pair_V is not None and check is not None and starts_from_rest(pair_V, check.moves_V)
    added = " and a relay test of a third amplitude were" if starts else " was"
    session.found.notes.append(f"thorough: {why}; a survey{added} added")
    if pair_V is not None and not starts:
        session.found.notes.append(
            f"thorough: no relay test of a third amplitude: {sum(pair_V):.2f} V would not move the shaft from rest"
        )
    elif pair_V is not None:
        # a replay tests with these gains: it does not know what was open
        session.note("further_test", h1_V=pair_V[0], h2_V=pair_V[1])
        test_once_more(session, pair_V)
    try:
        survey(session)
    except Fault as fault:
        if fault.code != "NO_SWEEPS":
            raise
        session.found.notes.append(f"thorough: no survey: {fault.detail}")
    identify_recorded(session)


def test_once_more(session: Session, pair_V: tuple[float, float]) -> None:
    """One more relay test, from rest to rest."""
    with driving(session):
        session.loop.run(Rest(REST_S), "rest")
        test_further(session, pair_V)


def what_is_open(found: Identification) -> str | None:
    """What the tests leave open, as the begin of a sentence; None if nothing."""
    law, estimate = found.motor_law, found.leading
    if law is None or estimate is None:
        return None
    if law.not_told_apart:
        groups = "; ".join(" and ".join(group) for group in law.not_told_apart)
        return f"the tests did not tell {groups.replace('_', ' ')} apart"
    for name, title in TITLES.items():
        size = max(abs(getattr(estimate, name)), 1e-9)
        share, (risk, _) = law.budget.u95[name] / size, law.budget.hidden.beyond(name, PROMISE * size)
        if share > ENOUGH:
            return f"the tests left {title} uncertain by {share:.2g} (u95, relative)"
        if risk > RISK:
            return f"the tests left {title} more than {PROMISE:.0%} off with a probability of {risk:.2g}"
    return None


def starts_from_rest(pair_V: tuple[float, float], breakaway_V: float) -> bool:
    """Whether the largest drive of these gains moves a shaft that stands: the first two tests go on from a cycle."""
    return sum(pair_V) > breakaway_V


def third_gains_V(session: Session) -> tuple[float, float] | None:
    """Gains of a relay test whose amplitude lies beyond those of the tests so far; None if there were enough."""
    found, e = session.found, session.experiment
    if not 0 < len(found.gains_V) <= MOST_TESTS or found.breakaway is None:
        return None
    if found.further_gains_V is not None:
        return found.further_gains_V
    ratio = e.relay.second_ratio**2
    friction_V = 0.45 * (found.breakaway.plus_V + found.breakaway.minus_V)
    h1_V, h2_V = found.gains_V[0]
    return h1_V * ratio, friction_V + max(h2_V - friction_V, 0.0) * ratio
