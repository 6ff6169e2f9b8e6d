"""A host that stands still at random while its device runs on, in virtual time."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from emulated_chips.virtual_chip import VirtualChip
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.serial.emulated.virtual_board import VirtualBoard

_BEFORE_WRITE = 0.3  # share of the stalls that hold back a drive already decided


@dataclass(frozen=True)
class Stalls:
    """Stalls of the host: ``a_minute`` on average, each ``least_s`` to ``most_s`` long."""

    a_minute: float = 5.0
    least_s: float = 0.03
    most_s: float = 0.2


class HostileHost:
    """A virtual device whose host stands still at random: every call may return late. Port and clock in one.

    Most stalls begin while the host sleeps or waits for a byte. Some wait for the next frame that it sends: there law
    and guard have decided, and the drive goes out late.

    device  powered on; used through this from now on
    """

    absolute = True  # of the clock

    def __init__(self, device: VirtualBoard | VirtualChip | VirtualPico, stalls: Stalls, seed: int) -> None:
        self.device = device
        self.lengths_s: list[float] = []  # of the stalls so far
        self.furthest_rad = 0.0  # that the shaft itself has been from zero, at any call
        self._stalls = stalls
        self._random = random.Random(seed)
        self._next_s = self._until_next_s()
        self._held_s = 0.0

    def write(self, data: bytes) -> None:
        """Hand ``data`` to the wire, perhaps late. Raises Fault LINK_LOST when unplugged."""
        held_s, self._held_s = self._held_s, 0.0
        if held_s > 0.0:
            self.device.sleep_until(self.now_s() + held_s)
        self.device.write(data)

    def read(self, timeout_s: float) -> bytes:
        """As the device's; the host may look at it late. Raises Fault LINK_LOST when unplugged."""
        data = self.device.read(timeout_s)
        self._stand_still()
        self.furthest_rad = max(self.furthest_rad, abs(self.device.truth().y_rad))
        return data

    def now_s(self) -> float:
        """Virtual time, s."""
        return self.device.now_s()

    def sleep_until(self, t_s: float) -> float:
        """Let time pass to ``t_s``, or longer; the time then, s."""
        self.device.sleep_until(t_s)
        self._stand_still()
        return self.now_s()

    def close(self) -> None:
        """Close the port; the device lives on. May be called twice."""
        self.device.close()

    def _stand_still(self) -> None:
        while self._next_s <= self.now_s():
            length_s = self._random.uniform(self._stalls.least_s, self._stalls.most_s)
            self.lengths_s.append(length_s)
            if self._random.random() < _BEFORE_WRITE:
                self._held_s = length_s
            else:
                self.device.sleep_until(self._next_s + length_s)
            self._next_s += length_s + self._until_next_s()

    def _until_next_s(self) -> float:
        a_minute = self._stalls.a_minute
        return self._random.expovariate(a_minute / 60.0) if a_minute > 0.0 else math.inf
