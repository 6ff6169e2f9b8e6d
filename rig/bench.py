"""From the config to a bench that can be driven: driver, clock, guard settings, and what is known of the truth."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import urlsplit

from rig.backends import registry
from rig.backends.backend import CHIP_PORTS, adapter_of
from rig.backends.clock import MonotonicClock, VirtualClock
from rig.backends.driver import Clock, DeviceInfo, Driver, DriverSettings, RelayDriver, Transport
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.link_budget import bits_per_byte, silence_s
from rig.backends.links.serial_port import SerialPort
from rig.backends.links.tcp_link import TcpTransport
from rig.backends.modbus.emulated.modbus_board import ModbusBoard
from rig.backends.modbus.section import EMULATED_PORTS as MODBUS_EMULATED_PORTS
from rig.backends.modbus.section import is_tcp, tcp_address
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.behind_usb import BehindUsb
from rig.backends.serial.emulated.chip_board import ChipBoard
from rig.backends.serial.emulated.host_board import HostBoard
from rig.backends.serial.emulated.usb_board import UsbBoard
from rig.backends.serial.emulated.virtual_chip import VirtualChip
from rig.backends.serial.flashing import flash_line
from rig.backends.serial.usb_port import check_adapter
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.calibration import Calibration, DriveMap, TachometerScale, polarity
from rig.config.problems import ConfigError, Problem
from rig.config.schema import Experiment
from rig.control.guard import GuardSettings
from rig.faults import Fault
from rig.loop.real_time import RealTimeSettings
from rig.model.bench import BenchParameters
from rig.preflight.room_to_stop import known_reaction_s
from rig.preflight.rules import Preflight, unknown_driver
from rig.signals import Limits

if TYPE_CHECKING:  # pymodbus loads slowly
    from rig.backends.modbus.driver import ModbusDriver
    from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock


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


class Unopened(NamedTuple):
    """A driver before ``open``, its clock, and the bench described under ``emulated``, if there is one."""

    driver: Driver
    clock: Clock
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


def driver_settings_of(experiment: Experiment) -> DriverSettings:
    """What a plug-in driver is constructed with."""
    daq, sensor = experiment.daq, experiment.sensor
    return DriverSettings(
        options=MappingProxyType(dict(daq.options or {})),
        calibration=calibration_of(experiment),
        drive_map=drive_map_of(experiment),
        rail_counts=sensor.rail_counts,
        counts_max=sensor.counts_max,
        timeout_s=daq.timeout_s,
        period_s=experiment.period_s,
        watchdog_s=daq.watchdog_s,
    )


def plug_in_preflight(experiment: Experiment) -> Preflight:
    """What the plug-in driver of a config says of itself, and what is wrong with it; no device is touched.

    The driver is imported and constructed, so that it refuses its options here and not before a motor.
    """
    name = experiment.daq.driver
    try:
        entries = registry.registered()
        if name not in entries:
            return Preflight((), (unknown_driver(name, entries),))
        driver = registry.construct(name, driver_settings_of(experiment))
    except registry.PlugInError as error:
        problem = Problem(("daq", "driver"), str(error), "see docs/plug-in-driver.md, or ask its author")
        return Preflight((), (problem,))
    except ValueError as error:
        return Preflight((), (Problem(("daq", "options"), f"driver {name!r}: {error}"),))
    if experiment.relay.where == "device" and not isinstance(driver, RelayDriver):
        problem = Problem(("relay", "where"), f"driver {name!r} has no relay in its device", "set it to host")
        return Preflight((), (problem,))
    failsafe = "none" if driver.failsafe is None else f"0 V after {driver.failsafe.time_s * 1e3:g} ms of silence"
    order = driver.order.replace("_", " ")
    return Preflight((f"{registry.described(entries[name])}: {order}; failsafe before it is opened: {failsafe}",), ())


def guard_settings_of(experiment: Experiment, noise_rad: float | None = None) -> GuardSettings:
    """The guard's knowledge; ``noise_rad`` once it was measured, before that two LSB are assumed."""
    lsb_rad = calibration_of(experiment).lsb_rad
    t = experiment.limits
    return GuardSettings(
        limits=limits_of(experiment),
        rail_counts=experiment.sensor.rail_counts,
        max_speed_rad_s=t.max_speed_rad_s,
        coast_tau_s=t.coast_tau_s,
        reaction_s=known_reaction_s(experiment),  # as in `rig check`
        noise_rad=2.0 * lsb_rad if noise_rad is None else max(noise_rad, lsb_rad),
        motion_rad=experiment.breakaway.motion_rad,
    )


def real_time_of(experiment: Experiment) -> RealTimeSettings:
    """What the loop's process asks the machine for."""
    wanted = experiment.loop
    return RealTimeSettings(wanted.priority, wanted.cpu, wanted.lock_memory, wanted.raise_workers)


def _clock_of(experiment: Experiment) -> MonotonicClock:
    return MonotonicClock(1e-6 * experiment.loop.spin_us)


def truth_of(experiment: Experiment) -> BenchParameters | None:
    """The bench described under ``emulated``, or None."""
    if experiment.emulated is None:
        return None
    tachometer = None if experiment.tachometer is None else experiment.tachometer.model_dump()
    return BenchParameters.from_mapping(experiment.emulated.model_dump(), tachometer)


@contextmanager
def connect(experiment: Experiment) -> Iterator[Bench]:
    """Open the bench for the block; on leaving it is stopped and closed.

    Raises Fault LINK_* where there is no such device, NO_WATCHDOG where it has none and the config forbids that;
    ConfigError where a plug-in driver is not installed, or refuses its options.
    Nothing is ever simulated in place of a missing device.
    """
    with unopened(experiment) as (driver, clock, truth):
        try:
            info = driver.open()
            if driver.failsafe is None and not experiment.daq.accept_no_watchdog:
                raise Fault("NO_WATCHDOG")
            # only a device that says that it is emulated has a truth to compare with
            yield Bench(driver, clock, info, truth if info.emulated else None)
        finally:
            try:
                driver.safe_stop()
            finally:
                driver.close()


@contextmanager
def unopened(experiment: Experiment) -> Iterator[Unopened]:
    """The driver of the config, not opened as a device yet; what an emulated one needs lives for the block.

    Who opens the driver closes it. Raises as ``connect``, Fault LINK_OPEN included.
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
            replace(drive_map_of(experiment), full_units=truth.drive_counts),  # as a real device says of itself
            experiment.sensor.rail_counts,
            latency,
            experiment.seed,
        )
        yield Unopened(driver, clock, truth)
    elif daq.driver == "serial":
        if daq.port in ("emulated", "emulated-chip-realtime"):
            with emulated_board(experiment) as board:
                yield from _serial(experiment, board.port, truth, emulated=True)
        elif daq.port == "emulated-chip":
            device = emulated_chip(experiment)
            chip = device if adapter_of(experiment) == "none" else BehindUsb(device, adapter_of(experiment))
            yield Unopened(_driver(experiment, chip, daq.port, emulated=True), chip, truth)
        elif daq.port is not None:
            yield from _serial(experiment, daq.port, truth)
        else:
            raise ValueError("daq.port is missing")
    elif daq.driver == "modbus":
        yield from _modbus(experiment, truth)
    else:
        try:
            plug_in = registry.construct(daq.driver, driver_settings_of(experiment))
        except (LookupError, ValueError, registry.PlugInError) as error:
            raise ConfigError(plug_in_preflight(experiment).problems) from error
        yield Unopened(plug_in, getattr(plug_in, "clock", None) or _clock_of(experiment), truth)


@contextmanager
def emulated_board(
    experiment: Experiment, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
) -> Iterator[BoardProcess]:
    """The emulated device of the config, running in real time for the block; its ``port`` is as daq.port takes it.

    chip  the Uno's firmware on its emulated chip, as where the config's port asks for that; else the firmware's core
          on this machine. Driver modbus: the I/O block, on TCP where the config's port is that of TCP; then there is
          no link
    Raises EmulationError where it cannot be built or started.
    """
    if experiment.emulated is None:
        raise ValueError("the config has no section `emulated`")
    if experiment.daq.modbus is not None:
        with ModbusBoard() as io_block:
            io_block.start(
                experiment.daq.modbus.model_dump(),
                experiment.emulated.model_dump(),
                experiment.seed,
                link,
                trace,
                baud=experiment.daq.baud,
                tcp_port=_tcp_port(experiment.daq.port),
                polarity=_register_polarity(experiment),
            )
            yield io_block
        return
    tachometer = None if experiment.tachometer is None else experiment.tachometer.model_dump()
    emulated, seed, adapter = experiment.emulated.model_dump(), experiment.seed, experiment.daq.adapter or "none"
    own_link = link if adapter == "none" else None
    with ExitStack() as stack:
        board: ChipBoard | HostBoard
        if chip or experiment.daq.port in CHIP_PORTS:
            board = stack.enter_context(ChipBoard())
            board.start(emulated, seed, own_link, trace, tachometer, experiment.daq.baud, experiment.drive.bridge)
        else:
            board = stack.enter_context(HostBoard())
            board.start(emulated, seed, own_link, trace, tachometer)
        if adapter == "none":
            yield board
            return
        behind = stack.enter_context(UsbBoard(board, adapter))
        behind.start(link)
        yield behind


def _modbus(experiment: Experiment, truth: BenchParameters | None) -> Iterator[Unopened]:
    port = experiment.daq.port
    if port is None:
        raise ValueError("daq.port is missing")
    if port == "emulated-virtual":
        block = emulated_io_block(experiment)
        yield Unopened(modbus_driver(experiment, block, port, emulated=True), block, truth)
    elif port in MODBUS_EMULATED_PORTS:
        with emulated_board(experiment) as board:
            transport = _modbus_transport(experiment, board.port)
            driver = modbus_driver(experiment, transport, f"modbus:{board.port}", emulated=True)
            yield Unopened(driver, _clock_of(experiment), truth)
    else:
        driver = modbus_driver(experiment, _modbus_transport(experiment, port), f"modbus:{port}")
        yield Unopened(driver, _clock_of(experiment), truth)


def _modbus_transport(experiment: Experiment, port: str) -> Transport:
    daq = experiment.daq
    if is_tcp(port):
        return TcpTransport(*tcp_address(port), daq.open_timeout_s)
    if daq.modbus is None:
        raise ValueError("the config has no section `daq.modbus`")
    parity, stop_bits = daq.modbus.parity[0].upper(), daq.modbus.stop_bits
    return SerialPort(port, daq.baud, parity, stop_bits)


def modbus_driver(
    experiment: Experiment, transport: Transport, name: str = "modbus", *, emulated: bool = False
) -> ModbusDriver:
    """The Modbus driver of the config on a transport, not opened yet; RTU or TCP as the config's port."""
    from rig.backends.modbus.client import ModbusLine
    from rig.backends.modbus.driver import ModbusDriver
    from rig.backends.modbus.registers import RegisterMap

    daq = experiment.daq
    if daq.modbus is None:
        raise ValueError("the config has no section `daq.modbus`")
    line = ModbusLine(
        tcp=is_tcp(daq.port),
        unit=daq.modbus.unit,
        requests=daq.modbus.requests,
        baud=daq.baud,
        bits_per_byte=bits_per_byte(daq.modbus),
        silence_s=silence_s(daq.modbus, daq.baud),
        turnaround_s=daq.modbus.turnaround_s,
    )
    return ModbusDriver(
        transport,
        line,
        RegisterMap.from_mapping(daq.modbus.model_dump()),
        calibration_of(experiment),
        drive_map_of(experiment),
        experiment.sensor.rail_counts,
        daq.timeout_s,
        daq.open_timeout_s,
        device_watchdog_s=daq.modbus.device_watchdog_s,
        counts_max=experiment.sensor.counts_max,
        name=name,
        emulated=emulated,
    )


def emulated_io_block(experiment: Experiment) -> VirtualIoBlock:
    """The emulated Modbus I/O block of the config in virtual time: RTU line and clock in one.

    Raises EmulationError where a register cannot hold what it is for.
    """
    from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock

    if experiment.emulated is None or experiment.daq.modbus is None:
        raise ValueError("the config needs the sections `emulated` and `daq.modbus`")
    return VirtualIoBlock(
        experiment.daq.modbus.model_dump(),
        experiment.emulated.model_dump(),
        experiment.seed,
        baud=experiment.daq.baud,
        polarity=_register_polarity(experiment),
    )


def _register_polarity(experiment: Experiment) -> int:
    """+1 if positive drive raises the position register of a Modbus device, -1 if it lowers it."""
    if experiment.daq.modbus is None:
        raise ValueError("the config has no section `daq.modbus`")
    direction = polarity(calibration_of(experiment), drive_map_of(experiment))
    return direction if experiment.daq.modbus.registers.position.scale > 0.0 else -direction


def _tcp_port(port: str | None) -> int | None:
    """Number of the TCP port on this machine that the emulated device is to serve: 0 for any; None for RTU."""
    if port == "emulated-tcp":
        return 0
    url = urlsplit(port or "")
    if url.scheme != "tcp":
        return None
    return url.port or 502 if url.hostname in ("localhost", "127.0.0.1") else 0


def emulated_chip(experiment: Experiment) -> VirtualChip:
    """The Uno's emulated chip with the config's bench behind it: port and clock in one, in virtual time.

    Raises EmulationError where it cannot be built.
    """
    if experiment.emulated is None:
        raise ValueError("the config has no section `emulated`")
    tachometer = None if experiment.tachometer is None else experiment.tachometer.model_dump()
    return VirtualChip.from_mapping(
        experiment.emulated.model_dump(),
        experiment.seed,
        tachometer,
        baud=experiment.daq.baud,
        bridge=experiment.drive.bridge,
    )


def _serial(
    experiment: Experiment, port: str, truth: BenchParameters | None, *, emulated: bool = False
) -> Iterator[Unopened]:
    transport = SerialPort(port, experiment.daq.baud)
    if not emulated:
        try:
            check_adapter(port, adapter_of(experiment))
        except Fault:
            transport.close()
            raise
    yield Unopened(_driver(experiment, transport, f"serial:{port}", emulated=emulated), _clock_of(experiment), truth)


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
        bridge=experiment.drive.bridge,
        flashing=flash_line(experiment),
        # a chip takes longer over some numbers than over others: an emulated run is the same by its seed
        session=random.Random(experiment.seed).randrange(1, 2**32) if emulated else None,
        name=name,
        emulated=emulated,
    )
