"""The strokes of the breakaway check on the compiled firmware, in virtual time: all are as planned without a late tick.

A drive rises within its stroke, and what is less than half a step of the device is 0 V at its pin.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import pytest
from evidence import evidence, examples
from hypothesis import example, given, settings
from hypothesis import strategies as st
from simulated_bench import ListSink

from emulated_chips.opening import emulated_chip, emulated_pico
from rig import config
from rig.backends.backend import Line
from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.serial import opening
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.config import Experiment
from rig.control.guard import Guard
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.core.faults import Fault
from rig.core.signals import FLAG_GUARD_CLIPPED, Limits, Sample
from rig.running.experiment.stages import breakaway_check
from rig.running.preflight.breakaway_strokes import breakaway_strokes, has_strokes
from rig.running.preflight.room_to_stop import guard_settings_of

CONFIG = Path(__file__).resolve().parents[2] / "config"
SENSORS = {"potentiometer": CONFIG / "demo-chip.yaml", "encoder": CONFIG / "encoder.yaml"}
Sensor = Literal["potentiometer", "encoder"]


def bench(
    speed_rad_s: float,
    period_s: float = 0.01,
    sensor: Sensor = "potentiometer",
    ramp_V_s: float = 0.4,
    port: str = "emulated-chip",
    **emulated: Any,
) -> Experiment:
    """A bench whose motor is as fast as its config says; a level is so low that a fast one has strokes, too."""
    e = config.load(SENSORS[sensor])
    assert e.emulated is not None and e.motor is not None
    max_V = min(1.2, 0.9 * 120.0 / speed_rad_s * 0.01 / period_s)
    friction_V = 0.4 * max_V
    motor = e.emulated.motor.model_copy(
        update={"K_rad_s_V": speed_rad_s / (e.drive.supply_V - friction_V), "bias_V": 0.0}
        | dict.fromkeys(("fc_plus_V", "fc_minus_V", "fs_plus_V", "fs_minus_V"), friction_V)
    )
    return e.model_copy(
        update={
            "period_s": period_s,
            "motor": e.motor.model_copy(update={"no_load_speed_rad_s": speed_rad_s}),
            "breakaway": e.breakaway.model_copy(update={"max_V": max_V, "ramp_V_s": ramp_V_s}),
            "emulated": e.emulated.model_copy(update={"motor": motor} | emulated),
            "daq": e.daq.model_copy(update={"port": port}),
        }
    )


def virtual_board(e: Experiment) -> VirtualBoard:
    assert e.emulated is not None
    parameters = bench_parameters(e.emulated)
    return VirtualBoard(parameters, e.seed, clock_error_ppm=e.emulated.clock_error_ppm, baud=e.daq.baud)


def driven(e: Experiment, device: Any) -> list[tuple[int, float]]:
    """Each stroke that the check asked for: its ticks, and its largest drive, V. Raises Fault, but for NO_MOTION."""
    driver = opening.driver(e.device, Line(device, device, "virtual", emulated=True))
    info = driver.open()
    record = ListSink()
    loop = Loop(driver, device, Guard(guard_settings_of(e)), record, e.period_s, StopRequest())
    limits = Limits(e.limits.soft_rad, e.limits.hard_rad, e.drive.max_V, e.daq.watchdog_s)
    try:
        with loop.armed(limits):
            loop.run(breakaway_check(e, info.drive_units), "breakaway")
    except Fault as fault:
        if fault.code != "NO_MOTION":
            raise
    finally:
        driver.close()
    return list(strokes(row["asked_V"] for row in record.rows))


class _Clipping(Guard):
    """Takes one drive of three, as near a limit."""

    def allow(self, sample: Sample, asked_V: float) -> tuple[float, int]:
        passed_V, flags = super().allow(sample, asked_V)
        return (0.0, FLAG_GUARD_CLIPPED) if sample.seq % 3 == 0 else (passed_V, flags)


def test_neither_the_guard_nor_a_lost_frame_lets_a_stroke_last_longer_in_the_device() -> None:
    """Each frame of a stroke is a pulse, and whichever of them comes first names the same end."""
    e = bench(21.0)
    device = virtual_board(e)
    driver = opening.driver(e.device, Line(device, device, "virtual", emulated=True))
    info = driver.open()
    ends_s: list[float] = []  # of each pulse; nan: none, the drive was to go on
    send_pulse, send = driver.write_pulse, driver.write

    def write_pulse(u_V: float, longest_s: float) -> None:
        ends_s.append(device.now_s() + longest_s)
        send_pulse(u_V, longest_s)

    def write(u_V: float) -> None:
        ends_s.append(math.nan)
        send(u_V)

    driver.write_pulse, driver.write = write_pulse, write  # type: ignore[method-assign]
    record = ListSink()
    loop = Loop(driver, device, _Clipping(guard_settings_of(e)), record, e.period_s, StopRequest())
    check = breakaway_check(e, info.drive_units)
    with pytest.raises(Fault, match=r"NO_MOTION|LINK_TIMEOUT"), loop.armed(e.device.arming):
        loop.run(check, "breakaway")
    driver.close()
    of_strokes = [list(ends) for is_none, ends in groupby(ends_s, math.isnan) if not is_none]
    assert len(of_strokes) > 4 and max(map(len, of_strokes)) > 3
    assert all(max(ends) - min(ends) < 0.5 * e.period_s for ends in of_strokes)


def strokes(asked_V: Iterator[float]) -> Iterator[tuple[int, float]]:
    for way, drives_V in groupby(asked_V, lambda u_V: (u_V > 0.0) - (u_V < 0.0)):
        if way:
            of_one = list(drives_V)
            yield len(of_one), max(map(abs, of_one))


def is_as_planned(e: Experiment, done: list[tuple[int, float]]) -> bool:
    """Whether each pair has two strokes of the planned length and one level."""
    plan = breakaway_strokes(e)
    assert plan is not None and len(done) >= 2
    lengths_s = (*plan.strokes_s, *plan.strokes_s[-1:] * plan.in_all)
    planned = [round(stroke_s / e.period_s) for stroke_s in lengths_s for _ in range(2)]
    levels = [level_V for _, level_V in done]
    return [ticks for ticks, _ in done] == planned[: len(done)] and levels[0:-1:2] == levels[1::2][
        : len(levels[0:-1:2])
    ]


@settings(max_examples=examples(50), deadline=None)
@given(
    speed_rad_s=st.floats(5.0, 300.0),
    period_s=st.sampled_from([0.005, 0.008, 0.01, 0.0125, 0.02]),
    sensor=st.sampled_from(["potentiometer", "encoder"]),
    ramp_V_s=st.sampled_from([0.1, 0.4, 1.0]),
    drive_counts=st.sampled_from([50, 100, 255, 400, 799, 6250]),
    clock_error_ppm=st.sampled_from([-5000.0, 0.0, 4000.0]),
)
@example(21.0, 0.01, "encoder", 0.4, 400, 4000.0)  # which ended in LATE
@example(5.0, 0.01, "encoder", 0.1, 100, 0.0)  # whole strokes of less than half a step
def test_every_stroke_is_as_planned_whatever_the_speed_and_the_steps_of_the_drive(
    speed_rad_s: float,
    period_s: float,
    sensor: Sensor,
    ramp_V_s: float,
    drive_counts: int,
    clock_error_ppm: float,
) -> None:
    e = bench(speed_rad_s, period_s, sensor, ramp_V_s, drive_counts=drive_counts, clock_error_ppm=clock_error_ppm)
    if not has_strokes(e, e.breakaway.max_V):
        return  # refused: no stroke is short enough
    assert is_as_planned(e, driven(e, virtual_board(e)))


@pytest.mark.long
@pytest.mark.parametrize(("sensor", "speed_rad_s"), [("potentiometer", 5.0), *evidence(("encoder", 21.0))])
def test_every_stroke_is_as_planned_on_the_unos_chip(sensor: Sensor, speed_rad_s: float) -> None:
    e = bench(speed_rad_s, sensor=sensor)
    assert is_as_planned(e, driven(e, emulated_chip(e.device)))


@pytest.mark.long
@pytest.mark.evidence
def test_every_stroke_is_as_planned_on_the_picos_chip() -> None:
    e = bench(21.0, sensor="encoder", ramp_V_s=0.1, port="emulated-pico")
    assert is_as_planned(e, driven(e, emulated_pico(e.device)))
