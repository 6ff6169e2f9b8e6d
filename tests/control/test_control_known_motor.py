"""Tracking with a motor of laws, on the simulated bench: what the drive makes up for, and that it rests at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from evidence import evidence
from numpy.typing import NDArray
from simulated_bench import DEMO, LIMITS, PERIOD_S, simulated_bench

from rig.control.known_motor import NOT_COMPENSATED, KnownMotor
from rig.control.observer import MotorObserver
from rig.control.tracking import Tracking, tracking_error
from rig.control.trajectory import SumOfSines
from rig.core.motor_numbers import Frame, RealMotor
from rig.model.real_motor import PARTS, FramedMotor

Array = NDArray[np.float64]
YD = [(0.5, 1.5), (0.2, 3.1)]
CORE = RealMotor(0.17, 6.5, 0.48)
FRAME = Frame(0.0, 0.8, 0.0, 60.0)
# Of each part that a drive can make up for: its numbers.
SIZES: dict[str, dict[str, float]] = {
    "dead_band": {"dead_band_V": 0.15},
    "load_friction": {"load_friction": 0.15, "viscous_share": 0.3},
    "source": {"source_per_V2": 0.02, "viscous_share": 0.3},
    "no_brake": {"no_brake": 0.5, "fc_V": 0.05},  # with more friction the drive never brakes
    "free_between": {"free_between": 0.8, "full_drive_V": 6.0},
    "gain_by_sign": {"gain_by_sign": 0.1},
    "sag": {"sag_per_V": 0.1},
    "lag": {"lag_s": 0.015},
    "viscous_by_direction": {"viscous_by_direction_V_s_rad": 0.02},
    "static": {"static_V": 0.2},
    "stribeck": {"stribeck_V": 0.3, "stribeck_rad_s": 0.4},
    "drag": {"drag_V_s2_rad2": 0.02},
    "force_over_position": {"force_sin_V": 0.1},
    "friction_over_position": {"friction_sin_V": 0.1},
    "cogging": {"cogging_sin_V": 0.1, "cogging_per_rad": 8.0},
    "linearity": {"linearity_sin1_rad": 0.015, "linearity_cos2_rad": 0.01},
}
NEVER_SHOWN = {"runs_free"}  # it acts at 0 V alone, where a drive that tracks is not


def tracked(model: RealMotor, truth: RealMotor, components: list[tuple[float, float]]) -> tuple[float, Tracking, Array]:
    """RMS error of the true shaft, rad; the law; time, s, true and wanted position, rad, and drive, V, of each tick."""
    bench = simulated_bench(replace(DEMO, real=truth, frame=FRAME, offset_rad=0.0))
    bench.guard.sign_proven = True
    framed = FramedMotor(model, FRAME)
    law = Tracking(framed, MotorObserver(framed, PERIOD_S, 0.003), SumOfSines(components), 12.0, 36.0, 8.0)
    rows: list[tuple[float, float, float]] = []

    def watch(t_s: float) -> None:
        rows.append((t_s, bench.driver.bench.shaft_rad, law.yd_rad))

    with bench.loop.armed(LIMITS):
        bench.loop.run(law, "track", watch)
    t, y, yd = np.array(rows).T
    u_V = np.array([row["asked_V"] for row in bench.record.rows])
    return tracking_error(t, y, yd, after_s=1.5)[0], law, np.column_stack([t, y, yd, u_V])


STAY = ("lag", "stribeck", "force_over_position")


@pytest.mark.parametrize("part", [*STAY, *evidence(*(part for part in SIZES if part not in STAY))])
def test_a_drive_that_knows_the_part_halves_the_error(part: str) -> None:
    truth = CORE._replace(**SIZES[part])
    knows, law, _ = tracked(truth, truth, YD)
    ignores, _, _ = tracked(CORE._replace(fc_V=truth.fc_V), truth, YD)
    assert knows <= 0.5 * ignores
    assert knows < 0.006
    assert law.largest_u_V < LIMITS.max_u_V


def test_every_part_is_made_up_for_or_named() -> None:
    assert SIZES.keys() | NEVER_SHOWN | set(NOT_COMPENSATED) == PARTS.keys()
    numbers = {name: 0.1 for part in NOT_COMPENSATED for name in PARTS[part]}
    known = KnownMotor(FramedMotor(CORE._replace(**numbers, delay_s=0.01), FRAME))
    assert known.motor == CORE


def test_at_rest_it_does_not_chatter() -> None:
    """Once the reference stands, the sensor's noise alone never moves the shaft, whatever the parts."""
    truth = CORE._replace(dead_band_V=0.15, static_V=0.2, stribeck_V=0.1, stribeck_rad_s=0.3)
    _, _, rows = tracked(truth, truth, [])
    t, y, _, u_V = rows[200:].T
    assert t[0] > 1.9
    assert np.ptp(y) == 0.0
    assert np.all(np.abs(u_V) < truth.fc_V + truth.dead_band_V)
    assert np.max(np.abs(np.diff(u_V))) < 0.5 * truth.fc_V
