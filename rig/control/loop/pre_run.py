"""Pre-run simulation: a tracking run or a survey on the best model, before it drives the bench."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from rig.backends.clock import VirtualClock
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.control.guard import Guard, GuardSettings
from rig.control.law import Law
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.core.calibration import ALL_COUNTS, Calibration, DriveMap, Scaling
from rig.core.faults import Fault
from rig.core.signals import Order
from rig.model.bench import BenchParameters
from rig.model.real_motor import FramedMotor
from rig.run_folder.recording.sink import NullSink


@dataclass(frozen=True)
class PreRunBench:
    """What rig knows of the bench: the best model, the shaft's position, noise, delay, the order of a tick."""

    motor: FramedMotor
    start_rad: float
    noise_rad: float
    latency_s: float
    calibration: Calibration
    drive_map: DriveMap
    rail_counts: tuple[int, int]
    period_s: float
    order: Order = "sample_first"
    further_delay_s: float = 0.0


class Rehearsed(Law, Protocol):
    """A law that knows the largest drive that it has asked for, V."""

    largest_u_V: float


def pre_run(law: Rehearsed, bench: PreRunBench, guard: GuardSettings) -> str | None:
    """Run ``law`` on a simulated bench. Returns why it must not drive the real bench; None if it may.

    It must not if it leaves the soft limits, asks for more than the largest drive, or ends with a fault.
    """
    clock = VirtualClock()
    calibration = bench.calibration
    parameters = BenchParameters(
        motor=bench.motor.plain,
        real=bench.motor.motor._replace(delay_s=0.0),
        frame=bench.motor.frame,
        start_rad=bench.start_rad,
        stop_rad=(-1e6, 1e6),
        rad_per_count=calibration.lsb_rad * calibration.direction,
        centre_counts=calibration.to_counts(0.0),
        counts_max=65535,
        encoder=bench.rail_counts == ALL_COUNTS,
        noise_rad=bench.noise_rad,
        supply_V=bench.drive_map.full_V,
        drive_counts=bench.drive_map.full_units,
        drive_delay_s=bench.further_delay_s,
    )
    plain = DriveMap(bench.drive_map.full_V, full_units=bench.drive_map.full_units)
    driver = SimulatedDriver(
        clock,
        parameters,
        Scaling(calibration, plain, bench.rail_counts),
        SimulatedLatency(bench.latency_s, 0.0),
        seed=0,
        order=bench.order,
    )
    simulated_guard = Guard(guard)
    simulated_guard.sign_proven = True
    loop = Loop(driver, clock, simulated_guard, NullSink(), bench.period_s, StopRequest())
    loop.expect_delay(bench.latency_s)
    low, high = guard.limits.soft_rad
    reached = [bench.start_rad, bench.start_rad]

    def watch(t_s: float) -> None:
        y = driver.bench.state.y
        reached[0], reached[1] = min(reached[0], y), max(reached[1], y)

    try:
        with loop.armed(guard.limits):
            loop.run(law, "pre-run", watch)
    except Fault as fault:
        return f"in simulation on the best model: {fault}"
    if reached[0] < low or reached[1] > high:
        return (
            f"in simulation on the best model it goes from {reached[0]:.2f} to {reached[1]:.2f} rad, "
            f"beyond the soft limits {low:.2f} to {high:.2f} rad"
        )
    if law.largest_u_V > guard.limits.max_u_V:
        return (
            f"in simulation on the best model it asks for {law.largest_u_V:.2f} V, "
            f"more than drive.max_V {guard.limits.max_u_V:.2f} V"
        )
    return None
