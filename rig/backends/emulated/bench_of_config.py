"""The bench of a config's section ``emulated``, as parameters of the model."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from rig.model.bench import BenchParameters
from rig.model.friction import Friction
from rig.model.motor import Motor
from rig.model.real_motor import Frame, RealMotor, plain

if TYPE_CHECKING:  # the process of an emulated device starts without the config
    from rig.config.schema import Emulated, EmulatedMotor, EmulatedParts, Tachometer

Value = TypeVar("Value")
_MODEL = BenchParameters  # its class attributes are its defaults


def bench_parameters(emulated: Emulated, tachometer: Tachometer | None = None) -> BenchParameters:
    """The parameters. Keys that the section leaves out have the model's defaults; a whole config leaves out none."""
    m, pot, wiring = emulated.motor, emulated.potentiometer, emulated.wiring
    dead_band = emulated.dead_band_duty
    channel = tachometer if emulated.tachometer else None
    motor, parts = Motor(m.tau_s, m.K_rad_s_V, _friction(m), m.bias_V), m.parts
    return BenchParameters(
        motor=motor,
        start_rad=m.start_rad,
        stop_rad=m.stop_rad,
        rad_per_count=_given(pot.rad_per_count, _MODEL.rad_per_count),
        centre_counts=_given(pot.centre_counts, _MODEL.centre_counts),
        counts_max=_given(pot.counts_max, _MODEL.counts_max),
        noise_rad=pot.noise_rad,
        offset_rad=pot.offset_rad,
        encoder=emulated.encoder is not None,
        end_rad=None if emulated.encoder is None else emulated.encoder.end_rad,
        estop_open_s=0.0 if emulated.encoder is None else emulated.encoder.estop_open_s,
        supply_V=_given(emulated.supply_V, _MODEL.supply_V),
        drive_counts=emulated.drive_counts,
        bridge_drop_V=_given(emulated.bridge_drop_V, _MODEL.bridge_drop_V),
        dead_band_plus=_MODEL.dead_band_plus if dead_band is None else dead_band.plus,
        dead_band_minus=_MODEL.dead_band_minus if dead_band is None else dead_band.minus,
        coasting=_given(emulated.coasting, _MODEL.coasting),
        reversed=_given(emulated.reversed, _MODEL.reversed),
        tachometer_rad_s_per_count=None if channel is None else channel.rad_s_per_count,
        tachometer_zero_counts=_MODEL.tachometer_zero_counts if channel is None else channel.zero_counts,
        gear_ratio=_MODEL.gear_ratio if channel is None else channel.gear_ratio,
        drive=wiring.drive,
        sensor=wiring.sensor,
        drive_delay_s=_given(m.delay_s, _MODEL.drive_delay_s),
        fault_after_s=wiring.fault_after_s,
        real=None if parts is None else _with_parts(motor, parts),
        frame=_MODEL.frame
        if parts is None
        else Frame(parts.centre_rad, parts.half_travel_rad, 0.0, parts.drift_over_s),
    )


def _with_parts(motor: Motor, parts: EmulatedParts) -> RealMotor:
    names = [name for name in RealMotor._fields if name in type(parts).model_fields]
    return plain(motor)._replace(**{name: getattr(parts, name) for name in names})


def _friction(m: EmulatedMotor) -> Friction:
    """Static friction is as moving friction where the section does not give it."""
    return Friction(
        m.fc_plus_V,
        m.fc_minus_V,
        _given(m.fs_plus_V, m.fc_plus_V),
        _given(m.fs_minus_V, m.fc_minus_V),
        m.stribeck_rad_s,
        m.viscous_V_s_rad,
    )


def _given(value: Value | None, default: Value) -> Value:
    return default if value is None else value
