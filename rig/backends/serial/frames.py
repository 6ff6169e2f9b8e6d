"""Wire format of the serial link, version 2.

On the wire a frame is COBS(packet) followed by 0x00. A packet is, little-endian,

    version u8 | kind u8 | seq u16 | body | crc u16

with CRC-16/IBM-3740 (check value 0x29B1) over everything before it, and at most 64 bytes. The host
chooses ``seq``, the device echoes it. The firmware's side is firmware/core.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from enum import IntEnum
from typing import NamedTuple, Self

from cobs import cobs

from rig.core.signals import plain

VERSION = 2
MAX_PACKET = 64  # bytes, CRC included
NO_TACHOMETER = 0xFFFF

STATUS_ARMED = 1
STATUS_FAULT = 2  # a fault is latched
STATUS_RECOVERING = 4  # armed outside a hard limit: only inward drive passes
STATUS_LAW = 8  # a law in the device runs: the relay or the strokes
STATUS_ZERO = 16  # ZERO has said where the encoder stands
STATUS_ESTOP_TRIED = 32  # a device with an encoder: its e-stop has been open since the reset
STATUS_LOOPBACK = 64

FEATURE_TACHOMETER = 1
FEATURE_SUPPLY = 2
FEATURE_ENCODER = 4
FEATURE_PULSE = 32
FEATURE_LOOPBACK = 64
FEATURE_STROKES = 128
SUPPLY_UNIT_V = 20.0 / 255.0  # of the motor supply in HELLO
SUPPLY_FULL = 255  # the largest reading: so much or more

RESET_CAUSES = {1: "power-on", 2: "external", 4: "brown-out", 8: "watchdog"}
BOARDS = {1: "host", 2: "uno", 3: "pico"}
BRIDGES = {1: "pwm-dir", 2: "in1-in2"}  # what a board's outputs are wired for; 0: it has no such
EMULATED_BOARDS = frozenset({1})

_HEAD = struct.Struct("<BBH")
_CRC = struct.Struct("<H")
MAX_BODY = MAX_PACKET - _HEAD.size - _CRC.size
_MAX_STUFFED = MAX_PACKET + 1  # COBS adds one byte below 254


class Kind(IntEnum):
    """What a packet is. Below 0x80 from host to device, above from device to host."""

    HELLO = 0x01
    SETUP = 0x02
    ARM = 0x03
    READ = 0x04
    DRIVE = 0x05
    STOP = 0x06
    RELAY = 0x07
    KEEP = 0x08
    ACK = 0x0A
    STROKES = 0x0B
    ZERO = 0x0C
    LOOPBACK = 0x0D
    PULSE = 0x0E
    HELLO_REPLY = 0x81
    SETUP_REPLY = 0x82
    ARM_REPLY = 0x83
    STATE = 0x84
    STOP_REPLY = 0x86
    RELAY_REPLY = 0x87
    BLOCK = 0x89
    ACK_REPLY = 0x8A
    STROKES_REPLY = 0x8B
    ZERO_REPLY = 0x8C
    LOOPBACK_REPLY = 0x8D
    NACK = 0xFF


class Code(IntEnum):
    """Why the device refused a request, or which fault it latched."""

    NONE = 0
    VERSION = 1
    UNKNOWN_TYPE = 2
    BAD_LENGTH = 3
    NOT_ARMED = 4
    WATCHDOG = 5
    TRAVEL = 6
    SENSOR_RAIL = 7
    DRIVE_RANGE = 8
    SETUP_INVALID = 9
    NO_SETUP = 10
    POLARITY = 11
    E_STOP = 12
    END_SWITCH = 13
    RESET = 14
    SESSION = 15
    ENCODER_LOST = 16
    ENCODER_RATE = 17
    ENCODER_STILL = 18
    NO_ZERO = 19
    E_STOP_UNTRIED = 20
    LOOPBACK = 21


class LoopbackAct(IntEnum):
    """What a LOOPBACK asks for. LOOK: edges; SHARE: those, and shares; OPEN, CLOSE: the e-stop; HANG: the main loop."""

    END = 0
    BEGIN = 1
    LOOK = 2
    SHARE = 3
    OPEN = 4
    CLOSE = 5
    HANG = 6


def code_name(code: int) -> str:
    """The code in words for people, e.g. "code 6 (travel)"; also for codes this version does not know."""
    try:
        words = Code(code).name.lower().replace("_", " ")
    except ValueError:
        words = "unknown"
    return f"code {code} ({words})"


class Packet(NamedTuple):
    """One packet whose CRC is right. ``version`` may still be another than ours."""

    kind: int
    seq: int
    body: bytes
    version: int = VERSION


class Hello(NamedTuple):
    """Body of HELLO_REPLY.

    board        key of BOARDS
    reset_cause  bits of RESET_CAUSES
    bridge       key of BRIDGES; 0: none
    features     FEATURE_* bits: has a tachometer channel, measures the motor supply, counts an encoder, ends a drive
                 by itself, can look at its own outputs, runs strokes
    counts_max   largest reading of the position sensor, counts; 0: an encoder, which has none
    drive_full   drive units at full duty
    now_us       device clock, us, wraps at 2**32
    supply       the motor supply in SUPPLY_UNIT_V, where it is measured
    build        16 bytes of ASCII, zero padded
    """

    board: int
    reset_cause: int
    bridge: int
    features: int
    counts_max: int
    drive_full: int
    now_us: int
    supply: int
    build: bytes

    def pack(self) -> bytes:
        """The body's bytes; struct.error outside a field's range."""
        return _HELLO.pack(*self)

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """From a body of the right length (struct.error otherwise)."""
        return cls(*_HELLO.unpack(body))

    @property
    def build_text(self) -> str:
        """The firmware's build as text."""
        return plain(self.build.rstrip(b"\0").decode("ascii", "backslashreplace"))

    @property
    def reset_words(self) -> str:
        """The reset's causes in words, e.g. "power-on, brown-out"; "unknown" if no bit is set."""
        words = [name for bit, name in RESET_CAUSES.items() if self.reset_cause & bit]
        return ", ".join(words) or "unknown"


class Setup(NamedTuple):
    """Body of SETUP and of its read-back SETUP_REPLY.

    session                                      chosen by the host, 1 to 2**32 - 1; a reset of the device ends it
    hard_lo, hard_hi, rail_lo, rail_hi, centre   counts of the position sensor, 32 bits with sign; both rails of an
                                                 encoder are 0; -2**31 and 2**31 - 1 as hard limits: none
    max_drive                                    drive units, > 0
    watchdog_ms                                  1 to 1000
    polarity                                     +1: positive drive raises the counts; -1: lowers
    homing                                       1: limits from wherever an encoder was switched on; no relay
    """

    session: int
    hard_lo: int
    hard_hi: int
    rail_lo: int
    rail_hi: int
    centre: int
    max_drive: int
    watchdog_ms: int
    polarity: int
    homing: int = 0

    def pack(self) -> bytes:
        """The body's bytes; struct.error outside a field's range."""
        return _SETUP.pack(*self)

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """From a body of the right length (struct.error otherwise)."""
        return cls(*_SETUP.unpack(body))


class DeviceState(NamedTuple):
    """Body of STATE, STOP_REPLY, ACK_REPLY and ZERO_REPLY.

    t_sample_us  device time of the position sample, us, wraps at 2**32
    counts       position reading, 32 bits with sign
    tach         tachometer reading, NO_TACHOMETER where there is none
    t_drive_us   device time at which the drive now acting took effect, us
    drive        drive now at the pin, units
    drive_seq    seq of the DRIVE or PULSE frame last accepted
    status       STATUS_* bits
    fault        the first latched Code, or the code of the last refusal
    session      that SETUP has begun; 0: none since the device's reset
    """

    t_sample_us: int
    counts: int
    tach: int
    t_drive_us: int
    drive: int
    drive_seq: int
    status: int
    fault: int
    session: int = 0

    def pack(self) -> bytes:
        """The body's bytes; struct.error outside a field's range."""
        return _STATE.pack(*self)

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """From a body of the right length (struct.error otherwise)."""
        return cls(*_STATE.unpack(body))


class RelaySetup(NamedTuple):
    """Body of RELAY and of its read-back RELAY_REPLY: the dual-channel relay in the device (firmware/core/relay.h).

    drive      drive units of its four states: y >= 0 and z >= 0, y >= 0 > z, y < 0 <= z, both < 0
    centre     reading at y = 0, in 1/16 count, below 2**30 in size
    z_bound    bound on the integral, in 1/32 count tick, 1 to 2**30
    direction  +1: positions rise with the counts; -1: they fall
    rows       of a block, 1 to 10
    """

    drive: tuple[int, int, int, int]
    centre: int
    z_bound: int
    direction: int
    rows: int

    def pack(self) -> bytes:
        """The body's bytes; struct.error outside a field's range."""
        return _RELAY.pack(*self.drive, self.centre, self.z_bound, self.direction, self.rows)

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """From a body of the right length (struct.error otherwise)."""
        a, b, c, d, centre, z_bound, direction, rows = _RELAY.unpack(body)
        return cls((a, b, c, d), centre, z_bound, direction, rows)


class StrokesSetup(NamedTuple):
    """Body of STROKES and of its read-back STROKES_REPLY: the stroke test in the device (firmware/core/strokes.h).

    strokes       (drive units, turning point in counts) of each, an even number of 2 to MAX_STROKES, to and fro
    stroke_ticks  longest time of a stroke, 1 to MAX_STROKE_TICKS
    still_ticks   longest time for which the reading may stand still under one drive, 1 to MAX_STROKE_TICKS
    still_counts  readings less than this apart are one position, 1 to 65535
    rows          of a block, 1 to 10
    """

    strokes: tuple[tuple[int, int], ...]
    stroke_ticks: int
    still_ticks: int
    still_counts: int
    rows: int

    def pack(self) -> bytes:
        """The body's bytes; struct.error outside a field's range. Raises ValueError for more strokes than fit."""
        n = len(self.strokes)
        if n > MAX_STROKES:
            raise ValueError(f"a device takes at most {MAX_STROKES} strokes, not {n}")
        head = _STROKES.pack(n, self.rows, self.stroke_ticks, self.still_ticks, self.still_counts)
        return head + b"".join(_STROKE.pack(*stroke) for stroke in (*self.strokes, *((0, 0),) * (MAX_STROKES - n)))

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """From a body of the right length (struct.error otherwise)."""
        n, rows, stroke_ticks, still_ticks, still_counts = _STROKES.unpack_from(body)
        drives_and_turns = tuple((drive, turn) for drive, turn in _STROKE.iter_unpack(body[_STROKES.size :]))
        return cls(drives_and_turns[:n], stroke_ticks, still_ticks, still_counts, rows)


class Block(NamedTuple):
    """Body of BLOCK: ticks of a law in the device, sent unasked. The packet's seq counts blocks from 0.

    t_first_us  device time of the first row's sample, us; the others follow every ``period_us``
    delay_us    from a row's sample until its drive acts
    status      STATUS_* bits when the block was closed; without STATUS_LAW it is the last one
    fault       as in DeviceState
    session     as in DeviceState
    rows        (position reading, drive units from then on) of each tick; the last block may have none. On the wire a
                position is its 16-bit distance from the block's first
    """

    t_first_us: int
    period_us: int
    delay_us: int
    status: int
    fault: int
    session: int
    rows: tuple[tuple[int, int], ...]

    def pack(self) -> bytes:
        """The body's bytes; struct.error outside a field's range."""
        first = self.rows[0][0] if self.rows else 0
        return _BLOCK.pack(*self[:6], first) + b"".join(_ROW.pack(counts - first, u) for counts, u in self.rows)

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """From a body of a length that a block can have (struct.error otherwise)."""
        t_first_us, period_us, delay_us, status, fault, session, first = _BLOCK.unpack_from(body)
        rows = tuple((first + away, drive) for away, drive in _ROW.iter_unpack(body[_BLOCK.size :]))
        return cls(t_first_us, period_us, delay_us, status, fault, session, rows)


class LoopbackEnd(NamedTuple):
    """One output of the bridge and the end of its wire, in LOOPBACK_REPLY.

    wire_highs, pin_highs  of the looks: how often the wire's end, and the output itself, was high
    rises                  at the wire's end since the loop-back began, modulo 2**16
    last_us                device time of the last edge there, us
    """

    wire_highs: int
    pin_highs: int
    rises: int
    last_us: int


class Loopback(NamedTuple):
    """Body of LOOPBACK_REPLY: what a bare board sees of its own outputs.

    now_us    device clock, us, wraps at 2**32
    ticks     control ticks since the reset
    estop_us  device time at which the board last opened its e-stop, us
    looks     of a SHARE, else 0
    high      bits: the wires' ends now, in the order of ``ends``
    ends      of PWM or IN1; of direction or IN2
    """

    now_us: int
    ticks: int
    estop_us: int
    looks: int
    high: int
    ends: tuple[LoopbackEnd, LoopbackEnd]

    def pack(self) -> bytes:
        """The body's bytes; struct.error outside a field's range."""
        return _LOOPBACK.pack(*self[:5], *self.ends[0], *self.ends[1])

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """From a body of the right length (struct.error otherwise)."""
        now_us, ticks, estop_us, looks, high, *ends = _LOOPBACK.unpack(body)
        return cls(now_us, ticks, estop_us, looks, high, (LoopbackEnd(*ends[:4]), LoopbackEnd(*ends[4:])))


class Nack(NamedTuple):
    """Body of NACK: why, and the kind of the refused request."""

    code: int
    kind: int

    def pack(self) -> bytes:
        """The body's bytes; struct.error outside a field's range."""
        return _NACK.pack(*self)

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """From a body of the right length (struct.error otherwise)."""
        return cls(*_NACK.unpack(body))


_HELLO = struct.Struct("<BBBBIHIB16s")
_SETUP = struct.Struct("<IiiiiiHHbB")
_STATE = struct.Struct("<IiHIhHBBI")
_ARM = struct.Struct("<I")
_ACK = struct.Struct("<B")
_ZERO = struct.Struct("<i")
_LOOPBACK = struct.Struct("<IIIHBHHHIHHHI")
_NACK = struct.Struct("<BB")
_DRIVE = struct.Struct("<h")
_PULSE = struct.Struct("<hH")
_RELAY = struct.Struct("<hhhhiIbB")
_STROKES = struct.Struct("<BBHHH")
_STROKE = struct.Struct("<hi")
_BLOCK = struct.Struct("<IHHBBIi")
_ROW = struct.Struct("<hh")
BLOCK_ROWS = 10  # in a block, at most
MAX_STROKES = 8
MAX_STROKE_TICKS = 10_000
_STROKES_LENGTH = _STROKES.size + MAX_STROKES * _STROKE.size

BODY_LENGTH: dict[int, int] = {
    Kind.HELLO: 0,
    Kind.SETUP: _SETUP.size,
    Kind.ARM: _ARM.size,
    Kind.READ: 0,
    Kind.DRIVE: _DRIVE.size,
    Kind.STOP: 0,
    Kind.RELAY: _RELAY.size,
    Kind.KEEP: 0,
    Kind.ACK: _ACK.size,
    Kind.STROKES: _STROKES_LENGTH,
    Kind.ZERO: _ZERO.size,
    Kind.LOOPBACK: 1,
    Kind.PULSE: _PULSE.size,
    Kind.HELLO_REPLY: _HELLO.size,
    Kind.SETUP_REPLY: _SETUP.size,
    Kind.ARM_REPLY: 1,
    Kind.STATE: _STATE.size,
    Kind.STOP_REPLY: _STATE.size,
    Kind.RELAY_REPLY: _RELAY.size,
    Kind.ACK_REPLY: _STATE.size,
    Kind.STROKES_REPLY: _STROKES_LENGTH,
    Kind.ZERO_REPLY: _STATE.size,
    Kind.LOOPBACK_REPLY: _LOOPBACK.size,
    Kind.NACK: _NACK.size,
}


def pack_drive(units: int) -> bytes:
    """Body of DRIVE: signed drive units, -32768 to 32767 (struct.error outside)."""
    return _DRIVE.pack(units)


def pack_pulse(units: int, longest_ms: int) -> bytes:
    """Body of PULSE: drive units, and the longest time from the first PULSE on, ms (struct.error outside 16 bits)."""
    return _PULSE.pack(units, longest_ms)


def pack_arm(session: int) -> bytes:
    """Body of ARM: the session that SETUP has begun (struct.error outside 32 bits)."""
    return _ARM.pack(session)


def pack_ack(code: int) -> bytes:
    """Body of ACK: the fault that somebody has seen (struct.error outside 0 to 255)."""
    return _ACK.pack(code)


def pack_zero(counts: int) -> bytes:
    """Body of ZERO: what an encoder's present position reads from now on (struct.error outside 32 bits)."""
    return _ZERO.pack(counts)


def crc16(data: bytes) -> int:
    """CRC-16/IBM-3740: polynomial 0x1021, start 0xFFFF; 0x29B1 for b"123456789"."""
    return crc_hqx(data, 0xFFFF)


def encode(kind: int, seq: int, body: bytes = b"", version: int = VERSION) -> bytes:
    """One frame, ready for the wire, delimiter included.

    seq 0 to 65535; body at most MAX_BODY bytes. Raises ValueError on a longer body, struct.error
    on numbers outside their fields.
    """
    if len(body) > MAX_BODY:
        raise ValueError(f"a body has at most {MAX_BODY} bytes, not {len(body)}")
    packet = _HEAD.pack(version, kind, seq) + body
    frame: bytes = cobs.encode(packet + _CRC.pack(crc_hqx(packet, 0xFFFF)))
    return frame + b"\0"


class FrameReader:
    """Takes bytes as they arrive, gives the packets in them, drops what is damaged and counts it.

    bad_frames  frames dropped: COBS, length or CRC wrong. A damaged delimiter costs both its
                neighbours; the reader is in step again at the next intact one.
    """

    def __init__(self) -> None:
        self.bad_frames = 0
        self._pending = b""
        self._skipping = False  # the frame that is arriving is too long already

    def feed(self, data: bytes) -> list[Packet]:
        """Packets completed by ``data``, in order. Never raises on content."""
        if not data:
            return []
        *frames, rest = (self._pending + data).split(b"\0")
        packets = []
        for frame in frames:
            if self._skipping:
                self._skipping = False
            elif frame:  # two delimiters in a row are no frame
                packet = _decode(frame)
                if packet is None:
                    self.bad_frames += 1
                else:
                    packets.append(packet)
        if len(rest) > _MAX_STUFFED:
            if not self._skipping:
                self.bad_frames += 1
            self._skipping = True
        self._pending = b"" if self._skipping else rest
        return packets


def _decode(frame: bytes) -> Packet | None:
    """The packet in one stuffed frame without its delimiter, None if damaged."""
    if len(frame) > _MAX_STUFFED:
        return None
    try:
        packet = cobs.decode(frame)
    except cobs.DecodeError:
        return None
    size = len(packet)
    if size < _HEAD.size + _CRC.size or crc_hqx(packet[:-2], 0xFFFF) != int.from_bytes(packet[-2:], "little"):
        return None
    version, kind, seq = _HEAD.unpack_from(packet)
    body = packet[4:-2]
    if version == VERSION and not _may_be(kind, len(body)):
        return None
    return Packet(kind, seq, body, version)


def _may_be(kind: int, length: int) -> bool:
    """Whether a body of this kind can have this length; of an unknown kind, any."""
    if kind == Kind.BLOCK:
        rows, rest = divmod(length - _BLOCK.size, _ROW.size)
        return rest == 0 and 0 <= rows <= BLOCK_ROWS
    return length == BODY_LENGTH.get(kind, length)
