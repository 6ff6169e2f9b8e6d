"""Faults of the answers on a servo bus: late, lost, cut short, from another id, with an alert, or none executed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rig.backends.servo.emulated.servo import EmulatedServo

Kind = Literal["late", "lost", "deaf", "short", "id", "alert"]


@dataclass
class ReplyFault:
    """A fault of the answers of one servo: what, from when, and how often.

    kind     late: by ``by_s``. lost: executed, not answered. deaf: neither executed nor answered. short: a data byte
             too few. id: as from ``id``. alert: with an error that the servo has not: Dynamixel's alert, all bits that
             Feetech names
    servo    whose answers
    after_s  begin: time since its torque was first on
    times    number of answers that it affects; None: all
    """

    kind: Kind
    servo: int = 1
    after_s: float = 0.0
    times: int | None = None
    by_s: float = 0.02
    id: int = 99

    def strikes(self, servo: EmulatedServo) -> bool:
        """Whether the answer to a request that this servo hears now has the fault; it counts."""
        if servo.id != self.servo or self.times == 0 or servo.bench.armed_for_s < self.after_s:
            return False
        if self.times is not None:
            self.times -= 1
        return True
