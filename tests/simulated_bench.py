"""A simulated bench for tests of laws, guard and loop: the demo's motor unless told otherwise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from rig.backends.clock import VirtualClock
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.control.breakaway import BreakawayCheck, StrokePlan
from rig.control.guard import Guard, GuardSettings
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.core.calibration import Calibration, DriveMap, Scaling
from rig.core.signals import Limits
from rig.model.bench import BenchParameters
from rig.model.friction import Friction
from rig.model.motor import Motor
from rig.run_folder.recording.sink import NullSink, Row

PERIOD_S = 0.01
LIMITS = Limits(soft_rad=(-1.1, 1.1), hard_rad=(-1.9, 1.9), max_u_V=3.0, watchdog_s=0.1)
RAD_PER_COUNT = 4.2 / 1024
CALIBRATION = Calibration([(24, -488 * RAD_PER_COUNT), (1000, 488 * RAD_PER_COUNT)])
RAILS = (5, 1018)
SCALING = Scaling(CALIBRATION, DriveMap(12.0), RAILS)
DEMO_MOTOR = Motor(0.17, 6.5, Friction(0.50, 0.46, 0.54, 0.50), 0.01)
DEMO = BenchParameters(motor=DEMO_MOTOR, noise_rad=0.003, offset_rad=0.02)
GUARD = GuardSettings(
    limits=LIMITS,
    rail_counts=RAILS,
    max_speed_rad_s=6.0,
    coast_tau_s=0.2,
    reaction_s=0.13,
    noise_rad=RAD_PER_COUNT,
    motion_rad=0.02,
)


PROMPT = SimulatedLatency(0.0012, 0.0003)


class ListSink(NullSink):
    """Keeps rows and events in memory, completed as the recorder would."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []

    def sample(self, *row: *Row) -> None:
        tick, sample, stage, z_rad_s, _, u_V, late_us, io_us, flags = row
        self.rows.append(
            {"tick": tick, "t_s": sample.t_s, "y_rad": sample.y_rad, "stage": stage, "u_V": u_V, "asked_V": u_V,
             "t_u_s": None, "late_us": late_us, "io_us": io_us, "flags": flags, "z_rad_s": z_rad_s}
        )  # fmt: skip

    def complete(self, t_u_s: float, u_V: float, flags: int = 0) -> None:
        row = self.rows[-1]
        row["t_u_s"], row["u_V"], row["flags"] = t_u_s, u_V, row["flags"] | flags

    def event(self, t_s: float, kind: str, **fields: object) -> None:
        self.events.append({"t_s": t_s, "kind": kind, **fields})


@dataclass
class BenchModel:
    """Driver, guard and loop on one bench in virtual time."""

    driver: SimulatedDriver
    clock: VirtualClock
    guard: Guard
    loop: Loop
    record: ListSink
    stop: StopRequest


def simulated_bench(
    parameters: BenchParameters = DEMO,
    seed: int = 1,
    guard: GuardSettings = GUARD,
    latency: SimulatedLatency = PROMPT,
    **changes: Any,
) -> BenchModel:
    """A bench with ``changes`` made to its parameters."""
    clock = VirtualClock()
    driver = SimulatedDriver(clock, replace(parameters, **changes), SCALING, latency, seed)
    watching, record, stop = Guard(guard), ListSink(), StopRequest()
    loop = Loop(driver, clock, watching, record, PERIOD_S, stop)
    return BenchModel(driver, clock, watching, loop, record, stop)


def breakaway_check() -> BreakawayCheck:
    """The check as config/demo.yaml has it."""
    return BreakawayCheck(
        max_V=1.2,
        motion_rad=0.02,
        rest_s=0.4,
        plan=StrokePlan((*(0.03,) * 16, 0.02, 0.02, 0.01), 0.13, 0.13, 0.064, 0.04, unseen_rad=math.inf),
        period_s=PERIOD_S,
    )


def break_away(loop: Loop) -> BreakawayCheck:
    """The breakaway check inside ``armed``; the guard knows of it then, as in a run."""
    # longer strokes than the bound on unseen travel allows: for motors stiffer than the demo's, too
    check = BreakawayCheck(1.2, 0.02, 0.4, StrokePlan((0.04,), 0.12, 0.12, 0.064, 0.04, unseen_rad=math.inf), PERIOD_S)
    loop.run(check, "breakaway")
    loop.guard.sign_proven = True
    loop.guard.static_V = max(check.plus_V, check.minus_V)
    return check
