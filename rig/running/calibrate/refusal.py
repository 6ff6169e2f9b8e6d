"""Why a measurement or an answer cannot be used, and why a drive was ended."""

from __future__ import annotations

from typing import Final

from rig.core.errors import CauseError
from rig.core.faults import Fault
from rig.running.calibrate.wiring import Wiring

ALONE: Final = "the panel fell silent"
"""Why what a panel has let drive was ended: nobody is there who could stop it."""


def stopped(fault: Fault) -> str:
    """What to say of a drive that was ended by this fault, INTERRUPTED."""
    return f"{ALONE if fault.detail == ALONE else 'stopped'}: the drive is at 0 V"


class Refusal(CauseError):
    """What cannot be used, and drawings of the wires to look at."""

    def __init__(self, cause: str, cure: str, drawings: tuple[Wiring, ...] = ()) -> None:
        super().__init__(cause, cure)
        self.drawings = drawings


class NotMovedError(Refusal):
    """The reading stood still while the shaft turned."""
