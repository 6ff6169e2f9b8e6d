"""The wire formats, as far as fault injection has to understand them."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from rig.backends.modbus.emulated.rtu_slave import check_sum
from rig.backends.serial import frames
from rig.backends.serial.frames import BODY_LENGTH, Block, DeviceState, FrameReader, Kind

_STARTS = (Kind.RELAY, Kind.STROKES)  # of a law in the device
_TO_KIND = 3  # bytes of a frame from which its kind is known
_BESIDE_BODY = 8  # bytes of a frame: head, check sum, what COBS adds, delimiter
_FASTER = 0.97  # a device's bytes may take so much of the nominal time: an Uno's at 115,200 baud take 0.98

ASKED = -1


def _units(body: bytes) -> int:
    """The drive that a request carries."""
    return int.from_bytes(body, "little", signed=True)


class Reading(NamedTuple):
    """A sample that the device has sent.

    key     its number in the column ``seq`` of samples.csv
    counts  reading of the sensor
    reply   bytes that brought it
    row     row within a block of the relay in the device, from 0; ASKED for the reply to a request
    """

    key: int
    counts: int
    reply: bytes
    row: int = ASKED


class Language(Protocol):
    """The wire format of one link. A request is what the host writes in one piece."""

    def replies(self, data: bytes) -> list[bytes]:
        """Whole replies, as they are completed by ``data``."""
        ...

    def to_come_s(self) -> float:
        """Time from now until shortly before the last byte of the reply that is arriving, at least, s."""
        ...

    def asked(self, request: bytes) -> int | None:
        """Key of the sample that a request asks for."""
        ...

    def drive_V(self, request: bytes) -> float | None:
        """Drive that a request carries, V; nan where it lets the device choose."""
        ...

    def is_stop(self, request: bytes) -> bool:
        """Whether a request says stop."""
        ...

    def is_arm(self, request: bytes) -> bool:
        """Whether a request allows drive from now on."""
        ...

    def hands_over(self, request: bytes) -> bool:
        """Whether a request lets a law in the device drive from now on."""
        ...

    def readings(self, reply: bytes) -> list[Reading]:
        """The samples in an intact reply."""
        ...


class SerialLanguage:
    """Frames of rig's firmware.

    unit_V  what one unit of its drive is
    byte_s  that a byte takes on the wire; 0: a device in whose time a reply is not waited for
    """

    def __init__(self, unit_V: float, byte_s: float = 0.0) -> None:
        self._unit_V = unit_V
        self._byte_s = _FASTER * byte_s
        self._pending = b""
        self._next_block: float = 0  # that is due; inf where one is missing

    def replies(self, data: bytes) -> list[bytes]:
        """Whole frames, delimiter included."""
        *whole, self._pending = (self._pending + data).split(b"\0")
        return [frame + b"\0" for frame in whole]

    def to_come_s(self) -> float:
        """As far as the frame says; a first byte is waited for as ever."""
        have = len(self._pending)
        if have == 0:
            return 0.0
        whole = _TO_KIND + 1
        if have >= _TO_KIND and self._pending[0] >= _TO_KIND:  # what COBS has not changed
            whole = _BESIDE_BODY + BODY_LENGTH.get(self._pending[2], 0)
        return max(whole - have - 1, 0) * self._byte_s

    def asked(self, request: bytes) -> int | None:
        """READ."""
        packet = _packet(request)
        return packet.seq if packet is not None and packet.kind == Kind.READ else None

    def drive_V(self, request: bytes) -> float | None:
        """DRIVE, or PULSE while it lasts; a STOP is 0 V; RELAY, STROKES and KEEP let the device choose."""
        packet = _packet(request)
        if packet is not None and packet.kind in (*_STARTS, Kind.KEEP):
            self._next_block = 0 if packet.kind in _STARTS else self._next_block
            return math.nan
        if packet is None or packet.kind not in (Kind.DRIVE, Kind.PULSE, Kind.STOP):
            return None
        if packet.kind == Kind.PULSE:
            return _units(packet.body[:2]) * self._unit_V
        return _units(packet.body) * self._unit_V if packet.kind == Kind.DRIVE else 0.0

    def is_stop(self, request: bytes) -> bool:
        """STOP."""
        packet = _packet(request)
        return packet is not None and packet.kind == Kind.STOP

    def is_arm(self, request: bytes) -> bool:
        """ARM."""
        packet = _packet(request)
        return packet is not None and packet.kind == Kind.ARM

    def hands_over(self, request: bytes) -> bool:
        """RELAY, STROKES."""
        packet = _packet(request)
        return packet is not None and packet.kind in _STARTS

    def readings(self, reply: bytes) -> list[Reading]:
        """STATE; BLOCK if it is the next one. After a missing block, no further block is recorded."""
        packet = _packet(reply)
        if packet is not None and packet.kind == Kind.STATE:
            return [Reading(packet.seq, DeviceState.unpack(packet.body).counts, reply)]
        if packet is None or packet.kind != Kind.BLOCK or packet.seq < self._next_block:
            return []
        if packet.seq > self._next_block:
            self._next_block = math.inf
            return []
        self._next_block += 1
        rows = Block.unpack(packet.body).rows
        return [Reading(packet.seq, counts, reply, row) for row, (counts, _) in enumerate(rows)]


class ModbusLanguage:
    """Requests and replies for the register map of config/modbus-rtu.yaml: FC23 in a tick, or FC03 and then FC16.

    unit_V    what one unit of the drive register is
    separate  a tick reads, then writes
    tcp       frames of Modbus TCP; else of RTU
    bare      of that map only drive, sequence and position are there: a drive arms it, one of 0 by itself is a stop
    """

    def __init__(self, unit_V: float, *, separate: bool = False, tcp: bool = False, bare: bool = False) -> None:
        self._unit_V = unit_V
        self._stop = _NO_DRIVE if bare else _STOP
        self._bare = bare
        self._reply_bytes = 4 if bare else 8
        self._looks = bytes((3, 0, 16, 0, self._reply_bytes // 2))
        self._was_armed = False
        self._confirms = False  # the next look is at whether it has stopped
        self._is_poll = False  # the last request was a reading in a pause, which the column seq counts too
        self._reads = bytes((3, 0, 16, 0, 4)) if separate else bytes((23,))
        self._pdu = _tcp_pdu if tcp else _rtu_pdu
        self._tcp = tcp
        self._separate = separate
        self._asked = 0  # readings in the tick, which the recording counts, too
        self._sequence = 0
        self._armed = False
        self._in_a_tick = not separate  # FC23 is only asked in one
        self._pending = b""

    def replies(self, data: bytes) -> list[bytes]:
        """On a line a reply arrives whole; of a stream what its header says."""
        if not self._tcp:
            return [data] if data else []
        self._pending += data
        whole = []
        while len(self._pending) >= (length := 6 + int.from_bytes(self._pending[4:6], "big")) > 6:
            whole.append(self._pending[:length])
            self._pending = self._pending[length:]
        return whole

    def to_come_s(self) -> float:
        """None: what arrives is whole, or a segment."""
        return 0.0

    def asked(self, request: bytes) -> int | None:
        """What asks for the position in a tick; the number that went with the drive must come back."""
        pdu = self._pdu(request)
        if self.is_arm(request) or self.is_stop(request):
            self._armed, self._in_a_tick = self.is_arm(request), not self._separate
            self._was_armed |= self._armed
            self._confirms = not self._bare
        self._is_poll = False
        if pdu == self._looks and not self._armed and self._was_armed:
            self._is_poll, self._confirms = not self._confirms, False
        if pdu[:1] in (_FC16, _FC23):
            self._sequence = int.from_bytes(pdu[-2:], "big")
        if not pdu.startswith(self._reads):
            return None
        if not self._in_a_tick:
            self._in_a_tick = self._armed  # the first one after arming looks whether it is
            return None
        self._asked += 1
        return self._asked

    def drive_V(self, request: bytes) -> float | None:
        """The drive in FC23 and FC16; a stop is 0 V."""
        pdu = self._pdu(request)
        if pdu[:1] in (_FC16, _FC23):
            return int.from_bytes(pdu[-4:-2], "big", signed=True) * self._unit_V
        return 0.0 if self.is_stop(request) else None

    def is_stop(self, request: bytes) -> bool:
        """FC06, control to 0; without control the drive."""
        return self._pdu(request) == self._stop

    def is_arm(self, request: bytes) -> bool:
        """FC06, control to 1; without control FC16, a drive outside the tick."""
        pdu = self._pdu(request)
        return pdu[:1] == _FC16 if self._bare else pdu == _ARM

    def hands_over(self, request: bytes) -> bool:
        """Never."""
        return False

    def readings(self, reply: bytes) -> list[Reading]:
        """Registers 16 and 17: the position, and the number of the drive that was asked with, or the last one."""
        pdu = self._pdu(reply)
        if self._is_poll:
            self._asked += pdu[:2] == bytes((3, self._reply_bytes))
            self._is_poll = False
            return []
        if (
            pdu[:2] != self._reads[:1] + bytes((self._reply_bytes,))
            or int.from_bytes(pdu[4:6], "big") != self._sequence
        ):
            return []
        return [Reading(self._asked, int.from_bytes(pdu[2:4], "big"), reply)]


_FC16, _FC23 = bytes((16,)), bytes((23,))
_ARM, _STOP = bytes((6, 0, 8, 0, 1)), bytes((6, 0, 8, 0, 0))
_NO_DRIVE = bytes((6, 0, 0, 0, 0))


def _rtu_pdu(frame: bytes) -> bytes:
    """Function code and data of a whole frame; empty of anything else."""
    return frame[1:-2] if len(frame) >= 8 and check_sum(frame[:-2]) == frame[-2:] else b""


def _tcp_pdu(frame: bytes) -> bytes:
    return frame[7:] if len(frame) >= 9 and int.from_bytes(frame[4:6], "big") == len(frame) - 6 else b""


def is_drive(request: bytes) -> bool:
    """Whether a serial request is a DRIVE, or a Modbus one writes some registers (FC16)."""
    packet = _packet(request)
    return (packet is not None and packet.kind == Kind.DRIVE) or _rtu_pdu(request)[:1] == b"\x10"


def is_block(reply: bytes) -> bool:
    """Whether a serial reply is a BLOCK."""
    packet = _packet(reply)
    return packet is not None and packet.kind == Kind.BLOCK


def is_keep(request: bytes) -> bool:
    """Whether a serial request is a KEEP."""
    packet = _packet(request)
    return packet is not None and packet.kind == Kind.KEEP


def _packet(frame: bytes) -> frames.Packet | None:
    packets = FrameReader().feed(frame)
    return packets[0] if packets else None
