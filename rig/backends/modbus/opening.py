"""How a Modbus device opens: a serial port or a connection, or an emulated I/O block in real or virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from rig.backends.backend import Line, emulated_of
from rig.backends.driver import Timeouts, Transport
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.links.serial_port import SerialPort
from rig.backends.links.tcp_link import TcpTransport
from rig.backends.modbus.client import ModbusLine
from rig.backends.modbus.driver import ModbusDriver
from rig.backends.modbus.emulated.modbus_board import ModbusBoard
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.modbus.emulated.virtual_tcp_block import VirtualTcpBlock
from rig.backends.modbus.link_budget import bits_per_byte, silence_s
from rig.backends.modbus.registers import RegisterMap
from rig.backends.modbus.section import EMULATED_PORTS, Modbus, is_tcp, tcp_address
from rig.config.schema import DeviceSetup
from rig.core.calibration import polarity


def virtual_line(d: DeviceSetup) -> Line:
    """As of ``Opening``."""
    block = emulated_tcp_block(d) if is_tcp(d.daq.port) else emulated_io_block(d)
    return Line(block, block, d.daq.port or "", emulated=True)


def transport(d: DeviceSetup, port: str, *, emulated: bool = False) -> Transport:
    """As of ``Opening``."""
    modbus = _modbus_of(d)
    if is_tcp(port):
        return TcpTransport(*tcp_address(port), d.daq.open_timeout_s, modbus.unit)
    return SerialPort(port, d.daq.baud, modbus.parity[0].upper(), modbus.stop_bits, d.daq.usb_serial)


def driver(d: DeviceSetup, line: Line) -> ModbusDriver:
    """As of ``Opening``."""
    return modbus_driver(d, line.transport, line.name, emulated=line.emulated, answered=line.answered)


def modbus_driver(
    d: DeviceSetup, transport: Transport, name: str = "modbus", *, emulated: bool = False, answered: bool = False
) -> ModbusDriver:
    """The driver of the config on a transport, not opened yet; RTU or TCP as the config's port."""
    daq, modbus = d.daq, _modbus_of(d)
    asked = ModbusLine(
        tcp=is_tcp(daq.port),
        unit=modbus.unit,
        requests=modbus.requests,
        baud=daq.baud,
        bits_per_byte=bits_per_byte(modbus),
        silence_s=silence_s(modbus, daq.baud),
        turnaround_s=modbus.turnaround_s,
    )
    return ModbusDriver(
        transport,
        asked,
        RegisterMap.of(modbus),
        d.scaling,
        Timeouts(daq.timeout_s, daq.open_timeout_s, d.period_s),
        name=name,
        emulated=emulated,
        answered=answered,
    )


def emulated_io_block(d: DeviceSetup) -> VirtualIoBlock:
    """The emulated I/O block of the config in virtual time: RTU line and clock in one.

    Raises EmulationError where a register cannot hold what it is for.
    """
    modbus, emulated = _modbus_of(d), emulated_of(d)
    return VirtualIoBlock(modbus, emulated, d.seed, baud=d.daq.baud, polarity=_register_polarity(d))


def emulated_tcp_block(d: DeviceSetup) -> VirtualTcpBlock:
    """The same block on Modbus TCP in virtual time: a connection and clock in one. Raises as ``emulated_io_block``."""
    block = VirtualTcpBlock(_modbus_of(d), emulated_of(d), d.seed, polarity=_register_polarity(d))
    block.connect(d.daq.open_timeout_s)
    return block


@contextmanager
def emulated_board(
    d: DeviceSetup, link: Path | None = None, trace: Path | None = None, *, chip: bool = False
) -> Iterator[BoardProcess]:
    """The emulated I/O block, running in real time for the block; its ``port`` is as daq.port takes it.

    There is no ``chip``. On TCP where the config's port is that of TCP; then there is no link.
    Raises EmulationError where it does not start.
    """
    with ModbusBoard() as io_block:
        io_block.start(
            _modbus_of(d),
            emulated_of(d),
            d.seed,
            link,
            trace,
            baud=d.daq.baud,
            tcp_port=_tcp_port(d.daq.port),
            polarity=_register_polarity(d),
        )
        yield io_block


def _register_polarity(d: DeviceSetup) -> int:
    """+1 if positive drive raises the position register, -1 if it lowers it."""
    direction = polarity(d.sensor.curve, d.drive.map)
    return direction if _modbus_of(d).registers.position.scale > 0.0 else -direction


def _tcp_port(port: str | None) -> int | None:
    """Number of the TCP port on this machine that the emulated device is to serve: 0 for any; None for RTU."""
    if port in EMULATED_PORTS:
        return 0 if is_tcp(port) else None
    url = urlsplit(port or "")
    if url.scheme != "tcp":
        return None
    return url.port or 502 if url.hostname in ("localhost", "127.0.0.1") else 0


def _modbus_of(d: DeviceSetup) -> Modbus:
    if d.daq.modbus is None:
        raise ValueError("the config has no section `daq.modbus`")
    return d.daq.modbus
