"""Modbus TCP: the transport on a real socket, and every fault of a reply on the emulated I/O block."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from rig.backends.driver import Transport
from rig.backends.links.tcp_link import TcpTransport
from rig.backends.modbus.driver import ModbusDriver
from rig.backends.modbus.emulated.io_block import IoBlock
from rig.backends.modbus.opening import modbus_driver
from rig.config import load
from rig.core.faults import Fault

CONFIG = Path(__file__).resolve().parents[3] / "config" / "modbus-tcp.yaml"
EXPERIMENT = load(CONFIG)
Answer = Callable[[bytes, bytes], list[tuple[float, bytes]]]  # header and reply -> frames with their delays, s


class TcpBlock:
    """The I/O block behind a TCP transport in virtual time; replies go through ``answer``."""

    def __init__(self) -> None:
        assert EXPERIMENT.daq.modbus is not None
        assert EXPERIMENT.emulated is not None
        self.block = IoBlock.of(EXPERIMENT.daq.modbus, EXPERIMENT.emulated, 1)
        self.answer: Answer = lambda header, pdu: [(0.0, header + pdu)]
        self._going: list[tuple[float, bytes]] = []
        self._t_s = 0.0

    def write(self, data: bytes) -> None:
        assert int.from_bytes(data[4:6], "big") == len(data) - 6
        pdu = self.block.request(data[7:], self._t_s)
        header = data[:4] + (len(pdu) + 1).to_bytes(2, "big") + data[6:7]
        self._going += [(self._t_s + 0.001 + delay_s, frame) for delay_s, frame in self.answer(header, pdu)]

    def read(self, timeout_s: float) -> bytes:
        until_s = self._t_s + timeout_s
        self._going.sort(key=lambda going: going[0])
        self._t_s = max(self._t_s, min(until_s, self._going[0][0])) if self._going else until_s
        arrived = b"".join(frame for t_s, frame in self._going if t_s <= self._t_s)
        self._going = [going for going in self._going if going[0] > self._t_s]
        return arrived

    def now_s(self) -> float:
        return self._t_s

    def close(self) -> None:
        pass


@pytest.fixture
def line() -> TcpBlock:
    return TcpBlock()


@pytest.fixture
def driver(line: TcpBlock) -> ModbusDriver:
    transport: Transport = line
    driver = modbus_driver(EXPERIMENT.device, transport)
    assert driver.open().emulated
    driver.arm(EXPERIMENT.device.arming)
    for _ in range(3):
        tick(line, driver)
    assert line.block.output_V == pytest.approx(0.6, abs=0.001)
    return driver


def tick(line: TcpBlock, driver: ModbusDriver) -> None:
    line._t_s += 0.008
    driver.read()
    driver.write(0.6)


FAULTS: dict[str, tuple[Answer, str, str]] = {
    "later than the watchdog": (lambda h, p: [(0.3, h + p)], "LINK_TIMEOUT", "no reply"),
    "none": (lambda h, p: [], "LINK_TIMEOUT", "position, holding register 16"),
    "of the request before": (
        lambda h, p: [(0.0, (int.from_bytes(h[:2], "big") - 1).to_bytes(2, "big") + h[2:] + p)],
        "LINK_REPLY",
        "the reply is to request",
    ),
    "another unit": (lambda h, p: [(0.0, h[:6] + b"\x09" + p)], "LINK_UNIT", "unit 9 answered"),
    "another protocol": (lambda h, p: [(0.0, h[:2] + b"\0\1" + h[4:] + p)], "LINK_REPLY", "header"),
    "no length": (lambda h, p: [(0.0, h[:4] + b"\0\0" + h[6:] + p)], "LINK_REPLY", "header"),
    "exception": (
        lambda h, p: [(0.0, h[:4] + b"\0\3" + h[6:] + bytes((p[0] | 0x80, 4)))],
        "MODBUS_EXCEPTION",
        "device failure (4) at drive, holding register 0",
    ),
    "another function": (lambda h, p: [(0.0, h + b"\x04" + p[1:])], "LINK_REPLY", "of FC04"),
    "byte count": (lambda h, p: [(0.0, h + p[:1] + b"\x06" + p[2:])], "LINK_REPLY", "bytes came"),
    "half": (lambda h, p: [(0.0, (h + p)[:9])], "LINK_REPLY", "no whole reply"),
    "twice": (lambda h, p: [(0.0, 2 * (h + p))], "LINK_REPLY", "two answers"),
    "stale echo": (lambda h, p: [(0.0, h + p[:4] + bytes((p[4], p[5] ^ 1)) + p[6:])], "LINK_REPLY", "echo"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_reply_that_is_not_the_reply_is_a_fault_and_the_motor_stops(
    name: str, line: TcpBlock, driver: ModbusDriver
) -> None:
    answer, code, words = FAULTS[name]
    right = line.answer
    line.answer = answer
    with pytest.raises(Fault) as caught:
        tick(line, driver)
    assert caught.value.code == code
    assert words in caught.value.detail
    line.answer = right
    assert driver.safe_stop()
    assert (line.block.output_V, line.block.armed) == (0.0, False)


def test_pieces_of_a_reply_are_put_together(line: TcpBlock, driver: ModbusDriver) -> None:
    line.answer = lambda h, p: (
        [(0.0005 * k, bytes((byte,))) for k, byte in enumerate((h + p)[:9])] + [(0.005, (h + p)[9:])]
    )
    for _ in range(3):
        tick(line, driver)
    assert driver.link_statistics["stale_bytes"] == 0


# ---------------------------------------------------------------------- a real socket


def test_a_device_that_starts_late_and_does_not_know_who_it_is_can_be_opened(line: TcpBlock) -> None:
    asked = []

    def answer(header: bytes, pdu: bytes) -> list[tuple[float, bytes]]:
        asked.append(pdu[0] & 0x7F)
        if len(asked) == 1:
            return []  # nobody there yet
        if asked[-1] == 0x2B:
            return [(0.0, header[:4] + bytes((0, 3)) + header[6:7] + bytes((0xAB, 1)))]
        return [(0.0, header + pdu)]

    line.answer = answer
    assert modbus_driver(EXPERIMENT.device, line).open().board == "Modbus device"
    assert 0x2B in asked


def test_in_a_pause_late_replies_that_come_together_hold_the_right_one(line: TcpBlock, driver: ModbusDriver) -> None:
    """As after a lost packet, which TCP sends again after 0.2 s, with all that came after it."""
    assert driver.safe_stop()
    lost_s = line.now_s()
    line.answer = lambda header, pdu: [(max(lost_s + 0.2 - line.now_s(), 0.0), header + pdu)]
    assert driver.read().y_counts > 0
    assert line.now_s() == pytest.approx(lost_s + 0.201, abs=0.01)
    assert driver.link_statistics["stale_bytes"] > 0


@pytest.mark.realtime
def test_a_connection_carries_bytes_both_ways_and_says_when_it_is_dead() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
        accepted: list[socket.socket] = []
        thread = threading.Thread(target=lambda: accepted.append(server.accept()[0]))
        thread.start()
        transport = TcpTransport("127.0.0.1", number)
        thread.join()
        (peer,) = accepted
        assert transport._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert transport.read(0.0) == b""
        transport.write(b"abc")
        assert peer.recv(10) == b"abc"
        peer.sendall(b"def")
        assert transport.read(5.0) == b"def"
        peer.close()
        with pytest.raises(Fault, match=r"LINK_LOST.*hung up"):
            transport.read(5.0)
        transport.close()
        transport.close()
        with pytest.raises(Fault, match="LINK_LOST"):
            transport.write(b"abc")
        with pytest.raises(Fault, match="LINK_LOST"):
            transport.read(0.0)


@pytest.mark.realtime
def test_nobody_there_is_a_fault_of_opening() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
    with pytest.raises(Fault, match=rf"LINK_OPEN.*tcp://127.0.0.1:{number}"):
        TcpTransport("127.0.0.1", number, 1.0)
