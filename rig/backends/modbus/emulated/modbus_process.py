"""The emulated Modbus I/O block in real time: a process behind a pseudo-terminal (RTU) or on loopback (TCP).

``modbus_board`` starts it.
"""

from __future__ import annotations

import errno
import socket
import struct
from collections.abc import Callable

from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.line_faults import Disturbance
from rig.backends.emulated.real_time import BehindPty, Look, Served
from rig.backends.modbus.emulated.io_block import IoBlock
from rig.backends.modbus.emulated.io_block_registers import BlockRegisters
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.rtu_slave import LineTimes, RtuSlave
from rig.backends.modbus.emulated.tcp_slave import Stream, TcpSlave
from rig.core.package import VERSION
from rig.model.bench import BenchModel, BenchParameters

LOOPBACK = "127.0.0.1"
_MOST_CONNECTIONS = 8


class _Block:
    """The block, whatever its port."""

    last = "fault"

    def __init__(self, block: IoBlock) -> None:
        self._block = block

    def watch(self, changed: Callable[[], None]) -> None:
        self._block.on_output = lambda t_s, u_V: changed()

    def look(self) -> Look:
        truth = self._block.truth()
        fault = 0 if truth.fault is None else self._block.registers.status_of[truth.fault]
        return Look(truth.t_s, truth.output_V, truth.y_rad, truth.v_rad_per_s, fault)

    def power_cycle(self) -> None:
        self._block.power_cycle()

    def power_off(self) -> None:
        self._block.power_off()


class _Rtu(_Block, BehindPty):
    """RTU behind a pseudo-terminal."""

    def __init__(self, slave: RtuSlave) -> None:
        _Block.__init__(self, slave.block)
        BehindPty.__init__(self, slave)


class _Tcp(_Block):
    """A server on loopback, for a few hosts at a time."""

    def __init__(self, slave: TcpSlave, number: int) -> None:
        super().__init__(slave.block)
        self._slave = slave
        self._open: dict[int, tuple[socket.socket, Stream]] = {}
        try:
            self._server = socket.create_server((LOOPBACK, number))
        except OSError as error:
            why = "another program has it" if error.errno == errno.EADDRINUSE else error.strerror
            raise EmulationError(
                f"port {number} of this machine: {why}; end that program, or give daq.port another number"
            ) from error
        self._server.setblocking(False)
        self.name = f"tcp://{LOOPBACK}:{self._server.getsockname()[1]}"

    def files(self) -> list[int]:
        return [self._server.fileno(), *self._open]

    def serve(self, ready: set[int], now: Callable[[], float]) -> None:
        arrived: dict[int, bytes] = {}
        for number in ready & self._open.keys():
            try:
                arrived[number] = self._open[number][0].recv(4096)
            except BlockingIOError:
                continue
            except ConnectionError:
                arrived[number] = b""
        t_s = now()
        for number, data in arrived.items():
            if number not in self._open:  # it ended when a reply was sent
                continue
            stream = self._open[number][1]
            for adu in stream.feed(data):
                self._slave.take(number, adu, t_s)
            if not data or stream.broken:
                self._drop(number)
        if self._server.fileno() in ready:
            self._accept()

    def _accept(self) -> None:
        try:
            connection, _ = self._server.accept()
        except (BlockingIOError, ConnectionError):
            return
        if len(self._open) >= _MOST_CONNECTIONS:
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._open[connection.fileno()] = connection, Stream()

    def power_cycle(self) -> None:
        """Each connection ends with a reset, as where a segment comes that the device knows nothing of."""
        super().power_cycle()
        for number, (connection, _) in list(self._open.items()):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._drop(number)

    def _drop(self, number: int) -> None:
        self._open.pop(number)[0].close()
        self._slave.forget(number)

    def next_event_s(self) -> float:
        return self._slave.next_event_s()

    def advance_to(self, t_s: float) -> None:
        self._slave.block.advance_to(t_s)
        for number, reply in self._slave.due(t_s):
            if number in self._open:
                try:
                    self._open[number][0].sendall(reply)
                except (BlockingIOError, ConnectionError):  # it does not read, or is gone
                    self._drop(number)


def served(
    registers: BlockRegisters,
    unit: int,
    bench: BenchParameters,
    seed: int,
    polarity: int,
    line: LineTimes,
    tcp_port: int | None,
    reply_fault: ReplyFault | None,
    disturbance: Disturbance | None,
) -> Served:
    """The block with its line, at its time 0.

    registers, unit   what is at which address, and its unit id
    bench, seed       what is behind it, and of its noise
    polarity          +1: positive drive raises the position register; -1: lowers it
    line              times of an RTU line; of TCP its turnaround alone counts
    tcp_port          TCP on this port, 0: on a free one; None: RTU
    reply_fault, disturbance   of the block, of an RTU line
    """
    block = IoBlock(registers, BenchModel(bench, seed), unit, polarity=polarity, revision=VERSION)
    if tcp_port is not None:
        return _Tcp(TcpSlave(block, line.turnaround_s, reply_fault), tcp_port)
    return _Rtu(RtuSlave(block, line, reply_fault, disturbance))
