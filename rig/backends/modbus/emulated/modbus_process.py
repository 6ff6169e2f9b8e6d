"""The emulated Modbus I/O block in real time: a process behind a pseudo-terminal (RTU) or on loopback (TCP).

Started by ``modbus_board``. It says ``port NAME`` once it is there. It sleeps between requests, for 20 ms
at most: the block's milliseconds are caught up with then, which nobody outside can tell from doing them in time.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import gc
import math
import os
import select
import signal
import socket
import struct
import sys
import time
from pathlib import Path
from typing import Protocol, TextIO

from rig.backends.emulated.device_process import ORPHAN_S, fail, linked, open_pty, signals, take_priority
from rig.backends.emulated.errors import EmulationError
from rig.backends.modbus.emulated.device import Device, unpacked
from rig.backends.modbus.emulated.io_block import IoBlock
from rig.backends.modbus.emulated.line_faults import Corruption
from rig.backends.modbus.emulated.rtu_slave import RtuSlave
from rig.backends.modbus.emulated.tcp_slave import Stream, TcpSlave
from rig.model.bench import Bench
from rig.package import VERSION

LOOPBACK = "127.0.0.1"
_TRACE_S = 0.01
_CATCH_UP_S = 0.02  # longest sleep: what is caught up with then takes 0.1 ms
_MOST_CONNECTIONS = 8


class _Port(Protocol):
    """Where the host comes in. All times are the block's, s."""

    name: str

    def files(self) -> list[int]:
        """What to wait for."""
        ...

    def serve(self, ready: set[int], t_s: float) -> None:
        """Take what has come in, without waiting."""
        ...

    def forget(self) -> None:
        """The device was reset: it knows of no connection."""
        ...

    def next_event_s(self) -> float:
        """When it has something to do next; inf for never."""
        ...

    def advance_to(self, t_s: float) -> None:
        """Let time pass for line and block, and send what is due."""
        ...


class _Pty:
    """RTU behind a pseudo-terminal, whose other end is held open: it lives on while no host has it open."""

    def __init__(self, slave: RtuSlave) -> None:
        self._slave = slave
        self._pty, self.name = open_pty()

    def files(self) -> list[int]:
        return [self._pty]

    def serve(self, ready: set[int], t_s: float) -> None:
        if self._pty in ready:
            with contextlib.suppress(BlockingIOError):
                self._slave.send(os.read(self._pty, 4096), t_s)

    def forget(self) -> None:
        """A line has none."""

    def next_event_s(self) -> float:
        return self._slave.next_event_s()

    def advance_to(self, t_s: float) -> None:
        self._slave.advance_to(t_s)
        reply = self._slave.receive(t_s)
        if reply:
            with contextlib.suppress(BlockingIOError):  # nobody reads
                os.write(self._pty, reply)


class _Tcp:
    """A server on loopback, for a few hosts at a time."""

    def __init__(self, slave: TcpSlave, number: int) -> None:
        self._slave = slave
        self._open: dict[int, tuple[socket.socket, Stream]] = {}
        try:
            self._server = socket.create_server((LOOPBACK, number))
        except OSError as error:
            why = "another program has it" if error.errno == errno.EADDRINUSE else error.strerror
            raise EmulationError(
                f"port {number} of this machine: {why}; end what uses it, or give daq.port another"
            ) from error
        self._server.setblocking(False)
        self.name = f"tcp://{LOOPBACK}:{self._server.getsockname()[1]}"

    def files(self) -> list[int]:
        return [self._server.fileno(), *self._open]

    def serve(self, ready: set[int], t_s: float) -> None:
        for number in ready & self._open.keys():
            connection, stream = self._open[number]
            try:
                data = connection.recv(4096)
            except BlockingIOError:
                continue
            except ConnectionError:
                data = b""
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

    def forget(self) -> None:
        """Each connection ends with a reset, as where a segment comes that the device knows nothing of."""
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


class _Trace:
    """The truth over time as CSV; nothing without a file."""

    def __init__(self, file: TextIO | None, start_s: float) -> None:
        self._file = file
        self._start_s = start_s
        self.next_s = math.inf if file is None else 0.0
        if file is not None:
            file.write("t_s,drive_V,y_rad,v_rad_per_s,fault\n")

    def row(self, block: IoBlock) -> None:
        if self._file is None:
            return
        truth = block.truth()
        fault = 0 if truth.fault is None else block.registers.status_of[truth.fault]
        self._file.write(
            f"{self._start_s + truth.t_s:.6f},{truth.output_V:.6f},{truth.y_rad:.6f},{truth.v_rad_per_s:.6f},{fault}\n"
        )
        self._file.flush()

    def rows_to(self, t_s: float, block: IoBlock, port: _Port) -> None:
        """One row every 10 ms."""
        while self.next_s <= t_s:
            port.advance_to(self.next_s)
            self.row(block)
            self.next_s += _TRACE_S


def main() -> None:
    """Run until a signal, or until standard input ends where that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", required=True, help="as rig.backends.modbus.emulated.modbus_board packs it")
    parser.add_argument("--link", type=Path)
    parser.add_argument("--trace", type=Path)
    parser.add_argument("--exit-with-stdin", action="store_true")
    asked = parser.parse_args()
    ends = signals()
    try:
        with contextlib.ExitStack() as stack:
            file = None if asked.trace is None else stack.enter_context(asked.trace.open("w", encoding="utf-8"))
            start_s = time.monotonic()
            trace = _Trace(file, start_s)
            block, port = _device(unpacked(asked.device), trace)
            if asked.link is not None:
                stack.enter_context(linked(asked.link, port.name))
            sys.stdout.write(f"port {port.name}\n")
            sys.stdout.flush()
            take_priority()
            gc.freeze()
            _run(block, port, trace, start_s, ends, watches_stdin=asked.exit_with_stdin)
            block.power_off()
    except (OSError, EmulationError) as error:
        fail(str(error))


def _device(device: Device, trace: _Trace) -> tuple[IoBlock, _Port]:
    bench = Bench(device.bench, device.seed)
    block = IoBlock(device.registers, bench, device.unit, polarity=device.polarity, revision=VERSION)
    block.on_output = lambda t_s, u_V: trace.row(block)
    if device.tcp_port is not None:
        return block, _Tcp(TcpSlave(block, device.line.turnaround_s, device.misbehaviour), device.tcp_port)
    corruption = None if device.corruption is None else Corruption(*device.corruption)
    return block, _Pty(RtuSlave(block, device.line, device.misbehaviour, corruption))


def _run(block: IoBlock, port: _Port, trace: _Trace, start_s: float, ends: int, *, watches_stdin: bool) -> None:
    end_s, stdin = math.inf, sys.stdin.fileno()
    now_s = time.monotonic() - start_s
    while now_s < end_s:
        files = [ends, *port.files(), *([stdin] if watches_stdin else [])]
        until_s = min(port.next_event_s(), trace.next_s, end_s, now_s + _CATCH_UP_S)
        ready = set(select.select(files, [], [], max(until_s - now_s, 0.0))[0])
        now_s = time.monotonic() - start_s
        if ends in ready:
            if os.read(ends, 1)[0] != signal.SIGUSR1:
                return
            block.advance_to(now_s)
            block.power_cycle()
            port.forget()
        if stdin in ready and not os.read(stdin, 64):
            watches_stdin, end_s = False, now_s + ORPHAN_S
        trace.rows_to(now_s, block, port)
        port.serve(ready, now_s)
        port.advance_to(now_s)


if __name__ == "__main__":
    main()
