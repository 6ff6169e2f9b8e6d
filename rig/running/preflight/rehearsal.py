"""A rehearsal: the bench of a config, emulated in virtual time, with a motor made from its data sheet."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rig.backends.registry import backend_of
from rig.config.edit import Value
from rig.config.new_bench import LEAST_CYCLE_COUNTS
from rig.config.problems import ConfigError, Path, Problem, wrong
from rig.config.schema import EmulatedMotor, Experiment
from rig.config.yaml12 import Document
from rig.core.errors import CauseError
from rig.run_folder.results import JsonObject
from rig.running.preflight.rules import check

if TYPE_CHECKING:
    from rig.model.describing_function import RelayGains

FRICTION_SHARE = 0.05  # of the supply; this and the next three: see ``made_motor``
TAU_SHARE = 0.5  # of limits.coast_tau_s
_BY_DIRECTION = 0.04  # of friction, more one way and less the other
_STATIC = 1.08  # times moving friction
_NOISE_SHARE = 7e-4  # of a potentiometer's range: standard deviation; 3 mrad of 4.2 rad, as the demo's
_BEYOND_HARD_RAD = 0.2  # from the hard limits to the mechanical stops: docs/real-bench.md asks for it
_SLACK = 1.01  # the config's digits are rounded
_OUT_OF_REACH = 1.1  # times drive.max_V: a describing function is only about right
_IN_REACH = 0.8  # of drive.max_V, of a new config's swings: the motor may be slower than it says
_STEP = 0.05  # of relay.search.h_max_V: that search's step
_START = 0.7  # of the swing's own gains beyond friction: where the search for it begins
_SLOWER, _SLOWEST = 1.05, 8.0  # from one try to the next; slower ones take too long


class SheetError(CauseError):
    """Numbers of a data sheet that make no motor."""


@dataclass(frozen=True)
class DataSheet:
    """What is known of a motor; None: as the config says it, or typical.

    rated_V      supply of the data sheet's speed, V; default: drive.supply_V
    no_load_rpm  speed of the motor's own shaft at that supply, revolutions a minute; default: the measured shaft's
                 motor.no_load_speed_rad_s
    gear         turns of the motor for one of the measured shaft; goes with ``no_load_rpm``
    friction_V   Coulomb friction, V: no-load current over stall current, times the supply
    tau_s        time constant, s, with the load
    coasting     the bridge lets the motor run free while PWM is low; None: as the config says
    Raises SheetError.
    """

    rated_V: float | None = None
    no_load_rpm: float | None = None
    gear: float | None = None
    friction_V: float | None = None
    tau_s: float | None = None
    coasting: bool | None = None

    def __post_init__(self) -> None:
        for name, unit in (("rated_V", "V"), ("no_load_rpm", "rpm"), ("gear", ""), ("friction_V", "V"), ("tau_s", "s")):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise SheetError(f"{_option(name)} {value:g} {unit}".rstrip() + " is no motor's", "give more than 0")
        if self.no_load_rpm is not None and self.gear is None:
            raise SheetError(
                "--no-load-rpm is the speed of the motor's own shaft, and nothing says what its gear makes of it",
                "give --gear, the motor's turns for one of the measured shaft; --gear 1 where there is none",
            )
        for name in ("gear", "rated_V"):
            if getattr(self, name) is not None and self.no_load_rpm is None:
                raise SheetError(f"{_option(name)} says nothing without --no-load-rpm", "give both, or neither")


def made_motor(sheet: DataSheet, e: Experiment) -> dict[str, float]:
    """Keys of ``emulated.motor`` for a motor of this data sheet on the bench of this config.

    What is not given is typical. Friction is 1/20 of the supply: no-load current over stall current is 1/15 and 3/50
    in the data sheets of 12 V gear motors of 25 mm (Pololu 25D, 75:1 LP: 0.06 of 0.9 A; 47:1 HP: 0.3 of 5 A), and
    less in larger ones. The time constant is 1/2 of the longest that the config expects: a bare motor's is 1/100 to
    1/30 s, and the load on it, which no data sheet knows, makes the rest.
    Friction is 1/25 more one way and 1/25 less the other, and 2/25 more at rest. Where the config has an emulated
    motor, it keeps what is not given. Raises SheetError.
    """
    own = None if e.emulated is None else e.emulated.motor
    supply_V = sheet.rated_V or e.drive.supply_V
    made: dict[str, float] = {}
    friction_V = sheet.friction_V
    if friction_V is None:
        friction_V = FRICTION_SHARE * supply_V if own is None else 0.5 * (own.fc_plus_V + own.fc_minus_V)
    if friction_V >= min(supply_V, e.drive.supply_V):
        raise SheetError(
            f"friction of {friction_V:g} V takes the whole supply of {min(supply_V, e.drive.supply_V):g} V",
            "friction is the supply times no-load current over stall current, both of the data sheet",
        )
    if own is None or sheet.friction_V is not None:
        plus_V, minus_V = (1.0 + _BY_DIRECTION) * friction_V, (1.0 - _BY_DIRECTION) * friction_V
        made |= {"fc_plus_V": plus_V, "fc_minus_V": minus_V}
        made |= {"fs_plus_V": _STATIC * plus_V, "fs_minus_V": _STATIC * minus_V}
    if own is None or sheet.tau_s is not None:
        made["tau_s"] = sheet.tau_s or TAU_SHARE * e.limits.coast_tau_s
    if sheet.no_load_rpm is not None and sheet.gear is not None:
        made["K_rad_s_V"] = sheet.no_load_rpm * math.pi / 30.0 / sheet.gear / (supply_V - friction_V)
    elif own is None and e.motor is not None:
        made["K_rad_s_V"] = e.motor.no_load_speed_rad_s / (supply_V - friction_V)
    return {name: float(f"{value:.4g}") for name, value in made.items()}


def swings_in_reach(e: Experiment) -> dict[Path, Value]:
    """Keys of the config's swings that a typical motor of ``motor`` makes with ``drive.max_V``; {}: its own are.

    All are slower and smaller by one share, but none is too small for the sensor.
    """
    made = made_motor(DataSheet(), e)
    tau_s, gain = made["tau_s"], made["K_rad_s_V"]
    friction_V = 0.5 * (made["fc_plus_V"] + made["fc_minus_V"])
    target, sines = e.relay.target, () if e.tracking is None else e.tracking.trajectory
    least_rad = LEAST_CYCLE_COUNTS * e.sensor.curve.lsb_rad
    by = 1.0
    while True:
        swing = None if target is None else (max(target.amplitude_rad / by, least_rad), target.period_s * by)
        swing_V = 0.0 if swing is None else sum(_gains_V(gain, tau_s, friction_V, *swing))
        speed_V = sum(s.amplitude_rad * s.omega_rad_s * (1.0 + tau_s * s.omega_rad_s / by) for s in sines) / gain
        if max(swing_V, friction_V + speed_V / by**2) <= _IN_REACH * e.drive.max_V or by > _SLOWEST:
            break
        by *= _SLOWER
    if by == 1.0:
        return {}
    found: dict[Path, Value] = {}
    if swing is not None:
        found["relay", "target"] = {
            "amplitude_rad": math.ceil(100.0 * swing[0]) / 100.0,
            "period_s": round(swing[1], 1),
        }
        h1_V, h2_V = _gains_V(gain, tau_s, friction_V, *swing)
        found["relay", "search"] = {
            "h1_start_V": round(_START * h1_V, 2),
            "h2_start_V": round(friction_V + _START * (h2_V - friction_V), 2),
            "h2_step_V": round(_STEP * e.relay.search.h_max_V, 2),
            "h_max_V": e.relay.search.h_max_V,
            "timeout_s": math.ceil(e.relay.search.timeout_s * by),
        }
    if sines:
        found["tracking", "trajectory"] = [
            {"amplitude_rad": round(s.amplitude_rad / by, 3), "omega_rad_s": round(s.omega_rad_s / by, 2)}
            for s in sines
        ]
    return found


def rehearsed(document: Document, sheet: DataSheet, pace: float | None = None) -> Experiment:
    """The checked experiment on an emulated device in virtual time: all but the device is the config's own.

    document  the config as it was read; it needs no ``daq.port``
    sheet     of the motor; where nothing is given the motor of section ``emulated``, if there is one
    pace      in place of loop.pace; None: as the config says
    Raises ConfigError, with line and key, as ``check``, where rig emulates no such device, or where the config's limits
    do not fit the motor; SheetError.
    """
    no_port = () if "port" in _section(document.data, "daq") else ("daq.port",)
    e, _ = check(document, ("emulated", *no_port))
    keys = backend_of(e.device).rehearsed(e.device)
    if keys is None:
        problem = wrong(
            "daq.driver",
            f"rig has no emulated device for `driver: {e.daq.driver}`",
            "rehearse a copy of this config with `driver: simulated`, and without port and options",
        )
        raise ConfigError([document.located(problem)])
    daq: JsonObject = {
        key: value for key, value in (_section(document.data, "daq") | keys["daq"]).items() if value is not None
    }
    own = _section(document.data, "emulated")
    motor: JsonObject = {**_section(own, "motor"), **made_motor(sheet, e)}
    if not own:
        own = keys["emulated"]
        if e.sensor.encoder is None:
            rad_per_count, _ = e.sensor.straight
            noise_rad = _NOISE_SHARE * abs(rad_per_count) * (e.sensor.counts_max or 0)
            own |= {"potentiometer": {"noise_rad": float(f"{noise_rad:.3g}")}}
        if not e.limits.is_endless:
            low_rad, high_rad = e.limits.hard_rad
            motor["stop_rad"] = [low_rad - _BEYOND_HARD_RAD, high_rad + _BEYOND_HARD_RAD]
    if sheet.coasting is not None:
        own = own | {"coasting": sheet.coasting}
    data: JsonObject = {**document.data, "daq": daq, "emulated": {**own, "motor": motor, "rehearsal": True}}
    found, _ = check(replace(document, data=data), pace=pace)
    assert found.emulated is not None
    if problems := [document.located(problem) for problem in _unfit(found, found.emulated.motor)]:
        raise ConfigError(problems)
    return found


def _section(data: JsonObject, name: str) -> JsonObject:
    """A section of a config; empty where it is not there, or is none."""
    found = data.get(name)
    return found if isinstance(found, dict) else {}


def _unfit(e: Experiment, motor: EmulatedMotor) -> Iterator[Problem]:
    """What the config says of the motor, and its safety rests on, that is not true of this one."""
    if e.motor is None:
        return
    friction_V = 0.5 * (motor.fc_plus_V + motor.fc_minus_V)
    no_load_rad_s = motor.K_rad_s_V * (e.drive.supply_V - friction_V)
    if no_load_rad_s > _SLACK * e.motor.no_load_speed_rad_s:
        yield wrong(
            "motor.no_load_speed_rad_s",
            f"this motor turns the measured shaft at {no_load_rad_s:.3g} rad/s at {e.drive.supply_V:g} V, more than "
            f"{e.motor.no_load_speed_rad_s:g}, on which the bound of the breakaway check rests",
            f"{math.ceil(10.0 * no_load_rad_s) / 10.0:g}, and see what `rig check` says then; or a slower motor",
        )
    static_V = max(motor.fs_plus_V or motor.fc_plus_V, motor.fs_minus_V or motor.fc_minus_V)
    if static_V >= e.breakaway.max_V:
        yield wrong(
            "breakaway.max_V",
            f"{e.breakaway.max_V:g} V does not move this motor, whose static friction is {static_V:.3g} V",
            f"two to three times that, {2.0 * static_V:.2g} V, and drive.max_V at least as much",
        )
    target = e.relay.target
    if target is not None:
        needed_V = sum(_gains_V(motor.K_rad_s_V, motor.tau_s, friction_V, target.amplitude_rad, target.period_s))
        if needed_V > _OUT_OF_REACH * e.drive.max_V:
            yield wrong(
                "relay.target",
                f"to swing {target.amplitude_rad:g} rad every {target.period_s:g} s this motor needs about "
                f"{needed_V:.2g} V, and drive.max_V is {e.drive.max_V:g}",
                "a smaller amplitude_rad, a longer period_s, or a higher drive.max_V",
            )
    if motor.tau_s > _SLACK * e.limits.coast_tau_s:
        travel_rad = e.limits.max_speed_rad_s * motor.tau_s
        yield wrong(
            "limits.coast_tau_s",
            f"this motor's time constant is {motor.tau_s:g} s, longer than {e.limits.coast_tau_s:g}: from "
            f"{e.limits.max_speed_rad_s:g} rad/s it coasts {travel_rad:.3g} rad, more than the limits have room for",
            f"{motor.tau_s:g}, and see what `rig check` says then: a lower limits.max_speed_rad_s, or wider limits",
        )


def _gains_V(K_rad_s_V: float, tau_s: float, friction_V: float, amplitude_rad: float, period_s: float) -> RelayGains:
    """The relay's gains that swing the motor so, by the describing function (docs/theory.md 4)."""
    from rig.model.describing_function import (
        Oscillation,
        gains_for,
    )  # with numpy, which a missing port need not wait for

    return gains_for(Oscillation(2.0 * math.pi / period_s, amplitude_rad), tau_s, K_rad_s_V, friction_V)


def _option(name: str) -> str:
    return "--" + name.replace("_V", "-V").replace("tau_s", "tau-s").replace("_", "-")
