"""A million damaged answers of both protocols to the driver: none lets a shaft move unasked, or escapes."""

from __future__ import annotations

import contextlib
import random
from typing import Any, cast

import pytest
from evidence import evidence
from servo_bench import PROTOCOLS, Bench

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.core.faults import Fault


class Damaging:
    """The servo of a ready config, without a motor: what it would drive acts at once. A transport and its clock.

    share    of its answers that are damaged; ``answers`` counts those
    """

    def __init__(self, protocol: str, seed: int) -> None:
        self.bench = Bench(protocol, setup={"brakes": False})
        self.bus, self.servo = self.bench.bus.bus, cast(Any, self.bench.servo)
        self.codec = cast(Any, {"dynamixel": dynamixel, "feetech": feetech}[protocol])
        self.bench.bus = cast(VirtualServoBus, self)
        self.draw, self.share, self.answers = random.Random(seed), 0.0, 0
        self._t_s, self._answer, self._stream = 0.0, b"", self.codec.Stream()
        self._is_plugged = True

    def write(self, data: bytes) -> None:
        self._t_s += 1e-3
        servo, roles = self.servo, self.servo.model.roles
        if "tick" in roles:
            servo.put(roles["tick"], round(1e3 * self._t_s) % 32768)
        for frame in self._stream.feed(data):
            if frame.id == servo.id and (status := servo.instruct(frame)) is not None:
                self._answer = self.codec.status(servo.id, status.data, status[1])
            servo.put(roles["applied"], servo.of("drive") if servo.is_on else 0)
        if self._answer and self.draw.random() < self.share:
            self._damage()

    def _damage(self) -> None:
        """Bits are others, a byte is lost or added, the end is lost, or an answer comes once more."""
        draw, wire = self.draw, bytearray(self._answer)
        at = draw.randrange(len(wire))
        for _ in range(draw.choice((1, 1, 2, 8))):
            wire[draw.randrange(len(wire))] ^= 1 << draw.randrange(8)
        ways = (wire, wire[:at] + wire[at + 1 :], wire[:at] + draw.randbytes(1) + wire[at:], wire[:at], 2 * wire)
        self._answer = bytes(draw.choice(ways))
        self.answers += 1

    def read(self, timeout_s: float) -> bytes:
        answer, self._answer = self._answer, b""
        self._t_s += 0.0 if answer else max(timeout_s, 0.0)
        return answer

    def now_s(self) -> float:
        return self._t_s

    def close(self) -> None:
        """It stays as it is."""


@pytest.mark.parametrize(("answers", "seed"), [(2_000, 0), *evidence(*((200_000, seed) for seed in range(1, 6)))])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_of_damaged_answers_come_faults_alone(protocol: str, answers: int, seed: int) -> None:
    """A stop that is told is one, torque never goes on with another duty than 0, and the registers are put back."""
    line = Damaging(protocol, seed)
    driver, before = line.bench.another(), line.bench.registers()
    driver.open()
    while line.answers < answers:
        line.share = line.draw.choice((0.02, 0.1, 0.3))
        with contextlib.suppress(Fault):
            driver.arm(line.bench.limits)
            for k in range(20):
                driver.read()
                driver.write(0.4 if k % 4 < 2 else -0.4)
        assert not driver.safe_stop() or not line.servo.is_on
        line.share = 0.0
        assert driver.safe_stop() and not line.servo.is_on
    driver.close()
    assert line.bench.registers() == before and line.bus.violations == []
