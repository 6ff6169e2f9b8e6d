"""What goes over the wire, as far as the test stand has to understand it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from rig.daq import frames
from rig.daq.frames import FrameReader, Kind, State


class Reading(NamedTuple):
    """A sample that the device has told of.

    key     that the record has in its column ``seq``
    counts  of the sensor
    is_well armed, and no fault latched
    """

    key: int
    counts: int
    is_well: bool


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
        state = State.unpack(packet.body)
        return Reading(packet.seq, state.counts, state.status & 3 == frames.STATUS_ARMED)


def is_drive(request: bytes) -> bool:
    """Whether a serial request is a DRIVE."""
    packet = _packet(request)
    return packet is not None and packet.kind == Kind.DRIVE


def _packet(frame: bytes) -> frames.Packet | None:
    packets = FrameReader().feed(frame)
    return packets[0] if packets else None
