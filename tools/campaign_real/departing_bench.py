"""The motor with departures as a bench that rig's own loop drives, in virtual time, with all its stages.

Only the device around the motor is rig's (``SimulatedDriver``): its watchdog, its travel limits, its drive in steps.
Motor and sensor are ``departing_motor``'s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from campaign_real.departing_motor import Bench, Departures, MovingShaft, PlainMotor
from rig.backends.clock import VirtualClock
from rig.backends.registry import Bench as OpenBench
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.campaign.random_motors import Draw
from rig.config import Experiment
from rig.config.load import load
from rig.model.bench import BenchParameters
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.running.preflight.breakaway_strokes import breakaway_strokes

CONFIG = Path(__file__).resolve().parents[2] / "config" / "quick.yaml"
REACH_RAD, FASTEST_RAD_S, LARGEST_V = 0.55, 4.9, 3.0  # room of every motor
HARD_RAD = 1.95  # as in the ready configs: the stops are farther
FAST = 1.05  # no-load speed of the data sheet over the motor's
BREAKAWAY_V: Sequence[float] = (1.2, 1.0, 0.9, 0.8, 0.75, 0.65, 0.6, 0.55, 0.5)  # the first with a bounded check
FORCE_MEMORY_S = 0.1  # of the random force


class DepartingShaft:
    """Motor, drive stage and potentiometer, as ``rig.model.bench.BenchModel`` is driven and read.

    furthest_rad   largest position, as an ideal sensor in its place would read it, that the shaft ever had
    ideal_rad      of each reading so far: what it would have been without noise and steps
    """

    def __init__(
        self,
        motor: PlainMotor,
        departures: Departures,
        bench: Bench,
        parameters: BenchParameters,
        drifts_over_s: float,
        seed: int,
    ) -> None:
        self.parameters = parameters
        self.pin_counts = 0.0
        self.furthest_rad = 0.0
        self.ideal_rad: list[float] = []
        self._shaft = MovingShaft(motor, departures, (0.0, drifts_over_s))
        self._bench, self._random_V = bench, departures.random_V
        self._rng = np.random.default_rng(seed)
        self._now_s = self._force_V = 0.0

    def arm(self) -> None:
        """Nothing begins with it."""

    def advance(self, dt_s: float) -> None:
        """Let ``dt_s`` pass with the drive at the pin unchanged."""
        if dt_s <= 0.0:
            return
        if self._random_V > 0.0:
            keep = math.exp(-dt_s / FORCE_MEMORY_S)
            self._force_V = (
                keep * self._force_V + math.sqrt(1.0 - keep**2) * self._random_V * self._rng.standard_normal()
            )
        u_V = self.pin_counts / self.parameters.drive_counts * self.parameters.supply_V
        self._shaft.advance(u_V, self._force_V, self._now_s, dt_s)
        self._now_s += dt_s
        self.furthest_rad = max(self.furthest_rad, abs(self._shaft.reading_rad + self._bench.offset_rad))

    @property
    def shaft_rad(self) -> float:
        """Where the motor is, rad."""
        return self._shaft.y_rad

    def read_counts(self) -> int:
        """Reading of the position's converter."""
        p = self.parameters
        ideal_rad = self._shaft.reading_rad + self._bench.offset_rad
        self.ideal_rad.append(ideal_rad)
        y_rad = ideal_rad + self._bench.noise_rad * self._rng.standard_normal()
        return min(max(round(p.centre_counts + y_rad / p.rad_per_count), 0), p.counts_max)

    def read_tachometer_rad_s(self) -> float:
        """There is none."""
        return math.nan


def config_of(one: Draw, bench: Bench) -> Experiment:
    """The simulated bench's config for this motor: its data sheet, the room, the breakaway strokes that are allowed."""
    e = load(CONFIG)
    assert e.motor is not None
    limits = e.limits.model_copy(
        update={
            "soft_rad": (-REACH_RAD, REACH_RAD),
            "hard_rad": (-HARD_RAD, HARD_RAD),
            "max_speed_rad_s": FASTEST_RAD_S,
            "coast_tau_s": one.tau_s,
        }
    )
    no_load = FAST * one.K_rad_s_V * e.drive.supply_V
    given = {
        "period_s": bench.period_s,
        "limits": limits,
        "tracking": None,
        "drive": e.drive.model_copy(update={"max_V": LARGEST_V}),
        "motor": e.motor.model_copy(update={"no_load_speed_rad_s": no_load}),
    }
    levels = (
        e.model_copy(update={**given, "breakaway": e.breakaway.model_copy(update={"max_V": V})}) for V in BREAKAWAY_V
    )
    return next((trial for trial in levels if breakaway_strokes(trial) is not None), e.model_copy(update=given))


def open_bench(
    e: Experiment, one: Draw, departures: Departures, bench: Bench, drifts_over_s: float, seed: int
) -> tuple[OpenBench, DepartingShaft]:
    """The bench, open, and the shaft behind it.

    drifts_over_s   how long the friction's drift takes from one end to the other
    """
    clock = VirtualClock()
    plain = Motor(one.tau_s, one.K_rad_s_V, coulomb(one.fc_V), one.asym_V)
    truth = BenchParameters(plain, noise_rad=bench.noise_rad, rad_per_count=bench.lsb_rad, offset_rad=bench.offset_rad)
    driver = SimulatedDriver(clock, truth, e.device.scaling, SimulatedLatency(bench.delay_s, 0.0), seed)
    motor = PlainMotor(one.tau_s, one.K_rad_s_V, one.fc_V, one.asym_V)
    shaft = DepartingShaft(motor, departures, bench, truth, drifts_over_s, seed)
    driver.bench = shaft  # type: ignore[assignment]  # the same calls, another motor
    return OpenBench(driver, clock, driver.open(), truth), shaft
