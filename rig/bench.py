"""From the config to a bench that can be driven: driver, clock, guard settings, and what is known of the truth."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rig.config.preflight import CHIP_PORTS, reaction_periods
from rig.config.schema import Experiment
from rig.control.guard import GuardSettings
from rig.daq import registry
from rig.daq.calibration import Calibration, DriveMap, TachometerScale
from rig.daq.driver import Clock, DeviceInfo, Driver, Transport
from rig.daq.serial_link import PySerialTransport, SerialDriver
from rig.daq.simulated import SimulatedDriver, SimulatedLatency
from rig.emulate.chip_board import ChipBoard
from rig.emulate.host_board import HostBoard
from rig.emulate.virtual_chip import VirtualChip
from rig.faults import Fault
from rig.loop.clock import MonotonicClock, VirtualClock
from rig.model.bench import BenchParameters
from rig.signals import Limits


@dataclass(frozen=True)
class Bench:
    """An open bench.

    driver, clock  what the loop runs on
    info           what the device said of itself
    truth          the motor behind an emulated bench; None behind a real one
    """

    driver: Driver
    clock: Clock
    info: DeviceInfo
    truth: BenchParameters | None


def calibration_of(experiment: Experiment) -> Calibration:
    """Counts to rad, as the config gives it."""
    return Calibration((p.counts, p.rad) for p in experiment.sensor.calibration)


def drive_map_of(experiment: Experiment) -> DriveMap:
    """V to drive units, as the config gives it."""
    d = experiment.drive
    return DriveMap(d.supply_V, d.bridge_drop_V, d.dead_band_duty.plus, d.dead_band_duty.minus, d.reversed)


def limits_of(experiment: Experiment) -> Limits:
    """What the device is armed with."""
    t = experiment.limits
    return Limits(t.soft_rad, t.hard_rad, experiment.drive.max_V, experiment.daq.watchdog_s)


def guard_settings_of(experiment: Experiment, noise_rad: float | None = None) -> GuardSettings:
    """The guard's knowledge; ``noise_rad`` once it was measured, before that two LSB are assumed."""
    lsb_rad = calibration_of(experiment).lsb_rad
    t = experiment.limits
    loop_s = reaction_periods(experiment) * experiment.period_s
    return GuardSettings(
        limits=limits_of(experiment),
        rail_counts=experiment.sensor.rail_counts,
        max_speed_rad_s=t.max_speed_rad_s,
        coast_tau_s=t.coast_tau_s,
        # as in `rig check`: the loop's own reaction, one reply that never comes, then the device's watchdog
        reaction_s=loop_s + experiment.daq.timeout_s + experiment.daq.watchdog_s,
        noise_rad=2.0 * lsb_rad if noise_rad is None else max(noise_rad, lsb_rad),
        motion_rad=experiment.breakaway.motion_rad,
    )


def truth_of(experiment: Experiment) -> BenchParameters | None:
    """The bench described under ``emulated``, or None."""
    if experiment.emulated is None:
        return None
    tachometer = None if experiment.tachometer is None else experiment.tachometer.model_dump()
    return BenchParameters.from_mapping(experiment.emulated.model_dump(), tachometer)


@contextmanager
def connect(experiment: Experiment) -> Iterator[Bench]:
    """Open the bench for the block; on leaving it is stopped and closed.

    Raises Fault LINK_* where there is no such device, NO_WATCHDOG where it has none and the config forbids that.
    Nothing is ever simulated in place of a missing device.
    """
    truth = truth_of(experiment)
    daq = experiment.daq
    if daq.driver == "simulated":
        if truth is None or experiment.emulated is None:
            raise ValueError("a simulated driver needs the section `emulated`")
        clock = VirtualClock()
        latency = SimulatedLatency(experiment.emulated.latency_s, experiment.emulated.latency_jitter_s)
        driver = SimulatedDriver(
            clock,
            truth,
            calibration_of(experiment),
            drive_map_of(experiment),
            experiment.sensor.rail_counts,
            latency,
            experiment.seed,
        )
        yield from _opened(driver, clock, truth, daq.accept_no_watchdog)
    elif daq.driver == "serial":
        if daq.port == "emulated":
            if truth is None:
                raise ValueError("port `emulated` needs the section `emulated`")
            with emulated_board(experiment) as port:
                yield from _serial(experiment, port, truth)
        elif daq.port == "emulated-chip-realtime":
            if truth is None:
                raise ValueError("port `emulated-chip-realtime` needs the section `emulated`")
            with emulated_board(experiment) as port:
                yield from _serial(experiment, port, truth, emulated=True)
        elif daq.port == "emulated-chip":
            if truth is None:
                raise ValueError("port `emulated-chip` needs the section `emulated`")
            chip = emulated_chip(experiment)
            yield from _opened(_driver(experiment, chip, daq.port, emulated=True), chip, truth, daq.accept_no_watchdog)
        elif daq.port is not None:
            yield from _serial(experiment, daq.port, truth)
        else:
            raise ValueError("daq.port is missing")
    else:
        raise ValueError(f"no driver {daq.driver!r}; installed: {', '.join(registry.registered()) or 'none'}")


@contextmanager
def emulated_board(
    experiment: Experiment, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
) -> Iterator[str]:
    """The emulated serial device of the config, running for the block; yields the path of its port.

    chip  the Uno's firmware on its emulated chip, as where the config's port asks for that; else the firmware's core
          on this machine
    Raises EmulationError where it cannot be built or started.
    """
    if experiment.emulated is None:
        raise ValueError("the config has no section `emulated`")
    tachometer = None if experiment.tachometer is None else experiment.tachometer.model_dump()
    emulated, seed = experiment.emulated.model_dump(), experiment.seed
    if chip or experiment.daq.port in CHIP_PORTS:
        with ChipBoard() as uno:
            yield uno.start(emulated, seed, link, trace, tachometer, experiment.daq.baud)
    else:
        with HostBoard() as board:
            yield board.start(emulated, seed, link, trace, tachometer)


def emulated_chip(experiment: Experiment) -> VirtualChip:
    """The Uno's emulated chip with the config's bench behind it: port and clock in one, in virtual time.

    Raises EmulationError where it cannot be built.
    """
    if experiment.emulated is None:
        raise ValueError("the config has no section `emulated`")
    tachometer = None if experiment.tachometer is None else experiment.tachometer.model_dump()
    return VirtualChip.from_mapping(
        experiment.emulated.model_dump(), experiment.seed, tachometer, baud=experiment.daq.baud
    )


def _serial(
    experiment: Experiment, port: str, truth: BenchParameters | None, *, emulated: bool = False
) -> Iterator[Bench]:
    transport = PySerialTransport(port, experiment.daq.baud)
    driver = _driver(experiment, transport, f"serial:{port}", emulated=emulated)
    yield from _opened(driver, MonotonicClock(), truth, experiment.daq.accept_no_watchdog)


def _driver(experiment: Experiment, transport: Transport, name: str, *, emulated: bool = False) -> SerialDriver:
    t = experiment.tachometer
    return SerialDriver(
        transport,
        calibration_of(experiment),
        drive_map_of(experiment),
        experiment.sensor.rail_counts,
        experiment.daq.timeout_s,
        experiment.daq.open_timeout_s,
        None if t is None else TachometerScale(t.rad_s_per_count, t.zero_counts, t.gear_ratio),
        counts_max=experiment.sensor.counts_max,
        name=name,
        emulated=emulated,
    )


def _opened(driver: Driver, clock: Clock, truth: BenchParameters | None, accept_no_watchdog: bool) -> Iterator[Bench]:
    try:
        info = driver.open()
        if driver.failsafe is None and not accept_no_watchdog:
            raise Fault("NO_WATCHDOG")
        # only a device that says that it is emulated has a truth to compare with
        yield Bench(driver, clock, info, truth if info.emulated else None)
    finally:
        driver.safe_stop()
        driver.close()
