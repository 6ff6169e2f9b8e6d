"""One random motor, recorded several times, each run identified; and what `rig compare` says of its runs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from rig.campaign.random_motors import Draw, draw
from rig.config.campaign import Campaign
from rig.control.relay import DualChannelRelay
from rig.control.simulation import Sampling, simulate
from rig.identification import IdentifyError, identify
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.output.compare.compared_run import ComparedRun, NotComparableError, of_result
from rig.output.compare.comparison import compare_runs
from rig.run_folder.results import RunMeta, RunResult

SAME, DRIFTED, LAWS = "same", "drifted", "laws"
RUNS = {SAME: 4, DRIFTED: 2, LAWS: 2}  # of each motor
CYCLES = 10
WANTED_FC = 0.006  # half width of f_c's 95 % interval in a run that shall show a drift, relative
MOST_CYCLES = 120
DRIFT = 1.02  # of f_c, in the second run of a motor that drifts
GAINS = (0.9, 1.1)  # of the relay's gains, drawn anew for each run
METHOD = "sampled-data"
NORMAL = 1.96
BEGAN = datetime(2026, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, eq=False)
class Row:
    """What was identified of one motor's runs.

    values, covariance   (n, 3) and (n, 3, 3), as ``ComparedRun`` has them
    lost                 why there is no row; empty if there is
    """

    group: str
    number: int
    values: tuple[Any, ...] = ()
    covariance: tuple[Any, ...] = ()
    lost: str = ""

    def runs(self) -> list[ComparedRun]:
        """The runs, an hour apart, to be compared."""
        found = []
        for k, (values, covariance) in enumerate(zip(self.values, self.covariance, strict=True)):
            meta = RunMeta(started_utc=(BEGAN + timedelta(hours=k)).isoformat())
            own = (np.array(values), np.array(covariance))
            found.append(ComparedRun(f"run {k}", Path(f"run-{k}"), *own, None, {}, meta, "ok"))
        return found


@dataclass(frozen=True)
class Judged:
    """What `rig compare` says of one motor's runs.

    chances    of each pair of its runs, that one motor differs so much (Type A)
    odd        of all its runs together: how many are named odd
    agree      whether all its runs together do not differ
    held       of tau, K and f_c, whether the interval of the trend over the runs' times holds 0
    off        of the pairs, how far off the second is, in its standard errors: tau, K and f_c
    fc_half    half width of f_c's interval in the first run, relative
    fc_shows   whether the interval of f_c's difference in the first pair leaves 0 out
    """

    chances: tuple[float, ...]
    odd: int
    agree: bool
    held: tuple[bool, ...]
    off: tuple[tuple[float, ...], ...]
    fc_half: float
    fc_shows: bool


def row(campaign: Campaign, group: str, number: int) -> Row:
    """The row of motor ``number`` of the campaign."""
    one = draw(campaign, number)
    cycles = CYCLES
    try:
        if group == DRIFTED:
            half = _fc_half(_run(campaign, one, group, 0, cycles))
            cycles = min(MOST_CYCLES, math.ceil(cycles * (half / WANTED_FC) ** 2))
        runs = [_run(campaign, one, group, k, cycles) for k in range(RUNS[group])]
    except (IdentifyError, NotComparableError) as error:
        return Row(group, number, lost=str(error).splitlines()[0])
    return Row(
        group, number, tuple(run.values.tolist() for run in runs), tuple(run.covariance.tolist() for run in runs)
    )


def judged(one: Row) -> Judged:
    """What `rig compare` says of the runs of a row."""
    runs = one.runs()
    pairs = [compare_runs(runs[k : k + 2]).result for k in range(0, len(runs), 2)]
    second = [pair.runs[1] for pair in pairs]
    together = compare_runs(runs).result
    low, high = second[0].off_ci95_percent["fc_V"]
    return Judged(
        tuple(pair.measurably.chance for pair in pairs),
        len(together.measurably.odd or ()),
        not together.measurably.differs,
        tuple((t.ci95[0] or 0.0) <= 0.0 <= (t.ci95[1] or 0.0) for t in together.trends),
        tuple(_in_errors(run.off_percent.values(), run.off_ci95_percent.values()) for run in second),
        _fc_half(runs[0]),
        not (low or 0.0) <= 0.0 <= (high or 0.0),
    )


def _run(campaign: Campaign, one: Draw, group: str, run: int, cycles: int) -> ComparedRun:
    """Run ``run`` of a motor: simulated with gains, a start and noise of its own, and identified."""
    random = np.random.default_rng((campaign.seed, one.number, list(RUNS).index(group), run))
    gain = random.uniform(*GAINS)
    drifts = group == DRIFTED and run == 1
    motor = Motor(one.tau_s, one.K_rad_s_V, coulomb(one.fc_V * (DRIFT if drifts else 1.0)), one.asym_V)
    sampling = Sampling(
        campaign.sampling.period_s,
        0.2 * campaign.sampling.period_s,
        campaign.sensor.noise_rad,
        campaign.sensor.lsb_rad,
        float(random.uniform(-0.05, 0.05)),
        int(random.integers(2**31)),
    )
    relay = DualChannelRelay(gain * one.h1_V, gain * one.h2_V, math.inf)
    duration_s = (campaign.relay.settling_cycles + cycles) * one.period_s
    recording = simulate(motor, relay, duration_s, sampling)
    found = identify([recording], (METHOD,), choose_law=group == LAWS).as_result()
    result = RunResult(answer=found.answer, budget=found.budget)
    return of_result(f"run {run}", Path(f"run-{run}"), RunMeta(), result)


def _fc_half(run: ComparedRun) -> float:
    return NORMAL * math.sqrt(float(run.covariance[2, 2])) / float(run.values[2])


def _in_errors(
    off: Iterable[float | None], intervals: Iterable[tuple[float | None, float | None]]
) -> tuple[float, ...]:
    return tuple(
        2.0 * NORMAL * (by or 0.0) / ((high or 0.0) - (low or 0.0))
        for by, (low, high) in zip(off, intervals, strict=True)
    )
