"""The emulated I/O block as a process in real time. Nothing here asserts how long anything takes."""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from modbus_device import (
    APPLIED,
    CONFIG,
    CONTROL,
    DRIVE,
    POSITION,
    SETTINGS,
    STATUS,
    WATCHDOG,
    emulated,
    modbus,
    read,
    read_write,
    words,
    write,
    write_one,
)
from processes import alive, rows, wait_until
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu.mei_message import ReadDeviceInformationResponse

from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.line_faults import Corruption
from rig.backends.modbus.emulated.modbus_board import ModbusBoard, mbpoll_line
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.tcp_slave import Adu, Stream
from rig.cli import main
from rig.core.package import VERSION

pytestmark = pytest.mark.realtime

LONG_WATCHDOG = (10_000, *SETTINGS[1:])

HOST = """
import sys, time
from pathlib import Path
from pymodbus.client import ModbusSerialClient
from rig.backends.modbus.emulated.modbus_board import ModbusBoard
from rig.backends.modbus.section import Modbus
from rig.config.schema import Emulated
board = ModbusBoard()
modbus, emulated = Modbus.model_validate({modbus}), Emulated.model_validate({emulated})
port = board.start(modbus, emulated, 1, link=Path(sys.argv[1]), trace=Path(sys.argv[2]))
print(board.pid, flush=True)
client = ModbusSerialClient(port, baudrate=115200)
client.connect()
client.write_registers(9, {settings}, device_id=1)
for k in range(10**6):
    if k <= 5:  # again, for a busy machine may have held this up for longer than the watchdog waits
        client.write_register(8, 1, device_id=1)
    client.write_register(0, 500, device_id=1)
    if k == 5:
        print("driving", flush=True)
"""


@contextlib.contextmanager
def stock_client(port: str) -> Iterator[ModbusSerialClient | ModbusTcpClient]:
    if port.startswith("tcp://"):
        host, number = port.removeprefix("tcp://").split(":")
        client: ModbusSerialClient | ModbusTcpClient = ModbusTcpClient(host, port=int(number), timeout=5)
    else:
        client = ModbusSerialClient(port, baudrate=115200, timeout=5)
    assert client.connect()
    try:
        yield client
    finally:
        client.close()  # type: ignore[no-untyped-call]  # has none in pymodbus


class Socket:
    """A bare connection that asks and waits."""

    def __init__(self, port: str, timeout_s: float = 20.0) -> None:
        host, number = port.removeprefix("tcp://").split(":")
        self.socket = socket.create_connection((host, int(number)), timeout=timeout_s)
        self._n = 0

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def ask(self, pdu: bytes, unit: int = 1) -> Adu:
        """The reply, which must be that to this request. Raises TimeoutError."""
        self._n += 1
        self.socket.sendall(Adu(self._n, unit, pdu).pack())
        stream, replies = Stream(), list[Adu]()
        while not replies:
            data = self.socket.recv(4096)
            assert data, "it hung up"
            replies = stream.feed(data)
        assert len(replies) == 1 and replies[0].transaction == self._n
        return replies[0]


def start(board: ModbusBoard, tcp: bool, **options: Any) -> str:
    return board.start(modbus(), emulated(), 1, tcp_port=0 if tcp else None, **options)


@pytest.mark.parametrize("tcp", [False, True], ids=["rtu", "tcp"])
def test_the_stock_client_reads_arms_and_drives_it(tcp: bool) -> None:
    with ModbusBoard() as board, stock_client(start(board, tcp)) as client:
        who = client.read_device_information(device_id=1)
        assert isinstance(who, ReadDeviceInformationResponse)
        assert who.information == {0: b"rig", 1: b"emulated I/O block", 2: VERSION.encode()}
        assert client.read_holding_registers(POSITION, count=4, device_id=1).registers == [512, 0, 0, 0]
        assert client.write_registers(WATCHDOG, list(LONG_WATCHDOG), device_id=1).count == 6
        assert client.read_holding_registers(WATCHDOG, count=6, device_id=1).registers == list(LONG_WATCHDOG)
        assert client.write_register(CONTROL, 1, device_id=1).registers == [1]

        def tick(drive: int, number: int) -> list[int]:
            reply = client.readwrite_registers(
                read_address=POSITION, read_count=4, write_address=DRIVE, values=[drive & 0xFFFF, number], device_id=1
            )
            return list(reply.registers)

        assert tick(500, 1)[1:] == [1, 500, 1]
        wait_until(lambda: tick(500, 2)[0] > 520)
        assert tick(-1, 3)[1:] == [3, 65535, 1]
        assert client.read_holding_registers(100, count=1, device_id=1).exception_code == 2
        assert client.read_coils(0, count=1, device_id=1).exception_code == 1
        assert client.write_register(CONTROL, 0, device_id=1).registers == [0]
        assert client.read_holding_registers(APPLIED, count=2, device_id=1).registers == [0, 0]


def test_the_stock_client_hears_nothing_of_another_unit() -> None:
    with ModbusBoard() as board:
        client = ModbusSerialClient(start(board, tcp=False), baudrate=115200, timeout=0.3, retries=0)
        assert client.connect()
        with pytest.raises(ModbusException, match="No response"):
            client.read_holding_registers(POSITION, count=1, device_id=2)
        assert client.read_holding_registers(POSITION, count=1, device_id=1).registers == [512]
        client.close()  # type: ignore[no-untyped-call]  # has none in pymodbus


@pytest.mark.parametrize("tcp", [False, True], ids=["rtu", "tcp"])
def test_the_line_that_is_printed_to_try_it_works(tcp: bool) -> None:
    with ModbusBoard() as board:
        command = mbpoll_line(modbus(), start(board, tcp), 115200).split()
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert [line.split() for line in done.stdout.splitlines() if line.startswith("[")] == [
        ["[16]:", "512"], ["[17]:", "0"], ["[18]:", "0"], ["[19]:", "0"]
    ]  # fmt: skip


def test_the_line_to_try_it_is_of_the_table_and_line_of_the_config() -> None:
    plain = modbus({"position": {"table": "input", "type": "int32", "address": 4}}, parity="even", unit=9)
    wanted = "mbpoll -m rtu -b 9600 -P even -s 1 -0 -1 -a 9 -t 3 -r 4 -c 16 /dev/ttyUSB0"
    assert mbpoll_line(plain, "/dev/ttyUSB0", 9600) == wanted


@pytest.mark.parametrize(
    ("config", "option", "says"),
    [
        ("modbus-rtu", "--chip", "the Uno, which does not speak Modbus"),
        ("modbus-tcp", "--link=x", "a TCP port cannot have a symbolic link"),
    ],
)
def test_the_command_refuses_what_the_device_has_not(config: str, option: str, says: str) -> None:
    done = CliRunner().invoke(main, ["emulate", str(CONFIG / f"{config}.yaml"), option])
    assert done.exit_code in (1, 2) and says in done.stderr


def test_a_killed_host_leaves_0_V_and_its_device_ends_with_it(tmp_path: Path) -> None:
    link, trace = tmp_path / "port", tmp_path / "trace.csv"
    script = HOST.format(
        modbus=modbus().model_dump(),
        emulated=emulated(fc_plus_V=5.0, fc_minus_V=5.0).model_dump(),
        settings=list(SETTINGS),
    )
    host = subprocess.Popen([sys.executable, "-c", script, str(link), str(trace)], stdout=subprocess.PIPE, text=True)
    assert host.stdout is not None
    with host.stdout:
        pid = int(host.stdout.readline())
        assert host.stdout.readline() == "driving\n"
        assert link.is_symlink() and alive(pid)
        host.kill()
        killed_s = time.monotonic()
        host.wait()
    wait_until(lambda: not alive(pid))
    assert not link.is_symlink()
    seen = rows(trace)
    times = [row["t_s"] for row in seen]
    assert times == sorted(times) and any(row["drive_V"] == pytest.approx(0.6) for row in seen)
    stopped = next(row for row in seen if row["t_s"] > killed_s and row["drive_V"] == 0.0)
    assert stopped["fault"] == 2.0 and seen[-1]["drive_V"] == 0.0  # its watchdog, before the process ended


def test_stopping_it_cuts_the_drive_and_removes_its_link(tmp_path: Path) -> None:
    link, trace = tmp_path / "port", tmp_path / "trace.csv"
    board = ModbusBoard()
    port = start(board, tcp=False, link=link, trace=trace)
    pid = board.pid
    assert str(link.readlink()) == port
    with pytest.raises(EmulationError, match="already runs"):
        start(board, tcp=False)
    with pytest.raises(EmulationError, match="is the link of a device that exists"):
        start(ModbusBoard(), tcp=False, link=link)
    with stock_client(str(link)) as client:
        client.write_registers(WATCHDOG, list(LONG_WATCHDOG), device_id=1)
        client.write_register(CONTROL, 1, device_id=1)
        client.write_register(DRIVE, 200, device_id=1)
    board.stop()
    board.stop()
    assert not alive(pid) and not link.is_symlink()
    assert rows(trace)[-2]["drive_V"] == pytest.approx(0.24) and rows(trace)[-1]["drive_V"] == 0.0


def test_what_cannot_start_says_why(tmp_path: Path) -> None:
    (tmp_path / "port").write_text("a file")
    with pytest.raises(EmulationError, match="exists and is not a symbolic link"):
        start(ModbusBoard(), tcp=False, link=tmp_path / "port")
    with pytest.raises(EmulationError, match="No such file"):
        start(ModbusBoard(), tcp=True, trace=tmp_path / "none" / "trace.csv")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        with pytest.raises(
            EmulationError, match=f"port {number} of this machine: another program has it; end that program"
        ):
            ModbusBoard().start(modbus(), emulated(), 1, tcp_port=number)
    with pytest.raises(EmulationError, match="cannot have a symbolic link"):
        start(ModbusBoard(), tcp=True, link=tmp_path / "other")
    with pytest.raises(EmulationError, match="uint16 cannot hold"):
        ModbusBoard().start(modbus({"position": {"scale": 0.001}}), emulated(), 1)


def test_tcp_answers_its_unit_and_the_two_that_mean_itself() -> None:
    with ModbusBoard() as board, Socket(start(board, tcp=True), timeout_s=0.5) as host:
        for unit in (1, 0, 255):
            reply = host.ask(read(POSITION, 1), unit)
            assert reply.unit == unit and words(reply.pdu) == [512]
        with pytest.raises(TimeoutError):
            host.ask(read(POSITION, 1), unit=2)


def test_tcp_takes_requests_in_pieces_and_several_at_once_and_from_several_hosts() -> None:
    with ModbusBoard() as board:
        port = start(board, tcp=True)
        with Socket(port) as one, Socket(port) as other:
            several = b"".join(Adu(n, 1, read(POSITION, 1)).pack() for n in (7, 8, 9))
            one.socket.sendall(several[:5])
            assert words(other.ask(read(STATUS, 1)).pdu) == [0]
            one.socket.sendall(several[5:])
            stream, got = Stream(), list[Adu]()
            while len(got) < 3:
                got += stream.feed(one.socket.recv(4096))
            assert [adu.transaction for adu in got] == [7, 8, 9]


@pytest.mark.parametrize("garbage", [b"GET / HTTP/1.0\r\n\r\n", b"\0\1\0\0\xff\xff\1\3", b"\0\1\0\0\0\1\1\3"])
def test_tcp_hangs_up_on_what_is_not_modbus_and_serves_on(garbage: bytes) -> None:
    with ModbusBoard() as board:
        port = start(board, tcp=True)
        with Socket(port) as host:
            host.socket.sendall(garbage)
            assert host.socket.recv(100) == b""
        with Socket(port) as host:
            assert words(host.ask(read(POSITION, 1)).pdu) == [512]


@pytest.mark.parametrize("kind", ["late", "wrong", "exception", "unit", "silent"])
def test_it_misbehaves_when_asked_to(kind: Any, tmp_path: Path) -> None:
    trace = tmp_path / "trace.csv"
    reply_fault = ReplyFault(kind, by_s=0.4)
    with ModbusBoard() as board, Socket(start(board, tcp=True, trace=trace, reply_fault=reply_fault)) as host:
        host.ask(write(WATCHDOG, *SETTINGS))
        host.ask(write_one(CONTROL, 1))
        if kind in ("late", "silent"):
            host.socket.settimeout(0.2)
            with pytest.raises(TimeoutError):
                host.ask(read_write(POSITION, 4, DRIVE, 500, 1))
        else:
            reply = host.ask(read_write(POSITION, 4, DRIVE, 500, 1))
            assert reply.unit == (99 if kind == "unit" else 1)
            assert reply.pdu[:2] == {"wrong": b"\x17\x06", "exception": b"\x97\x04", "unit": b"\x17\x08"}[kind]
        executed = kind in ("late", "wrong", "unit")
        wait_until(lambda: rows(trace)[-1]["fault"] == 2.0)  # the host asks no more
        assert any(row["drive_V"] > 0.0 for row in rows(trace)) == executed
        assert rows(trace)[-1]["drive_V"] == 0.0


def test_a_damaged_line_answers_less_and_executes_nothing_else(tmp_path: Path) -> None:
    with ModbusBoard() as board:
        port = start(board, tcp=False, disturbance=Corruption(1e6, 1), trace=tmp_path / "trace.csv")
        client = ModbusSerialClient(port, baudrate=115200, timeout=0.1, retries=0)
        assert client.connect()
        for _ in range(5):
            with contextlib.suppress(ModbusException):
                client.write_register(DRIVE, 500, device_id=1)
        client.close()  # type: ignore[no-untyped-call]  # has none in pymodbus
        board.stop()
    # every request or reply is damaged: what arrives whole is refused, for it is not armed
    assert {row["drive_V"] for row in rows(tmp_path / "trace.csv")} == {0.0}


def test_a_reply_is_one_header_and_its_data() -> None:
    packed = Adu(0x0102, 5, b"\x03\x02\x00\x07").pack()
    assert packed == struct.pack(">HHHB", 0x0102, 0, 5, 5) + b"\x03\x02\x00\x07"
    assert Stream().feed(packed) == [Adu(0x0102, 5, b"\x03\x02\x00\x07")]


@pytest.mark.parametrize("tcp", [False, True])
def test_its_reset_button_cuts_the_drive_disarms_it_and_ends_its_connections(tcp: bool, tmp_path: Path) -> None:
    trace = tmp_path / "trace.csv"
    with ModbusBoard() as board:
        port = board.start(modbus(), emulated(), 1, trace=trace, tcp_port=0 if tcp else None)

        def connect() -> ModbusSerialClient | ModbusTcpClient:
            client = (
                ModbusTcpClient("127.0.0.1", port=int(port.rsplit(":", 1)[1]))
                if tcp
                else ModbusSerialClient(port, baudrate=115200)
            )
            assert client.connect()
            return client

        client = connect()
        assert not client.write_registers(WATCHDOG, list(LONG_WATCHDOG), device_id=1).isError()
        client.write_register(CONTROL, 1, device_id=1)
        client.write_register(DRIVE, 800, device_id=1)
        assert client.read_holding_registers(STATUS, count=1, device_id=1).registers == [1]
        board.reset()
        wait_until(lambda: trace.read_text(encoding="ascii").splitlines()[-1].split(",")[1] == "0.000000")
        if tcp:
            assert isinstance(client.socket, socket.socket)
            with pytest.raises(OSError):
                client.socket.send(b"\0")
                client.socket.recv(1)
            client.close()  # type: ignore[no-untyped-call]  # has none in pymodbus
            client = connect()
        assert client.read_holding_registers(STATUS, count=1, device_id=1).registers == [0]
        board.check()
        client.close()  # type: ignore[no-untyped-call]  # has none in pymodbus
