"""What a tick over Modbus costs beyond the wire: rig's driver, pymodbus's own client and a bare client, in one run.

PYTHONPATH=tools python -m bench.modbus_latency [--json] [--rounds N]

All three write drive and sequence number and read four registers by one FC23. Each has a slave of its own, all the same
program on libmodbus (tests/backends/modbus/libmodbus_slave), which answers at once; RTU behind a pseudo-terminal, which
has no wire time, and TCP on loopback. They take turns, each exchange after a pause as a loop has it. The bare client
writes a finished request and waits for as many bytes as the reply has: the wire and the slave, nothing else.
"""

from __future__ import annotations

import gc
import json
import os
import select
import socket
import statistics
import sys
import time
import tty
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from bench.benchmark import options, tell
from rig.backends.registry import connect
from rig.config import load

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from libmodbus_peer import EXAMPLE_MAP, LibmodbusSlave  # noqa: E402

PAUSE_S = 0.003  # more than the silence that RTU asks for between frames
WARM_UP = 20
GOAL_MS = 0.5
TIMEOUT_S = 0.5
# read 4 registers from 16, write 2 from 0: drive 0, sequence 0
REQUEST = bytes.fromhex("17 0010 0004 0000 0002 04 0000 0000")
REPLY_BYTES = 2 + 2 * 4

Exchange = Callable[[], object]


def crc16(data: bytes) -> bytes:
    """CRC-16/MODBUS as RTU appends it."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


def bare(slave: LibmodbusSlave, stack: ExitStack) -> Exchange:
    """Finished bytes out, as many bytes back as the reply has."""
    if slave.port.startswith("tcp://"):
        host, port = slave.port.removeprefix("tcp://").split(":")
        link = stack.enter_context(socket.create_connection((host, int(port))))
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        fd = link.fileno()
        request = bytes([0, 1, 0, 0, 0, 1 + len(REQUEST), 1]) + REQUEST
        expected = 7 + REPLY_BYTES
    else:
        fd = os.open(slave.port, os.O_RDWR | os.O_NOCTTY)
        stack.callback(os.close, fd)
        tty.setraw(fd)
        request = b"\x01" + REQUEST
        request += crc16(request)
        expected = 1 + REPLY_BYTES + 2

    def exchange() -> bytes:
        os.write(fd, request)
        reply = b""
        while len(reply) < expected:
            if not select.select([fd], [], [], TIMEOUT_S)[0]:
                raise TimeoutError(f"the slave at {slave.port} does not answer the bare client")
            reply += os.read(fd, 256)
        return reply

    return exchange


def stock(slave: LibmodbusSlave, stack: ExitStack) -> Exchange:
    """Pymodbus's own synchronous client."""
    client: ModbusSerialClient | ModbusTcpClient
    if slave.port.startswith("tcp://"):
        host, port = slave.port.removeprefix("tcp://").split(":")
        client = ModbusTcpClient(host, port=int(port), timeout=TIMEOUT_S, retries=0)
    else:
        client = ModbusSerialClient(slave.port, baudrate=115200, timeout=TIMEOUT_S, retries=0)
    if not client.connect():
        raise ConnectionError(f"pymodbus does not connect to {slave.port}")
    stack.callback(client.close)

    def exchange() -> None:
        reply = client.readwrite_registers(read_address=16, read_count=4, write_address=0, values=[0, 0], device_id=1)
        if reply.isError():
            raise RuntimeError(f"the slave refuses pymodbus: {reply}")

    return exchange


def ours(slave: LibmodbusSlave, stack: ExitStack) -> Exchange:
    """Rig's driver, as `rig run` opens it for config/modbus-rtu.yaml: one sample."""
    experiment = load(ROOT / "config" / "modbus-rtu.yaml")
    daq = experiment.daq.model_copy(update={"port": slave.port, "timeout_s": TIMEOUT_S})
    experiment = experiment.model_copy(update={"daq": daq})
    driver = stack.enter_context(connect(experiment.device)).driver
    driver.arm(replace(experiment.device.arming, watchdog_s=1.0))
    return driver.read


CLIENTS = {"bare": bare, "rig": ours, "pymodbus": stock}


def measured_ms(kind: str, rounds: int) -> dict[str, list[float]]:
    """Times of the exchanges of each client, which take turns."""
    with ExitStack() as stack:
        exchanges = {
            name: client(stack.enter_context(LibmodbusSlave(kind, *EXAMPLE_MAP)), stack)
            for name, client in CLIENTS.items()
        }
        times: dict[str, list[float]] = {name: [] for name in exchanges}
        names = list(exchanges)
        gc.collect()
        gc.disable()
        for k in range(WARM_UP + rounds):
            for name in names:
                time.sleep(PAUSE_S)
                begin = time.perf_counter()
                exchanges[name]()
                taken_s = time.perf_counter() - begin
                if k >= WARM_UP:
                    times[name].append(1e3 * taken_s)
            names.append(names.pop(0))  # none always comes after the same one
        gc.enable()
        return times


def summary(times: dict[str, list[float]]) -> dict[str, float]:
    """Medians, 99th percentiles, and what they are beyond the bare client's."""
    median = {name: statistics.median(values) for name, values in times.items()}
    p99 = {name: statistics.quantiles(values, n=100)[98] for name, values in times.items()}
    result = {}
    for name in times:
        result[f"{name}_median_ms"] = median[name]
        result[f"{name}_p99_ms"] = p99[name]
    for name in ("rig", "pymodbus"):
        result[f"{name}_overhead_median_ms"] = median[name] - median["bare"]
        result[f"{name}_overhead_p99_ms"] = p99[name] - p99["bare"]
    result["rig_over_bare"] = median["rig"] / median["bare"]
    result["pymodbus_over_rig"] = median["pymodbus"] / median["rig"]
    return result


def main() -> int:
    """Both links, one after the other."""
    parser = options("A tick over Modbus beyond the wire.")
    parser.add_argument("--rounds", type=int, default=500)
    arguments = parser.parse_args()
    result: dict[str, object] = {"rounds": arguments.rounds, "goal_rig_overhead_median_ms": GOAL_MS}
    for name, kind in (("rtu_pty", "rtu"), ("tcp_loopback", "tcp")):
        result[name] = summary(measured_ms(kind, arguments.rounds))
    tell(result, as_json=arguments.json, text=json.dumps(result, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
