"""How a serial device opens: a port of this machine, or an emulated device in virtual or in real time."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rig.backends.backend import Line, emulated_of
from rig.backends.driver import Timeouts
from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.links.serial_port import SerialPort
from rig.backends.links.usb_port import check_adapter
from rig.backends.serial.driver import ByHand, SerialDriver
from rig.backends.serial.emulated.behind_usb import BehindUsb
from rig.backends.serial.emulated.firmware_build import require_emulator
from rig.backends.serial.emulated.serial_board import HostBoard
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.emulated.virtual_device import PortAndClock
from rig.backends.serial.fit import Board
from rig.backends.serial.flashing import flash_line
from rig.backends.serial.ports import CHIP_PORTS, adapter_of
from rig.config.schema import DeviceSetup
from rig.core.faults import Fault


def virtual_line(d: DeviceSetup) -> Line:
    """As of ``Opening``."""
    device: PortAndClock
    port = d.daq.port or ""
    if port in CHIP_PORTS:
        require_emulator(port)
        from emulated_chips import opening as chips

        device, shaft = chips.virtual_chip(d), None
    else:
        device = board = emulated_host_board(d)
        shaft = board.shaft
    adapter = adapter_of(d)
    line = device if adapter == "none" else BehindUsb(device, adapter)
    return Line(line, line, port, emulated=True, shaft=shaft)


def transport(d: DeviceSetup, port: str, *, emulated: bool = False) -> SerialPort:
    """As of ``Opening``."""
    opened = SerialPort(port, d.daq.baud, usb_serial=d.daq.usb_serial)
    if d.sensor.encoder is not None:
        opened.keep_on()
    if not emulated:
        try:
            check_adapter(port, adapter_of(d))
        except Fault:
            opened.close()
            raise
    return opened


def driver(d: DeviceSetup, line: Line) -> SerialDriver:
    """As of ``Opening``."""
    return SerialDriver(
        line.transport,
        d.scaling,
        Timeouts(d.daq.timeout_s, d.daq.open_timeout_s, d.period_s),
        board=Board(d.drive.bridge, flash_line(d), runs_strokes=d.runs_strokes),
        # a chip takes longer over some numbers than over others: an emulated run is the same by its seed
        session=random.Random(d.seed).randrange(1, 2**32) if line.emulated else None,
        name=line.name,
        emulated=line.emulated,
        by_hand=_by_hand(d, line),
    )


def _by_hand(d: DeviceSetup, line: Line) -> ByHand | None:
    """Without travel limits zero is where the shaft stands. With them nobody knows but `rig home`.

    An emulated device that starts with the command has a hand, which does what a person would do.
    """
    if d.sensor.encoder is None:
        return None
    if d.limits.is_endless:
        return ByHand(0.0, tried_estop=line.emulated)
    return ByHand(emulated_of(d).motor.start_rad) if line.emulated else None


def emulated_host_board(d: DeviceSetup) -> VirtualBoard:
    """The firmware's core on this machine with the config's bench behind it: port and clock in one, in virtual time.

    Raises EmulationError where it cannot be built, ValueError without section ``emulated``.
    """
    emulated = emulated_of(d)
    bench = bench_parameters(emulated, d.tachometer)
    board = VirtualBoard(bench, d.seed, clock_error_ppm=emulated.clock_error_ppm, baud=d.daq.baud)
    board.keeps_shaft = True
    return board


@contextmanager
def emulated_board(
    d: DeviceSetup, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
) -> Iterator[BoardProcess]:
    """The emulated board of the config, running in real time for the block; its ``port`` is a value for daq.port.

    link   symbolic link to its port
    trace  CSV file of the truth
    chip   the Uno's firmware on its emulated chip, unless the config's port names another chip; False: only if the port
           names a chip, else the firmware's core on this machine
    Raises EmulationError where it cannot be built or started, ValueError without section ``emulated``.
    """
    adapter = d.daq.adapter or "none"
    if chip or d.daq.port in CHIP_PORTS:
        require_emulator("emulated-chip" if chip else d.daq.port)
        from emulated_chips import opening as chips

        with chips.chip_process(d, link, trace, adapter) as board:
            yield board
    else:
        with HostBoard() as host:
            host.start(emulated_of(d), d.seed, link, trace, d.tachometer, adapter)
            yield host
