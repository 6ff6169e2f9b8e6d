"""The emulated servo bus in virtual time: line and clock in one, so that waiting for a byte makes time pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rig.backends.emulated.line_faults import Disturbance
from rig.backends.emulated.plug import Plug
from rig.backends.servo.emulated.bus import LineTimes, ServoBus
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.servo import ServoOptions, ServoTruth


class VirtualServoBus(Plug):
    """Servos of one protocol, powered on at virtual time 0: a ``Transport`` that is a ``Clock`` too.

    servos       what is on the bus
    line         its times
    disturbance, reply_fault   of the wire, of one servo's answers; may be changed on ``bus`` at any time
    outputs      (time s, voltage at the motor V) at each change of it, by the servo's place, from (0, 0) on
    Raises EmulationError as ``ServoBus``.
    """

    absolute = True  # of the clock: it sleeps until an instant, not for a while

    def __init__(
        self,
        servos: Sequence[ServoOptions],
        *,
        line: LineTimes | None = None,
        disturbance: Disturbance | None = None,
        reply_fault: ReplyFault | None = None,
    ) -> None:
        Plug.__init__(self, "virtual servo bus")
        self.outputs: list[list[tuple[float, float]]] = [[(0.0, 0.0)] for _ in servos]
        self.bus = ServoBus(
            servos,
            line,
            disturbance,
            reply_fault,
            on_output=lambda place, t_s, volts: self.outputs[place].append((t_s, volts)),
        )
        self._now_s = 0.0

    # ------------------------------------------------------------------ clock

    def now_s(self) -> float:
        """Virtual time, s."""
        return self._now_s

    def sleep_until(self, t_s: float) -> float:
        """Let time pass to ``t_s``; none if that is past. Returns the time then."""
        self._run_to(t_s)
        return self._now_s

    def _run_to(self, t_s: float) -> None:
        self._now_s = max(self._now_s, t_s)
        self.bus.advance_to(self._now_s)

    # ------------------------------------------------------------------ port

    def set_baud(self, baud: int) -> None:
        """The host's port has another baud from now on."""
        self.bus.line = replace(self.bus.line, baud=baud)

    def write(self, data: bytes) -> None:
        """Hand ``data`` to the wire; takes no time. Raises Fault LINK_LOST when unplugged."""
        self._check_plug()
        self.bus.send(data, self._now_s)

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at least one byte; b"" after ``timeout_s`` of virtual time without any.

        An answer arrives whole, when its last bit does. Raises Fault LINK_LOST when unplugged.
        """
        self._check_plug()
        until_s = self._now_s + max(timeout_s, 0.0)
        self._run_to(self._now_s)
        while self.bus.next_reply_s() > self._now_s and self._now_s < until_s:
            self._run_to(min(self.bus.next_event_s(), until_s))
        return self.bus.receive(self._now_s)

    # ------------------------------------------------------------------ the truth, and what may happen

    def truth(self, id: int = 1) -> ServoTruth:
        """What is really the case now with a servo. Raises KeyError where none has this id."""
        return self.bus.servo(id).truth()

    def power_cycle(self) -> None:
        """The supply of all fails for a moment."""
        for servo in self.bus.servos:
            servo.power_cycle()
