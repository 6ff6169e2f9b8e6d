"""The pyserial transport on a pseudo-terminal. No assertion on how long anything takes."""

import contextlib
import os
import pty
import tty

import pytest

from rig.daq.serial_port import SerialPort
from rig.faults import Fault


@pytest.fixture
def terminal():
    """(our end, the port's name) of a pseudo-terminal."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    ends = {"ours": ours, "theirs": theirs}
    yield ends, os.ttyname(theirs)
    for fd in ends.values():
        os.close(fd)


def test_bytes_both_ways(terminal):
    ends, name = terminal
    port = SerialPort(name)
    assert port.read(0.0) == b""
    every_byte = bytes(range(256))
    port.write(every_byte)
    assert os.read(ends["ours"], 512) == every_byte
    os.write(ends["ours"], every_byte)
    received = b""
    while len(received) < 256:
        received += port.read(5.0)
    assert received == every_byte
    assert port.now_s() <= port.now_s()
    assert port.low_latency is False  # a pseudo-terminal has no such mode
    port.close()


def test_the_port_is_held_exclusively(terminal):
    _, name = terminal
    port = SerialPort(name)
    with pytest.raises(Fault) as caught:
        SerialPort(name)
    assert caught.value.code == "LINK_OPEN"
    assert caught.value.detail == f"{name}: another program holds it"
    port.close()
    SerialPort(name).close()


def test_a_missing_port():
    with pytest.raises(Fault) as caught:
        SerialPort("/dev/no-such-port")
    assert caught.value.code == "LINK_OPEN"
    assert caught.value.detail == "/dev/no-such-port: No such file or directory"


def test_the_cable_is_pulled(terminal):
    ends, name = terminal
    port = SerialPort(name)
    os.close(ends.pop("ours"))
    for dead in (lambda: port.read(5.0), lambda: port.write(b"x")):
        with pytest.raises(Fault) as caught:
            dead()
        assert caught.value.code == "LINK_LOST"
    port.close()


def test_a_closed_port_is_dead_not_another_file(terminal, tmp_path):
    """Files opened later get its number; nothing may be written to them."""
    _, name = terminal
    port = SerialPort(name)
    port.close()
    port.close()
    with contextlib.ExitStack() as stack:
        files = [stack.enter_context((tmp_path / f"{k}").open("w+b")) for k in range(8)]
        for dead in (lambda: port.read(0.0), lambda: port.write(b"x")):
            with pytest.raises(Fault) as caught:
                dead()
            assert caught.value.code == "LINK_LOST"
        assert all(file.read() == b"" for file in files)
