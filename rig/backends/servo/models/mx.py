"""MX with protocol 2. Source: the MX-64's page of the e-Manual; of the others no value as shipped was looked up."""

from __future__ import annotations

from rig.backends.servo.models.control_table import LOAD, Family, with_current
from rig.backends.servo.models.register import Register

_ACCELERATION = Register("acceleration_limit", 40, "uint32", shipped=32767, low=0, high=32767)
_MX28 = Family("MX", (LOAD, _ACCELERATION), (9.5, 16.0))
_MX = Family("MX", (*with_current(3.36e-3), _ACCELERATION), (9.5, 16.0))

MODELS = (
    _MX28.model("mx-28", 30),
    _MX.model(
        "mx-64", 311, temperature_limit=80, max_voltage_limit=160, min_voltage_limit=95, current_limit=1941,
        velocity_i_gain=1920, velocity_p_gain=100, position_d_gain=0, position_i_gain=0, position_p_gain=850,
    ),
    _MX.model("mx-106", 321),
)  # fmt: skip
