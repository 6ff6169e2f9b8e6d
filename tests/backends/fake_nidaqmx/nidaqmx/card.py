"""The card itself, which outlives every task: converters of 16 bits, the amplifier, the motor, a virtual clock."""

from __future__ import annotations

import random
from typing import Any

from simulated_bench import DEMO

from nidaqmx.errors import DaqError
from rig.backends.clock import VirtualClock
from rig.model.bench import BenchModel

AMPLIFIER_GAIN = 1.2
CENTRE_V, V_PER_RAD, NOISE_V = 2.5, 0.9, 0.0027
_CALL_S = 60e-6  # of a call, the conversion in its middle


class Card:
    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.plugged_in = True
        self.reserved: dict[str, Any] = {}
        self.restarts = 0
        self.output_V = 0.0
        self.written: list[float] = []
        self.bench = BenchModel(DEMO, seed=1)
        self._noise = random.Random(2)
        self._until_s = 0.0

    def meet(self, device: str) -> None:
        if device != "Dev1":
            raise DaqError(f"Device identifier is invalid.\n\nDevice Specified: {device}", -200220)
        if not self.plugged_in:
            raise DaqError("Device cannot be accessed.\n\nDevice Specified: Dev1", -201003)

    def _pass(self, duration_s: float) -> None:
        self.clock.sleep_until(self.clock.now_s() + duration_s)

    def catch_up(self) -> None:
        """Let the motor turn up to now, driven by what stands at the output."""
        self.bench.pin_counts = self.output_V * AMPLIFIER_GAIN / DEMO.supply_V * DEMO.drive_counts
        self.bench.advance(self.clock.now_s() - self._until_s)
        self._until_s = self.clock.now_s()

    def convert(self) -> float:
        self._pass(0.5 * _CALL_S)
        self.catch_up()
        self._pass(0.5 * _CALL_S)
        volts = CENTRE_V + V_PER_RAD * self.bench.state.y + self._noise.gauss(0.0, NOISE_V)
        return round(volts / (10.0 / 65536)) * (10.0 / 65536)

    def generate(self, volts: float) -> None:
        self._pass(0.5 * _CALL_S)
        self.catch_up()
        self.output_V = round(volts / (20.0 / 65536)) * (20.0 / 65536)
        self.written.append(self.output_V)
        self._pass(0.5 * _CALL_S)


CARD = Card()
