"""The emulated Modbus I/O block in real time: a process behind a pseudo-terminal (RTU) or on loopback (TCP)."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.line_faults import Disturbance
from rig.backends.modbus.emulated.io_block_registers import BlockRegisters
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.rtu_slave import LineTimes
from rig.backends.modbus.registers import RegisterMap
from rig.backends.modbus.section import Modbus
from rig.config.schema import Emulated


def mbpoll_line(modbus: Modbus, port: str, baud: int) -> str:
    """A command of Debian's mbpoll that reads what a tick reads: position, and what stands beside it.

    modbus  section of the config
    """
    read = RegisterMap.of(modbus).read
    table = 4 if modbus.registers.position.table == "holding" else 3
    what = f"-0 -1 -a {modbus.unit} -t {table} -r {read.address} -c {read.words}"
    url = urlsplit(port)
    if url.scheme == "tcp":
        return f"mbpoll -m tcp -p {url.port} {what} {url.hostname}"
    return f"mbpoll -m rtu -b {baud} -P {modbus.parity} -s {modbus.stop_bits} {what} {port}"


class ModbusBoard(BoardProcess):
    """The block of ``rig.backends.modbus.emulated.io_block`` with the bench behind it."""

    def start(
        self,
        modbus: Modbus,
        emulated: Emulated,
        seed: int,
        link: Path | None = None,
        trace: Path | None = None,
        *,
        baud: int = 115200,
        tcp_port: int | None = None,
        polarity: int = 1,
        reply_fault: ReplyFault | None = None,
        disturbance: Disturbance | None = None,
    ) -> str:
        """Start the process and return the name of its port: a pseudo-terminal's, or ``tcp://127.0.0.1:number``.

        modbus, emulated   sections of the config
        seed, link, trace  as of HostBoard; the trace's fault is the value of the status register for it. No link to TCP
        baud          RTU: of the wire, whose time is kept
        tcp_port      TCP on this port, 0: on a free one; None: RTU
        polarity      +1: positive drive raises the position register; -1: lowers it
        reply_fault   fault of the device's replies
        disturbance   RTU: damage on the line
        Raises EmulationError where it does not start.
        """
        if tcp_port is not None and link is not None:
            raise EmulationError("a TCP port cannot have a symbolic link\nleave --link out")
        from rig.backends.modbus.emulated.modbus_process import served  # not on Windows

        make = partial(
            served,
            BlockRegisters.of(modbus),
            modbus.unit,
            bench_parameters(emulated),
            seed,
            polarity,
            LineTimes.of(modbus, baud),
            tcp_port,
            reply_fault,
            disturbance,
        )
        return self._launch(make, link, trace)
