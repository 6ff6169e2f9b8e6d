"""The sweeps of a survey on the compiled firmware: host board, Uno and Pico, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from evidence import evidence
from pico_host import twelve_bits
from simulated_bench import DEMO, GUARD, LIMITS, PERIOD_S, RAD_PER_COUNT, SCALING, ListSink, break_away

from emulated_chips.pico_parameters import pico_parameters
from emulated_chips.virtual_chip import VirtualChip
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.control.guard import Guard, GuardSettings
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.sweep_plan import Room, sweep_plan
from rig.control.sweeps import CrudeMotor, SweepLoop, Sweeps
from rig.core.calibration import Calibration, DriveMap, Scaling

Device = VirtualBoard | VirtualChip | VirtualPico
PLAN = sweep_plan(Room(LIMITS.soft_rad, GUARD.max_speed_rad_s, 0.2, 8.0, 60.0), (0.6,))
LOOP = SweepLoop(PERIOD_S, 0.003, LIMITS.max_u_V, 0.11, RAD_PER_COUNT)
ON_PICO = Scaling(
    Calibration([(96, -488 * RAD_PER_COUNT), (4000, 488 * RAD_PER_COUNT)]), DriveMap(12.0), PICO_RAILS := (20, 4075)
)


@contextmanager
def bench(device: str) -> Iterator[tuple[Device, Scaling, GuardSettings]]:
    """A device with its scaling and its guard."""
    if device == "pico":
        pico = VirtualPico(pico_parameters(twelve_bits(DEMO)))
        try:
            yield pico, ON_PICO, replace(GUARD, rail_counts=PICO_RAILS)
        finally:
            pico.end()
    else:
        yield (VirtualBoard(DEMO, 1) if device == "host" else VirtualChip(DEMO, 1)), SCALING, GUARD


@pytest.mark.parametrize("device", ["host", *evidence("uno", "pico")])
def test_the_shaft_of_a_board_follows_the_sweeps_within_its_limits_and_rests(device: str) -> None:
    """The true shaft; the motor is known to 20 %."""
    true_rad: list[float] = []
    wanted_rad: list[float] = []
    with bench(device) as (board, scaling, guard):
        driver = SerialDriver(board, scaling, emulated=True)
        driver.open()
        loop = Loop(driver, board, Guard(guard), ListSink(), PERIOD_S, StopRequest())
        sweeps = Sweeps(CrudeMotor(0.2, 5.4, 0.54, 0.50), PLAN, LOOP)

        def watch(_: float) -> None:
            true_rad.append(board.truth().y_rad)
            wanted_rad.append(sweeps.yd_rad)

        with loop.armed(guard.limits):
            break_away(loop)
            loop.run(sweeps, "survey", watch)
        assert board.truth().pin_V == 0.0
    true, wanted = np.array(true_rad), np.array(wanted_rad)
    assert true.min() > LIMITS.soft_rad[0] and true.max() < LIMITS.soft_rad[1]
    assert true.max() - true.min() == pytest.approx(PLAN.high_rad - PLAN.low_rad, abs=0.05)
    assert float(np.sqrt(np.mean((true - wanted + DEMO.offset_rad) ** 2))) < 0.01
    assert abs(true[-1] - wanted[-1] + DEMO.offset_rad) < 0.01, "at rest where the sweeps end"
