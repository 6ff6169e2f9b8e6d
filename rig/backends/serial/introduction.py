"""The first exchange with a device behind a serial port: ask who it is until it answers, or refuses.

Opening the port restarts an Uno. Its boot loader hears the first bytes, perhaps at another baud rate. It must never
hear "program page", which erases a page of the firmware at once. So these requests go out byte by byte (docs/wire.md).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

from rig.backends.driver import Transport
from rig.backends.serial import frames
from rig.backends.serial.frames import Code, Hello, Kind, Nack, Packet
from rig.core.faults import Fault

STALE_READS = 64  # more than any port keeps
_HELLO_INTERVAL_S = 0.2
_LETTER_S = 0.004  # between two bytes of a spelled frame: several frames of USB, so that its chip does not join them
_PROGRAM_PAGE = 0x64  # to the boot loaders of Arduinos (STK500)


class Introduction(NamedTuple):
    """The device's HELLO_REPLY, the seq of the last HELLO (``requests``), and how many other replies came meanwhile."""

    hello: Hello
    requests: int
    stale_replies: int


def await_introduction(transport: Transport, reader: frames.FrameReader, timeout_s: float) -> Introduction:
    """Ask until the device introduces itself: it may be restarting, or in its boot loader.

    Raises Fault LINK_HELLO after ``timeout_s``, LINK_LOST, or the refusal of the device: LINK_VERSION, LINK_REJECTED.
    """
    for _ in range(STALE_READS):  # what an earlier run left behind; a device that never falls silent leaves more
        if not transport.read(0.0):
            break
    started_s = transport.now_s()
    requests = stale_replies = 0
    numbers = _harmless_numbers()
    while transport.now_s() - started_s < timeout_s:
        requests += 1
        seq = next(numbers)
        for packet in _spell(transport, reader, frames.encode(Kind.HELLO, seq)):
            if packet.version != frames.VERSION:
                raise Fault(
                    "LINK_VERSION", f"the device speaks version {packet.version}, this rig version {frames.VERSION}"
                )
            asked = 1 <= packet.seq <= seq
            if asked and packet.kind == Kind.NACK:
                raise refusal(packet)
            if asked and packet.kind == Kind.HELLO_REPLY:
                return Introduction(Hello.unpack(packet.body), seq, stale_replies)
            stale_replies += 1
    raise Fault("LINK_HELLO", f"{requests} requests in {timeout_s:g} s, {reader.bad_frames} damaged frames came back")


def _spell(transport: Transport, reader: frames.FrameReader, frame: bytes) -> Iterator[Packet]:
    """Send a frame byte by byte, each alone on the line, and give what is heard until the next request is due.

    A lone byte is over before a boot loader at a lower baud rate has read its last bits, which are then ones.
    """
    due_s = transport.now_s() + _HELLO_INTERVAL_S
    for byte in frame:
        transport.write(bytes((byte,)))
        yield from _heard(transport, reader, transport.now_s() + _LETTER_S)
    yield from _heard(transport, reader, due_s)


def _heard(transport: Transport, reader: frames.FrameReader, until_s: float) -> Iterator[Packet]:
    while (left_s := until_s - transport.now_s()) > 0.0:
        yield from reader.feed(transport.read(left_s))


def _harmless_numbers() -> Iterator[int]:
    """Sequence numbers of HELLOs in which nobody can read "program page" at their own baud rate, in any phase."""
    return (seq for seq in itertools.count(1) if not _reads_program_page(frames.encode(Kind.HELLO, seq)))


def _reads_program_page(frame: bytes) -> bool:
    """Whether a receiver that begins to listen anywhere in the bits of a frame can find that byte."""
    return "1" + _on_the_line(_PROGRAM_PAGE) in "1" + "".join(_on_the_line(byte) + "1" for byte in frame)


def _on_the_line(byte: int) -> str:
    """Start bit and data bits, the lowest first."""
    return "0" + f"{byte:08b}"[::-1]


def refusal(packet: Packet) -> Fault:
    """The fault that a NACK stands for."""
    nack = Nack.unpack(packet.body)
    try:
        request = Kind(nack.kind).name
    except ValueError:
        request = f"type {nack.kind}"
    code = "LINK_VERSION" if nack.code == Code.VERSION else "LINK_REJECTED"
    return Fault(code, f"{request} refused, {frames.code_name(nack.code)}, by a device of version {packet.version}")
