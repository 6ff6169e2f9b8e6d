"""The delay of a bench by the strokes of its breakaway check: the interval holds the true one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evidence import evidence
from simulated_bench import DEMO, LIMITS, PERIOD_S, breakaway_check, simulated_bench

from rig.core.faults import Fault
from rig.identification.stroke_delay import LONGEST_S, StrokeDelay, stroke_delay
from rig.model.friction import Friction, coulomb
from rig.model.motor import Motor
from rig.run_folder.recording.series import TimeSeries


def strokes(seed: int = 1, **changes: Any) -> tuple[TimeSeries, float]:
    """The rows of a breakaway check, and the noise that it saw."""
    bench, law = simulated_bench(seed=seed, **changes), breakaway_check()
    try:
        with bench.loop.armed(LIMITS):
            bench.loop.run(law, "breakaway")
    except Fault as fault:
        assert fault.code == "NO_MOTION"
    rows = [row for row in bench.record.rows if row["t_u_s"] is not None and np.isfinite(row["t_u_s"])]
    t_s, y_rad, t_u_s, u_V = (np.array([row[name] for row in rows]) for name in ("t_s", "y_rad", "t_u_s", "u_V"))
    return TimeSeries(t_s, y_rad, t_u_s, u_V), law.noise_rad


def found(**changes: Any) -> StrokeDelay:
    delay = stroke_delay(*strokes(**changes))
    assert delay is not None
    return delay


@pytest.mark.parametrize("delay_s", [0.0, 0.035, *evidence(0.015, 0.06, 0.1)])
def test_the_interval_holds_the_true_delay_and_is_some_periods_wide(delay_s: float) -> None:
    widths = []
    for seed in (1, 2, 3):
        delay = found(seed=seed, drive_delay_s=delay_s)
        assert delay.low_s <= delay_s <= delay.high_s
        assert delay.low_s <= delay.best_s <= delay.high_s
        widths.append(delay.high_s - delay.low_s)
    assert np.median(widths) < 4.0 * PERIOD_S


@pytest.mark.evidence
def test_it_holds_it_for_other_motors_and_sensors() -> None:
    """Friction, its direction, tau, K, noise and steps differ; the interval is one of three standard errors."""
    random = np.random.default_rng(4)
    missed = 0
    for seed in range(6):
        tau_s, K_rad_s_V, fc_V = random.uniform(0.05, 0.2), random.uniform(3.0, 9.0), random.uniform(0.3, 0.55)
        static = random.uniform(1.0, 1.3)
        friction = Friction(1.05 * fc_V, 0.95 * fc_V, 1.05 * static * fc_V, 0.95 * static * fc_V)
        bench = replace(DEMO, motor=Motor(tau_s, K_rad_s_V, friction), noise_rad=float(random.choice([0.001, 0.004])))
        delay_s = random.uniform(0.0, 0.08)
        delay = stroke_delay(*strokes(seed=seed, parameters=bench, drive_delay_s=delay_s))
        assert delay is not None
        missed += not delay.low_s <= delay_s <= delay.high_s
    assert missed <= 1


def test_a_shaft_that_does_not_move_shows_no_delay() -> None:
    assert stroke_delay(*strokes(motor=Motor(0.17, 6.5, coulomb(2.0)))) is None
    assert stroke_delay(*strokes(sensor="stuck")) is None


def test_a_shaft_that_moves_against_the_drive_shows_no_delay() -> None:
    series, noise_rad = strokes()
    assert stroke_delay(replace(series, y_rad=-series.y_rad), noise_rad) is None


def test_rows_without_a_stroke_show_no_delay() -> None:
    series, noise_rad = strokes()
    assert stroke_delay(replace(series, u_V=np.zeros(len(series))), noise_rad) is None


def test_without_times_of_the_drive_it_counts_from_the_samples() -> None:
    series, noise_rad = strokes(drive_delay_s=0.06)
    delay = stroke_delay(replace(series, t_u_s=None), noise_rad)
    assert delay is not None
    assert delay.low_s < 0.0612 < delay.high_s < LONGEST_S
