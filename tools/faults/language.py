"""What goes over the wire, as far as the test stand has to understand it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from rig.daq import frames
from rig.daq.frames import FrameReader, Kind, State
from rig.emulate.rtu_slave import check_sum


class Reading(NamedTuple):
    """A sample that the device has told of.

    key     that the record has in its column ``seq``
    counts  of the sensor
    reply   in which it came
    """

    key: int
    counts: int
    reply: bytes


class Language(Protocol):
    """Of one link. A request is what the host writes in one piece."""

    def replies(self, data: bytes) -> list[bytes]:
        """Whole replies, as they are completed by ``data``."""
        ...

    def asked(self, request: bytes) -> int | None:
        """Key of the sample that a request asks for."""
        ...

    def drive_V(self, request: bytes) -> float | None:
        """Drive that a request carries, V."""
        ...

    def is_stop(self, request: bytes) -> bool:
        """Whether a request says stop."""
        ...

    def reading(self, reply: bytes) -> Reading | None:
        """The sample in an intact reply."""
        ...


class SerialLanguage:
    """Frames of rig's firmware; ``unit_V`` is what one unit of its drive is."""

    def __init__(self, unit_V: float) -> None:
        self._unit_V = unit_V
        self._pending = b""

    def replies(self, data: bytes) -> list[bytes]:
        """Whole frames, delimiter included."""
        *whole, self._pending = (self._pending + data).split(b"\0")
        return [frame + b"\0" for frame in whole]

    def asked(self, request: bytes) -> int | None:
        """READ."""
        packet = _packet(request)
        return packet.seq if packet is not None and packet.kind == Kind.READ else None

    def drive_V(self, request: bytes) -> float | None:
        """DRIVE; a STOP is 0 V."""
        packet = _packet(request)
        if packet is None or packet.kind not in (Kind.DRIVE, Kind.STOP):
            return None
        return frames.unpack_drive(packet.body) * self._unit_V if packet.kind == Kind.DRIVE else 0.0

    def is_stop(self, request: bytes) -> bool:
        """STOP."""
        packet = _packet(request)
        return packet is not None and packet.kind == Kind.STOP

    def reading(self, reply: bytes) -> Reading | None:
        """STATE."""
        packet = _packet(reply)
        if packet is None or packet.kind != Kind.STATE:
            return None
        return Reading(packet.seq, State.unpack(packet.body).counts, reply)


class ModbusLanguage:
    """RTU frames of FC23 in a tick and FC06 to stop, for the register map of config/modbus-rtu.yaml.

    unit_V  what one unit of the drive register is
    """

    def __init__(self, unit_V: float) -> None:
        self._unit_V = unit_V
        self._asked = 0  # readings in the tick, which the record counts, too
        self._sequence = 0

    def replies(self, data: bytes) -> list[bytes]:
        """A reply arrives whole."""
        return [data] if data else []

    def asked(self, request: bytes) -> int | None:
        """FC23; the number that goes with the drive must come back."""
        if not _is_rtu(request, 23):
            return None
        self._asked += 1
        self._sequence = int.from_bytes(request[13:15], "big")
        return self._asked

    def drive_V(self, request: bytes) -> float | None:
        """The drive in FC23, and in FC06 to the drive register; a stop is 0 V."""
        if _is_rtu(request, 23):
            return int.from_bytes(request[11:13], "big", signed=True) * self._unit_V
        return 0.0 if self.is_stop(request) else None

    def is_stop(self, request: bytes) -> bool:
        """FC06, control to 0."""
        return _is_rtu(request, 6) and request[2:6] == bytes((0, 8, 0, 0))

    def reading(self, reply: bytes) -> Reading | None:
        """Registers 16 and 17: the position, and the number of the drive that was asked with."""
        if not _is_rtu(reply, 23) or int.from_bytes(reply[5:7], "big") != self._sequence:
            return None
        return Reading(self._asked, int.from_bytes(reply[3:5], "big"), reply)


def _is_rtu(frame: bytes, function: int) -> bool:
    return len(frame) >= 8 and frame[1] == function and check_sum(frame[:-2]) == frame[-2:]


def is_drive(request: bytes) -> bool:
    """Whether a serial request is a DRIVE."""
    packet = _packet(request)
    return packet is not None and packet.kind == Kind.DRIVE


def _packet(frame: bytes) -> frames.Packet | None:
    packets = FrameReader().feed(frame)
    return packets[0] if packets else None
