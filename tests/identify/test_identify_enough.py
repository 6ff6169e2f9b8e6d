"""What the live fit of everything driven calls enough is never refused afterwards, nor known worse.

A run that ends because its motor is known has short tests: alone they may say too little for a fit to come to an end.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_bench import DEMO, GUARD, LIMITS, PERIOD_S, break_away, simulated_bench

from rig.control.law import Rest
from rig.control.strokes import Stroke, StrokeTest, StrokeTiming
from rig.core.estimators import LEADING
from rig.core.faults import Fault
from rig.identification import Identification, IdentifyError, identify
from rig.identification.departures.budget import TYPE_A
from rig.identification.live import OF_PARAMETERS, LiveEstimate, LiveFit, LiveRows, LiveSettings
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.run_folder.recording.recording import Recording, assembled
from rig.run_folder.recording.series import FEWEST_ROWS
from rig.run_folder.results import RunEvent
from stopping.in_memory import NAMES, MemoryRecord

ENOUGH_PERCENT = 1.0
WIDER = 1.1  # of the live interval: 2 of a normal distribution in place of 1.96, and the noise is measured anew


def driven(motor: Motor, seed: int, test_s: float) -> Recording | None:
    """A breakaway check, some seconds of search and a short test of random strokes; None if it ended in a fault."""
    rng = np.random.default_rng(seed)
    bench = simulated_bench(replace(DEMO, motor=motor), seed=seed, guard=replace(GUARD, max_speed_rad_s=20.0))
    bench.loop._record = record = MemoryRecord()

    def strokes(count: int, speeds_rad_s: tuple[float, float]) -> list[Stroke]:
        drives_V = motor.friction.plus_V + rng.uniform(*speeds_rad_s, count) / motor.K_rad_s_V
        return [
            Stroke(float(sign * min(u_V, 2.9)), float(sign * turn_rad))
            for sign, u_V, turn_rad in zip(
                np.resize([1.0, -1.0], count), drives_V, rng.uniform(0.05, 0.5, count), strict=True
            )
        ]

    law = partial(StrokeTest, motion_rad=0.02)
    with contextlib.suppress(Fault), bench.loop.armed(LIMITS):
        break_away(bench.loop)
        bench.loop.run(law(strokes(6, (0.8, 2.5)), StrokeTiming(6.0, 2.5)), "search")
        bench.loop.run(law(strokes(4, (1.5, 4.0)), StrokeTiming(test_s, 2.5)), "strokes-1")
        known = record.recording()  # the rest after it comes too late to say anything
        bench.loop.run(Rest(0.5), "rest")
        return known
    return None


def live(recording: Recording) -> LiveEstimate | None:
    settings = LiveSettings(PERIOD_S, DEMO.noise_rad, DEMO.rad_per_count, LIMITS.max_u_V)
    fit, estimate = LiveFit(settings), None
    rows = np.arange(len(recording), dtype=np.int64)
    for k in np.array_split(rows, 12):
        fit.take(LiveRows(k, recording.t_s[k], recording.y_rad[k], recording.t_u_s[k], recording.u_V[k]))
        estimate = fit.estimate()
    return estimate


def as_known(recording: Recording) -> Recording:
    """The recording of a run that ended because its live estimate was enough."""
    stop = RunEvent.model_validate({"t_s": float(recording.t_s[-1]), "kind": "decided", "what": "stop", "by": "advice"})
    return replace(recording, events=(stop,))


def scatter(found: Identification) -> dict[str, float]:
    """Of the answer: half width of tau, K and f_c by noise alone, as a share of each."""
    assert found.answer is not None and found.motor_law is not None
    line = next(entry for entry in found.motor_law.budget.entries if entry.source == TYPE_A)
    return {name: getattr(line, name) / getattr(found.answer, name) for name in OF_PARAMETERS}


@pytest.mark.evidence
@settings(max_examples=examples(18, at_least=3), deadline=None)
@given(
    tau_s=st.floats(0.03, 0.5),
    K_rad_s_V=st.floats(2.0, 20.0),
    fc_V=st.floats(0.1, 0.8),
    test_s=st.floats(0.2, 1.5),
    seed=st.integers(0, 10_000),
)
def test_what_was_enough_is_not_refused_afterwards_nor_known_worse(
    tau_s: float, K_rad_s_V: float, fc_V: float, test_s: float, seed: int
) -> None:
    recording = driven(Motor(tau_s, K_rad_s_V, coulomb(fc_V)), seed, test_s)
    known = None if recording is None else live(recording)
    if recording is None or known is None or known.worst_percent > ENOUGH_PERCENT:
        return
    found = identify([as_known(recording)], (LEADING,))
    assert found.answer is not None and found.answer.verdict != "refused", found.answer
    for name, share in scatter(found).items():
        assert 100.0 * share <= WIDER * known.half_percent[name], name


def test_stages_that_follow_each_other_are_one_motion() -> None:
    """Each start of its own takes from what the record says: of this motor 1.5 times the live interval and more."""
    recording = driven(Motor(0.42, 5.0, coulomb(0.36)), 627, 0.6)
    assert recording is not None
    known, found = live(recording), identify([as_known(recording)], (LEADING,))
    assert known is not None
    assert all(100.0 * share <= WIDER * known.half_percent[name] for name, share in scatter(found).items())


def test_a_test_too_short_to_fit_does_not_cost_the_answer() -> None:
    recording = driven(Motor(0.2, 8.0, coulomb(0.3)), 3, 0.2)
    assert recording is not None
    last = int(np.flatnonzero(recording.stage == "strokes-1")[0]) + FEWEST_ROWS
    columns = {name: getattr(recording, name)[:last] for name in NAMES}
    columns["t_u_s"] = np.full(last, np.nan)  # a device that does not tell: rows before the longest delay are lost
    short = assembled(Path("short"), columns, range(1, last + 1), columns_present=NAMES)
    with pytest.raises(IdentifyError, match="too few"):
        identify([short], (LEADING,))
    found = identify([as_known(short)], (LEADING,))
    assert found.answer is not None and found.answer.verdict != "refused"
