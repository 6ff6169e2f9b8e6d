"""The emulated servo bus in real time: a process behind a pseudo-terminal."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rig.backends.emulated.board_process import BoardProcess
from rig.backends.emulated.line_faults import Disturbance
from rig.backends.servo.emulated.bus import LineTimes, ServoBus
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.servo import ServoOptions


class ServoBoard(BoardProcess):
    """The servos of ``rig.backends.servo.emulated.bus`` in a process. Its reset button cuts their supply a moment."""

    def start(
        self,
        servos: Sequence[ServoOptions],
        link: Path | None = None,
        trace: Path | None = None,
        *,
        line: LineTimes | None = None,
        follows_baud: bool = True,
        reply_fault: ReplyFault | None = None,
        disturbance: Disturbance | None = None,
        violations: Path | None = None,
    ) -> str:
        """Start the process and return the name of its pseudo-terminal.

        servos        what is on the bus
        link, trace   as of HostBoard; the trace is of the first servo, its fault that of its errors' register
        line          times; the time on the wire is kept
        follows_baud  a baud that the host sets on the port is the line's; a servo of another one does not hear it
        reply_fault, disturbance  of one servo's answers, of the wire
        violations    CSV file that each violation is appended to: time, s, id, what
        Raises EmulationError where it does not start.
        """
        line = LineTimes() if line is None else line
        ServoBus(servos, line)  # what it cannot be is said here
        from rig.backends.servo.emulated.servo_process import served  # not on Windows

        make = partial(served, tuple(servos), line, follows_baud, reply_fault, disturbance, violations)
        return self._launch(make, link, trace)
