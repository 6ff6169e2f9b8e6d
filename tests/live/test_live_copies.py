"""What a copy of this process, as a law may fork one, does not have: neither flag nor link of the run."""

from __future__ import annotations

import os
import pty
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rig.backends.links.held_endpoint import HeldEndpoint
from rig.backends.links.serial_port import SerialPort
from rig.backends.links.tcp_link import TcpTransport
from rig.run_folder.live.shared_page import MappedPage, OthersPage


@contextmanager
def copy() -> Iterator[int]:
    """A copy of this process that does nothing, for the block."""
    begun, begins = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.write(begins, b"1")
        signal.pause()
        os._exit(0)
    os.read(begun, 1)
    os.close(begun)
    os.close(begins)
    try:
        yield pid
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def test_a_page_is_nobodys_once_its_owner_is_gone_though_a_copy_of_him_lives(tmp_path: Path) -> None:
    begun, begins = os.pipe()
    owner = os.fork()
    if owner == 0:
        page = MappedPage(tmp_path / "page", b"")
        with copy() as pid:
            os.write(begins, pid.to_bytes(4, "little"))
            signal.pause()
        page.close()
    other = int.from_bytes(os.read(begun, 4), "little")
    with OthersPage(tmp_path / "page") as seen:
        owned = [seen.is_owned]
        os.kill(owner, signal.SIGKILL)
        os.waitpid(owner, 0)
        os.kill(other, 0)
        assert [*owned, seen.is_owned] == [True, False]
    os.kill(other, signal.SIGKILL)
    os.close(begun)
    os.close(begins)


def _port(_: socket.socket) -> Callable[[], SerialPort]:
    device = os.ttyname(pty.openpty()[1])
    return lambda: SerialPort(device)


def _unit(_: socket.socket) -> Callable[[], HeldEndpoint]:
    return lambda: HeldEndpoint("127.0.0.1", 502, 7)


def _block(served: socket.socket) -> Callable[[], TcpTransport]:
    return lambda: TcpTransport(*served.getsockname())


@pytest.mark.parametrize("link", [_port, _unit, _block])
def test_a_link_that_is_given_back_is_free_though_a_copy_of_its_holder_lives(
    link: Callable[[socket.socket], Callable[[], SerialPort | HeldEndpoint | TcpTransport]],
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as served:
        opened = link(served)
        first = opened()
        with copy():
            first.close()
            opened().close()


def test_a_connection_ends_with_its_holder_though_a_copy_of_him_lives() -> None:
    with socket.create_server(("127.0.0.1", 0)) as served:
        link = TcpTransport(*served.getsockname())
        peer, _ = served.accept()
        with peer, copy():
            link.close()
            peer.settimeout(60.0)
            assert peer.recv(1) == b""


def test_a_copy_does_not_lose_what_has_got_the_number_of_a_closed_link() -> None:
    link = SerialPort(os.ttyname(pty.openpty()[1]))
    number = link.descriptor
    read, write = os.pipe()
    link.close()
    os.dup2(write, number)
    pid = os.fork()
    if pid == 0:
        os.write(number, b"here")
        os._exit(0)
    os.waitpid(pid, 0)
    os.close(number)
    os.close(write)
    assert os.read(read, 8) == b"here"
    os.close(read)
