"""XM, XH and XD: 430 and 540. Sources: the e-Manual's pages of XM430-W350, XM540-W270 and XH430-V350.

Of the others no value as shipped was looked up. An XH430-V tells its current in finer steps.
"""

from __future__ import annotations

from rig.backends.servo.models.control_table import BACKUP_READY, EXTERNAL_PORTS, STARTUP, Family, with_current

_MORE = (STARTUP, BACKUP_READY)
_FINE, _COARSE = with_current(1.34e-3), with_current(2.69e-3)
_12, _24 = (9.5, 16.0), (11.0, 30.0)
_GAINS = {
    "velocity_i_gain": 1920, "velocity_p_gain": 100, "position_d_gain": 0, "position_i_gain": 0, "position_p_gain": 800,
    "temperature_limit": 80,
}  # fmt: skip
_XM430 = Family("XM430", (*_MORE, *_COARSE), _12)
_XM540 = Family("XM540", (*_MORE, *_COARSE, *EXTERNAL_PORTS), _12)
_XH430 = Family("XH430", (*_MORE, *_COARSE), _12)
_XH430_V = Family("XH430", (*_MORE, *_FINE), _24)
_XH540 = Family("XH540", (*_MORE, *_COARSE, *EXTERNAL_PORTS), _12)
_XD430 = Family("XD430", (*_MORE, *_COARSE), _12)
_XD540 = Family("XD540", (*_MORE, *_COARSE, *EXTERNAL_PORTS), _12)

MODELS = (
    _XM430.model("xm430-w350", 1020, **_GAINS, max_voltage_limit=160, min_voltage_limit=95, current_limit=1193),
    _XM430.model("xm430-w210", 1030),
    _XM540.model(
        "xm540-w270",
        1120,
        **_GAINS,
        max_voltage_limit=160,
        min_voltage_limit=95,
        current_limit=2047,
        velocity_limit=128,
    ),
    _XM540.model("xm540-w150", 1130),
    _XH430.model("xh430-w350", 1000),
    _XH430.model("xh430-w210", 1010),
    _XH430_V.model("xh430-v350", 1040, **_GAINS, max_voltage_limit=300, min_voltage_limit=110, current_limit=689),
    _XH430_V.model("xh430-v210", 1050),
    _XH540.model("xh540-w270", 1100),
    _XH540.model("xh540-w150", 1110),
    _XH540.model("xh540-v270", 1140, _24),
    _XH540.model("xh540-v150", 1150, _24),
    _XD430.model("xd430-t350", 1001),
    _XD430.model("xd430-t210", 1011),
    _XD540.model("xd540-t270", 1101),
    _XD540.model("xd540-t150", 1111),
)
