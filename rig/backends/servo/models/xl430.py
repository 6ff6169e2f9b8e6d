"""XL430 and XC430, alone and two in one housing: they tell a load where others tell a current.

Source: the XL430's page of the e-Manual; of the others no value as shipped was looked up.
"""

from __future__ import annotations

from rig.backends.servo.models.control_table import BACKUP_READY, LOAD, STARTUP, Family

_XL430 = Family("XL430", (STARTUP, BACKUP_READY, LOAD), (6.0, 14.0))
_XC430 = Family("XC430", (STARTUP, BACKUP_READY, LOAD), (6.0, 16.0))

MODELS = (
    _XL430.model(
        "xl430-w250", 1060, temperature_limit=72, max_voltage_limit=140, min_voltage_limit=60, velocity_limit=265,
        velocity_i_gain=1000, velocity_p_gain=100, position_d_gain=4000, position_i_gain=0, position_p_gain=640,
    ),
    _XL430.model("2xl430-w250", 1090),
    _XC430.model("xc430-w150", 1070),
    _XC430.model("xc430-w240", 1080),
    _XC430.model("2xc430-w250", 1160),
)  # fmt: skip
