"""Why a measurement or an answer cannot be used."""

from __future__ import annotations

from rig.calibrate.wiring import Wiring
from rig.errors import RigError


class Refusal(RigError):
    """What cannot be used: one line of cause, one of cure, and drawings of the wires to look at."""

    def __init__(self, cause: str, cure: str, drawings: tuple[Wiring, ...] = ()) -> None:
        self.cause = cause
        self.cure = cure
        self.drawings = drawings
        super().__init__(f"{cause}\n{cure}")


class NotMovedError(Refusal):
    """The reading stood still while the shaft turned."""
