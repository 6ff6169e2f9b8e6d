"""One packet goes wrong, at each exchange of an opening, a run and its end: no torque stays on, and no register."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import pytest
from evidence import evidence
from servo_bench import PROTOCOLS, Bench

from rig.backends.emulated.line_faults import Direction
from rig.backends.servo import dynamixel
from rig.core.faults import Fault

Arriving = Sequence[tuple[float, bytes]]

LATE_S = (0.005, 0.03, 0.15, 0.25)
TWICE_S = (0.0005, 0.0012, 0.002, 0.11)
KINDS: list[tuple[str, float]] = [
    ("request lost", 0), ("reply lost", 0), ("damaged", 0), ("another id", 9), ("error", 1), ("error", 4),
    ("wrong", 1), ("wrong", 64), *(("late", s) for s in LATE_S), *(("twice", s) for s in TWICE_S),
]  # fmt: skip
HARMLESS_V, MOST_V = 0.03, 0.42  # of the watchdog's proof; of the run
MOST = 300  # more than all exchanges with the servo


class OnePacket:
    """Spoils one exchange with the servo, by its number; ``count``: those so far."""

    def __init__(self, bench: Bench, number: int, kind: str, by: float) -> None:
        self.count, self._number, self._kind, self._by = 0, number, kind, by
        self._id, self._is_dynamixel = bench.own.id, bench.setup.model.protocol == "dynamixel"

    def __call__(self, direction: Direction, data: bytes, t_s: float) -> Arriving:
        id_at, said_at, check = (4, 8, 2) if self._is_dynamixel else (2, 4, 1)
        is_request = direction == "request"
        if data[id_at] != self._id:
            return ((0.0, data),)
        self.count += is_request
        if self.count != self._number or is_request != (self._kind == "request lost"):
            return ((0.0, data),)
        if self._kind in ("request lost", "reply lost"):
            return ()
        if self._kind in ("late", "twice"):
            return ((self._by, data),) if self._kind == "late" else ((0.0, data), (self._by, data))
        spoilt, at = bytearray(data), {"another id": id_at, "error": said_at}.get(self._kind, said_at + 1)
        if at >= len(data) - check and self._kind == "wrong":
            return ((0.0, data),)  # it brings nothing that could be wrong
        if self._kind == "damaged":
            spoilt[-1] ^= 0x10
            return ((0.0, bytes(spoilt)),)
        spoilt[at] = spoilt[at] ^ round(self._by) if self._kind == "wrong" else round(self._by)
        body = bytes(spoilt[:-check])
        if self._is_dynamixel:
            return ((0.0, body + dynamixel.crc16(body).to_bytes(2, "little")),)
        return ((0.0, body + bytes((~sum(body[2:]) & 0xFF,))),)


def spoilt_at(protocol: str, number: int, kind: str, by: float) -> bool:
    """Whether a run had such an exchange; after it all is as it was, or is once the next run has ended."""
    bench = Bench(protocol)
    for name, value in {"position_p_gain": 123, "position_d_gain": 77}.items():  # somebody's own tuning
        bench.servo.put(name, value)
    before, armed_s = bench.registers(), math.inf
    one = bench.bus.bus.disturbance = OnePacket(bench, number, kind, by)
    with contextlib.suppress(Fault):
        bench.driver.open()
        bench.driver.arm(bench.limits)
        armed_s = bench.bus.now_s()
        for u_V in (0.4, 0.4, -0.4, -0.4):
            bench.tick(u_V)
        bench.driver.safe_stop()
        bench.driver.arm(bench.limits)
        bench.tick(0.2)
    assert bench.driver.safe_stop() or not bench.servo.is_on
    bench.driver.close()
    assert not bench.servo.is_on and bench.wrong() == []
    if bench.store.load(bench.setup.model) is not None:
        bench.bus.bus.disturbance = None
        bench.another().open()
        bench.driver.close()
    assert bench.registers() == before and bench.store.load(bench.setup.model) is None
    assert max(abs(volts) for t_s, volts in bench.bus.outputs[0] if t_s <= armed_s) <= HARMLESS_V
    assert max(abs(volts) for _, volts in bench.bus.outputs[0]) <= MOST_V
    return one.count >= number


@pytest.mark.parametrize(("protocol", "kind", "by", "step"), [
    *((p, kind, by, 61) for p in PROTOCOLS for kind, by in (("twice", 0.0012), ("request lost", 0))),
    ("feetech", "wrong", 1, 61),
    *evidence(*((p, kind, by, 1) for p in PROTOCOLS for kind, by in KINDS if p == "feetech" or kind != "wrong")),
])  # fmt: skip
def test_one_packet_that_goes_wrong_anywhere_leaves_nothing_on_and_nothing_changed(
    protocol: str, kind: str, by: float, step: int
) -> None:
    """A Dynamixel's wrong answer with the right CRC is one in 65536 of those that are damaged: no promise is made."""
    for number in range(27 if step > 1 else 1, MOST, step):
        if not spoilt_at(protocol, number, kind, by):
            break
