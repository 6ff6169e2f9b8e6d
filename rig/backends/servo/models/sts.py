"""Feetech STS: STS3215 of the SO-100 and SO-101 arms, STS3250.

Sources: Feetech's memory table of STS servos as others have copied it, its SCServo library (SMS_STS), and LeRobot's
tables. Their makers ship one model with 7.4 V and 12 V motors under one number. All sources agree on the baud's
indices 0 to 4 only. Speed is in steps per second where bit 2 of ``phase`` is set; else one is 50 of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from rig.backends.servo.models.model import ServoModel
from rig.backends.servo.models.register import Register

FULL_DUTY = 1000
PWM_MODE = 2
POSITION_MODE = 0
COUNTS = 4096
MANY_TURNS = 0x10  # bit of ``phase``: the position goes on over turns
STEPS_PER_SECOND = 0x04  # bit of ``phase``: the unit of speed
_STEP_RAD = 2.0 * math.pi / COUNTS
_A = 6.5e-3

BAUDS: Mapping[int, int] = {0: 1_000_000, 1: 500_000, 2: 250_000, 3: 128_000, 4: 115_200}

ROLES: Mapping[str, str] = {
    "answers": "response_level",
    "id": "id",
    "baud": "baud_rate",
    "return_delay": "return_delay_time",
    "model_number": "model_number",
    "firmware": "firmware_major",
    "mode": "mode",
    "torque": "torque_enable",
    "drive": "goal_duty",
    "max_drive": "torque_limit",
    "position": "present_position",
    "applied": "present_load",
    "velocity": "present_speed",
    "voltage": "present_voltage",
    "temperature": "present_temperature",
    "errors": "status",
    "lock": "lock",
    "marked": "torque_limit",  # that of max_torque after its supply was cut
    "phase": "phase",
    "protective_torque": "protective_torque",
    "protection_time": "protection_time",
    "overload_torque": "overload_torque",
    "shutdown": "unloading_condition",
    "low_voltage": "min_voltage_limit",
    "high_voltage": "max_voltage_limit",
}

_TABLE = (
    Register("firmware_major", 0, "uint8", "r"),
    Register("firmware_minor", 1, "uint8", "r"),
    Register("model_number", 3, "uint16", "r"),
    Register("id", 5, shipped=1, low=0, high=252),
    Register("baud_rate", 6, shipped=0, low=0, high=7),
    Register("return_delay_time", 7, shipped=0, unit="s", scale=2e-6, low=0, high=253),
    Register("response_level", 8, shipped=1, low=0, high=1),
    Register("min_position_limit", 9, "uint16", shipped=0, unit="rad", scale=_STEP_RAD, low=0, high=COUNTS - 1),
    Register(
        "max_position_limit", 11, "uint16", shipped=COUNTS - 1, unit="rad", scale=_STEP_RAD, low=0, high=COUNTS - 1
    ),
    Register("max_temperature_limit", 13, shipped=70, unit="degC", low=0, high=100),
    Register("max_voltage_limit", 14, unit="V", scale=0.1, low=0, high=254),
    Register("min_voltage_limit", 15, shipped=40, unit="V", scale=0.1, low=0, high=254),
    Register("max_torque", 16, "uint16", shipped=FULL_DUTY, unit="1", scale=1e-3, low=0, high=FULL_DUTY),
    Register("phase", 18, low=0, high=254),
    Register("unloading_condition", 19, low=0, high=254),
    Register("led_alarm_condition", 20, low=0, high=254),
    Register("position_p_gain", 21, low=0, high=254),
    Register("position_d_gain", 22, low=0, high=254),
    Register("position_i_gain", 23, shipped=0, low=0, high=254),
    Register("minimum_startup_force", 24, unit="1", scale=1e-3, low=0, high=254),
    Register("integral_limit", 25, shipped=0, low=0, high=254),
    Register("cw_dead_zone", 26, shipped=1, unit="rad", scale=_STEP_RAD, low=0, high=16),
    Register("ccw_dead_zone", 27, shipped=1, unit="rad", scale=_STEP_RAD, low=0, high=16),
    Register("protection_current", 28, "uint16", shipped=511, unit="A", scale=_A, low=0, high=2047),
    Register("angular_resolution", 30, shipped=1, low=1, high=128),
    Register("homing_offset", 31, "sign11", shipped=0, unit="rad", scale=_STEP_RAD, low=-2047, high=2047),
    Register("mode", 33, shipped=0, low=0, high=3),
    Register("protective_torque", 34, shipped=20, unit="1", scale=1e-2, low=0, high=254),
    Register("protection_time", 35, shipped=200, unit="s", scale=1e-2, low=0, high=254),
    Register("overload_torque", 36, shipped=80, unit="1", scale=1e-2, low=0, high=254),
    Register("speed_p_gain", 37, low=0, high=254),
    Register("over_current_time", 38, shipped=200, unit="s", scale=1e-2, low=0, high=254),
    Register("speed_i_gain", 39, low=0, high=254),
    Register("torque_enable", 40, shipped=0, low=0, high=128),
    Register("acceleration", 41, shipped=0, unit="rad/s2", scale=100.0 * _STEP_RAD, low=0, high=254),
    Register("goal_position", 42, "sign15", shipped=0, unit="rad", scale=_STEP_RAD),
    Register("goal_duty", 44, "sign10", unit="1", scale=1e-3, low=-FULL_DUTY, high=FULL_DUTY),
    Register("goal_speed", 46, "sign15", unit="rad/s", scale=_STEP_RAD),
    Register("torque_limit", 48, "uint16", unit="1", scale=1e-3, low=0, high=FULL_DUTY),
    Register("lock", 55, shipped=1, low=0, high=1),
    Register("present_position", 56, "sign15", "r", unit="rad", scale=_STEP_RAD),
    Register("present_speed", 58, "sign15", "r", unit="rad/s", scale=_STEP_RAD),
    Register("present_load", 60, "sign10", "r", unit="1", scale=1e-3),
    Register("present_voltage", 62, "uint8", "r", unit="V", scale=0.1),
    Register("present_temperature", 63, "uint8", "r", unit="degC"),
    Register("async_write", 64, "uint8", "r", 0),
    Register("status", 65, "uint8", "r", 0),
    Register("moving", 66, "uint8", "r", 0),
    Register("target_position", 67, "sign15", "r", unit="rad", scale=_STEP_RAD),
    Register("present_current", 69, "sign15", "r", unit="A", scale=_A),
)


def _model(name: str, number: int, supply_V: tuple[float, float]) -> ServoModel:
    table = {r.name: r for r in _TABLE}
    table["model_number"] = table["model_number"]._replace(shipped=number)
    return ServoModel(
        name=name,
        family="STS",
        number=number,
        protocol="feetech",
        registers=table,
        roles=ROLES,
        eeprom_end=40,
        full_drive=FULL_DUTY,
        pwm_mode=PWM_MODE,
        position_mode=POSITION_MODE,
        counts_per_turn=COUNTS,
        bauds=BAUDS,
        supply_V=supply_V,
    )


MODELS = (_model("sts3215", 777, (4.0, 14.0)), _model("sts3250", 2825, (4.0, 14.0)))
