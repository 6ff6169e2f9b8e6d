"""The room that a config gives a planned test, and how its bench is read (docs/design.md)."""

from __future__ import annotations

import numpy as np

from rig.backends.registry import backend_of
from rig.config.schema import Experiment
from rig.control.guard import velocity_noise_rad_s
from rig.core.signals import BenchDelay
from rig.design.belief import Belief
from rig.design.outlook import Task
from rig.design.planned_test import Reading, Room
from rig.model.real_motor import RealMotor
from rig.run_folder.results import BreakawayResult, RunResult
from rig.running.preflight.room_to_stop import counted_delay_s, known_reaction_s, swing_rad

STATIC = 1.1  # times f_c: level at which a shaft breaks away, where no check has seen it
INSIDE = 0.95  # part of the soft limits that a plan uses
SCATTER = 4.0  # standard deviations of the guard's velocity that a plan leaves it
LEAST = 0.5  # part of the speed and of the way to stop that a plan uses at least, however noisy the sensor


def room_of_tests(
    e: Experiment, static_V: float, delay: BenchDelay | None = None, noise_rad: float | None = None
) -> Room:
    """What a planned test may use: so much that the guard, which sees a noisy velocity, does not brake.

    static_V   level that the shaft breaks away at, V
    delay      of the bench, as its breakaway check shows it
    noise_rad  standard deviation of a reading at rest, rad; None, or less: one step of the sensor
    """
    d = e.device
    limits, delay_s = e.limits, 0.0 if delay is None else counted_delay_s(d, delay)
    horizon_s = known_reaction_s(d) + delay_s + limits.coast_tau_s
    step_rad = e.sensor.curve.lsb_rad
    scatter_rad_s = SCATTER * velocity_noise_rad_s(max(noise_rad or 0.0, step_rad), e.period_s)
    low, high = (max(1.0 - scatter_rad_s * horizon_s / abs(hard), LEAST) * hard for hard in limits.hard_rad)
    soft_low, soft_high = (-swing_rad(d), swing_rad(e.device)) if limits.is_endless else limits.soft_rad
    return Room(
        INSIDE * soft_low,
        INSIDE * soft_high,
        e.drive.max_V,
        max(limits.max_speed_rad_s - scatter_rad_s, LEAST * limits.max_speed_rad_s),
        static_V,
        (low, high),
        horizon_s,
    )


def reading_of(e: Experiment, noise_rad: float, latency_s: float) -> Reading:
    """How the bench of a config is read.

    noise_rad  standard deviation of a reading at rest, rad; its step is in it
    latency_s  from a sample until its drive acts, s
    """
    step_rad = e.sensor.curve.lsb_rad
    return Reading(e.period_s, max(noise_rad, step_rad / 12.0**0.5), 0.0, latency_s)


def task_of_run(
    e: Experiment, motor: RealMotor, result: RunResult | None, doubt_percent: float, percent: float
) -> Task:
    """The task of a design for the motor that a run has found, on the bench of a config.

    result         of that run: what its breakaway check saw
    doubt_percent  by how many % tau, K and f_c may all be wrong
    percent        wanted half width of their 95 % intervals, %
    The device says when its drives act. Raises ValueError for a motor without friction.
    """
    seen = BreakawayResult() if result is None or result.breakaway is None else result.breakaway
    identified, moved = (seen.static_plus_V, seen.static_minus_V), (seen.seen_plus_V, seen.seen_minus_V)
    levels = next((each for each in (identified, moved) if None not in each), (STATIC * motor.fc_V,))
    static_V = max(level for level in levels if level is not None)
    noise_rad = 0.0 if seen.noise_rad is None else seen.noise_rad
    latency_s = (1.5 if backend_of(e.device).writes_first(e.device) else 0.5) * e.period_s
    reading = reading_of(e, noise_rad, latency_s)
    belief = Belief.within((motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V), doubt_percent, motor.delay_s, 0.0)
    return Task(belief, np.zeros((5, 5)), room_of_tests(e, static_V, None, noise_rad), reading, percent)
