"""The emulated servo bus in virtual time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rig.backends.emulated.line_faults import Disturbance
from rig.backends.emulated.virtual_time import WireInVirtualTime
from rig.backends.servo.emulated.bus import LineTimes, ServoBus
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.servo import ServoOptions, ServoTruth


class VirtualServoBus(WireInVirtualTime):
    """Servos of one protocol, powered on at virtual time 0: a ``Transport`` that is a ``Clock`` too.

    servos       what is on the bus
    line         its times
    disturbance, reply_fault   of the wire, of one servo's answers; may be changed on ``bus`` at any time
    outputs      (time s, voltage at the motor V) at each change of it, by the servo's place, from (0, 0) on
    Raises EmulationError as ``ServoBus``.
    """

    def __init__(
        self,
        servos: Sequence[ServoOptions],
        *,
        line: LineTimes | None = None,
        disturbance: Disturbance | None = None,
        reply_fault: ReplyFault | None = None,
    ) -> None:
        self.outputs: list[list[tuple[float, float]]] = [[(0.0, 0.0)] for _ in servos]
        self.bus = ServoBus(
            servos,
            line,
            disturbance,
            reply_fault,
            on_output=lambda place, t_s, volts: self.outputs[place].append((t_s, volts)),
        )
        super().__init__(self.bus, "virtual servo bus")

    def set_baud(self, baud: int) -> None:
        """The host's port has another baud from now on."""
        self.bus.line = replace(self.bus.line, baud=baud)

    def truth(self, id: int = 1) -> ServoTruth:
        """What is really the case now with a servo. Raises KeyError where none has this id."""
        return self.bus.servo(id).truth()

    def power_cycle(self) -> None:
        """The supply of all fails for a moment, or comes back."""
        for servo in self.bus.servos:
            servo.power_cycle()

    def power_off(self) -> None:
        """The supply of all fails, until ``power_cycle``."""
        for servo in self.bus.servos:
            servo.power_off()
