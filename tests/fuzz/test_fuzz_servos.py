"""A million damaged packets of both servo protocols, to the codecs and to the emulated buses: none escapes."""

from __future__ import annotations

import random
from typing import Any

import pytest
from evidence import evidence

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.emulated.bus import ServoBus
from rig.backends.servo.emulated.servo import ServoOptions
from rig.backends.servo.packets import Skipped

SERVOS = {
    dynamixel: (ServoOptions(id=1, registers={"return_delay_time": 0}), ServoOptions(model="xl430-w250", id=2)),
    feetech: (ServoOptions(model="sts3215", id=1), ServoOptions(model="sts3250", id=2)),
}
IDS = (0, 1, 1, 1, 2, 2, 252, 254, 254)
ADDRESSES = (0, 5, 7, 8, 11, 33, 40, 44, 48, 55, 62, 64, 98, 100, 116, 120, 132, 147, 240)
NASTY = (0x00, 0x01, 0x02, 0x55, 0x7F, 0x80, 0xFD, 0xFE, 0xFF)


def packet(draw: random.Random, codec: Any) -> bytes:
    """One of any instruction, with parameters that now and then mean something; sometimes damaged."""
    code = draw.choice([*codec.Instruction, draw.randrange(256)])
    parameters = bytes(
        draw.choice((draw.choice(NASTY), draw.randrange(256))) for _ in range(draw.choice((0, 1, 2, 4, 9)))
    )
    if draw.random() < 0.7:
        address = draw.choice(ADDRESSES)
        parameters = address.to_bytes(2 if codec is dynamixel else 1, "little") + parameters
    wire = bytearray(codec.Frame(draw.choice(IDS), code, parameters).encode())
    damage = draw.randrange(8)
    if damage == 0:
        wire[draw.randrange(len(wire))] ^= 1 << draw.randrange(8)
    elif damage == 1:
        del wire[draw.randrange(len(wire))]
    elif damage == 2:
        at = draw.randrange(len(wire))
        wire[at:at] = bytes((draw.choice(NASTY),))
    elif damage == 3:
        del wire[draw.randrange(len(wire)) :]
    return bytes(wire)


@pytest.mark.parametrize("packets", [2_000, *evidence(1_000_000)])
@pytest.mark.parametrize("codec", [dynamixel, feetech])
def test_packets_to_the_codec(codec: Any, packets: int) -> None:
    """Every byte is told, in its order; what is taken for a packet is one."""
    draw = random.Random(36)
    stream = codec.Stream()
    for begins in range(0, packets, 50):
        wire = b"".join(packet(draw, codec) for _ in range(50))
        taken: list[Any] = []
        at = 0
        while at < len(wire):
            length = draw.choice((1, 3, 20, 200))
            taken += stream.feed(wire[at : at + length])
            at += length
        taken += stream.flush()
        assert b"".join(t.data if isinstance(t, Skipped) else t.encode() for t in taken) == wire, begins
        frames = [t for t in taken if not isinstance(t, Skipped)]
        assert frames, begins
        for frame in frames:
            assert codec.Stream().feed(frame.encode()) == [frame]


@pytest.mark.parametrize("packets", [2_000, *evidence(1_000_000)])
@pytest.mark.parametrize("codec", [dynamixel, feetech])
def test_packets_to_the_bus(codec: Any, packets: int) -> None:
    """Servos live on: whatever came, they are pinged after each hundred; each answer is a packet where nobody spoke."""
    draw = random.Random(37)
    bus, t_s = ServoBus(SERVOS[codec]), 0.0
    for _ in range(0, packets, 100):
        for _ in range(100):
            bus.send(packet(draw, codec), t_s)
            t_s += draw.choice((0.0, 1e-4, 2e-3))
            bus.advance_to(t_s)
        if not _finds_both(bus, codec, t_s + 0.25):
            bus = ServoBus(SERVOS[codec])  # its ids, bauds or return levels are others now
            assert _finds_both(bus, codec, 0.1), "a new bus answers"
        t_s = bus.t_s
        bus.log.clear()
        bus.violations.clear()


def _finds_both(bus: ServoBus, codec: Any, t_s: float) -> bool:
    bus.advance_to(t_s)
    bus.receive(t_s)
    found = []
    for id in (1, 2):
        bus.send(codec.ping(id), bus.t_s)
        bus.advance_to(bus.t_s + 0.01)
        taken = codec.Stream().feed(bus.receive(bus.t_s))
        assert not any(isinstance(t, Skipped) for t in taken)
        found += [t.id for t in taken]
    return found == [1, 2]
