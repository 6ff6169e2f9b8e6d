"""The parameters of the emulated servo bus's process, already parsed, so that it starts without loading the config."""

from __future__ import annotations

from dataclasses import dataclass

from rig.backends.emulated.line_faults import CorruptionRate
from rig.backends.servo.emulated.bus import LineTimes
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.servo import ServoOptions


@dataclass(frozen=True)
class Device:
    """Servos and their line; ``follows_baud``: the line's baud is what the host sets on the port."""

    servos: tuple[ServoOptions, ...]
    line: LineTimes
    follows_baud: bool = True
    reply_fault: ReplyFault | None = None
    corruption: CorruptionRate | None = None
