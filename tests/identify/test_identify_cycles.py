"""Cycles in recordings: gains, edges, what is settled, what is accepted, and the average."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from evidence import evidence
from hypothesis import given
from hypothesis import strategies as st
from synthetic import Bench, dcr, motor, record, simulate

from rig.identification.cycles import equivalent_edge, find_cycle, relay_gains
from rig.identification.mean_cycle import Bins, Cycle, average
from rig.model.friction import coulomb
from rig.model.limit_cycle import limit_cycle
from rig.model.motor import Motor, State
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries


def relay_record(h1: float = 0.8, h2: float = 1.0, rows: int = 1200, first: int = 0, **bench: Any) -> TimeSeries:
    return record(simulate(motor(), dcr(h1, h2), rows, Bench(**bench)), first=first)


def redriven(base: TimeSeries, u_V: np.ndarray) -> TimeSeries:
    return TimeSeries(base.t_s, base.y_rad, base.t_u_s, u_V)


@pytest.mark.parametrize(("h1", "h2"), [(0.8, 1.0), (0.5, 1.2), (1.0, 1.0), (0.3, 0.9), (1.2, 1.0)])
def test_gains_are_read_off_the_levels(h1: float, h2: float) -> None:
    gains = relay_gains(relay_record(h1, h2, noise_rad=0.003))
    assert (gains.h1_V, gains.h2_V) == pytest.approx((h1, h2), abs=1e-12)
    assert f"h1 = {h1:.4g} V" in gains.note


def test_a_quantised_and_a_noisily_reported_drive_have_the_same_gains() -> None:
    base = relay_record()
    step = 12.0 / 255
    rng = np.random.default_rng(1)
    for u in (np.round(base.u_V / step) * step, base.u_V + 0.01 * rng.standard_normal(len(base))):
        gains = relay_gains(redriven(base, u))
        assert (gains.h1_V, gains.h2_V) == pytest.approx((0.8, 1.0), abs=step)


def test_a_saturated_drive_has_the_gains_that_the_motor_saw() -> None:
    gains = relay_gains(redriven(base := relay_record(), np.clip(base.u_V, -1.5, 1.5)))
    assert gains.h1_V + gains.h2_V == pytest.approx(1.5)
    assert gains.h2_V - gains.h1_V == pytest.approx(0.2)


def test_levels_that_differ_between_the_directions_are_averaged_and_it_says_so() -> None:
    base = relay_record()
    gains = relay_gains(redriven(base, np.where(base.u_V > 0, base.u_V, 0.95 * base.u_V)))
    assert gains.h1_V + gains.h2_V == pytest.approx(1.8 * 0.975)
    assert "unequal" in gains.note


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda t: np.sin(3.0 * t), "not a dual-channel relay"),
        (lambda t: np.sign(np.sin(3.0 * t)), "not a dual-channel relay"),
        (lambda t: 0.0 * t, "zero throughout"),
        (lambda t: 1.0 + 0.5 * np.sign(np.sin(3.0 * t)) + 0.2 * np.sign(np.sin(7.0 * t)), "not symmetric"),
    ],
)
def test_other_drives_are_not_taken_for_a_relay(law: Callable[[np.ndarray], np.ndarray], words: str) -> None:
    base = relay_record(rows=600)
    with pytest.raises(IdentifyError, match=words):
        relay_gains(redriven(base, law(base.t_s)))


def test_finely_sampled_the_averaged_cycle_is_that_of_theorem_2_1() -> None:
    cycle = find_cycle(relay_record(rows=40_000, period_s=0.0002, delay_s=0.0))
    exact = limit_cycle(0.17, 6.5, 0.5, 0.8, 1.0)
    assert cycle.period_s == pytest.approx(exact.period_s, rel=0.01)
    assert cycle.t1_s == pytest.approx(exact.durations_s[0], abs=4e-4)
    assert (cycle.t2_s, cycle.t3_s) == pytest.approx(exact.durations_s[1:], rel=0.01)
    assert cycle.y_extremum_rad == pytest.approx(exact.states[1, 1], rel=0.01)
    assert cycle.y_rc_rad == pytest.approx(exact.states[0, 1], rel=0.01)
    assert abs(cycle.y_rb_rad) < 0.003
    assert cycle.amplitude_rad == -cycle.y_extremum_rad


def ideal_record(
    tau: float = 0.17,
    K: float = 6.5,
    fc: float = 0.5,
    h1: float = 0.8,
    h2: float = 1.0,
    cycles: int = 15,
    sampling_s: float = 0.01,
) -> TimeSeries:
    """The exact limit cycle, seen at a rate that its period is no multiple of; edges between the samples."""
    exact = limit_cycle(tau, K, fc, h1, h2)
    t1, t2, _ = exact.durations_s
    half = 0.5 * exact.period_s
    t = np.arange(0.0, cycles * exact.period_s, sampling_s)
    sign = np.where((t // half) % 2 == 0, 1.0, -1.0)
    path = Motor(tau, K, coulomb(fc)).response(
        State(*exact.states[0]), np.unique(t % half), [0.0, t1 + t2], [h1 + h2, h2 - h1]
    )
    y = sign * path[np.searchsorted(np.unique(t % half), t % half), 1]
    edges = np.concatenate([k * half + np.array([0.0, t1 + t2]) for k in range(2 * cycles)])
    levels = np.concatenate([(-1) ** k * np.array([h1 + h2, h2 - h1]) for k in range(2 * cycles)])
    following = np.minimum(np.searchsorted(edges, t + sampling_s) - 1, edges.size - 1)
    t_u = np.maximum(t, edges[following])
    return TimeSeries(t, y, t_u, levels[following])


def test_the_average_is_aligned_although_the_period_is_no_multiple_of_the_sampling() -> None:
    exact = limit_cycle(0.17, 6.5, 0.5, 0.8, 1.0)
    assert abs(exact.period_s / 0.01 - round(exact.period_s / 0.01)) > 0.2
    cycle = find_cycle(ideal_record())
    assert cycle.period_s == pytest.approx(exact.period_s, rel=1e-9)
    assert (cycle.t1_s + cycle.t2_s, cycle.t3_s) == pytest.approx(
        (sum(exact.durations_s[:2]), exact.durations_s[2]), rel=1e-9
    )
    motor_now = Motor(0.17, 6.5, coulomb(0.5))
    half = cycle.phase < 0.5
    at_s = cycle.phase[half] * cycle.period_s
    edges = [0.0, sum(exact.durations_s[:2])]
    true = motor_now.response(State(*exact.states[0]), np.r_[0.0, at_s], edges, [1.8, 0.2])[1:, 1]
    assert cycle.curve_rad[half] == pytest.approx(true, abs=0.003 * exact.amplitude_rad)
    assert cycle.curve_rad[~half] == pytest.approx(-cycle.curve_rad[half])
    assert np.all(np.diff(cycle.phase) > 0.0)
    assert cycle.phase[-1] < 1.0
    assert cycle.amplitude_rad == pytest.approx(exact.amplitude_rad, rel=0.005)


def test_an_offset_of_position_does_not_reach_the_average() -> None:
    base = relay_record(rows=1500)
    shifted = TimeSeries(base.t_s, base.y_rad + 0.3, base.t_u_s, base.u_V)
    one, other = find_cycle(base), find_cycle(shifted)
    assert other.curve_rad == pytest.approx(one.curve_rad, abs=1e-12)
    assert other.t1_s == pytest.approx(one.t1_s)


def edges_of(
    u_V: np.ndarray, before: Callable[[np.ndarray], np.ndarray], after: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Rows at which the drive steps from a level to another, with room on both sides."""
    rows = np.flatnonzero(before(u_V[:-1]) & after(u_V[1:])) + 1
    return rows[(rows > 30) & (rows < u_V.size - 30)]


def chattering(base: TimeSeries, rows: np.ndarray, reach: int, rng: np.random.Generator) -> TimeSeries:
    """The record with a chatter of the same area within ``reach`` rows of each of these edges.

    As many rows before the edge are switched early as rows after it are switched late.
    """
    u = base.u_V.copy()
    for k in rows.tolist():
        count = int(rng.integers(1, reach))
        early, late = k - 1 - rng.permutation(reach)[:count], k + rng.permutation(reach)[:count]
        u[early], u[late] = base.u_V[k], base.u_V[k - 1]
    return redriven(base, u)


def shape(cycle: Cycle) -> tuple[float, ...]:
    return cycle.period_s, cycle.t1_s + cycle.t2_s, cycle.t3_s


@pytest.mark.parametrize("relay", ["both", *evidence("RB", "RC")])
@pytest.mark.parametrize(("period_s", "reach"), [(0.01, 2), (0.0002, 20)])
def test_chatter_is_merged_into_one_edge_of_the_same_area(relay: str, period_s: float, reach: int) -> None:
    base = relay_record(rows=round(9.0 / period_s), period_s=period_s, delay_s=0.3 * period_s)
    clean = find_cycle(base)
    rb = edges_of(base.u_V, lambda u: np.abs(u) > 1.0, lambda u: np.abs(u) < 1.0)
    rc = edges_of(base.u_V, lambda u: np.abs(u) < 1.0, lambda u: np.abs(u) > 1.0)
    rows = {"RB": rb, "RC": rc, "both": np.concatenate([rb, rc])}[relay]
    found = find_cycle(chattering(base, rows, reach, np.random.default_rng(3)))
    assert found.cycles == clean.cycles
    assert shape(found) == pytest.approx(shape(clean), abs=1e-9)
    assert (found.h1_V, found.h2_V) == (clean.h1_V, clean.h2_V)


def test_a_moment_of_the_opposite_level_is_no_cycle() -> None:
    base = relay_record(rows=900)
    clean = find_cycle(base)
    u = base.u_V.copy()
    edges = edges_of(u, lambda u: np.abs(u) < 1.0, lambda u: u > 1.0)
    u[edges + 3] = -1.8
    assert find_cycle(redriven(base, u)).cycles == clean.cycles


def test_noise_makes_a_sampled_relay_chatter_and_cycles_are_counted_all_the_same() -> None:
    fine: dict[str, Any] = {"rows": 40_000, "period_s": 0.0002, "delay_s": 0.0001}
    clean, noisy = relay_record(**fine), relay_record(noise_rad=0.003, **fine)
    exact = limit_cycle(0.17, 6.5, 0.5, 0.8, 1.0)
    assert np.count_nonzero(np.diff(noisy.u_V)) > 2 * np.count_nonzero(np.diff(clean.u_V))
    one, other = find_cycle(clean), find_cycle(noisy)
    assert abs(one.cycles - other.cycles) <= 1
    assert shape(other) == pytest.approx(shape(one), rel=0.01)
    assert other.period_s == pytest.approx(exact.period_s, rel=0.01)


def test_the_averaged_relay_signal_has_the_mean_of_its_cycles_edges() -> None:
    base = relay_record(rows=60_000, period_s=0.0002, delay_s=0.0001, noise_rad=0.003)
    cycle = find_cycle(base)
    begins = edges_of(base.u_V, lambda u: np.abs(u) < 1.0, lambda u: u > 1.0)
    begins = begins[np.r_[True, np.diff(begins) > 1000]]  # RC does not chatter, RB does
    begins = begins[(begins >= cycle.rows[0]) & (begins < cycle.rows[1] - 3100)]
    length = round(cycle.period_s / 0.0002)
    u, y = (np.mean([values[k : k + length] for k in begins], axis=0) for values in (base.u_V, base.y_rad))
    assert np.unique(np.round(u, 6)).size > 8  # a staircase
    t = 0.0002 * np.arange(5 * length, dtype=float)
    found = find_cycle(TimeSeries(t, np.tile(y, 5), t + 0.0001, np.tile(u, 5)))
    assert (found.h1_V, found.h2_V) == pytest.approx((0.8, 1.0), abs=0.01)
    assert shape(found) == pytest.approx(shape(cycle), rel=0.005)


@given(st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=20), st.floats(-5.0, 5.0))
def test_an_equivalent_edge_has_the_area_of_its_staircase(stairs: list[tuple[float, float]], first: float) -> None:
    lasting, done = (np.array(column) for column in zip(*stairs, strict=True))
    begin = first + np.concatenate([[0.0], np.cumsum(lasting)[:-1]])
    edge = equivalent_edge(begin, lasting, done)
    assert first - 1e-9 <= edge <= first + lasting.sum() + 1e-9
    assert first + lasting.sum() - edge == pytest.approx(lasting @ done)


def test_means_without_one_cycle_are_those_of_the_others() -> None:
    cycle = find_cycle(relay_record(rows=900, noise_rad=0.003))
    bins = Bins.of(cycle.waves, cycle.period_sampling_s)
    for k in (0, cycle.cycles - 1):
        rest = average(cycle.waves[:k] + cycle.waves[k + 1 :], 0.8, 1.0, 0.01, 0.0, cycle.rows)
        for one, other in zip(bins.halves(without=k), rest.halves, strict=True):
            assert (one.inner_s, one.length_s) == pytest.approx((other.inner_s, other.length_s), abs=1e-12)
            assert one.y_rad == pytest.approx(other.y_rad, abs=1e-12)
            assert one.at_s == pytest.approx(other.at_s, abs=1e-12)


def test_cycles_before_it_has_settled_are_left_out() -> None:
    samples = simulate(motor(), dcr(0.5, 1.2), 2500, Bench())
    cycle = find_cycle(record(samples))
    assert cycle.rows[0] > 100
    first = find_cycle(record(samples, first=700))
    assert first.period_s == pytest.approx(cycle.period_s, rel=0.02)
    assert first.rows[0] >= 700


def test_delay_hunting_is_not_a_cycle() -> None:
    samples = simulate(motor(), dcr(1.0, 0.4), 1500, Bench(delay_s=0.009))
    assert np.ptp(samples.y_rad[500:]) > 0.02  # it does oscillate, with h2 < fc
    with pytest.raises(IdentifyError, match=r"delay hunting|not a simple|settled") as caught:
        find_cycle(record(samples))
    assert "h2" in caught.value.cure or "steady" in caught.value.cure


def test_a_cycle_as_small_as_the_sensor_is_refused() -> None:
    with pytest.raises(IdentifyError, match="steps of the sensor"):
        find_cycle(relay_record(rows=1500, lsb_rad=0.05))


def test_too_few_and_unsettled_cycles_are_refused() -> None:
    with pytest.raises(IdentifyError, match="too few"):
        find_cycle(relay_record(rows=100))
    base = relay_record(rows=1500)
    stretched = np.cumsum(np.diff(base.t_s, prepend=0.0) * np.linspace(1.0, 4.0, len(base)))
    with pytest.raises(IdentifyError, match="settled"):
        find_cycle(TimeSeries(stretched, base.y_rad, None, base.u_V))


def test_a_cycle_with_a_gap_and_the_next_one_are_not_averaged() -> None:
    """In a gap of the host the relay switches late; the cycle after it has not settled again."""
    base = relay_record()
    kept = np.ones(len(base), dtype=bool)
    kept[700:712] = False
    cut = TimeSeries(base.t_s[kept], base.y_rad[kept], base.t_u_s[kept], base.u_V[kept])  # type: ignore[index]
    assert find_cycle(cut).cycles == find_cycle(base).cycles - 2
