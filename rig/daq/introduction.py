"""How a device behind a serial port is met: asked who it is until it says so, or refuses."""

from __future__ import annotations

from typing import NamedTuple

from rig.daq import frames
from rig.daq.driver import Transport
from rig.daq.frames import Code, Hello, Kind, Nack, Packet
from rig.faults import Fault

STALE_READS = 64  # more than any port keeps
_HELLO_INTERVAL_S = 0.2


class Introduction(NamedTuple):
    """What a device said of itself, after ``requests`` HELLOs of seq 1, 2, ..., and other replies meanwhile."""

    hello: Hello
    requests: int
    stale_replies: int


def await_introduction(transport: Transport, reader: frames.FrameReader, timeout_s: float) -> Introduction:
    """Ask until the device introduces itself: it may be restarting, or in its boot loader.

    Raises Fault LINK_HELLO after ``timeout_s``, LINK_VERSION, LINK_REJECTED or LINK_LOST.
    """
    for _ in range(STALE_READS):  # what an earlier run left behind; a device that never falls silent leaves more
        if not transport.read(0.0):
            break
    started_s = transport.now_s()
    requests = stale_replies = 0
    while transport.now_s() - started_s < timeout_s:
        requests += 1
        transport.write(frames.encode(Kind.HELLO, requests))
        again_s = transport.now_s() + _HELLO_INTERVAL_S
        while (left_s := again_s - transport.now_s()) > 0.0:
            for packet in reader.feed(transport.read(left_s)):
                if packet.version != frames.VERSION:
                    raise Fault(
                        "LINK_VERSION", f"the device speaks version {packet.version}, this rig version {frames.VERSION}"
                    )
                asked = 1 <= packet.seq <= requests
                if asked and packet.kind == Kind.NACK:
                    raise refusal(packet)
                if asked and packet.kind == Kind.HELLO_REPLY:
                    return Introduction(Hello.unpack(packet.body), requests, stale_replies)
                stale_replies += 1
    raise Fault("LINK_HELLO", f"{requests} requests in {timeout_s:g} s, {reader.bad_frames} damaged frames came back")


def refusal(packet: Packet) -> Fault:
    """What a NACK says."""
    nack = Nack.unpack(packet.body)
    try:
        request = Kind(nack.kind).name
    except ValueError:
        request = f"type {nack.kind}"
    code = "LINK_VERSION" if nack.code == Code.VERSION else "LINK_REJECTED"
    return Fault(code, f"{request} refused, {frames.code_name(nack.code)}, by a device of version {packet.version}")
