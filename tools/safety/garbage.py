"""What is no frame, or no longer one, never moves the drive; and what of that rests on the CRC alone."""

from __future__ import annotations

import random
from itertools import combinations
from typing import NamedTuple

from cobs import cobs

from rig.backends.serial.frames import STATUS_ARMED, DeviceState, FrameReader, Kind, encode, pack_drive
from safety.driven_chip import UNO, DrivenChip, Stand, Way

_CHUNK = 8  # pieces of garbage between two looks: the chip has room for 255 bytes
_CHUNK_FRAMES = 50  # in less than the watchdog's time


class Thrown(NamedTuple):
    """Garbage at an armed chip that stands at 0 V.

    moves  of the drive
    """

    baud: int
    pieces: int
    moves: int


class Errors(NamedTuple):
    """Of all errors of one and of two bits in DRIVE frames on the wire, how many gave a valid frame."""

    frames: int
    errors: int
    taken: int


class Guesses(NamedTuple):
    """DRIVE frames that are right but for a CRC drawn at random: how many the chip took."""

    frames: int
    taken: int


def _drive(rng: random.Random, stand: Stand = UNO) -> bytes:
    units = rng.choice((1, -1)) * rng.randint(1, stand.setup.max_drive)
    return encode(Kind.DRIVE, rng.randrange(2**16), pack_drive(units))


def piece(rng: random.Random, stand: Stand = UNO) -> bytes:
    """Noise, a frame with wrong bits, a frame cut short, two frames run into one, or a burst within a frame."""
    frame, other = _drive(rng, stand), _drive(rng, stand)
    kind = rng.randrange(5)
    if kind == 0:
        return rng.randbytes(rng.randint(1, 90))
    if kind == 1:
        damaged = bytearray(frame)
        for bit in rng.sample(range(8 * (len(frame) - 1)), rng.randint(1, 4)):
            damaged[bit // 8] ^= 1 << bit % 8
        return bytes(damaged)
    if kind == 2:
        return frame[: rng.randrange(1, len(frame) - 1)] + b"\0"
    if kind == 3:
        cut = rng.randrange(1, len(frame) - 1)
        joined = frame[:cut] + other[rng.randrange(1, len(other) - 1) :]
        return joined if joined not in (frame, other) else b"\0"
    at = rng.randrange(1, len(frame) - 1)
    size = rng.randint(1, len(frame) - 1 - at)
    return frame[:at] + bytes(b ^ rng.randint(1, 255) for b in frame[at : at + size]) + frame[at + size :]


def _armed(baud: int, rng: random.Random, stand: Stand = UNO) -> DrivenChip:
    driven = DrivenChip(Way(baud=baud, stand=stand), rng)
    driven.arm()
    return driven


def throw(baud: int, pieces: int, seed: int = 1, stand: Stand = UNO) -> Thrown:
    """Throw ``pieces`` at the chip, which is asked now and then so that it stays armed."""
    rng = random.Random(f"{seed} {baud}")
    driven = _armed(baud, rng, stand)
    changed_s, moves = driven.truth().pin_changed_s, 0
    for _ in range(pieces // _CHUNK):
        driven.write(b"\0" + b"".join(piece(rng, stand) for _ in range(_CHUNK)) + b"\0")
        driven.wait_for_wire()
        truth = driven.truth()
        if truth.pin_changed_s != changed_s:
            moves, changed_s = moves + 1, truth.pin_changed_s
        if DeviceState.unpack(driven.ask(Kind.READ).body).status != STATUS_ARMED:
            raise RuntimeError("the chip is no longer armed: garbage proves nothing")
    return Thrown(baud, pieces // _CHUNK * _CHUNK, moves)


def errors(frames: int, seed: int = 1) -> Errors:
    """Every error of one and two bits, by the wire format's decoder."""
    rng = random.Random(seed)
    count = taken = 0
    for _ in range(frames):
        frame = _drive(rng)
        size = len(frame) - 1
        sent = int.from_bytes(frame[:size], "big")
        masks = [1 << bit for bit in range(8 * size)]
        for mask in [*masks, *(a | b for a, b in combinations(masks, 2))]:
            count += 1
            taken += bool(FrameReader().feed((sent ^ mask).to_bytes(size, "big") + b"\0"))
    return Errors(frames, count, taken)


def guesses(frames: int, seed: int = 1) -> Guesses:
    """Frames with a CRC drawn at random; each that is taken drives."""
    rng = random.Random(seed)
    driven = _armed(115200, rng)
    taken = 0
    for _ in range(frames // _CHUNK_FRAMES):
        driven.ask(Kind.READ)  # keeps it armed at 0 V
        changed_s = driven.truth().pin_changed_s
        for _ in range(_CHUNK_FRAMES):
            packet: bytes = cobs.decode(_drive(rng)[:-1])
            driven.write(cobs.encode(packet[:-2] + rng.randbytes(2)) + b"\0")
        driven.wait_for_wire()
        if driven.truth().pin_changed_s != changed_s:
            taken += 1
            driven.send(Kind.DRIVE, pack_drive(0))
            driven.wait_for_wire()
    return Guesses(frames // _CHUNK_FRAMES * _CHUNK_FRAMES, taken)
