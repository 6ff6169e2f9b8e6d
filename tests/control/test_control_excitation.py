"""The gain search on simulated motors: finds the wanted cycle, stays inside, knows hunting from a cycle."""

from __future__ import annotations

import contextlib
import math

import pytest
from directional_friction import directional
from evidence import evidence
from simulated_bench import CALIBRATION, DEMO, LIMITS, PERIOD_S, break_away, simulated_bench

from rig.control.excitation import CycleTarget, GainSearch, RelayTest, SearchRange
from rig.control.relay import DualChannelRelay
from rig.core.faults import Fault
from rig.model.cycle_detector import CycleDetector
from rig.model.friction import coulomb
from rig.model.motor import Motor

TARGET = CycleTarget(0.6, 1.0, 0.15)
SEARCH = SearchRange(0.3, 0.1, 0.15, 0.6, h_max_V=3.0, sum_max_V=3.0, timeout_s=60.0)


def relay_and_detector() -> tuple[DualChannelRelay, CycleDetector]:
    detector = CycleDetector(30 * PERIOD_S, 20 * CALIBRATION.lsb_rad)
    return DualChannelRelay(0.0, 0.0, z_bound_rad_s=0.7), detector


MOTORS = {
    "demo": DEMO.motor,
    "quick": Motor(0.09, 6.0, coulomb(0.4, 0.44)),
    "slow": Motor(0.35, 4.0, coulomb(0.35)),
    "stiff": Motor(0.15, 5.0, coulomb(0.7, 0.9)),
    "one-sided": Motor(0.17, 6.5, directional(0.55, 0.40), 0.03),
}


@pytest.mark.parametrize(
    ("start_rad", "name"),
    [
        *((0.0, "demo"), (0.9, "quick"), (0.0, "slow"), (0.9, "one-sided")),
        *evidence((0.9, "demo"), (0.0, "quick"), (0.9, "slow"), (0.0, "stiff"), (0.9, "stiff"), (0.0, "one-sided")),
    ],
)
def test_search_finds_the_wanted_cycle_inside_the_soft_limits(name: str, start_rad: float) -> None:
    bench = simulated_bench(motor=MOTORS[name], start_rad=start_rad)
    relay, detector = relay_and_detector()
    with bench.loop.armed(LIMITS):
        check = break_away(bench.loop)
        search = GainSearch(relay, detector, TARGET, SEARCH, 0.45 * (check.plus_V + check.minus_V), 0.99)
        bench.loop.run(search, "search")
        period, amplitude = detector.mean()
        assert amplitude == pytest.approx(TARGET.amplitude_rad, rel=0.16)
        assert period == pytest.approx(TARGET.period_s, rel=0.16)
        test = RelayTest(relay, detector, (relay.h1_V, relay.h2_V), 8, 60.0)
        bench.loop.run(test, "relay-1")
    assert test.settled_end_s - test.settled_start_s == pytest.approx(8 * period, rel=0.1)
    # a jitter of one sampling period at each switch may carry a peak past the wanted amplitude, never past soft
    assert max(abs(row["y_rad"]) for row in bench.record.rows) < LIMITS.soft_rad[1]


def test_a_relay_that_takes_the_position_ahead_cycles_as_on_a_prompt_bench() -> None:
    """With 60 ms more delay the relay alone hunts; what it decides with is the position by then."""
    periods = {}
    for delay_s, ahead_s in ((0.0, 0.0), (0.06, 0.06), (0.06, 0.0)):
        bench = simulated_bench(drive_delay_s=delay_s)
        relay, detector = relay_and_detector()
        test = RelayTest(relay, detector, (0.45, 0.9), 6, 12.0)
        test.ahead_s = ahead_s
        with bench.loop.armed(LIMITS), contextlib.suppress(Fault):
            bench.loop.run(test, "relay-1")
        periods[delay_s, ahead_s] = detector.mean() if detector.settled else (math.inf, math.inf)
    (prompt_s, prompt_rad), (ahead_s, ahead_rad), (late_s, _) = periods.values()
    assert ahead_s == pytest.approx(prompt_s, rel=0.15)
    assert ahead_rad == pytest.approx(prompt_rad, rel=0.2)
    assert late_s > 1.3 * prompt_s


def test_search_gives_up_with_its_story_where_the_wish_cannot_be_had() -> None:
    bench = simulated_bench()
    relay, detector = relay_and_detector()
    weak = SearchRange(0.3, 0.1, 0.15, 0.6, h_max_V=0.6, sum_max_V=3.0, timeout_s=60.0)
    with bench.loop.armed(LIMITS), pytest.raises(Fault) as caught:
        check = break_away(bench.loop)
        search = GainSearch(relay, detector, TARGET, weak, 0.45 * (check.plus_V + check.minus_V), 0.99)
        bench.loop.run(search, "search")
    assert caught.value.code == "NO_CYCLE"
    assert "tried" in caught.value.detail or "nearest" in caught.value.detail
    assert bench.driver.bench.pin_counts == 0


@pytest.mark.parametrize(("h1", "h2", "amplitude_mrad"), [(0.8, 0.0, 40), (0.8, 0.4, 110)])
def test_delay_hunting_is_never_taken_for_a_cycle(h1: float, h2: float, amplitude_mrad: float) -> None:
    """docs/theory.md 4.3: with h2 <= f_c the loop still oscillates by its delay; that is not the limit cycle."""
    bench = simulated_bench(motor=Motor(0.17, 6.5, coulomb(0.5)), start_rad=0.3, noise_rad=0.0, offset_rad=0.0)
    relay, detector = relay_and_detector()
    bench.guard.sign_proven = True
    with bench.loop.armed(LIMITS), pytest.raises(Fault) as caught:
        bench.loop.run(RelayTest(relay, detector, (h1, h2), 5, timeout_s=15.0), "relay-1")
    assert caught.value.code == "NO_CYCLE"
    late = [row["y_rad"] for row in bench.record.rows if row["t_s"] > 10.0]
    assert 0.001 < 0.5 * (max(late) - min(late)) < 1e-3 * amplitude_mrad  # it does move
    assert not any(c.accepted for c in detector.cycles[3:])


def test_second_gains_change_the_amplitude_and_keep_the_period() -> None:
    bench = simulated_bench()
    relay, detector = relay_and_detector()
    with bench.loop.armed(LIMITS):
        check = break_away(bench.loop)
        search = GainSearch(relay, detector, TARGET, SEARCH, 0.45 * (check.plus_V + check.minus_V), 0.99)
        bench.loop.run(search, "search")
        first = detector.mean()
        search.seek_second(0.75)
        bench.loop.run(search, "search")
        bench.loop.run(RelayTest(relay, detector, (relay.h1_V, relay.h2_V), 6, 60.0), "relay-2")
        second = detector.mean()
    assert second[1] / first[1] == pytest.approx(0.75, rel=0.16)
    assert second[0] / first[0] == pytest.approx(1.0, rel=0.2)
    # upwards it would leave the reach: it goes down by as much instead
    assert search.further_gains(3.0) == search.further_gains(1.0 / 3.0)


def test_a_period_with_a_gap_neither_counts_nor_unsettles_the_others() -> None:
    def periods(left_out: range) -> tuple[int, bool]:
        detector = CycleDetector(min_period_s=0.3, min_amplitude_rad=0.08)
        for k in range(1000):
            if k not in left_out:
                angle = 2.0 * math.pi * 0.01 * k
                # it swings wider where nobody looks
                wide = 2.0 if left_out and 0 <= k - left_out.stop < 20 else 1.0
                detector.step(0.01 * k, wide * math.cos(angle), math.sin(angle) / 6.3)
        return len(detector.cycles), detector.settled

    whole, is_settled = periods(range(0))
    assert is_settled and periods(range(620, 632)) == (whole - 1, True)
