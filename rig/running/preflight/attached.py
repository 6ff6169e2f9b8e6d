"""What is on the horn of a servo, and whether it may be: does it fall, does it reach a stop. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from rig.backends.servo.rules import full_drive_stays_inside, has_watchdog
from rig.backends.servo.section import Servo
from rig.config.problems import Problem, wrong
from rig.config.schema import DeviceSetup, Experiment, LoadSection
from rig.running.preflight.room_to_stop import limits_are_ordered, stopping_rad

_GRAVITY_M_S2: Final = 9.81
_FRICTIONS: Final = 3.0  # times static friction that breakaway.max_V is, at most: its description


def attached_rules(e: Experiment) -> Iterator[Problem]:
    """The rules of ``load`` and ``daq.servo.attached`` that need more than the servo's own section."""
    d = e.device
    servo = e.daq.servo
    if servo is None:
        if e.load is not None:
            yield wrong("load", "rig knows what to do about a load on a servo alone", "leave it out")
        return
    if e.load is not None:
        yield from _gravity(e, servo, e.load)
    if servo.attached == "joint" and limits_are_ordered(d):
        yield from full_drive_stays_inside(
            d, joint_silence_s(d, servo), "before the drive is taken away and the shaft has stopped"
        )


def joint_silence_s(d: DeviceSetup, servo: Servo) -> float:
    """For how long a shaft may go on at its speed, s: docs/theory.md 10.2, and a unit of the watchdog.

    The servo counts its silence in units of 20 ms: the last one may have begun just after the last instruction.
    Without a watchdog this holds while the host lives.
    """
    reacts_s = stopping_rad(d) / d.limits.max_speed_rad_s
    return reacts_s + (servo.table.role("watchdog").scale if has_watchdog(servo) else 0.0)


def gravity_V(d: DeviceSetup, load: LoadSection) -> float | None:
    """The drive that holds an arm level, V; None without the data sheet's torque."""
    if d.motor is None or d.motor.stall_torque_N_m is None:
        return None
    return _GRAVITY_M_S2 * load.mass_kg * load.arm_m / d.motor.stall_torque_N_m * d.drive.supply_V


def _gravity(e: Experiment, servo: Servo, load: LoadSection) -> Iterator[Problem]:
    """An arm must not fall when the torque goes off, whatever puts it off."""
    if servo.attached == "nothing":
        yield wrong("daq.servo.attached", "nothing is attached, but section `load` says what is", "load, or joint")
        return
    if load.axis == "vertical":
        return
    if load.hangs:
        yield from _swing(e.device, servo)
        return
    pull_V, friction_V = gravity_V(e.device, load), e.breakaway.max_V / _FRICTIONS
    if pull_V is None:
        yield wrong(
            "motor",
            "stall_torque_N_m is missing: without it nobody can tell whether the arm falls when the torque goes off",
            "stall_torque_N_m, by its data sheet at drive.supply_V",
        )
    elif pull_V > friction_V:
        yield wrong(
            "load",
            f"{load.mass_kg:g} kg at {load.arm_m:g} m pull with up to {pull_V:.3g} V, and friction holds some "
            f"{friction_V:.2g} V (a third of breakaway.max_V): the arm falls when the torque goes off",
            "lay the arm on its rest and take it off the horn; or let it hang at 0 rad, with load.hangs: true; or "
            "stand the shaft upright, with load.axis: vertical",
        )


def _swing(d: DeviceSetup, servo: Servo) -> Iterator[Problem]:
    """An arm that hangs falls inward, and from there as far to the other side, at most."""
    (low, high), (soft_low, soft_high) = d.limits.hard_rad, d.limits.soft_rad
    if servo.attached == "joint" and limits_are_ordered(d) and (soft_high > -low or -soft_low > high):
        yield wrong(
            "limits.soft_rad",
            "an arm that falls from one soft limit can swing through 0 rad to the hard limit of the other side",
            f"at most {min(high, -low):g} rad either way",
        )
