"""What a config tells the loop: what the guard knows, as in `rig check`, and what the machine is asked for."""

from __future__ import annotations

from rig.config.schema import Experiment
from rig.control.guard import GuardSettings
from rig.control.loop.real_time import RealTimeSettings
from rig.core.signals import BenchDelay
from rig.running.preflight.room_to_stop import counted_delay_s, known_reaction_s


def guard_settings_of(
    experiment: Experiment, noise_rad: float | None = None, delay: BenchDelay | None = None
) -> GuardSettings:
    """The guard's knowledge; ``noise_rad`` and ``delay`` once they were measured.

    Before that two LSB are assumed, and a drive that acts within its own tick.
    """
    d = experiment.device
    lsb_rad = experiment.sensor.curve.lsb_rad
    t = experiment.limits
    return GuardSettings(
        limits=d.arming,
        rail_counts=experiment.sensor.rails,
        max_speed_rad_s=t.max_speed_rad_s,
        coast_tau_s=t.coast_tau_s,
        noise_rad=2.0 * lsb_rad if noise_rad is None else max(noise_rad, lsb_rad),
        motion_rad=experiment.breakaway.motion_rad,
        delay_s=0.0 if delay is None else counted_delay_s(d, delay),
        reaction_s=known_reaction_s(d),  # as in `rig check`
        free_rad_s=0.0
        if experiment.motor is None
        else experiment.motor.no_load_speed_rad_s * experiment.drive.max_V / experiment.drive.supply_V,
    )


def real_time_of(experiment: Experiment) -> RealTimeSettings:
    """What the loop's process asks the machine for."""
    wanted = experiment.loop
    return RealTimeSettings(wanted.priority, wanted.cpu, wanted.lock_memory, wanted.raise_workers)
