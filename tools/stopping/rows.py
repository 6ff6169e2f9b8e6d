"""One random motor, driven from rest with nothing known until rig says that it knows, beside its truth."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from campaign_real.departing_bench import REACH_RAD, DepartingShaft, config_of, open_bench
from campaign_real.departing_motor import Bench, Departures
from campaign_real.kinds import Kind, departures_of, truth_of
from rig.backends.registry import Bench as OpenBench
from rig.backends.simulated.driver import SimulatedDriver
from rig.campaign.random_motors import Draw, draw
from rig.config import Experiment
from rig.config.campaign import Campaign
from rig.config.schema import RelaySection, UntilSection
from rig.identification.departures.budget import TYPE_A
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.model.real_motor import Frame, FramedMotor, plain
from rig.run_folder.recording.recording import Recording
from rig.running.experiment.stages import identify_recorded
from rig.running.experiment.until import drive_until
from rig.running.preflight.breakaway_strokes import breakaway_strokes
from rig.running.session import Session
from stopping.in_memory import driven
from stopping.shown import expected_gain

Array = NDArray[np.float64]

OF = ("tau_s", "K_rad_s_V", "fc_V")
PERCENT_OF = {"tau_s": "tau_percent", "K_rad_s_V": "K_percent", "fc_V": "fc_percent"}
LONGEST_S = 60.0  # of the tests; friction drifts over it
FASTEST_MOTORS_V, LEAST_V = 0.5, 0.01  # of breakaway.max_V: from there on down, in these steps
WIDER = 1.1  # times the live interval: 2 of a normal distribution in place of 1.96, and the noise is measured anew
DOUBT = 0.30  # a model that is known beforehand is off by at most that: relay.until.model_doubt_percent


@dataclass(frozen=True)
class Row:
    """What came of one motor.

    known           whether the tests ended because it was known
    why             why they ended, or the fault that ended the run
    tests_s, run_s  how long the tests were, and the run from its start to their end, s
    error, inside   of the live estimate at the stop: relative errors of tau, K and f_c, and what its interval holds
    verdict         of the identification afterwards; None if it was not asked for
    final_error, final_inside, u95   of it: relative errors, whether u95 holds each, relative u95
    found, groups   of it: names of the laws that were found, and names that are not told apart
    gain            in BIC, that is to be expected of the motor's law in this run's tests; None: not asked, or no law
    beyond_rad      how far the shaft went beyond the soft limits, rad
    braked          ticks in which the guard braked
    seconds         of computing, s
    live            relative half widths of the live estimate's intervals at the stop
    scatter         relative half widths afterwards, what noise alone leaves of u95; None without a budget
    """

    number: int
    kinds: tuple[str, ...]
    known: bool
    why: str
    tests_s: float | None
    run_s: float | None
    error: tuple[float, ...] | None
    inside: tuple[bool, ...] | None
    verdict: str | None
    final_error: tuple[float, ...] | None
    final_inside: tuple[bool, ...] | None
    u95: tuple[float, ...] | None
    found: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    gain: float | None
    beyond_rad: float
    braked: int
    fault: str | None
    seconds: float
    live: tuple[float, ...] | None = None
    scatter: tuple[float, ...] | None = None

    @property
    def is_worse(self) -> bool:
        """Whether the answer that ended the tests was refused afterwards, or is known worse by its noise than live.

        What noise does not make is not compared: laws that the tests do not exclude, sag, supply, calibration.
        """
        if not self.known:
            return False
        if self.verdict in (None, "refused") or self.scatter is None or self.live is None:
            return True
        return any(after > WIDER * live for after, live in zip(self.scatter, self.live, strict=True))

    def as_json(self) -> dict[str, object]:
        """As a line of rows.jsonl."""
        return asdict(self)


@dataclass(frozen=True)
class Asked:
    """How the motors are driven.

    percent     wanted half width of the 95 % intervals, %
    identified  whether each run is identified afterwards
    known       whether the motor is known to 30 % beforehand
    """

    percent: float = 1.0
    identified: bool = False
    known: bool = False


def row(campaign: Campaign, number: int, kinds: Sequence[Kind], asked: Asked) -> Row:
    """The row of motor ``number`` of the campaign, with these departures."""
    began = time.perf_counter()
    one = draw(campaign, number)
    sampling, sensor = campaign.sampling, campaign.sensor
    bench = Bench(sampling.period_s, one.delay_s, sensor.noise_rad, sensor.lsb_rad, one.offset_rad)
    departures = departures_of(campaign, one, kinds)

    until = UntilSection(interval_percent=asked.percent, longest_s=LONGEST_S)

    def script(session: Session) -> None:
        drive_until(session, _known(campaign, one) if asked.known else None)
        if asked.identified:
            identify_recorded(session)

    e = checked(config_of(one, bench)).model_copy(update={"relay": RelaySection(until=until)})
    opened, shaft = open_bench(e, one, departures, bench, LONGEST_S, campaign.seed * 1_000_003 + number)
    session, fault = driven(e, opened, script)
    recording = session.read()
    stopped, found = session.found.stopped, session.found.identification
    truth = _truth(one, departures, recording)
    live = stopped.live[-1] if stopped is not None and stopped.live else None
    error = inside = percents = final_error = final_inside = u95 = scatter = verdict = None
    names: tuple[str, ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()
    if live is not None:
        values = np.array([getattr(live, name) for name in OF])
        percents = np.array([getattr(live, PERCENT_OF[name]) for name in OF])
        half = 0.01 * values * percents
        error = tuple((values / truth - 1.0).tolist())
        inside = tuple((np.abs(values - truth) <= half).tolist())
    answer = None if found is None else found.answer
    if found is not None and answer is not None:
        law = found.motor_law
        values = np.array([getattr(answer, name) for name in OF])
        wide = np.array([(answer.u95 or {}).get(name, np.nan) for name in OF])
        verdict = answer.verdict
        final_error = tuple((values / truth - 1.0).tolist())
        final_inside = tuple((np.abs(values - truth) <= wide).tolist())
        u95 = tuple((wide / values).tolist())
        if law is not None and answer.u95 is not None:
            of_noise = next(entry for entry in law.budget.entries if entry.source == TYPE_A)
            scatter = tuple((np.array([getattr(of_noise, name) for name in OF]) / values).tolist())
            names, groups = tuple(part.law.name for part in law.found), law.not_told_apart
    return Row(
        number,
        tuple(kind.name for kind in kinds),
        stopped is not None and stopped.known,
        stopped.why if stopped is not None else str(fault),
        None if stopped is None else stopped.tests_s,
        None if stopped is None else stopped.t_s,
        error,
        inside,
        verdict,
        final_error,
        final_inside,
        u95,
        names,
        groups,
        _gain(session, opened, shaft, kinds, bench) if asked.identified and stopped is not None else None,
        max(shaft.furthest_rad - REACH_RAD, 0.0),
        session.loop.guard.braked_ticks,
        None if fault is None else fault.code,
        time.perf_counter() - began,
        None if percents is None else tuple((0.01 * percents).tolist()),
        scatter,
    )


def checked(e: Experiment) -> Experiment:
    """The config with a breakaway.max_V that `rig check` accepts: the fastest motors need less than 0.5 V."""
    max_V = e.breakaway.max_V if breakaway_strokes(e) is not None else FASTEST_MOTORS_V
    while breakaway_strokes(e, max_V) is None and max_V > LEAST_V:
        max_V = round(max_V - LEAST_V, 3)
    return e.model_copy(update={"breakaway": e.breakaway.model_copy(update={"max_V": max_V})})


def _gain(
    session: Session, opened: OpenBench, shaft: DepartingShaft, kinds: Sequence[Kind], bench: Bench
) -> float | None:
    """What the motor's one law should gain in BIC, from what the sensor would have read without noise."""
    if len(kinds) != 1:
        return None
    assert isinstance(opened.driver, SimulatedDriver)
    times_s = np.array([session.loop.since_start_s(t_s) for t_s in opened.driver.shaft()[0]])
    recording = session.read()
    ideal_rad = np.interp(recording.t_s, times_s, shaft.ideal_rad)
    return expected_gain(
        recording, ideal_rad, kinds[0].law, math.hypot(bench.noise_rad, bench.lsb_rad / math.sqrt(12.0))
    )


def _truth(one: Draw, departures: Departures, recording: Recording) -> Array:
    """tau, K and f_c as they are defined for a bench with departures, over the driven travel and time."""
    driven = np.flatnonzero(recording.u_V != 0.0)
    rows = driven if driven.size else slice(None)
    y_rad = recording.y_rad[rows] - one.offset_rad
    course = float(np.mean(recording.t_s[rows])) / LONGEST_S
    truth = truth_of(one, departures, (float(y_rad.min()), float(y_rad.max())), course)
    return np.array([getattr(truth, name) for name in OF])


def _known(campaign: Campaign, one: Draw) -> FramedMotor:
    """The motor as an earlier run might know it: tau, K and f_c each off by up to 30 %, uniformly."""
    rng = np.random.default_rng(np.random.SeedSequence(campaign.seed, spawn_key=(one.number, 91)))
    off = 1.0 + DOUBT * rng.uniform(-1.0, 1.0, 3)
    motor = Motor(one.tau_s * off[0], one.K_rad_s_V * off[1], coulomb(one.fc_V * off[2]), 0.0)
    return FramedMotor(plain(motor), Frame())
