"""The rules of a servo's keys, and which combinations of servo and load may run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from rig.backends.servo.link_budget import tick_budget
from rig.backends.servo.section import EMULATED_PORTS, Servo
from rig.backends.tick_waits import UNWATCHED_S
from rig.config.problems import Problem, wrong
from rig.config.schema import DeviceSetup

_HALF_TURN_RAD: Final = math.pi - 0.1  # beyond it a position has two places
_SLACK: Final = 1e-9
_UNITS: Final = 127  # of the watchdog's register, at most


def servo_rules(d: DeviceSetup) -> Iterator[Problem]:
    """The rules that only a servo has."""
    port, servo = d.daq.port, d.daq.servo
    if d.runs_relay:
        yield wrong("relay.where", "`driver: servo` has no relay in the device", "set it to host")
    if d.tachometer is not None:
        yield wrong("tachometer", "rig takes a servo's position alone", "leave it out")
    if d.sensor.servo is None:
        yield wrong("sensor", "`driver: servo` has a sensor of its own", "servo: {}")
    if servo is None:
        yield wrong("daq.servo", "`driver: servo` needs this section", "see config/servo.yaml")
        return
    yield from _keys(d, servo)
    yield from _travel(d, servo)
    if port is None or (port.startswith("emulated") and port not in EMULATED_PORTS):
        return  # its adapter is not known
    budget = tick_budget(d.daq, servo)
    if not budget.fits(d.period_s):
        fitting = [f"daq.baud {baud} fits" for baud in sorted(servo.table.bauds.values()) if _fits(d, servo, baud)]
        yield budget.too_slow("daq.baud", d.period_s, fitting[:1])
    elif d.daq.timeout_s < budget.total_s:
        yield wrong(
            "daq.timeout_s",
            f"{1e3 * d.daq.timeout_s:g} ms is shorter than the exchanges of a tick, {1e3 * budget.total_s:.2f} ms",
            f"up to {d.period_s:g} seconds",
        )


def has_watchdog(servo: Servo) -> bool:
    """Whether its registers have one; the opening tries whether it works."""
    return "watchdog" in servo.table.roles


def needs_switch(d: DeviceSetup, servo: Servo) -> bool:
    """Whether the switch of its supply alone is certain to stop it, in front of stops."""
    return servo.attached == "joint" and not _is_proven(d, servo)


def switch_to_try(d: DeviceSetup, servo: Servo) -> str:
    """The switch that a person tries before the servo drives, in words; empty: none."""
    is_real = d.daq.port not in EMULATED_PORTS
    return (servo.supply_switch or "") if is_real and needs_switch(d, servo) else ""


def _is_proven(d: DeviceSetup, servo: Servo) -> bool:
    """Whether nothing drives without a watchdog that works."""
    return has_watchdog(servo) and not d.daq.accept_no_watchdog


def _keys(d: DeviceSetup, servo: Servo) -> Iterator[Problem]:
    table, daq = servo.table, d.daq
    if daq.baud not in table.bauds.values():
        yield wrong(
            "daq.baud",
            f"{servo.model} has no {daq.baud} baud",
            f"one of {', '.join(map(str, sorted(table.bauds.values())))}",
        )
    low_V, high_V = table.supply_V
    if not low_V <= d.drive.supply_V <= high_V:
        yield wrong("drive.supply_V", f"{servo.model} takes {low_V:g} to {high_V:g} V, not {d.drive.supply_V:g} V")
    if d.drive.bridge is not None:
        yield wrong("drive.bridge", "a servo has its bridge inside", "leave it out")
    if daq.timeout_s > d.period_s * (1 + _SLACK):
        yield wrong(
            "daq.timeout_s",
            f"{daq.timeout_s:g} s is longer than the period of {d.period_s:g} s: a reply could come in the next tick",
            f"at most {d.period_s:g} seconds",
        )
    if not has_watchdog(servo):
        if not daq.accept_no_watchdog:
            yield wrong(
                "daq.servo",
                f"{servo.model} has no watchdog: it holds its duty when the host is silent. A keeper on this machine "
                "stops it if rig dies or hangs, but not if cable, adapter or machine fail",
                "daq.accept_no_watchdog: true, and the supply's switch in reach",
            )
        return
    unit_s = table.role("watchdog").scale
    units = daq.watchdog_s / unit_s
    if not (0.5 <= units <= _UNITS and abs(round(units) - units) <= 1e-6):
        yield wrong("daq.watchdog_s", f"{daq.watchdog_s:g} s is no whole number of {unit_s:g} s", "such as 0.06")


def _travel(d: DeviceSetup, servo: Servo) -> Iterator[Problem]:
    if d.limits.is_endless:
        yield wrong("limits.travel", "`driver: servo` has no e-stop that could be tried", "give soft_rad and hard_rad")
        return
    low, high = d.limits.hard_rad
    if low < -_HALF_TURN_RAD or high > _HALF_TURN_RAD:
        yield wrong(
            "limits.hard_rad",
            "a servo's position is known within one turn alone when it is switched on",
            f"within {-_HALF_TURN_RAD:.2f} and {_HALF_TURN_RAD:.2f} rad",
        )
    if not (low < d.limits.soft_rad[0] and d.limits.soft_rad[1] < high):
        return  # said already
    if needs_switch(d, servo) and servo.supply_switch is None:
        yield wrong(
            "daq.servo.attached",
            "a joint with stops, and nothing in the servo takes the duty away when the host is silent",
            "put a switch into the servo's supply, and name it in daq.servo.supply_switch; or free the horn",
        )
    elif servo.attached == "load" and not _is_proven(d, servo):
        yield from full_drive_stays_inside(
            d, UNWATCHED_S, "and nothing in the servo takes the duty away when the host is silent"
        )


def full_drive_stays_inside(d: DeviceSetup, for_s: float, why: str) -> Iterator[Problem]:
    """A shaft at the speed of full drive stays inside the hard limits for so long, from a soft limit on.

    Up to there full drive may be outward. Without ``motor`` its speed is the largest one to expect.
    """
    (low, high), (soft_low, soft_high) = d.limits.hard_rad, d.limits.soft_rad
    room, top_rad_s = min(high - soft_high, soft_low - low), d.limits.max_speed_rad_s
    if d.motor is not None:
        top_rad_s = d.motor.no_load_speed_rad_s * d.drive.max_V / d.drive.supply_V
    if top_rad_s * for_s > room:
        most_V = d.drive.max_V * room / (top_rad_s * for_s)
        yield wrong(
            "drive.max_V",
            f"at {d.drive.max_V:g} V the shaft could leave limits.hard_rad within {for_s:.3g} s of a soft limit, {why}",
            f"at most {most_V * 0.995:.3g} volts, or more room between limits.soft_rad and limits.hard_rad",
        )


def _fits(d: DeviceSetup, servo: Servo, baud: int) -> bool:
    return tick_budget(d.daq, servo, baud).fits(d.period_s)
