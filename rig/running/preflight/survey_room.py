"""The room that a config gives the sweeps of a survey (docs/theory.md 13.2)."""

from __future__ import annotations

from rig.backends.registry import backend_of
from rig.config.schema import Experiment
from rig.control.sweep_plan import COUNTS_1_S, Room, SweepPlan, fastest_loop_1_s, sweep_plan
from rig.running.preflight.room_to_stop import stopping_terms


def survey_room(e: Experiment, slowest_rad_s: float, bandwidth_1_s: float) -> Room:
    """What there is for the sweeps, with a sensor that resolves this speed and a loop of this bandwidth."""
    ends = zip(e.limits.soft_rad, e.limits.hard_rad, strict=True)
    # at a soft limit, at this speed, the guard would just not brake yet
    horizon_s = sum(rad for _, rad in stopping_terms(e.device)) / e.limits.max_speed_rad_s
    by_stopping_rad_s = min(abs(hard - soft) for soft, hard in ends) / horizon_s
    return Room(
        e.limits.soft_rad,
        min(e.limits.max_speed_rad_s, by_stopping_rad_s),
        slowest_rad_s,
        bandwidth_1_s,
        e.survey.longest_s,
    )


def expected_sweeps(e: Experiment) -> SweepPlan:
    """The sweeps on a bench without noise and with the least latency. Raises TooShortError if there is no room."""
    least_s = (1.5 if backend_of(e.device).writes_first(e.device) else 0.5) * e.period_s
    return sweep_plan(
        survey_room(e, COUNTS_1_S * e.sensor.curve.lsb_rad, fastest_loop_1_s(least_s)), e.survey.speeds_rad_s or ()
    )
