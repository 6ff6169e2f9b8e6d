"""The line of a servo's config, its driver, and the emulated bus that stands for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rig.backends.backend import Line, emulated_of, host_clock
from rig.backends.driver import Timeouts
from rig.backends.emulated.bench import bench_parameters
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.emulated.words import in_virtual_time
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
from rig.backends.servo.section import EMULATED_PORTS, Servo
from rig.calibration import largest_drive_in_units
from rig.config.schema import Experiment, ServoSensor


@contextmanager
def servo_line(e: Experiment) -> Iterator[Line]:
    """As of ``LineBackend.line``. Raises ValueError where the config has no port."""
    port = e.daq.port
    if port is None:
        raise ValueError("daq.port is missing")
    if in_virtual_time(port):
        bus = emulated_bus(e)
        yield Line(bus, bus, port, emulated=True)
    elif port in EMULATED_PORTS:
        with emulated_board(e) as board:
            yield Line(SerialPort(board.port, e.daq.baud), host_clock(e), f"servo:{board.port}", emulated=True)
    else:
        check_adapter(port, adapter_of(e.daq, servo_of(e)), "daq.servo.adapter")
        yield Line(SerialPort(port, e.daq.baud, usb_serial=e.daq.usb_serial), host_clock(e), f"servo:{port}")


def servo_driver(e: Experiment, line: Line) -> ServoDriver:
    """The driver of the config on a line, not opened yet."""
    servo = servo_of(e)
    descriptor = getattr(line.transport, "descriptor", None)
    is_real = e.daq.port not in EMULATED_PORTS and not line.emulated
    store = store_of(e.daq.port or "", servo.id) if is_real else BeforeStore()
    # what only stops the servo, on a link that it has inherited, needs nobody to stop it
    guardian = None if descriptor is None or line.answered else starter(descriptor, e.daq.watchdog_s)
    return ServoDriver(
        line.transport,
        setup_of(e),
        e.daq.baud,
        e.scaling,
        Timeouts(e.daq.timeout_s, e.daq.open_timeout_s),
        store,
        guardian=guardian,
        name=line.name,
        emulated=line.emulated,
        answered=line.answered,
    )


def setup_of(e: Experiment) -> ServoSetup:
    """What the config says of the servo."""
    servo = servo_of(e)
    drive_map = replace(e.drive.map, full_units=servo.table.full_drive)
    return ServoSetup(
        model=servo.table,
        id=servo.id,
        fastest_slope=servo.pwm_slope == "fastest",
        brakes=servo.on_stop == "brake",
        hot_degC=servo.hot_degC,
        supply_V=e.drive.supply_V,
        zero_counts=_sensor(e).zero_counts,
        max_units=largest_drive_in_units(e.device_limits, drive_map),
        watchdog_s=e.daq.watchdog_s,
        longest_delay_s=longest_return_delay_s(e.daq, servo, e.period_s),
    )


def emulated_servo(e: Experiment) -> ServoOptions:
    """The emulated servo of the config, as shipped but for its id and baud."""
    servo, bench = servo_of(e), bench_parameters(emulated_of(e))
    sensor = _sensor(e)
    return ServoOptions(
        model=servo.model,
        id=servo.id,
        baud=e.daq.baud,
        bench=replace(bench, coasting=False),
        seed=e.seed,
        polarity=sensor.sign * (-1 if bench.reversed else 1),
        zero_counts=sensor.zero_counts,
    )


def emulated_bus(e: Experiment) -> VirtualServoBus:
    """The emulated bus in virtual time: line and clock in one. Raises EmulationError."""
    return VirtualServoBus([emulated_servo(e)], line=_times(e))


@contextmanager
def emulated_board(e: Experiment, link: Path | None = None, trace: Path | None = None) -> Iterator[BoardProcess]:
    """The emulated bus, running in real time for the block. Raises EmulationError where it does not start."""
    with ServoBoard() as board:
        board.start([emulated_servo(e)], link, trace, line=_times(e))
        yield board


def servo_of(e: Experiment) -> Servo:
    """Section ``daq.servo``. Raises ValueError without it."""
    if e.daq.servo is None:
        raise ValueError("the config has no section `daq.servo`")
    return e.daq.servo


def _sensor(e: Experiment) -> ServoSensor:
    return ServoSensor() if e.sensor.servo is None else e.sensor.servo


def _times(e: Experiment) -> LineTimes:
    return LineTimes(e.daq.baud, adapter_delay_s(adapter_of(e.daq, servo_of(e))))
