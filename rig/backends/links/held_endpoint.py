"""One master for each TCP device on this machine: whoever speaks to it holds its name, as a serial port is held.

A TCP device takes connections from anybody, so two runs could drive one motor. The name is that of a Unix socket in
Linux's abstract space: no file, one for all users, and gone with its process, however that ends. Another machine, a
container with a network of its own, and systems other than Linux do not see such names.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import socket
import struct
import sys
from typing import Final

from rig.backends.links.holder import process_in_words
from rig.core.copies import keep_from_copies, no_longer_own
from rig.core.faults import Fault

HERE: Final = "here"  # stands for every address of this machine
_PEER: Final = struct.Struct("3i")  # pid, uid, gid


class HeldEndpoint:
    """A unit behind host and port number, held until ``close``.

    Every address that the host's name has is held: whoever comes by another name of the device finds it held, too.
    Raises Fault LINK_OPEN where the name has no address; SECOND_MASTER, which says who holds the unit.
    """

    def __init__(self, host: str, port: int, unit: int) -> None:
        self._where = f"tcp://{host}:{port}, unit {unit}"
        self._behind = f"{port} {unit}"
        self._held: dict[str, socket.socket] = {}
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except OSError as error:
            raise Fault("LINK_OPEN", f"tcp://{host}:{port}: {error.strerror or error}") from error
        try:
            for *_, address in found:
                self.hold(str(address[0]))
        except BaseException:
            self.close()
            raise

    def hold(self, address: str) -> None:
        """Hold the unit at this address, too, if it is another one. Raises Fault SECOND_MASTER."""
        name = f"rig modbus {_one_text(address)} {self._behind}"
        if name in self._held or sys.platform != "linux":
            return
        one = self._held[name] = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            one.bind(f"\0{name}")
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise Fault("SECOND_MASTER", f"{self._where}: {_holder(name)}") from error
        keep_from_copies(one.fileno())
        one.listen()  # nobody accepts: whoever connects is told by the kernel who listens

    def close(self) -> None:
        """Let go. May be called twice."""
        for one in self._held.values():
            no_longer_own(one.fileno())
            one.close()
        self._held.clear()


def _one_text(address: str) -> str:
    """An address, always written alike; ``HERE`` if it is one of this machine."""
    ip = ipaddress.ip_address(address.partition("%")[0])  # without the interface of a link-local address
    if isinstance(ip, ipaddress.IPv6Address) and ip.ipv4_mapped is not None:
        ip = ip.ipv4_mapped
    return HERE if ip.is_loopback or ip.is_unspecified or _is_own(ip) else str(ip)


def _is_own(ip: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    """Whether this machine has the address: only then a socket can have it."""
    try:
        with socket.socket(socket.AF_INET if ip.version == 4 else socket.AF_INET6, socket.SOCK_DGRAM) as probe:
            probe.bind((str(ip), 0))
    except OSError:
        return False
    return True


def _holder(name: str) -> str:
    """Who has bound a name."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asked:
            asked.settimeout(0.5)
            asked.connect(f"\0{name}")
            pid, uid, _ = _PEER.unpack(asked.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))
    except OSError:
        return "another process of this machine holds it"
    words = process_in_words(pid) if pid else "a process of another container"
    return f"{words} holds it" if uid == os.getuid() else f"{words}, of user {uid}, holds it"
