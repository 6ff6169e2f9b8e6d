"""The live fit: what everything driven so far says, again and again, of a run whose motor is known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evidence import evidence
from synthetic import LSB_RAD, Bench, Samples, dcr, simulate

from rig.control.relay import DualChannelRelay
from rig.control.simulation import Sampling
from rig.control.simulation import simulate as simulate_real
from rig.core.signals import Sample
from rig.identification.live import OF_PARAMETERS, LiveEstimate, LiveFit, LiveRows, LiveSettings
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.model.real_motor import Frame, FramedMotor, RealMotor
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recording import Recording

GOLDEN = Path(__file__).parents[1] / "golden"
TRUTH = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48}
NOISE_RAD = 0.0032  # of the golden sensor at rest, its steps included
SETTINGS = LiveSettings(0.01, NOISE_RAD, LSB_RAD, 3.0)
SEARCH_ENDS, TESTS_END = 2363, 3420  # rows of the golden run


@pytest.fixture(scope="module")
def golden() -> Recording:
    return read_run(GOLDEN / "simulated")


def rows_of(run: Recording, first: int, stop: int) -> LiveRows:
    part = slice(first, stop)
    return LiveRows(np.arange(first, stop), run.t_s[part], run.y_rad[part], run.t_u_s[part], run.u_V[part])


def live_rows(samples: Samples, told: bool = True) -> LiveRows:
    n = samples.t_s.size
    t_u_s = samples.t_u_s if told else np.full(n, math.nan)
    return LiveRows(np.arange(n), samples.t_s, samples.y_rad, t_u_s, samples.u_V)


def errors(estimate: LiveEstimate, truth: dict[str, float]) -> dict[str, float]:
    """In half widths of the interval."""
    off = {name: 100.0 * abs(getattr(estimate, name) / value - 1.0) for name, value in truth.items()}
    return {name: off[name] / estimate.half_percent[name] for name in OF_PARAMETERS}


def estimated(rows: LiveRows, settings: LiveSettings = SETTINGS) -> LiveEstimate:
    fit = LiveFit(settings)
    fit.take(rows)
    estimate = fit.estimate()
    assert estimate is not None
    return estimate


def test_the_gain_search_alone_tells_the_motor(golden: Recording) -> None:
    estimate = estimated(rows_of(golden, 0, SEARCH_ENDS))
    assert max(errors(estimate, TRUTH).values()) < 1.5
    assert estimate.worst_percent < 0.5
    assert estimate.drives_differ
    assert estimate.residual_over_noise == pytest.approx(1.0, abs=0.05)
    assert estimate.row == SEARCH_ENDS - 1


def test_the_interval_narrows_and_holds_the_truth_from_the_third_second_of_motion_on(golden: Recording) -> None:
    fit = LiveFit(SETTINGS)
    widths = []
    for first in range(0, TESTS_END, 100):
        fit.take(rows_of(golden, first, min(first + 100, TESTS_END)))
        estimate = fit.estimate()
        if estimate is None:
            assert first < 800
            continue
        widths.append(estimate.worst_percent)
        assert max(errors(estimate, TRUTH).values()) < 2.0
        assert estimate.seconds_of_data < estimate.t_s
    assert widths[0] < 60.0
    assert widths[-1] < 0.25
    assert np.mean(np.diff(widths) < 0.02) > 0.9


def test_rows_in_portions_tell_what_they_tell_at_once(golden: Recording) -> None:
    """Warm starts find the minimum that a start from nothing finds."""
    whole = estimated(rows_of(golden, 0, TESTS_END))
    fit = LiveFit(SETTINGS)
    for first in range(0, TESTS_END, 190):
        fit.take(rows_of(golden, first, min(first + 190, TESTS_END)))
        portions = fit.estimate()
    assert portions is not None
    for name in OF_PARAMETERS:
        apart = 100.0 * abs(getattr(portions, name) / getattr(whole, name) - 1.0)
        assert apart < 0.02 * whole.half_percent[name]
        assert portions.half_percent[name] == pytest.approx(whole.half_percent[name], rel=1e-3)


def test_the_same_portions_give_the_same_numbers(golden: Recording) -> None:
    def numbers() -> list[float]:
        fit = LiveFit(SETTINGS)
        found = []
        for first in range(500, 1500, 100):
            fit.take(rows_of(golden, first, first + 100))
            estimate = fit.estimate()
            found += [] if estimate is None else [estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V]
        return found

    assert numbers() == numbers() != []


def test_a_delay_beyond_what_the_rows_tell_is_fitted_and_costs_certainty(golden: Recording) -> None:
    rows = rows_of(golden, 0, SEARCH_ENDS)
    told = estimated(rows)
    untold = estimated(rows, replace(SETTINGS, delay_s=(0.0, 0.02)))
    assert told.delay_s == 0.0
    assert untold.delay_s == pytest.approx(0.0012, abs=0.0005)
    assert untold.half_percent["tau_s"] > 1.2 * told.half_percent["tau_s"]
    assert max(errors(untold, TRUTH).values()) < 1.5


def test_rows_that_tell_too_early_a_drive_are_found_out_by_their_residual(golden: Recording) -> None:
    rows = rows_of(golden, 0, TESTS_END)
    early = estimated(rows._replace(t_u_s=rows.t_u_s - 0.008))
    assert max(errors(early, TRUTH).values()) < 2.0
    assert early.delay_s == pytest.approx(0.008, abs=0.0005)
    assert early.residual_over_noise < 1.1
    assert estimated(rows).delay_s == 0.0


def test_a_gap_between_rows_is_no_motion(golden: Recording) -> None:
    """Of a link that lost a second of rows: what lies between is not predicted."""
    whole = rows_of(golden, 0, SEARCH_ENDS)
    kept = np.r_[0:1500, 1613:SEARCH_ENDS]
    estimate = estimated(LiveRows._make(column[kept] for column in whole))
    assert max(errors(estimate, TRUTH).values()) < 1.5


def test_rows_of_a_law_in_the_device_come_ten_times_as_often() -> None:
    """Search at 10 ms, tests at 1 ms: what is at rest depends on the rate, so the record is cut where it changes."""
    run = read_run(GOLDEN / "chip-relay-in-device")
    estimate = estimated(rows_of(run, 0, len(run)))
    assert all(abs(error) < 1.0 for error in errors(estimate, TRUTH).values())
    assert estimate.residual_over_noise < 1.05 and estimate.worst_percent < 0.8
    assert estimate.seconds_of_data == pytest.approx(6.7, abs=0.5)  # of 7.8 s with search and tests


def test_a_shaft_that_does_not_move_tells_nothing(golden: Recording) -> None:
    fit = LiveFit(SETTINGS)
    assert fit.estimate() is None
    fit.take(rows_of(golden, 0, 400))
    assert fit.estimate() is None


def test_columns_of_unequal_length_are_refused(golden: Recording) -> None:
    rows = rows_of(golden, 0, 100)
    with pytest.raises(ValueError, match="one value a row"):
        LiveFit(SETTINGS).take(rows._replace(u_V=rows.u_V[1:]))


def test_a_known_motor_is_the_estimate_until_rows_say_more(golden: Recording) -> None:
    prior = FramedMotor(RealMotor(0.2, 5.5, 0.55), Frame())
    fit = LiveFit(LiveSettings(0.01, NOISE_RAD, LSB_RAD, 3.0, prior=prior))
    before = fit.estimate()
    assert before is not None
    assert before.motor().motor.tau_s == 0.2
    assert before.worst_percent == pytest.approx(58.8, abs=0.1)
    fit.take(rows_of(golden, 0, 800))
    early = fit.estimate()
    assert early is not None
    assert early.worst_percent < 0.7 * before.worst_percent
    fit.take(rows_of(golden, 800, SEARCH_ENDS))
    late = fit.estimate()
    assert late is not None
    assert max(errors(late, TRUTH).values()) < 1.5


@pytest.mark.parametrize(("law", "number"), [("viscous_by_direction", "viscous_by_direction_V_s_rad"), ("static", "")])
def test_the_laws_of_a_known_motor_are_fitted_too_but_for_static_friction_which_stays(law: str, number: str) -> None:
    true = Motor(0.2, 5.0, coulomb(0.4), 0.02)
    prior = FramedMotor(RealMotor(0.22, 4.5, 0.45, **{number or "static_V": 1e-3}), Frame())
    rows = live_rows(simulate(true, dcr(0.6, 0.9), 1500, Bench(noise_rad=0.003)))
    estimate = estimated(rows, LiveSettings(0.01, 0.003, 0.0, 3.0, prior=prior))
    assert estimate.laws == (law,)
    motor = estimate.motor().motor
    assert abs(getattr(motor, number)) < 1e-3 if number else motor.static_V == 1e-3
    assert max(errors(estimate, {"tau_s": 0.2, "K_rad_s_V": 5.0, "fc_V": 0.4}).values()) < 1.5


class Relays:
    """A soft relay for 8 s, and then a harder one."""

    def __init__(self) -> None:
        self._soft, self._hard = (DualChannelRelay(h1, h2, math.inf) for h1, h2 in ((0.4, 0.75), (0.6, 1.1)))

    def step(self, sample: Sample) -> float:
        return (self._soft if sample.t_s < 8.0 else self._hard).step(sample)


def of_real(motor: RealMotor, seed: int = 1) -> Recording:
    sampling = Sampling(noise_rad=0.003, resolution_rad=LSB_RAD, start_rad=0.3, seed=seed)
    return simulate_real(motor, Relays(), 16.0, sampling)


def every_second(run: Recording, settings: LiveSettings = SETTINGS) -> list[LiveEstimate]:
    fit, found = LiveFit(settings), []
    for first in range(0, len(run), 100):
        fit.take(rows_of(run, first, min(first + 100, len(run))))
        estimate = fit.estimate()
        found += [] if estimate is None else [estimate]
    return found


@pytest.mark.parametrize(
    ("part", "law"),
    [
        ({"force_sin_V": 0.1}, "force_over_position"),
        *evidence(({"sag_per_V": 0.1}, "sag"), ({"dead_band_V": 0.1}, "dead_band")),
    ],
)
def test_a_law_that_the_residual_asks_for_is_found_while_the_run_goes_on(part: dict[str, float], law: str) -> None:
    truth = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.4}
    found = every_second(of_real(RealMotor(**truth, **part)))
    with_it = [one for one in found if law in one.laws]
    assert with_it and with_it[0].t_s < 10.0
    last = found[-1]
    assert law in last.laws and last.residual_over_noise < 1.1
    assert max(errors(last, truth).values()) < 2.0 and last.worst_percent < 5.0


@pytest.mark.parametrize(
    ("part", "law"), [({"backlash_rad": 0.004}, "backlash"), *evidence(({"dead_band_V": 0.04}, "dead_band"))]
)
def test_a_law_that_the_residual_hides_is_found_if_it_is_looked_for(part: dict[str, float], law: str) -> None:
    run = of_real(RealMotor(0.17, 6.5, 0.4, **part))
    fit = LiveFit(SETTINGS)
    fit.take(rows_of(run, 0, len(run)))
    for seeks, laws in ((False, ()), (True, (law,)), (False, (law,))):
        estimate = fit.estimate(seeks_laws=seeks)
        assert estimate is not None and estimate.laws == laws and estimate.residual_over_noise < 1.1


def test_a_plain_motor_gets_no_laws() -> None:
    for seed in range(2):
        found = every_second(of_real(RealMotor(0.17, 6.5, 0.4), seed))
        assert found and all(one.laws == () for one in found)
        fit = LiveFit(SETTINGS)
        run = of_real(RealMotor(0.17, 6.5, 0.4), seed)
        fit.take(rows_of(run, 0, len(run)))
        sought = fit.estimate(seeks_laws=True)
        assert sought is not None and sought.laws == ()


@pytest.mark.evidence
@pytest.mark.parametrize("told", [False, *evidence(True)])
def test_intervals_hold_the_truth_at_any_length(told: bool) -> None:
    """Of 20 motors, each at three lengths of record: 95 % of the intervals, within chance."""
    rng = np.random.default_rng(3)
    inside, all_of_them = 0, 0
    for seed in range(20):
        tau, fc = math.exp(rng.uniform(math.log(0.08), math.log(0.5))), rng.uniform(0.1, 0.5)
        h2 = fc + rng.uniform(0.3, 1.0)
        gain = 0.8 * 0.7 / (tau * (h2 - fc) ** 2) * h2 * 0.8
        truth = {"tau_s": tau, "K_rad_s_V": gain, "fc_V": fc}
        bench = Bench(delay_s=0.004, noise_rad=0.003, lsb_rad=LSB_RAD, seed=seed)
        rows = live_rows(simulate(Motor(tau, gain, coulomb(fc), 0.01), dcr(0.7 * h2, h2), 1200, bench), told)
        fit = LiveFit(LiveSettings(0.01, NOISE_RAD, LSB_RAD, 3.0))
        for first in range(0, 1200, 400):
            fit.take(LiveRows._make(column[first : first + 400] for column in rows))
            estimate = fit.estimate()
            if estimate is not None:
                off = errors(estimate, truth)
                inside += sum(value <= 1.0 for value in off.values())
                all_of_them += len(off)
    assert all_of_them > 100
    assert inside / all_of_them > 0.88
