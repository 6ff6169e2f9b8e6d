"""The emulated device's options: a bench's parameters by the names of firmware/boards/host/bench.h."""

from __future__ import annotations

from rig.core.motor_numbers import NUMBERS, of_every_bench
from rig.model.bench import BenchParameters


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
        "tau-s": bench.motor.tau_s,
        "K-rad-s-V": bench.motor.K_rad_s_V,
        "fc-plus-V": friction.plus_V,
        "fc-minus-V": friction.minus_V,
        "fs-plus-V": friction.static_plus_V,
        "fs-minus-V": friction.static_minus_V,
        "stribeck-rad-s": friction.stribeck_rad_s,
        "viscous-V-s-rad": friction.viscous_V_s_rad,
        "bias-V": bench.motor.bias_V,
        "start-rad": bench.start_rad,
        "stop-low-rad": bench.stop_rad[0],
        "stop-high-rad": bench.stop_rad[1],
        "rad-per-count": bench.rad_per_count,
        "centre-counts": bench.centre_counts,
        "counts-max": bench.counts_max,
        "noise-rad": bench.noise_rad,
        "offset-rad": bench.offset_rad,
        "supply-V": bench.supply_V,
        "drive-counts": bench.drive_counts,
        "bridge-drop-V": bench.bridge_drop_V,
        "dead-band-plus": bench.dead_band_plus,
        "dead-band-minus": bench.dead_band_minus,
        "coasting": int(bench.coasting),
        "reversed": int(bench.reversed),
        "tachometer-rad-s-per-count": bench.tachometer_rad_s_per_count or 0.0,
        "tachometer-zero-counts": bench.tachometer_zero_counts,
        "gear-ratio": bench.gear_ratio,
        "fault-after-s": bench.fault_after_s,
        "clock-error-ppm": clock_error_ppm,
        "clock-start-us": clock_start_us,
        "seed": seed,
    }
    if bench.encoder:
        low_rad, high_rad = bench.end_rad or (0.0, 0.0)
        numbers |= {"encoder": 1, "centre-counts": 0.0, "estop-open-s": bench.estop_open_s}
        numbers |= {"end-low-rad": low_rad, "end-high-rad": high_rad}
    if bench.real is not None:
        numbers |= {"parts": 1, "drift-over-s": bench.frame.duration_s}
        numbers |= {name: getattr(bench.real, name) for name in NUMBERS if not of_every_bench(name)}
        numbers |= {name.replace("_", "-"): getattr(bench.frame, name) for name in ("centre_rad", "half_travel_rad")}
    options = {name: repr(value) for name, value in numbers.items()}
    return {**options, "drive": bench.drive, "sensor": bench.sensor}
