"""The room that a config gives a planned test, and how its bench is read (docs/design.md)."""

from __future__ import annotations

from rig.config.schema import Experiment
from rig.design.room import Reading, Room
from rig.preflight.room_to_stop import counted_delay_s, known_reaction_s
from rig.signals import BenchDelay

INSIDE = 0.95  # part of the soft limits, the speed and the stop that a plan uses: the rest is for noise


def room_of_tests(e: Experiment, static_V: float, delay: BenchDelay | None = None) -> Room:
    """What a planned test may use.

    static_V  level that the shaft breaks away at, V
    delay     of the bench, as its breakaway check shows it
    """
    (low, high), (stop_low, stop_high) = e.limits.soft_rad, e.limits.hard_rad
    delay_s = 0.0 if delay is None else counted_delay_s(e, delay)
    return Room(
        INSIDE * low,
        INSIDE * high,
        e.drive.max_V,
        INSIDE * e.limits.max_speed_rad_s,
        static_V,
        (INSIDE * stop_low, INSIDE * stop_high),
        known_reaction_s(e) + delay_s + e.limits.coast_tau_s,
    )


def reading_of(e: Experiment, noise_rad: float, latency_s: float) -> Reading:
    """How the bench of a config is read.

    noise_rad  standard deviation of a reading at rest, rad; its step is in it
    latency_s  from a sample until its drive acts, s
    """
    step_rad = e.sensor.curve.lsb_rad
    return Reading(e.period_s, max(noise_rad, step_rad / 12.0**0.5), 0.0, latency_s)
