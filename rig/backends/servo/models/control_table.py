"""The registers that all Dynamixel X and MX(2.0) servos share, and how one family's table is made of them.

Sources: ROBOTIS e-Manual, the pages of the models; addresses and sizes as in the ``.model`` files of dynamixel-sdk
4.1.0, which a test compares. Indirect addresses are left out: rig does not use them, and where their data lie depends
on the firmware.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from rig.backends.servo.models.model import ServoModel
from rig.backends.servo.models.register import Register

FULL_PWM = 885
PWM_MODE = 16
POSITION_MODE = 3
COUNTS = 4096
_LAST = COUNTS - 1
TURN_RAD = 2.0 * math.pi / COUNTS
SPEED_RAD_S = 0.0239691227  # 0.229 rpm, with the digits of dynamixel-sdk
ACCELERATION_RAD_S2 = 214.577 * 2.0 * math.pi / 3600.0
DUTY = 1.0 / FULL_PWM
SHADOW_OFF = 253  # from here on there is no second id
_MOST_OFFSET = 1_044_479
_MOST_GAIN = 16_383
_MOST_PROFILE = 32_767

BAUDS_330: Mapping[int, int] = {
    0: 9_600, 1: 57_600, 2: 115_200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000,
}  # fmt: skip
BAUDS: Mapping[int, int] = {**BAUDS_330, 7: 4_500_000}

ROLES: Mapping[str, str] = {
    "id": "id",
    "answers": "status_return_level",
    "baud": "baud_rate",
    "return_delay": "return_delay_time",
    "model_number": "model_number",
    "firmware": "firmware_version",
    "mode": "operating_mode",
    "torque": "torque_enable",
    "drive": "goal_pwm",
    "max_drive": "pwm_limit",
    "position": "present_position",
    "applied": "present_pwm",
    "velocity": "present_velocity",
    "voltage": "present_input_voltage",
    "temperature": "present_temperature",
    "errors": "hardware_error_status",
    "watchdog": "bus_watchdog",
    "tick": "realtime_tick",
    "slope": "pwm_slope",
    "marked": "profile_velocity",  # 0 after its supply was cut
    "shadow_id": "secondary_id",
    "drive_mode": "drive_mode",
    "shutdown": "shutdown",
    "startup": "startup_configuration",
    "low_voltage": "min_voltage_limit",
    "high_voltage": "max_voltage_limit",
}

_COMMON = (
    Register("model_number", 0, "uint16", "r"),
    Register("model_information", 2, "uint32", "r"),
    Register("firmware_version", 6, "uint8", "r"),
    Register("id", 7, shipped=1, low=0, high=252),
    Register("baud_rate", 8, shipped=1, low=0, high=7),
    Register("return_delay_time", 9, shipped=250, unit="s", scale=2e-6, low=0, high=254),
    Register("drive_mode", 10, shipped=0, low=0, high=13),
    Register("operating_mode", 11, shipped=3, low=0, high=PWM_MODE),
    Register("secondary_id", 12, shipped=255, low=0, high=255),
    Register("protocol_type", 13, shipped=2, low=1, high=22),
    Register("homing_offset", 20, "int32", shipped=0, unit="rad", scale=TURN_RAD, low=-_MOST_OFFSET, high=_MOST_OFFSET),
    Register("moving_threshold", 24, "uint32", shipped=10, unit="rad/s", scale=SPEED_RAD_S, low=0, high=1023),
    Register("temperature_limit", 31, unit="degC", low=0, high=100),
    Register("max_voltage_limit", 32, "uint16", unit="V", scale=0.1),
    Register("min_voltage_limit", 34, "uint16", unit="V", scale=0.1),
    Register("pwm_limit", 36, "uint16", shipped=FULL_PWM, unit="1", scale=DUTY, low=0, high=FULL_PWM),
    Register("velocity_limit", 44, "uint32", unit="rad/s", scale=SPEED_RAD_S, low=0, high=1023),
    Register("max_position_limit", 48, "uint32", shipped=_LAST, unit="rad", scale=TURN_RAD, low=0, high=_LAST),
    Register("min_position_limit", 52, "uint32", shipped=0, unit="rad", scale=TURN_RAD, low=0, high=_LAST),
    Register("shutdown", 63, shipped=52, low=0, high=63),
    Register("torque_enable", 64, shipped=0, low=0, high=1),
    Register("led", 65, shipped=0, low=0, high=1),
    Register("status_return_level", 68, shipped=2, low=0, high=2),
    Register("registered_instruction", 69, "uint8", "r", 0),
    Register("hardware_error_status", 70, "uint8", "r", 0),
    Register("velocity_i_gain", 76, "uint16", low=0, high=_MOST_GAIN),
    Register("velocity_p_gain", 78, "uint16", low=0, high=_MOST_GAIN),
    Register("position_d_gain", 80, "uint16", low=0, high=_MOST_GAIN),
    Register("position_i_gain", 82, "uint16", low=0, high=_MOST_GAIN),
    Register("position_p_gain", 84, "uint16", low=0, high=_MOST_GAIN),
    Register("feedforward_2nd_gain", 88, "uint16", shipped=0, low=0, high=_MOST_GAIN),
    Register("feedforward_1st_gain", 90, "uint16", shipped=0, low=0, high=_MOST_GAIN),
    Register("bus_watchdog", 98, "int8", shipped=0, unit="s", scale=0.02, low=0, high=127),
    Register("goal_pwm", 100, "int16", unit="1", scale=DUTY),
    Register("goal_velocity", 104, "int32", unit="rad/s", scale=SPEED_RAD_S),
    Register(
        "profile_acceleration", 108, "uint32", shipped=0, unit="rad/s2", scale=ACCELERATION_RAD_S2,
        low=0, high=_MOST_PROFILE,
    ),
    Register("profile_velocity", 112, "uint32", shipped=0, unit="rad/s", scale=SPEED_RAD_S, low=0, high=_MOST_PROFILE),
    Register("goal_position", 116, "int32", unit="rad", scale=TURN_RAD),
    Register("realtime_tick", 120, "uint16", "r", unit="s", scale=1e-3),
    Register("moving", 122, "uint8", "r", 0),
    Register("moving_status", 123, "uint8", "r", 0),
    Register("present_pwm", 124, "int16", "r", unit="1", scale=DUTY),
    Register("present_velocity", 128, "int32", "r", unit="rad/s", scale=SPEED_RAD_S),
    Register("present_position", 132, "int32", "r", unit="rad", scale=TURN_RAD),
    Register("velocity_trajectory", 136, "int32", "r", unit="rad/s", scale=SPEED_RAD_S),
    Register("position_trajectory", 140, "int32", "r", unit="rad", scale=TURN_RAD),
    Register("present_input_voltage", 144, "uint16", "r", unit="V", scale=0.1),
    Register("present_temperature", 146, "uint8", "r", unit="degC"),
)  # fmt: skip

STARTUP = Register("startup_configuration", 60, shipped=0, low=0, high=3)
BACKUP_READY = Register("backup_ready", 147, "uint8", "r")
LOAD = Register("present_load", 126, "int16", "r", unit="1", scale=1e-3)
EXTERNAL_PORTS = (
    *(Register(f"external_port_mode_{n}", 55 + n, shipped=3, low=0, high=3) for n in (1, 2, 3)),
    *(Register(f"external_port_data_{n}", 150 + 2 * n, "uint16") for n in (1, 2, 3)),
)


def with_current(scale_A: float) -> tuple[Register, ...]:
    """Registers of a servo that measures its current; ``scale_A``: of one step, A."""
    return (
        Register("current_limit", 38, "uint16", unit="A", scale=scale_A, low=0),
        Register("goal_current", 102, "int16", unit="A", scale=scale_A),
        Register("present_current", 126, "int16", "r", unit="A", scale=scale_A),
    )


@dataclass(frozen=True)
class Family:
    """What the servos of a family share.

    name      as its maker has it
    more      registers beside the common ones
    without   common registers that they have not
    supply_V  lowest and highest that the voltage limits can be set to, V
    bauds     by the value of their register
    shipped   values as they come, by name
    """

    name: str
    more: tuple[Register, ...]
    supply_V: tuple[float, float]
    without: frozenset[str] = frozenset()
    bauds: Mapping[int, int] = field(default_factory=lambda: BAUDS)
    shipped: Mapping[str, int] = field(default_factory=dict)

    def model(
        self, name: str, number: int, supply_V: tuple[float, float] | None = None, /, **shipped: int
    ) -> ServoModel:
        """One of them; ``shipped`` values go before those of the family."""
        supply_V = self.supply_V if supply_V is None else supply_V
        table = {r.name: r for r in (*_COMMON, *self.more) if r.name not in self.without}
        known = {**self.shipped, **shipped, "model_number": number}
        for register, value in known.items():
            table[register] = table[register]._replace(shipped=value)
        if "current_limit" in known:
            table["current_limit"] = table["current_limit"]._replace(high=known["current_limit"])
        low, high = (round(10.0 * volts) for volts in supply_V)
        for limit in ("min_voltage_limit", "max_voltage_limit"):
            table[limit] = table[limit]._replace(low=low, high=high)
        table["baud_rate"] = table["baud_rate"]._replace(high=max(self.bauds))
        registers = {r.name: r for r in sorted(table.values(), key=lambda r: r.address)}
        return ServoModel(
            name=name,
            family=self.name,
            number=number,
            protocol="dynamixel",
            registers=registers,
            roles={role: register for role, register in ROLES.items() if register in registers},
            eeprom_end=64,
            full_drive=FULL_PWM,
            pwm_mode=PWM_MODE,
            position_mode=POSITION_MODE,
            counts_per_turn=COUNTS,
            bauds=self.bauds,
            supply_V=supply_V,
        )
