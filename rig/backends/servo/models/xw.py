"""XW, against water: no light. Sources: the e-Manual's pages of XW430-T200 and XW540-T260.

Of the others no value as shipped was looked up. dynamixel-sdk has the XW430-T200's table, and not its number.
"""

from __future__ import annotations

from rig.backends.servo.models.control_table import BACKUP_READY, STARTUP, Family, with_current

_MORE = (STARTUP, BACKUP_READY, *with_current(2.69e-3))
_XW430 = Family("XW430", _MORE, (9.5, 16.0), without=frozenset({"led"}))
_XW540 = Family("XW540", _MORE, (9.5, 16.0), without=frozenset({"led"}))

MODELS = (
    _XW430.model(
        "xw430-t200", 1280, temperature_limit=80, max_voltage_limit=160, min_voltage_limit=95, current_limit=2047,
        velocity_limit=235, velocity_i_gain=1920, velocity_p_gain=100, position_d_gain=0, position_i_gain=0,
        position_p_gain=900,
    ),
    _XW430.model("xw430-t333", 1270),
    _XW540.model(
        "xw540-t260", 1170, temperature_limit=80, max_voltage_limit=160, min_voltage_limit=95, current_limit=2047,
        velocity_limit=167, velocity_i_gain=1920, velocity_p_gain=100, position_d_gain=0, position_i_gain=0,
        position_p_gain=800,
    ),
    _XW540.model("xw540-t140", 1180),
    _XW540.model("xw540-h260", 1310, (11.0, 30.0)),
)  # fmt: skip
