"""The breakaway check finds every way a bench can be wired wrong before a relay runs."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evidence import evidence
from simulated_bench import DEMO_MOTOR, LIMITS, breakaway_check, simulated_bench

from rig import config
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.control.breakaway import BreakawayCheck
from rig.core.faults import Fault
from rig.core.signals import Limits, Sample
from rig.model.friction import Friction, coulomb
from rig.model.motor import Motor
from rig.model.real_motor import plain
from rig.run_folder.recording.reader import read_run
from rig.running.experiment import script as experiment
from rig.running.experiment.stages import breakaway_check as check_of
from rig.running.preflight.breakaway_strokes import UNSEEN_RAD, _sheet, _unseen_rad, breakaway_strokes, has_strokes
from unseen_travel import check, suited, trials, with_late_tick

ROOT = Path(__file__).resolve().parents[2]


def test_it_measures_both_levels_and_the_noise_and_hardly_moves_the_shaft() -> None:
    bench = simulated_bench()
    law = breakaway_check()
    with bench.loop.armed(LIMITS):
        bench.loop.run(law, "breakaway")
    friction, bias = DEMO_MOTOR.friction, DEMO_MOTOR.bias_V
    # the ramp gains up to 0.15 V until the motion is seen
    assert friction.static_plus_V - bias < law.plus_V < friction.static_plus_V - bias + 0.15
    assert friction.static_minus_V + bias < law.minus_V < friction.static_minus_V + bias + 0.15
    assert 0.002 < law.noise_rad < 0.005
    assert max(abs(row["y_rad"]) for row in bench.record.rows) < 0.15


@pytest.mark.parametrize("delay_s", [0.0012, 0.015, 0.035, 0.06, 0.1, 0.17])
def test_it_measures_how_late_the_device_says_that_drives_act(delay_s: float) -> None:
    """Also where drives wait in the device for longer than the planned pause, and reports leave some out."""
    bench, law = simulated_bench(latency=SimulatedLatency(delay_s, 0.0003)), breakaway_check()
    with bench.loop.armed(LIMITS):
        bench.loop.run(law, "breakaway")
    assert law.reported_delay_s == pytest.approx(delay_s, abs=0.001)
    assert max(abs(row["y_rad"]) for row in bench.record.rows) < 0.15


@pytest.mark.parametrize("delay_s", [0.035, 0.06, 0.1, 0.17])
@pytest.mark.parametrize("reported", [True, False])
def test_unseen_travel_stays_bounded_on_a_bench_that_acts_late(delay_s: float, reported: bool) -> None:
    """The strokes take each other back, however late they act."""
    late = SimulatedLatency(delay_s, 0.0) if reported else SimulatedLatency(0.0012, 0.0)
    bench = simulated_bench(latency=late, sensor="stuck", drive_delay_s=0.0 if reported else delay_s)
    reached: list[float] = []
    with pytest.raises(Fault, match="NO_MOTION"), bench.loop.armed(LIMITS):
        bench.loop.run(breakaway_check(), "breakaway", lambda _: reached.append(abs(bench.driver.bench.state.y)))
    assert 0.01 < max(reached) < 0.5


@pytest.mark.parametrize(
    ("wiring", "code"),
    [
        ({"drive": "reversed"}, "POLARITY"),
        ({"sensor": "reversed"}, "POLARITY"),
        ({"drive": "dead"}, "NO_MOTION"),
        ({"sensor": "stuck"}, "NO_MOTION"),
        ({"sensor": "broken_low"}, "DEVICE_SENSOR"),
        ({"sensor": "broken_high"}, "DEVICE_SENSOR"),
        ({"motor": Motor(0.17, 6.5, coulomb(1.5))}, "NO_MOTION"),
        ({"noise_rad": 0.05}, "SENSOR_NOISY"),
    ],
)
def test_each_wrong_bench_is_named_and_left_at_zero(wiring: dict[str, Any], code: str) -> None:
    bench = simulated_bench(**wiring)
    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(breakaway_check(), "breakaway")
    assert caught.value.code == code
    assert bench.driver.bench.pin_counts == 0
    # a stuck sensor cannot show the motion: the strokes keep it short
    assert abs(bench.driver.bench.state.y) < 0.5


@pytest.mark.parametrize(("wired", "code"), [("intact", "LOAD_TURNS"), ("reversed", "POLARITY")])
@pytest.mark.parametrize("way", [1, -1])
def test_a_load_that_turns_the_shaft_is_not_taken_for_swapped_wires(wired: str, code: str, way: int) -> None:
    """Where the shaft stands the load is just below friction, farther on it is larger: a push makes the shaft slide."""
    motor = Motor(0.38, 2.2, coulomb(0.146), way * 0.137 if wired == "intact" else 0.0)
    grows_V = -0.3 if wired == "intact" else 0.0
    bench = simulated_bench(motor=motor, drive=wired, real=plain(motor)._replace(force_sin_V=grows_V))
    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(breakaway_check(), "breakaway")
    assert caught.value.code == code
    if code == "LOAD_TURNS":
        assert ("rising" if way > 0 else "falling") in caught.value.detail
        assert way * bench.driver.bench.state.y > 0.0


@pytest.mark.parametrize(("way", "words"), [(1, "towards rising ones: a load"), (-1, "towards falling ones: a load")])
def test_a_shaft_that_moves_one_way_only_is_said_to(way: int, words: str) -> None:
    bench = simulated_bench(motor=Motor(0.38, 2.2, coulomb(1.0), way * 0.8))
    with pytest.raises(Fault, match="NO_MOTION") as caught, bench.loop.armed(LIMITS):
        bench.loop.run(breakaway_check(), "breakaway")
    assert words in caught.value.detail


def test_a_drive_that_is_stuck_on_is_noticed_though_no_software_can_stop_it() -> None:
    bench = simulated_bench(drive="stuck_on", motor=Motor(0.17, 0.4, coulomb(0.5)))
    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(breakaway_check(), "breakaway")
    assert caught.value.code in ("DRIVE_STUCK_ON", "TRAVEL_HARD", "DEVICE_TRAVEL")


def test_a_shaft_that_still_turns_at_the_start_is_waited_for() -> None:
    bench = simulated_bench()
    bench.driver.bench.state = bench.driver.bench.state._replace(v=2.0, y=-0.5)
    law = breakaway_check()
    with bench.loop.armed(LIMITS):
        bench.loop.run(law, "breakaway")
    assert law.finished


def drives(law: BreakawayCheck, y_rad: Callable[[float], float], until_s: float) -> list[float]:
    return [law.step(Sample(0.01 * k, y_rad(0.01 * k), 512)) for k in range(round(until_s / 0.01))]


@pytest.mark.parametrize(("drift", "waits"), [(2.0, True), (1.5, False)])
def test_a_shaft_that_drifts_by_more_than_the_noise_explains_is_waited_for(drift: float, waits: bool) -> None:
    """Of 20 readings the means of the halves differ by 0.45 standard deviations: four times that is no noise."""
    noise_rad = 0.005

    def y_rad(t_s: float) -> float:
        flicker = noise_rad * math.sqrt(6.0) / 4.0  # which second differences find to be of noise_rad
        return flicker * (-1.0) ** round(t_s / 0.01) + drift * noise_rad * t_s / 0.1  # the halves are 0.1 s apart

    assert (max(drives(breakaway_check(), y_rad, 0.6)) == 0.0) is waits


def test_a_shaft_that_coasts_after_a_stroke_is_waited_for() -> None:
    law, drive_V, k = breakaway_check(), 0.0, 0

    def step(y_rad: float) -> float:
        nonlocal k
        k += 1
        return law.step(Sample(0.01 * k, y_rad, 512))

    while drive_V == 0.0:
        drive_V = step(0.0)
    while drive_V != 0.0:
        drive_V = step(0.0)
    coasting_rad = [0.005 * j for j in range(25)]
    assert not any(step(y_rad) for y_rad in coasting_rad)
    assert any(step(coasting_rad[-1]) for _ in range(100))


@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_never_gathers_to_motion(seed: int) -> None:
    """As much of it as the check takes: a third of what counts as motion."""
    noise_rad = np.random.default_rng(seed).normal(0.0, 0.3 * 0.02, 20_000)
    with pytest.raises(Fault, match=r"NO_MOTION.*towards rising and falling"):
        drives(breakaway_check(), lambda t_s: float(noise_rad[round(100.0 * t_s)]), 200.0)


@pytest.mark.parametrize("friction_V", [0.2, 0.3])
@pytest.mark.parametrize("fault_after_s", [0.0, 1.5, 2.5])
def test_with_a_sensor_that_sticks_the_shaft_turns_less_than_half_a_radian(
    friction_V: float, fault_after_s: float
) -> None:
    """At the demo's 1.2 V, for friction that it does not suit; also where the sensor dies in the midst of the check."""
    motor = Motor(0.17, 6.5, Friction(1.1 * friction_V, 0.9 * friction_V, 1.1 * friction_V, 0.9 * friction_V))
    bench = simulated_bench(motor=motor, sensor="stuck", fault_after_s=fault_after_s)
    law, shaft_rad = breakaway_check(), []
    step = law.step

    def watched(sample: Sample) -> float:
        shaft_rad.append(bench.driver.bench.state.y)
        return step(sample)

    law.step = watched  # type: ignore[method-assign]  # for this test
    with contextlib.suppress(Fault), bench.loop.armed(LIMITS):
        bench.loop.run(law, "breakaway")
    assert bench.driver.bench.pin_counts == 0
    fault = bench.guard.fault
    assert law.finished is False and fault is None  # it ended with NO_MOTION, of the check's own
    assert max(map(abs, shaft_rad)) < UNSEEN_RAD


def test_strokes_come_in_pairs_of_equal_level_and_opposite_sign() -> None:
    bench = simulated_bench(sensor="stuck")
    with pytest.raises(Fault, match=r"up to 1\.20 V towards rising and falling positions"), bench.loop.armed(LIMITS):
        bench.loop.run(breakaway_check(), "breakaway")
    drives = [row["asked_V"] for row in bench.record.rows]
    starts = [k for k, u_V in enumerate(drives) if u_V and not drives[k - 1]]
    strokes = [drives[k : k + 3] for k in starts]
    assert len(strokes) == 38 and sum(u_V != 0.0 for u_V in drives) == 2 * (16 * 3 + 2 + 2 + 1)
    for first, second in zip(strokes[::2], strokes[1::2], strict=True):
        assert first == [-u_V for u_V in second]
    assert [stroke[0] > 0.0 for stroke in strokes[::2]] == [True, False] * 9 + [True]
    assert max(drives) == 1.2
    third_V = 0.064 / 3  # within a stroke it rises from the last pair's level to its own
    assert strokes[2] == pytest.approx([-0.064 - third_V, -0.064 - 2.0 * third_V, -0.128])


@pytest.mark.parametrize(("plus_V", "minus_V", "word"), [(0.5, 5.0, "falling"), (5.0, 0.5, "rising")])
def test_the_way_in_which_nothing_moved_is_named(plus_V: float, minus_V: float, word: str) -> None:
    """A shaft that turns one way alone."""
    bench = simulated_bench(motor=Motor(0.17, 6.5, Friction(plus_V, minus_V, plus_V, minus_V)))
    with pytest.raises(Fault, match=rf"NO_MOTION.* V towards {word} positions"), bench.loop.armed(LIMITS):
        bench.loop.run(breakaway_check(), "breakaway")


# the whole grid as evidence; the worst is a light motor
@pytest.mark.parametrize(
    ("frictions_V", "taus_s"),
    [
        ((0.01, 0.1, 0.3, 0.7), (0.001, 0.05)),
        *evidence(((0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7), (0.001, 0.01, 0.05, 0.2, 1.0))),
    ],
    ids=["some", "all"],
)
def test_the_bound_holds_for_any_inertia_and_friction_that_differs_by_a_tenth(
    frictions_V: tuple[float, ...], taus_s: tuple[float, ...]
) -> None:
    """The motors that it is about: as fast as the data sheet says, the less friction and inertia the farther.

    Also where one tick comes late, or the host dies in a stroke.
    """
    demo = config.load(ROOT / "config/demo.yaml")
    strokes = breakaway_strokes(demo)
    assert strokes is not None and demo.motor is not None
    worst_rad = 0.0
    for friction_V in frictions_V:
        K = demo.motor.no_load_speed_rad_s / (demo.drive.supply_V - friction_V)
        for tau_s in taus_s:
            plus_V, minus_V = 1.1 * friction_V, 0.9 * friction_V
            motor = Motor(tau_s, K, Friction(plus_V, minus_V, plus_V, minus_V))
            seen = check(motor, breakaway_check(), demo.period_s, 1, stuck=True)
            assert seen.end == "NO_MOTION"
            runs = with_late_tick(motor, demo, 1, seen)
            assert {run.end for run in runs} == {"NO_MOTION", "DEVICE_WATCHDOG"}
            worst_rad = max(worst_rad, seen.travel_rad, *(run.travel_rad for run in runs))
    assert 0.8 * strokes.unseen_rad < worst_rad < strokes.unseen_rad <= UNSEEN_RAD


@pytest.mark.parametrize("late_s", [0.004, 0.006, 0.015, 0.0299])
@pytest.mark.parametrize("stroke", [0, 1, 20, 21, 36, 37])
def test_what_a_late_tick_adds_to_a_stroke_is_taken_back(stroke: int, late_s: float) -> None:
    """To the stroke out, which the one back has to match, or to the one back, which needs its like."""
    motor = Motor(0.005, 6.5, Friction(0.1, 0.1, 0.1, 0.1))
    undisturbed = check(motor, breakaway_check(), 0.01, 1, stuck=True)
    tick = undisturbed.strokes[stroke].last_tick + 1
    seen = check(motor, breakaway_check(), 0.01, 1, stuck=True, late={tick: late_s}, watchdog_s=0.04)
    assert seen.end == "NO_MOTION"
    # less than half a period of a stroke is left: it takes a whole one to take it back
    assert abs(seen.left_rad - undisturbed.left_rad) < 6.5 * 1.1 * 0.005
    assert len(seen.strokes) - len(undisturbed.strokes) == (2 if stroke % 2 and late_s > 0.005 else 0)


def test_many_late_ticks_end_the_check_before_they_add_up() -> None:
    motor = Motor(0.005, 6.5, Friction(0.1, 0.1, 0.1, 0.1))
    late = dict.fromkeys(range(1, 1000, 2), 0.008)
    seen = check(motor, breakaway_check(), 0.01, 1, stuck=True, late=late, watchdog_s=0.04)
    assert seen.end == "LATE" and len(seen.strokes) < 12


@pytest.mark.parametrize(("ticks", "most"), [(1, 8), (2, 8), (9, 8), (1, 99), (9, 99)])
@pytest.mark.parametrize("every", [1, 2, 5])
def test_strokes_that_come_short_break_no_promise(ticks: int, most: int, every: int) -> None:
    """The device takes the first drives of strokes late, or never: the shaft turns no farther. It is never LATE.

    The motors of the bound on unseen travel. Where it goes on for longer than a stall would, the link is at fault.
    """
    demo = config.load(ROOT / "config/demo.yaml")
    strokes = breakaway_strokes(demo)
    assert strokes is not None and demo.motor is not None
    for friction_V in (0.1, 0.4, 0.7):
        plus_V, minus_V = 1.1 * friction_V, 0.9 * friction_V
        K = demo.motor.no_load_speed_rad_s / (demo.drive.supply_V - friction_V)
        motor = Motor(0.005, K, Friction(plus_V, minus_V, plus_V, minus_V))
        short: list[int] = []

        def lost(stroke: int, tick: int, short: list[int] = short) -> bool:
            if tick == 0 and len(short) < most and stroke >= 20 and stroke % every == every - 1:
                short.append(stroke)
            return stroke in short and tick < ticks

        seen = check(motor, breakaway_check(), demo.period_s, 1, stuck=True, lost=lost)
        assert seen.end == ("NO_MOTION" if len(short) <= 8 else "LINK_TIMEOUT")
        assert seen.travel_rad < strokes.unseen_rad


def test_a_drive_that_is_lost_at_the_end_of_a_stroke_is_taken_back() -> None:
    """The device tells what acts, and since when: by that the stroke lasted longer than it was asked for."""
    law, tick = breakaway_check(), 0
    drives: list[float] = []
    acts_V, since_s, lost = 0.0, -1.0, False
    while len([k for k in range(1, len(drives)) if drives[k] and not drives[k - 1]]) < 3:
        asked_V = law.step(Sample(0.01 * tick, 0.0, 512, math.nan, since_s, acts_V, tick))
        if asked_V == 0.0 and acts_V != 0.0 and not lost:
            lost = True  # the 0 V after the first stroke never arrives
        elif asked_V != acts_V:
            acts_V, since_s = asked_V, 0.01 * tick + 0.001
        drives.append(asked_V)
        tick += 1
    asked = [u_V for u_V in drives if u_V]
    assert sum(u_V > 0.0 for u_V in asked) == 3 and sum(u_V < 0.0 for u_V in asked) == 4 + 1


@pytest.mark.parametrize("motors", [24, *evidence(80)])
def test_random_motors_turn_little_unseen_and_are_seen_both_ways(motors: int) -> None:
    """Some of the 500 motors of tools/unseen_travel.py, which takes longer and says more."""
    ends: Counter[str] = Counter()
    for number, (motor, e) in enumerate(trials(motors)):
        if not has_strokes(e, e.breakaway.max_V):
            ends["refused"] += 1
            continue
        stuck = check(motor, check_of(e), e.period_s, number, stuck=True)
        assert stuck.end == "NO_MOTION" and stuck.travel_rad < UNSEEN_RAD
        ends[check(motor, check_of(e), e.period_s, number, stuck=False).end] += 1
    assert set(ends) <= {"moves", "NO_MOTION", "refused"}
    assert ends["refused"] <= 10  # fast ones: half a radian is too little for a host that dies in a stroke of theirs
    assert ends["NO_MOTION"] <= 3  # of the others; one way after the other moved fewer


@pytest.fixture(scope="module")
def fast() -> tuple[Motor, config.Experiment]:
    """Fast, with much friction: no stroke of the bound moves it by 3 mrad."""
    demo = config.load(ROOT / "config/demo.yaml")
    e = suited(demo, 189.0, 0.42)
    breakaway = demo.breakaway.model_copy(update={"max_V": 0.95})
    limits = demo.limits.model_copy(update={"coast_tau_s": 0.264})
    e = e.model_copy(update={"breakaway": breakaway, "limits": limits})
    return Motor(0.264, 15.0, Friction(0.38, 0.4, 0.38, 0.4)), e


def test_a_fast_motor_with_much_friction_is_seen_by_further_pairs(fast: tuple[Motor, config.Experiment]) -> None:
    motor, e = fast
    strokes = breakaway_strokes(e)
    assert strokes is not None and strokes.further > 5 and strokes.unseen_rad <= UNSEEN_RAD
    moved = dict.fromkeys((True, False), 0)
    for further in moved:
        for seed in range(5):
            law = check_of(e)
            if not further:
                law._further = law._in_all = 0
            moved[further] += check(motor, law, e.period_s, seed, stuck=False).end == "moves"
    assert moved[True] >= 4 and moved[False] < moved[True]  # not always: the steps of the sensor may hide it


def test_further_pairs_need_a_sensor_that_shows_motion_and_shows_it_again(
    fast: tuple[Motor, config.Experiment],
) -> None:
    motor, e = fast
    strokes = breakaway_strokes(e)
    assert strokes is not None
    assert len(check(motor, check_of(e), e.period_s, 1, stuck=True).strokes) == 2 * strokes.pairs
    light = replace(motor, tau_s=0.005)  # it turns farther
    for motor_ in (motor, light):
        ends_s = check(motor_, check_of(e), e.period_s, 1, stuck=False).time_s
        for share in (0.5, 0.7, 0.9):
            frozen = check(motor_, check_of(e), e.period_s, 1, stuck=False, freezes_s=share * ends_s)
            assert frozen.travel_rad < UNSEEN_RAD
            assert len(frozen.strokes) <= 2 * (strokes.pairs + strokes.further)


def test_pairs_go_on_only_while_the_sensor_shows_motion_and_none_of_their_series_exceeds_the_bound(
    fast: tuple[Motor, config.Experiment],
) -> None:
    _, e = fast
    strokes = breakaway_strokes(e)
    assert strokes is not None and strokes.strokes_s == (strokes.strokes_s[0],) * strokes.pairs
    first_at_top = math.ceil(e.breakaway.max_V / strokes.step_V)
    assert strokes.pairs > first_at_top  # planned pairs repeat the largest level
    law = check_of(e)
    law._pair = strokes.pairs
    assert not law._may_go_on()  # nothing was seen
    series: list[int] = []
    while len(series) < 10:  # the sensor shows a motion as late as it may, again and again
        law._proven = proven = law._pair
        while law._may_go_on():
            law._pair += 1
        series.append(law._pair - proven)
    stroke_s, further = strokes.strokes_s[-1], strokes.further
    assert max(series) == further and sum(series) == strokes.in_all
    unseen_rad = _unseen_rad(
        *_sheet(e.device), e.breakaway.max_V, (1.0,) * further, (stroke_s,) * further, strokes.watchdog_s
    )
    assert 0.8 * UNSEEN_RAD < unseen_rad <= UNSEEN_RAD


def test_a_slow_bench_keeps_its_long_strokes() -> None:
    """Only strokes of one period give way to pairs that repeat max_V: on a slow bench they would see too little."""
    e = config.load(ROOT / "config/simulated.yaml")
    e = e.model_copy(update={"limits": e.limits.model_copy(update={"coast_tau_s": 0.5, "max_speed_rad_s": 3.0})})
    strokes = breakaway_strokes(e)
    assert strokes is not None and strokes.strokes_s[-1] > 1.5 * e.period_s
    assert strokes.pairs == math.ceil(e.breakaway.max_V / strokes.step_V) and strokes.top_pause_s == strokes.pause_s


def test_for_the_check_the_device_is_armed_with_the_watchdog_that_its_bound_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    e = config.load(ROOT / "config/quick.yaml")
    armed_s, arm = [], SimulatedDriver.arm

    def watched(self: SimulatedDriver, limits: Limits) -> None:
        armed_s.append(limits.watchdog_s)
        arm(self, limits)

    monkeypatch.setattr(SimulatedDriver, "arm", watched)
    assert experiment.run_relay(e, tmp_path).fault is None
    strokes = breakaway_strokes(e)
    assert strokes is not None and strokes.watchdog_s < e.daq.watchdog_s
    assert armed_s == [strokes.watchdog_s, e.daq.watchdog_s]


def test_a_config_whose_unseen_travel_has_no_bound_drives_nothing(tmp_path: Path) -> None:
    """Also where nobody asked `rig check`."""
    e = config.load(ROOT / "config/quick.yaml")
    outcome = experiment.run_breakaway(e.model_copy(update={"motor": None}), tmp_path)
    assert outcome.fault is not None and outcome.fault.code == "CONFIG_MISMATCH"
    assert not read_run(outcome.folder).u_V.any()
