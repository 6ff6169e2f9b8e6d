"""XL330 and XC330. The duty is ramped; the slope is theirs alone. Source: their pages of the e-Manual."""

from __future__ import annotations

from rig.backends.servo.models.control_table import BACKUP_READY, BAUDS_330, SPEED_RAD_S, STARTUP, Family, with_current
from rig.backends.servo.models.register import Register

_SLOPE_M = Register("pwm_slope", 62, shipped=140, unit="V/s", scale=1.977, low=1, high=255)
_SLOPE_T = Register("pwm_slope", 62, shipped=255, unit="V/s", scale=3.955, low=1, high=255)
_SAME = {"temperature_limit": 70, "position_i_gain": 0, "position_d_gain": 0}
_M = {"max_voltage_limit": 70, "min_voltage_limit": 35}
_T = {"max_voltage_limit": 140, "min_voltage_limit": 55, "current_limit": 910}
_FASTER = Register("velocity_limit", 44, "uint32", unit="rad/s", scale=SPEED_RAD_S, low=0, high=2047)
_MORE = (_FASTER, STARTUP, BACKUP_READY, *with_current(1e-3))

_XL330 = Family(
    "XL330",
    (*_MORE, _SLOPE_M),
    (3.1, 7.0),
    bauds=BAUDS_330,
    shipped={**_SAME, **_M, "shutdown": 53, "current_limit": 1750},
)
_XC330_M = Family("XC330", (*_MORE, _SLOPE_M), (3.1, 7.0), bauds=BAUDS_330, shipped={**_SAME, **_M})
_XC330_T = Family("XC330", (*_MORE, _SLOPE_T), (5.5, 14.0), bauds=BAUDS_330, shipped={**_SAME, **_T})

MODELS = (
    _XL330.model(
        "xl330-m077", 1190, velocity_limit=1620, velocity_i_gain=400, velocity_p_gain=40, position_i_gain=400,
        position_p_gain=400,
    ),
    _XL330.model(
        "xl330-m288", 1200, velocity_limit=445, velocity_i_gain=1600, velocity_p_gain=180, position_p_gain=400
    ),
    _XC330_T.model(
        "xc330-t181", 1210, velocity_limit=510, velocity_i_gain=1200, velocity_p_gain=40, position_p_gain=900
    ),
    _XC330_T.model(
        "xc330-t288", 1220, velocity_limit=320, velocity_i_gain=1200, velocity_p_gain=40, position_p_gain=900
    ),
    _XC330_M.model("xc330-m181", 1230),
    _XC330_M.model(
        "xc330-m288", 1240, current_limit=2352, velocity_limit=350, velocity_i_gain=1600, velocity_p_gain=50,
        position_d_gain=500, position_p_gain=1100,
    ),
)  # fmt: skip
