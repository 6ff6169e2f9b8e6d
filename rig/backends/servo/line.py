"""The line of a servo's config, its driver, and the emulated bus that stands for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rig.backends.backend import Line, emulated_of
from rig.backends.driver import Timeouts
from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.links.serial_port import SerialPort
from rig.backends.links.usb_adapters import adapter_delay_s
from rig.backends.links.usb_port import check_adapter
from rig.backends.servo.before import BeforeStore, store_of
from rig.backends.servo.driver import ServoDriver
from rig.backends.servo.emulated.bus import LineTimes
from rig.backends.servo.emulated.servo import ServoOptions
from rig.backends.servo.emulated.servo_board import ServoBoard
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.backends.servo.keeper import starter
from rig.backends.servo.link_budget import adapter_of, longest_return_delay_s
from rig.backends.servo.opening import ServoSetup
from rig.backends.servo.rules import switch_to_try
from rig.backends.servo.section import EMULATED_PORTS, Servo
from rig.config.schema import DeviceSetup, ServoSensor
from rig.core.calibration import largest_drive_in_units


def virtual_line(d: DeviceSetup) -> Line:
    """As of ``Opening``."""
    bus = emulated_bus(d)
    return Line(bus, bus, d.daq.port or "", emulated=True)


def transport(d: DeviceSetup, port: str, *, emulated: bool = False) -> SerialPort:
    """As of ``Opening``."""
    if not emulated:
        check_adapter(port, adapter_of(d.daq, servo_of(d)), "daq.servo.adapter")
    return SerialPort(port, d.daq.baud, usb_serial=d.daq.usb_serial)


def driver(d: DeviceSetup, line: Line) -> ServoDriver:
    """As of ``Opening``."""
    servo = servo_of(d)
    descriptor = getattr(line.transport, "descriptor", None)
    is_real = d.daq.port not in EMULATED_PORTS and not line.emulated
    store = store_of(d.daq.port or "", servo.id) if is_real else BeforeStore()
    # what only stops the servo, on a link that it has inherited, needs nobody to stop it
    guardian = None if descriptor is None or line.answered else starter(descriptor, d.daq.watchdog_s, moves=is_real)
    return ServoDriver(
        line.transport,
        setup_of(d),
        d.daq.baud,
        d.scaling,
        Timeouts(d.daq.timeout_s, d.daq.open_timeout_s, d.period_s),
        store,
        guardian=guardian,
        name=line.name,
        emulated=line.emulated,
        answered=line.answered,
    )


def setup_of(d: DeviceSetup) -> ServoSetup:
    """What the config says of the servo."""
    servo = servo_of(d)
    drive_map = replace(d.drive.map, full_units=servo.table.full_drive)
    return ServoSetup(
        model=servo.table,
        id=servo.id,
        fastest_slope=servo.pwm_slope == "fastest",
        brakes=servo.on_stop == "brake",
        hot_degC=servo.hot_degC,
        supply_V=d.drive.supply_V,
        zero_counts=_sensor(d).zero_counts,
        max_units=largest_drive_in_units(d.arming, drive_map),
        watchdog_s=d.daq.watchdog_s,
        longest_delay_s=longest_return_delay_s(d.daq, servo, d.period_s),
        supply_switch=switch_to_try(d, servo),
        adapter_s=adapter_delay_s(adapter_of(d.daq, servo)),
    )


def emulated_servo(d: DeviceSetup) -> ServoOptions:
    """The emulated servo of the config, as shipped but for its id and baud."""
    servo, bench = servo_of(d), bench_parameters(emulated_of(d))
    sensor = _sensor(d)
    return ServoOptions(
        model=servo.model,
        id=servo.id,
        baud=d.daq.baud,
        bench=replace(bench, coasting=False),
        seed=d.seed,
        polarity=sensor.sign * (-1 if bench.reversed else 1),
        zero_counts=sensor.zero_counts,
    )


def emulated_bus(d: DeviceSetup) -> VirtualServoBus:
    """The emulated bus in virtual time: line and clock in one. Raises EmulationError."""
    return VirtualServoBus([emulated_servo(d)], line=_times(d))


@contextmanager
def emulated_board(
    d: DeviceSetup, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
) -> Iterator[BoardProcess]:
    """The emulated bus, running in real time for the block; there is no ``chip``.

    Raises EmulationError where it does not start.
    """
    with ServoBoard() as board:
        board.start([emulated_servo(d)], link, trace, line=_times(d))
        yield board


def servo_of(d: DeviceSetup) -> Servo:
    """Section ``daq.servo``. Raises ValueError without it."""
    if d.daq.servo is None:
        raise ValueError("the config has no section `daq.servo`")
    return d.daq.servo


def _sensor(d: DeviceSetup) -> ServoSensor:
    return ServoSensor() if d.sensor.servo is None else d.sensor.servo


def _times(d: DeviceSetup) -> LineTimes:
    return LineTimes(d.daq.baud, adapter_delay_s(adapter_of(d.daq, servo_of(d))))
