"""Cycles in recordings: gains, edges, what is settled, what is accepted, and the average."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import Bench, dcr, motor, record, simulate

from rig.identify.cycles import find_cycle, relay_gains
from rig.identify.record import IdentifyError, Record
from rig.model.friction import coulomb
from rig.model.limit_cycle import limit_cycle
from rig.model.motor import Motor, State


def relay_record(h1=0.8, h2=1.0, rows=1200, first=0, **bench) -> Record:
    return record(simulate(motor(), dcr(h1, h2), rows, Bench(**bench)), first=first)


def redriven(base: Record, u_V: np.ndarray) -> Record:
    return Record(base.t_s, base.y_rad, base.t_u_s, u_V)


@pytest.mark.parametrize(("h1", "h2"), [(0.8, 1.0), (0.5, 1.2), (1.0, 1.0), (0.3, 0.9), (1.2, 1.0)])
def test_gains_are_read_off_the_levels(h1, h2):
    gains = relay_gains(relay_record(h1, h2, noise_rad=0.003))
    assert (gains.h1_V, gains.h2_V) == pytest.approx((h1, h2), abs=1e-12)
    assert f"h1 = {h1:.4g} V" in gains.note


def test_a_quantised_and_a_noisily_reported_drive_have_the_same_gains():
    base = relay_record()
    step = 12.0 / 255
    rng = np.random.default_rng(1)
    for u in (np.round(base.u_V / step) * step, base.u_V + 0.01 * rng.standard_normal(len(base))):
        gains = relay_gains(redriven(base, u))
        assert (gains.h1_V, gains.h2_V) == pytest.approx((0.8, 1.0), abs=step)


def test_a_saturated_drive_has_the_gains_that_the_motor_saw():
    gains = relay_gains(redriven(base := relay_record(), np.clip(base.u_V, -1.5, 1.5)))
    assert gains.h1_V + gains.h2_V == pytest.approx(1.5)
    assert gains.h2_V - gains.h1_V == pytest.approx(0.2)


def test_levels_that_differ_between_the_directions_are_averaged_and_it_says_so():
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
def test_other_drives_are_not_taken_for_a_relay(law, words):
    base = relay_record(rows=600)
    with pytest.raises(IdentifyError, match=words):
        relay_gains(redriven(base, law(base.t_s)))


def test_finely_sampled_the_averaged_cycle_is_that_of_theorem_2_1():
    cycle = find_cycle(relay_record(rows=40_000, period_s=0.0002, delay_s=0.0))
    exact = limit_cycle(0.17, 6.5, 0.5, 0.8, 1.0)
    assert cycle.period_s == pytest.approx(exact.period_s, rel=0.01)
    assert cycle.t1_s == pytest.approx(exact.durations_s[0], abs=4e-4)
    assert (cycle.t2_s, cycle.t3_s) == pytest.approx(exact.durations_s[1:], rel=0.01)
    assert cycle.y_extremum_rad == pytest.approx(exact.states[1, 1], rel=0.01)
    assert cycle.y_rc_rad == pytest.approx(exact.states[0, 1], rel=0.01)
    assert abs(cycle.y_rb_rad) < 0.003
    assert cycle.amplitude_rad == -cycle.y_extremum_rad


def ideal_record(tau=0.17, K=6.5, fc=0.5, h1=0.8, h2=1.0, cycles=15, sampling_s=0.01) -> Record:
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
    return Record(t, y, t_u, levels[following])


def test_the_average_is_aligned_although_the_period_is_no_multiple_of_the_sampling():
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


def test_an_offset_of_position_does_not_reach_the_average():
    base = relay_record(rows=1500)
    shifted = Record(base.t_s, base.y_rad + 0.3, base.t_u_s, base.u_V)
    one, other = find_cycle(base), find_cycle(shifted)
    assert other.curve_rad == pytest.approx(one.curve_rad, abs=1e-12)
    assert other.t1_s == pytest.approx(one.t1_s)


def test_chatter_at_the_rb_edge_is_merged_into_one_edge_of_the_same_area():
    base = relay_record(rows=900)
    clean = find_cycle(base)
    u = base.u_V.copy()
    edges = np.flatnonzero((np.abs(u[1:]) < 1.0) & (np.abs(u[:-1]) > 1.0)) + 1
    for k in edges[edges < u.size - 3]:
        u[k], u[k - 1] = u[k - 1], u[k]  # on, off, on, off: one row early, one late
    chattering = find_cycle(redriven(base, u))
    assert chattering.cycles == clean.cycles
    assert chattering.t1_s + chattering.t2_s == pytest.approx(clean.t1_s + clean.t2_s, abs=1e-9)
    assert chattering.period_s == pytest.approx(clean.period_s)


def test_cycles_before_it_has_settled_are_left_out():
    samples = simulate(motor(), dcr(0.5, 1.2), 2500, Bench())
    cycle = find_cycle(record(samples))
    assert cycle.rows[0] > 100
    first = find_cycle(record(samples, first=700))
    assert first.period_s == pytest.approx(cycle.period_s, rel=0.02)
    assert first.rows[0] >= 700


def test_delay_hunting_is_not_a_cycle():
    samples = simulate(motor(), dcr(1.0, 0.4), 1500, Bench(delay_s=0.009))
    assert np.ptp(samples.y_rad[500:]) > 0.02  # it does oscillate, with h2 < fc
    with pytest.raises(IdentifyError, match=r"delay hunting|not a simple|settled") as caught:
        find_cycle(record(samples))
    assert "h2" in caught.value.cure or "steady" in caught.value.cure


def test_a_cycle_as_small_as_the_sensor_is_refused():
    with pytest.raises(IdentifyError, match="steps of the sensor"):
        find_cycle(relay_record(rows=1500, lsb_rad=0.05))


def test_too_few_and_unsettled_cycles_are_refused():
    with pytest.raises(IdentifyError, match="too few"):
        find_cycle(relay_record(rows=100))
    base = relay_record(rows=1500)
    stretched = np.cumsum(np.diff(base.t_s, prepend=0.0) * np.linspace(1.0, 4.0, len(base)))
    with pytest.raises(IdentifyError, match="settled"):
        find_cycle(Record(stretched, base.y_rad, None, base.u_V))
