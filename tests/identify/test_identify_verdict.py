"""Verdicts: believed where it is right, doubted or refused where it is not, always with a reason."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evidence import evidence
from synthetic import LSB_RAD, Bench, dcr, motor, record, simulate

from rig.identification import sampled_data, sampled_data_verdict
from rig.identification.cycles import find_cycle
from rig.identification.estimate import Estimate
from rig.identification.measurements import Measurements
from rig.identification.triple_relay import TripleRelay
from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TIMES_ERROR_S, TimeSeries

NOISY: dict[str, Any] = {"noise_rad": 0.003, "lsb_rad": LSB_RAD}


def judged(*records: TimeSeries) -> Estimate:
    periods_s: list[float | None] = []
    for one in records:
        try:
            periods_s.append(find_cycle(one).period_s)
        except IdentifyError:
            periods_s.append(None)
    return sampled_data_verdict.judge(sampled_data.fit(records, periods_s=periods_s), records)


def relay(
    rows: int = 1000, known: bool = True, plant: Motor | None = None, h1: float = 0.8, h2: float = 1.0, **bench: Any
) -> TimeSeries:
    samples = simulate(plant or motor(asym_V=0.02), dcr(h1, h2), rows, Bench(**(NOISY | bench)))
    return record(samples, known, 100)


def slipped(one: TimeSeries, rows: int) -> TimeSeries:
    """The drive written ``rows`` rows too late (> 0) or too early."""
    n = len(one)
    if rows > 0:
        return TimeSeries(
            one.t_s[rows:], one.y_rad[rows:], None if one.t_u_s is None else one.t_u_s[rows:], one.u_V[: n - rows]
        )
    return TimeSeries(
        one.t_s[:rows], one.y_rad[:rows], None if one.t_u_s is None else one.t_u_s[:rows], one.u_V[-rows:]
    )


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("seed", [0, *evidence(1, 2)])
def test_a_good_record_is_ok(known: bool, seed: int) -> None:
    found = judged(relay(known=known, seed=seed))
    assert found.verdict == "ok", found.reasons
    assert found.reasons == ()
    assert found.tau_s == pytest.approx(0.17, rel=0.05)


@pytest.mark.parametrize("rows", [1, -1])
@pytest.mark.parametrize("seed", [0, *evidence(1, 2)])
def test_with_known_times_a_row_slipped_by_one_tick_is_refused(rows: int, seed: int) -> None:
    found = judged(slipped(relay(seed=seed), rows))
    assert found.verdict == "refused"
    assert any("than t_u_s says" in reason or "unexplained" in reason for reason in found.reasons)


def shifted(by_s: float, error_s: float, noise_rad: float = 0.0) -> Estimate:
    """A fine sensor, and times of the drive that are off; ``error_s``: by what its link says that they can be."""
    one = relay(noise_rad=noise_rad, lsb_rad=1e-4)
    assert one.t_u_s is not None
    return judged(replace(one, t_u_s=one.t_u_s - by_s, times_error_s=error_s))


@pytest.mark.parametrize("by_s", [2e-5, -2e-5])
def test_a_shift_within_what_the_links_times_can_be_wrong_by_is_no_objection(by_s: float) -> None:
    """Without noise a hundredth of a millisecond shows, and moves nothing that anyone would miss."""
    found = shifted(by_s, TIMES_ERROR_S)
    assert found.verdict == "ok", found.reasons
    assert found.tau_s == pytest.approx(0.17, rel=0.002)
    exact = shifted(by_s, 1e-6)  # a link whose times are better than that has slipped
    assert exact.verdict == "doubtful"
    way = "later" if by_s > 0.0 else "earlier"
    assert any(re.search(rf"with the drive 0\.0[12]\d* ms {way} the fit is better", reason) for reason in exact.reasons)


@pytest.mark.parametrize("error_s", [TIMES_ERROR_S, 3.5e-4])
def test_beyond_what_they_can_be_wrong_by_it_is_one(error_s: float) -> None:
    for by_s, noise_rad in ((4e-4, 0.0), (1e-3, 0.003), (-1e-3, 0.003), (2e-3, 0.003)):
        found = shifted(by_s, error_s, noise_rad)
        assert found.verdict != "ok"
        assert any("the fit is better" in reason or "than t_u_s says" in reason for reason in found.reasons)


@pytest.mark.parametrize("delay_s", [0.002, 0.006])
def test_without_times_the_delay_absorbs_a_row_slipped_early(delay_s: float) -> None:
    """A drive one row early in the file acts from t_s + delay + Ts: within the 2 Ts that are looked at."""
    found = judged(slipped(relay(known=False, delay_s=delay_s), -1))
    whole = judged(relay(known=False, delay_s=delay_s))
    assert whole.delay_s == pytest.approx(delay_s, abs=0.002)
    assert found.delay_s == pytest.approx(delay_s + 0.01, abs=0.002)
    assert found.tau_s == pytest.approx(0.17, rel=0.05)


def test_without_times_a_row_slipped_late_is_not_believed() -> None:
    """It would have to act before it was commanded: the delay is negative, and the motor right."""
    found = judged(slipped(relay(known=False, delay_s=0.002), 1))
    assert found.verdict == "doubtful"
    assert any("move u up by a row" in reason for reason in found.reasons)
    assert found.delay_s == pytest.approx(-0.008, abs=0.002)
    assert found.tau_s == pytest.approx(0.17, rel=0.05)


@pytest.mark.parametrize("seed", range(6))
def test_a_drive_that_acts_at_once_is_no_objection(seed: int) -> None:
    """A plain simulation, or a controller that writes within microseconds of reading."""
    found = judged(relay(known=False, delay_s=0.0, seed=seed))
    assert found.verdict == "ok", found.reasons
    low, high = found.ci95["delay_s"]
    assert low < 0.0015
    assert high > -0.0015
    assert found.tau_s == pytest.approx(0.17, rel=0.03)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: TimeSeries(r.t_s, -r.y_rad, r.t_u_s, r.u_V), "unexplained|cannot tell|not converge"),
        (lambda r: TimeSeries(r.t_s, np.clip(r.y_rad, -0.35, 0.5), r.t_u_s, r.u_V), "noise|unexplained"),
        (
            lambda r: TimeSeries(r.t_s, np.random.default_rng(1).permutation(r.y_rad), r.t_u_s, r.u_V),
            "unexplained|only known",
        ),
    ],
)
def test_positions_that_do_not_belong_to_the_drive_are_not_believed(
    change: Callable[[TimeSeries], TimeSeries], words: str
) -> None:
    found = judged(change(relay()))
    assert found.verdict != "ok"
    assert re.search(words, " ".join(found.reasons)), found.reasons


def test_a_short_noisy_record_is_doubted_for_its_interval() -> None:
    found = judged(relay(rows=190, noise_rad=0.02, lsb_rad=0.0))
    assert found.verdict != "ok"
    assert any("only known to" in reason for reason in found.reasons)


@pytest.mark.parametrize(("between_V", "is_doubted"), [(0.3, True), (0.0, False)])
def test_a_motor_that_mostly_stands_still_under_a_drive_is_doubted(between_V: float, *, is_doubted: bool) -> None:
    samples = simulate(
        motor(), lambda t, y, z: (1.5 if t % 4.0 < 2.0 else -1.5) if t % 2.0 < 0.3 else between_V, 2000, Bench(**NOISY)
    )
    found = judged(record(samples))
    assert any("stands still" in reason for reason in found.reasons) == is_doubted


def test_two_tests_of_one_motor_predict_each_other_and_of_two_motors_do_not() -> None:
    same = judged(relay(), relay(1700, h1=0.5, h2=1.2, seed=2))
    assert same.verdict == "ok", same.reasons
    warm = judged(relay(), relay(1700, plant=motor(0.17, 6.0, 0.42), h1=0.5, h2=1.2, seed=2))
    assert warm.verdict != "ok"
    assert any("noise" in reason or "own fit" in reason for reason in warm.reasons)


def test_static_friction_above_moving_friction_is_no_objection_where_the_relay_exceeds_it() -> None:
    plant = Motor(0.17, 6.5, Friction(0.5, 0.46, 0.56, 0.52), 0.01)
    found = judged(relay(plant=plant))
    assert found.verdict == "ok", found.reasons
    assert found.fc_V == pytest.approx(0.48, rel=0.03)


def reference(tau: float, K: float, fc: float, known: bool = True) -> Estimate:
    one = relay(known=known)
    cycle = find_cycle(one)
    estimate = Estimate("triple-relay", tau, K, fc, cycles=(cycle,))
    return TripleRelay().judge(estimate, Measurements([one], cycles=[cycle]), {})


@pytest.mark.parametrize("known", [True, False])
def test_a_reference_method_is_judged_by_what_its_model_leaves(known: bool) -> None:
    good, poor, none = (reference(*p, known) for p in ((0.17, 6.5, 0.5), (0.22, 6.5, 0.5), (0.17, 6.5, -0.1)))
    # right or not: at 10 ms the interval of a reference method does not hold its own error, and it says so
    assert good.verdict == "doubtful"
    assert len(good.reasons) == 1
    assert "interval" in good.reasons[0]
    assert good.rms_rad == pytest.approx(0.0032, rel=0.1)
    assert poor.verdict in ("doubtful", "refused")
    assert poor.rms_rad > 5.0 * good.rms_rad
    assert none.verdict == "refused"
    assert "no motor" in none.reasons[0]


def test_a_verdict_never_improves_and_reasons_do_not_repeat() -> None:
    one = Estimate("sampled-data", 0.1, 1.0, 0.1).judged("refused", "a").judged("doubtful", "b", "a")
    assert (one.verdict, one.reasons) == ("refused", ("a", "b"))


def test_an_asymmetry_beyond_the_friction_is_doubtful() -> None:
    """A weight on the shaft pulls harder than friction holds."""
    pulled = judged(relay(plant=Motor(0.17, 6.5, Friction(0.1, 0.1, 0.1, 0.1), 0.2)))
    assert pulled.asym_V == pytest.approx(0.2, abs=0.01)
    assert pulled.verdict == "doubtful"
    assert any("turns by itself at 0 V" in reason for reason in pulled.reasons)
    held = judged(relay(plant=Motor(0.17, 6.5, Friction(0.3, 0.3, 0.3, 0.3), 0.2)))
    assert not any("turns by itself" in reason for reason in held.reasons)


def test_what_an_unknown_delay_costs_is_said() -> None:
    unknown, known = judged(relay(known=False)), judged(relay(known=True))
    words = sampled_data_verdict.confounding(unknown)
    assert words is not None
    shared = float(unknown.correlation[0, 4])
    assert f"{shared:+.2f}" in words
    assert 0.3 < abs(shared) < 1.0
    # the promise, held to the record with known times
    gain = unknown.covariance[0, 0] ** 0.5 / known.covariance[0, 0] ** 0.5
    assert gain == pytest.approx(1.0 / (1.0 - shared**2) ** 0.5, rel=0.25)
    assert sampled_data_verdict.confounding(known) is None


@pytest.mark.evidence
def test_rows_left_out_of_a_record_with_times_are_not_believed() -> None:
    """Logged every few ticks only: the drives between the rows are missing, and t_u_s cannot say so."""
    t = np.arange(1500, dtype=float) * 0.01
    u = 1.2 * (2.0 * np.abs((t / 1.5 + 0.25) % 1.0 - 0.5) * 2.0 - 1.0)
    y = Motor(0.17, 6.5, Friction(0.5, 0.5, 0.5, 0.5)).response(State(), t, np.r_[-1.0, t + 0.004], np.r_[0.0, u])[:, 1]
    y = y + 0.003 * np.random.default_rng(3).standard_normal(t.size)
    whole = judged(TimeSeries(t, y, t + 0.004, u))
    assert whole.tau_s == pytest.approx(0.17, rel=0.05)
    assert whole.verdict == "ok", whole.reasons
    thinned = judged(TimeSeries(t[::3], y[::3], t[::3] + 0.004, u[::3]))
    assert abs(thinned.tau_s / 0.17 - 1.0) > 0.05
    assert thinned.verdict != "ok"
