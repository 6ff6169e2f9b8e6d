"""The pyserial transport on a pseudo-terminal. No assertion on how long anything takes."""

import contextlib
import fcntl
import os
import pty
import subprocess
import sys
import termios
import tty
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from raised import fault_of
from serial.tools import list_ports

from rig.backends.links import open_link, serial_port
from rig.backends.links.holder import holder_of_file
from rig.backends.links.serial_port import SerialPort
from rig.backends.registry import unopened
from rig.config import Experiment, load
from rig.core.faults import Fault
from rig.core.heartbeat import KEEPER

_HOLDS = """
import sys
from rig.backends.links.serial_port import SerialPort
port = SerialPort(sys.argv[1])
print("holds it", flush=True)
sys.stdin.read()
"""
_TIOCGEXCL = 0x80045440  # of Linux: whether the kernel keeps others out; not in Python's termios


@pytest.fixture
def terminal() -> Iterator[tuple[dict[str, int], str]]:
    """(our end, the port's name) of a pseudo-terminal."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    ends = {"ours": ours, "theirs": theirs}
    yield ends, os.ttyname(theirs)
    for fd in ends.values():
        os.close(fd)


def test_bytes_both_ways(terminal: tuple[dict[str, int], str]) -> None:
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


def test_the_port_is_held_exclusively_by_each_link_to_it(terminal: tuple[dict[str, int], str], tmp_path: Path) -> None:
    """And who holds it is named: not this process, which stands for the device, and has both ends open."""
    _, name = terminal
    (link := tmp_path / "usb-Arduino_board-if00").symlink_to(name)
    with subprocess.Popen(
        [sys.executable, "-c", _HOLDS, link], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout is not None and holder.stdout.readline()
        for other in (name, str(link)):
            fault = fault_of(SerialPort, other)
            assert fault.code == "LINK_OPEN"
            assert fault.detail.startswith(f"{other}: process {holder.pid} (") and fault.detail.endswith(" holds it")
    SerialPort(name).close()


def test_of_a_run_and_its_keeper_the_run_is_named_and_what_to_do(tmp_path: Path) -> None:
    """A keeper that is alone soon lets go."""
    (port := tmp_path / "ttyUSB0").touch()
    (flag := tmp_path / "runs/one/stop.flag").parent.mkdir(parents=True)
    flag.touch()
    for pid, parent, name in ((12, 1, "rig"), (10, 12, KEEPER)):
        (open_files := tmp_path / f"proc/{pid}/fd").mkdir(parents=True)
        (open_files / "3").symlink_to(port)
        if name == "rig":
            (open_files / "4").symlink_to(flag)
        (tmp_path / f"proc/{pid}/cmdline").write_bytes(name.encode() + b"\0run\0servo.yaml\0")
        (tmp_path / f"proc/{pid}/status").write_text(f"Name:\t{name}\nPPid:\t{parent}\n")
    words = holder_of_file(str(port), tmp_path / "proc")
    assert words.startswith("process 12 (rig run servo.yaml)") and "Ctrl-C" in words and str(flag.parent) in words
    (tmp_path / "proc/12/fd/3").unlink()
    (tmp_path / "proc/10/status").write_text(f"Name:\t{KEEPER}\nPPid:\t1\n")
    words = holder_of_file(str(port), tmp_path / "proc")
    assert "process 10, rig's keeper" in words and "lets go within 30 s" in words


@pytest.mark.parametrize("is_real", [True, False])
def test_the_kernel_keeps_other_programs_out_of_a_real_port_while_it_is_open(
    terminal: tuple[dict[str, int], str], monkeypatch: pytest.MonkeyPatch, is_real: bool
) -> None:
    ends, name = terminal
    monkeypatch.setattr(serial_port, "_is_pseudo_terminal", lambda descriptor: not is_real)

    def is_exclusive() -> bool:
        return fcntl.ioctl(ends["theirs"], _TIOCGEXCL, bytes(4)) != bytes(4)

    port = SerialPort(name)
    assert is_exclusive() == is_real
    port.close()
    assert not is_exclusive()


def test_a_missing_port() -> None:
    with pytest.raises(Fault) as caught:
        SerialPort("/dev/no-such-port")
    assert caught.value.code == "LINK_OPEN"
    assert caught.value.detail == "/dev/no-such-port: No such file or directory"


def test_the_cable_is_pulled(terminal: tuple[dict[str, int], str]) -> None:
    ends, name = terminal
    port = SerialPort(name)
    os.close(ends.pop("ours"))
    for dead in (lambda: port.read(5.0), lambda: port.write(b"x")):
        with pytest.raises(Fault) as caught:
            dead()
        assert caught.value.code == "LINK_LOST"
    port.close()


def test_a_closed_port_is_dead_not_another_file(terminal: tuple[dict[str, int], str], tmp_path: Path) -> None:
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


def uno_at(port: str, adapter: str | None) -> Experiment:
    """The Uno's config with another port, and what it says of the adapter there."""
    data = load(Path(__file__).parents[2] / "config/uno.yaml").model_dump(mode="json", exclude_none=True)
    del data["daq"]["adapter"]
    data["daq"] |= {"port": port} | ({} if adapter is None else {"adapter": adapter})
    return Experiment.model_validate(data)


def plug_in(monkeypatch: pytest.MonkeyPatch, device: str, ids: tuple[int | None, int | None]) -> list[bool]:
    """A port with these USB ids; whether it is closed."""
    closed: list[bool] = []
    monkeypatch.setattr(list_ports, "comports", lambda: [SimpleNamespace(device=device, vid=ids[0], pid=ids[1])])
    monkeypatch.setattr(
        "rig.backends.serial.opening.SerialPort",
        lambda *_, **__: SimpleNamespace(close=lambda: closed.append(True), now_s=lambda: 0.0),
    )
    return closed


@pytest.mark.parametrize(
    ("ids", "adapter", "key"),
    [
        ((0x0403, 0x6001), "16u2", "set daq.adapter to ftdi,"),
        ((0x0403, 0x6001), "none", "set daq.adapter to ftdi,"),
        ((0x1A86, 0x7523), "native-usb", "set daq.adapter to ch340,"),
        ((0x2341, 0x0043), "ch340", "set daq.adapter to 16u2,"),
        ((0x2341, 0x0043), "none", "set daq.adapter to 16u2,"),
    ],
)
def test_an_adapter_slower_than_what_was_reckoned_with_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ids: tuple[int, int], adapter: str, key: str
) -> None:
    """By the port's own name, and by a link to it."""
    link = tmp_path / "usb-Arduino_clone-if00"
    link.symlink_to("/dev/ttyUSB9")
    for port in ("/dev/ttyUSB9", str(link)):
        closed = plug_in(monkeypatch, "/dev/ttyUSB9", ids)

        fault = fault_of(unopened(uno_at(port, adapter).device).__enter__)
        assert fault.code == "CONFIG_MISMATCH"
        assert port in fault.detail and f"{ids[0]:04x}:{ids[1]:04x}" in fault.detail
        assert f"({adapter}): {key}" in fault.detail
        assert closed == [True]


@pytest.mark.parametrize(
    ("ids", "adapter"),
    [
        ((0x2341, 0x8036), "16u2"),  # quicker
        ((0x2341, 0x0043), "16u2"),
        ((0x2341, 0x0043), None),  # by its name what it could be at worst
        ((0x1234, 0x5678), "none"),  # nobody knows
        ((None, None), "none"),
    ],
)
def test_an_adapter_that_is_quicker_or_unknown_is_taken(
    monkeypatch: pytest.MonkeyPatch, ids: tuple[int | None, int | None], adapter: str | None
) -> None:
    closed = plug_in(monkeypatch, "/dev/ttyACM9", ids)
    with unopened(uno_at("/dev/ttyACM9", adapter).device):
        assert closed == []


def test_a_port_that_keeps_on_does_not_hang_up_when_it_is_closed() -> None:
    ours, theirs = os.openpty()
    try:
        name = os.ttyname(theirs)
        for keeps_on in (False, True):
            attributes = termios.tcgetattr(theirs)
            attributes[2] |= termios.HUPCL
            termios.tcsetattr(theirs, termios.TCSANOW, attributes)
            port = SerialPort(name)
            if keeps_on:
                port.keep_on()
            port.close()
            assert bool(termios.tcgetattr(theirs)[2] & termios.HUPCL) != keeps_on
    finally:
        os.close(ours)
        os.close(theirs)


def test_bytes_that_a_keeper_has_read_are_no_dead_port(
    terminal: tuple[dict[str, int], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has the same open port: it may be quicker once both have seen that there is something."""
    port = SerialPort(terminal[1])
    looks: list[tuple[list[int], list[int], list[int]]] = [([port.descriptor], [], []), ([], [], [])]
    monkeypatch.setattr(open_link, "select", SimpleNamespace(select=lambda *_: looks.pop(0)))
    assert port.read(0.0) == b""
    port.close()
