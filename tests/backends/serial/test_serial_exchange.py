"""One request and its reply, where the host stands still between the two."""

from __future__ import annotations

from rig.backends.serial import frames
from rig.backends.serial.exchange import Exchange
from rig.backends.serial.frames import Kind


class StoodStill:
    """A port whose reply arrived while its host was stopped for a second."""

    def __init__(self, *, answers: bool) -> None:
        self.t_s = 0.0
        self._answers = answers
        self._arrived = b""

    def write(self, data: bytes) -> None:
        self.t_s += 1.0
        self._arrived = frames.encode(Kind.NACK, 1, bytes(frames.BODY_LENGTH[Kind.NACK])) if self._answers else b""

    def read(self, timeout_s: float) -> bytes:
        assert timeout_s >= 0.0
        self.t_s += 0.0 if self._arrived else timeout_s
        arrived, self._arrived = self._arrived, b""
        return arrived

    def now_s(self) -> float:
        return self.t_s

    def close(self) -> None:
        pass


def test_a_reply_that_arrived_while_the_host_was_stopped_counts() -> None:
    exchange = Exchange(StoodStill(answers=True), 0.03)
    seq = exchange.send(Kind.READ, b"")
    packet = exchange.wait([seq], Kind.STATE, until_s=0.03)  # that was a second ago
    assert packet is not None and packet.seq == seq


def test_silence_is_a_time_out_all_the_same() -> None:
    exchange = Exchange(StoodStill(answers=False), 0.03)
    assert exchange.wait([exchange.send(Kind.READ, b"")], Kind.STATE, until_s=0.03) is None
