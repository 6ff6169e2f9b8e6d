"""The tuned loop: its bandwidth, its bounds, what it does at rest and at the drive's limit, and its prediction."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from evidence import evidence
from scipy.integrate import trapezoid

from rig.control.known_motor import KnownMotor
from rig.control.set_point import InTurn, PositionStep, SpeedSteps
from rig.control.state_feedback import Loop
from rig.control.tuned import tuned as law_tuned
from rig.design.tune.prediction import predict, shown_of
from rig.design.tune.program import Room, steps_alone, whole_trial
from rig.design.tune.trial import Sensing, driven, shaft_of
from rig.design.tune.tuning import Tuned, TuneError, Wish, motor_of, tune
from rig.design.tune.uncertain import UncertainMotor
from rig.model.real_motor import FramedMotor
from rig.run_folder.results import Answer, GradedNumber

SENSING = Sensing(0.01, 0.003, 4.1e-3, 3.0)
FRAMED = FramedMotor.of({"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48, "bias_V": -0.01})
MOTOR = UncertainMotor(FRAMED, 0.0012, (0.003, 0.1, 0.005, 0.001, 0.0002), np.eye(5))
POSITION = Wish("position", 0.5, top_rad_s=4.4)


@pytest.fixture(scope="module")
def position() -> Tuned:
    return tune(MOTOR, SENSING, POSITION)


@pytest.mark.parametrize("loop", ["position", *evidence("velocity")])
def test_the_set_point_is_followed_at_the_wanted_bandwidth(loop: Loop) -> None:
    bandwidth = 4.0
    tuned = tune(MOTOR, SENSING, Wish(loop, 0.1, bandwidth))
    program = steps_alone(tuned).program().parts[1]
    # the response of the reference model to a step, at the bandwidth: its derivative's Fourier transform
    t = np.arange(0.0, 6.0, 1e-3)
    if isinstance(program, PositionStep):
        rate = np.array([program.at(one).v_rad_s for one in t.tolist()])
    else:
        assert isinstance(program, SpeedSteps)
        program = SpeedSteps((0.1,), 100.0, bandwidth)
        rate = np.array([program.at(one).a_rad_s2 for one in t.tolist()])
    share = abs(trapezoid(rate * np.exp(-1j * bandwidth * t), t)) / 0.1
    assert 20.0 * math.log10(share) == pytest.approx(-3.01, abs=0.1)
    # and the identified motor follows the model
    trial = steps_alone(tuned)
    ideal, lasts_s = Sensing(0.01, 0.0, 0.0, 3.0), trial.program().duration_s
    record = driven(shaft_of(FRAMED), tuned.law(trial.program()), ideal, MOTOR.delay_s, lasts_s, 1)
    assert np.max(np.abs(record.yd_rad - record.y_rad)) < 3e-3


@pytest.mark.evidence
def test_a_larger_bandwidth_than_possible_is_refused_with_the_largest(position: Tuned) -> None:
    asked = replace(POSITION, bandwidth_1_s=1.1 * position.largest_1_s)
    with pytest.raises(TuneError, match=r"too much: a step of 0\.5 rad would .*\n.*largest that is possible is \d"):
        tune(MOTOR, SENSING, asked)
    assert tune(MOTOR, SENSING, replace(POSITION, bandwidth_1_s=0.99 * position.largest_1_s)).bandwidth_1_s < 20.0
    with pytest.raises(TuneError, match="degrees and 6 dB are asked for"):
        tune(MOTOR, SENSING, replace(POSITION, least=replace(POSITION.least, phase_deg=80.0)))


def test_a_step_against_a_load_and_a_dead_band_takes_no_more_than_the_largest_drive() -> None:
    """What they take was left out of the step that the loop must make: it took 3.6 V of 3."""
    more = {"dead_band_V": 0.2, "force_sin_V": 0.4, "drag_V_s2_rad2": 0.01, "centre_rad": -0.5 * math.pi}
    framed = FramedMotor.of(FRAMED.numbers | more)
    bandwidth_1_s = tune(replace(MOTOR, framed=framed), SENSING, POSITION).largest_1_s
    known, program = KnownMotor(framed), PositionStep(POSITION.step, bandwidth_1_s, math.inf)
    needed_V = []
    for t_s in np.linspace(0.0, 1.0, 400).tolist():
        one = program.at(t_s)
        state = known.moved(known.at_rest(0.0), one.v_rad_s, one.y_rad)
        needed_V.append(known.drive_V(state, one.a_rad_s2, 1.0))
    assert 2.9 < max(needed_V) < 3.0 + 1e-9


def test_a_motor_that_may_be_any_gets_no_loop() -> None:
    """Its tau and K counted as known to their scatter: K was 4.6 % off, and the worst motor 0.6 %."""
    plain = FRAMED.motor._asdict()
    numbers = {name: plain[name] for name in ("tau_s", "K_rad_s_V", "fc_V")}
    scatter = {name: (0.99 * value, 1.01 * value) for name, value in numbers.items()}
    answer = Answer(verdict="doubtful", **numbers, ci95=scatter)
    assert motor_of(answer).half_95[:2] == pytest.approx((0.0017, 0.065))
    with pytest.raises(TuneError, match="have no intervals"):
        motor_of(answer.model_copy(update={"grade": dict.fromkeys(numbers, GradedNumber())}))


@pytest.mark.evidence
def test_a_motor_that_is_known_badly_gets_a_slower_loop() -> None:
    small = replace(POSITION, step=0.05)
    well = tune(MOTOR, SENSING, small)
    badly = tune(replace(MOTOR, half_95=(0.05, 2.0, 0.05, 0.01, 0.004)), SENSING, small)
    assert badly.bandwidth_1_s < 0.8 * well.bandwidth_1_s
    for tuned in (well, badly):
        assert tuned.worst.phase_deg >= 45.0
        assert tuned.worst.gain_dB >= 6.0
        assert "degrees" in tuned.bound_by  # the margins are what bounds it


def test_the_shaft_rests_without_hunting_and_comes_back_from_the_limit(position: Tuned) -> None:
    # friction that is 8 % larger than known, and a step that the drive has no room for
    real = FramedMotor.of({**FRAMED.numbers, "fc_V": 0.52})
    program = InTurn((PositionStep(1.0, 1.5 * position.bandwidth_1_s, 6.0),))
    record = driven(shaft_of(real), position.law(program), SENSING, MOTOR.delay_s, 6.0, 3)
    assert np.max(np.abs(record.u_V)) == 3.0  # it was at the limit
    late = record.t_s > 2.0
    assert np.max(np.abs(np.diff(record.y_rad[late]))) < 7.0 * SENSING.whole_noise_rad
    assert abs(np.mean(record.y_rad[late]) - 1.0) < SENSING.shown_rad
    assert np.max(record.y_rad) < 1.05  # no windup


def test_a_prediction_holds_a_motor_that_the_intervals_allow(position: Tuned) -> None:
    trial = steps_alone(position)
    found = predict(position, trial, 79)
    inside = []
    for k, (framed, delay_s) in enumerate(MOTOR.drawn(60, np.random.default_rng(77))):
        program = trial.program()
        record = driven(shaft_of(framed), position.law(program), SENSING, delay_s, program.duration_s, 500 + k)
        shown = shown_of(position, record, trial)
        inside.append([found.ranges[name].holds(shown[name]) for name in ("overshoot_percent", "rise_s")])
    assert np.mean(inside) > 0.88  # 95 % expected of 120; their scatter is below 3 %
    assert found.overshoot.high < 3.0
    with pytest.raises(ValueError, match="38 motors are too few"):
        predict(position, trial, 38)


def test_a_trial_stays_in_the_middle_of_the_travel(position: Tuned) -> None:
    trial = whole_trial(position, Room(-0.2, 1.0, ((0.2, 1.0),)))
    program = trial.program()
    program.start_rad = 0.9
    y = np.array([program.at(t).y_rad for t in np.arange(0.0, trial.step_s[1], 0.01).tolist()])
    assert y.min() == pytest.approx(0.15, abs=1e-3)
    at_begin, at_end = (program.at(t - 1e-9).y_rad for t in trial.step_s)
    assert (at_begin, at_end) == pytest.approx((0.15, 0.65), abs=1e-6)
    with pytest.raises(TuneError, match=r"takes 0\.5 rad, and the trial may use 0\.32 rad.*\n.*--step 0\.3"):
        whole_trial(position, Room(0.0, 0.4))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"loop": "speed"}, "loop must be one of position, velocity"),
        ({"gains": {"speed_1_s": 1.0}}, "gains needs speed_1_s, place_1_s2, integral; it has speed_1_s"),
        ({"program": []}, "program has no parts"),
        ({"program": [{"kind": "jump"}]}, "one of move, step, speeds, sines, not 'jump'"),
        ({"program": [{"kind": "move", "to": 1.0}]}, "program: move: "),
        ({"motor": {"tau_s": 0.1}}, "a motor needs"),
    ],
)
def test_bad_options_of_the_law_are_refused(change: dict[str, object], words: str) -> None:
    good: dict[str, object] = {
        "loop": "position",
        "motor": FRAMED.numbers,
        "observer": {"period_s": 0.01, "noise_rad": 0.003, "latency_s": 0.001, "further_s": 0.0},
        "gains": {"speed_1_s": 20.0, "place_1_s2": 100.0, "integral": 100.0},
        "limits": {"largest_V": 3.0, "shown_rad": 0.01},
        "program": [{"kind": "move", "to_rad": 0.0, "bandwidth_1_s": 2.0, "duration_s": 1.0}],
    }
    assert law_tuned(**good).program.duration_s == 1.0  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=words):
        law_tuned(**good | change)  # type: ignore[arg-type]
