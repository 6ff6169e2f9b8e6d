"""The emulated device's options: a bench's parameters by the names of firmware/boards/host/bench.h."""

from __future__ import annotations

from rig.core.motor_numbers import NUMBERS, of_every_bench
from rig.model.bench import BenchParameters

_SAME = (  # names of both; True is 1
    "start_rad", "rad_per_count", "centre_counts", "counts_max", "noise_rad", "offset_rad", "supply_V", "drive_counts",
    "bridge_drop_V", "dead_band_plus", "dead_band_minus", "coasting", "reversed", "tachometer_zero_counts",
    "gear_ratio", "fault_after_s",
)  # fmt: skip


def device_options(
    bench: BenchParameters, seed: int, clock_error_ppm: float = 0.0, clock_start_us: int = 0
) -> dict[str, str]:
    """Option names and values, numbers written so that they are read back exactly.

    seed             of the noise, 0 to 2**32 - 1
    clock_error_ppm  of the device's clock; positive: it runs fast
    clock_start_us   reading of the device's clock at a reset, 0 to 2**32 - 1
    """
    friction = bench.motor.friction
    numbers: dict[str, float | int] = {
        "tau_s": bench.motor.tau_s,
        "K_rad_s_V": bench.motor.K_rad_s_V,
        "fc_plus_V": friction.plus_V,
        "fc_minus_V": friction.minus_V,
        "fs_plus_V": friction.static_plus_V,
        "fs_minus_V": friction.static_minus_V,
        "stribeck_rad_s": friction.stribeck_rad_s,
        "viscous_V_s_rad": friction.viscous_V_s_rad,
        "bias_V": bench.motor.bias_V,
        "stop_low_rad": bench.stop_rad[0],
        "stop_high_rad": bench.stop_rad[1],
        "tachometer_rad_s_per_count": bench.tachometer_rad_s_per_count or 0.0,
        "clock_error_ppm": clock_error_ppm,
        "clock_start_us": clock_start_us,
        "seed": seed,
    }
    numbers |= {name: +getattr(bench, name) for name in _SAME}
    if bench.encoder:
        low_rad, high_rad = bench.end_rad or (0.0, 0.0)
        numbers |= {"encoder": 1, "centre_counts": 0.0, "estop_open_s": bench.estop_open_s}
        numbers |= {"end_low_rad": low_rad, "end_high_rad": high_rad}
    if bench.real is not None:
        numbers |= {"parts": 1, "drift_over_s": bench.frame.duration_s}
        numbers |= {name: getattr(bench.frame, name) for name in ("centre_rad", "half_travel_rad")}
    options = {name.replace("_", "-"): repr(value) for name, value in numbers.items()}
    if bench.real is not None:
        options |= {name: repr(getattr(bench.real, name)) for name in NUMBERS if not of_every_bench(name)}
    return {**options, "drive": bench.drive, "sensor": bench.sensor}
