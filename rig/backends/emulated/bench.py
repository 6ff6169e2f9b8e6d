"""The bench of a config's section ``emulated``, as parameters of the model."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rig.model.bench import BenchParameters
from rig.model.friction import Friction
from rig.model.motor import Motor
from rig.model.real_motor import Frame, RealMotor, plain

if TYPE_CHECKING:  # the process of an emulated device starts without the config
    from rig.config.schema import Emulated, EmulatedParts, Tachometer


def bench_parameters(emulated: Emulated, tachometer: Tachometer | None = None) -> BenchParameters:
    """The parameters. Keys that the section leaves out have the model's defaults; a whole config leaves out none."""
    m, w, dead_band = emulated.motor, emulated.wiring, emulated.dead_band_duty
    believed: dict[str, Any] = {
        "rad_per_count": emulated.potentiometer.rad_per_count,
        "centre_counts": emulated.potentiometer.centre_counts,
        "counts_max": emulated.potentiometer.counts_max,
        "supply_V": emulated.supply_V,
        "bridge_drop_V": emulated.bridge_drop_V,
        "reversed": emulated.reversed,
    }
    friction = Friction(
        m.fc_plus_V,
        m.fc_minus_V,
        m.fc_plus_V if m.fs_plus_V is None else m.fs_plus_V,
        m.fc_minus_V if m.fs_minus_V is None else m.fs_minus_V,
        m.stribeck_rad_s,
        m.viscous_V_s_rad,
    )
    motor = Motor(m.tau_s, m.K_rad_s_V, friction, m.bias_V)
    parameters = BenchParameters(
        motor=motor,
        start_rad=m.start_rad,
        stop_rad=m.stop_rad,
        noise_rad=emulated.potentiometer.noise_rad,
        offset_rad=emulated.potentiometer.offset_rad,
        dead_band_plus=0.0 if dead_band is None else dead_band.plus,
        dead_band_minus=0.0 if dead_band is None else dead_band.minus,
        drive_counts=emulated.drive_counts,
        drive=w.drive,
        sensor=w.sensor,
        fault_after_s=w.fault_after_s,
        **_with_parts(motor, m.parts),
    )
    if emulated.tachometer and tachometer is not None:
        believed |= {
            "tachometer_rad_s_per_count": tachometer.rad_s_per_count,
            "tachometer_zero_counts": tachometer.zero_counts,
            "gear_ratio": tachometer.gear_ratio,
        }
    return replace(parameters, **{name: value for name, value in believed.items() if value is not None})


def _with_parts(motor: Motor, parts: EmulatedParts | None) -> dict[str, Any]:
    """The motor with its parts, and what they refer to, as fields of ``BenchParameters``; none without parts."""
    if parts is None:
        return {}
    numbers = {name: value for name, value in parts.model_dump().items() if name in RealMotor._fields}
    frame = Frame(parts.centre_rad, parts.half_travel_rad, 0.0, parts.drift_over_s)
    return {"real": plain(motor)._replace(**numbers), "frame": frame}
