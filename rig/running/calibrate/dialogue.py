"""What a calibration asks for, as data: questions, readings, strokes. A terminal or a page brings the answers.

A step is a generator: it yields one of these requests, and is sent what the request says that it wants. ``session``
goes through them.

    dialogue = calibration(draft, steps)
    request = next(dialogue)
    while True:
        request = dialogue.send(answer to request)     # StopIteration brings the finished draft

To leave a step out, throw ``Skipped`` at a question instead of an answer. If a reading fails, throw the ``Refusal``:
the step shows it, and asks again.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, Literal

from rig.config.schema import Experiment
from rig.core.errors import RigError
from rig.core.faults import Fault
from rig.running.calibrate.wiring import Wiring

Pose = float | Literal["low stop", "high stop"]
"""Where a hand has turned the shaft to, rad; an emulated bench has no other hand than this."""


class Skipped(RigError):
    """Somebody leaves the step out."""


@dataclass(frozen=True)
class Say:
    """Something to show; wants nothing.

    kind      `step`: a new step begins; `found`: a result; `refused`: what was measured or answered cannot be used
    drawings  wires to look at
    """

    words: str
    kind: Literal["step", "found", "note", "refused"] = "note"
    drawings: tuple[Wiring, ...] = ()


@dataclass(frozen=True)
class Ask:
    """A question. Wants the answer as text, as it was typed; "" takes the default.

    kind      what a page should show: `enter` (nothing to type), `angle` (degrees, or `0.5 rad`), `number`, `choice`
    choices   of `choice`: answer and meaning
    empty     what "" means, where it is no default; of `enter`: what has been done
    commands  other answers, and what each does
    skips     whether there is a step to leave out
    """

    words: str
    kind: Literal["enter", "angle", "number", "choice"] = "enter"
    default: str = ""
    choices: tuple[tuple[str, str], ...] = ()
    empty: str = ""
    commands: tuple[tuple[str, str], ...] = ()
    skips: bool = True


@dataclass(frozen=True)
class Reading:
    """The position sensor, read for a moment while the shaft stands.

    y_counts, noise_counts  median, and standard deviation
    drift_counts            from the first half to the second: the shaft turned
    board                   name of the device's board
    """

    y_counts: float
    noise_counts: float
    drift_counts: float
    board: str


@dataclass(frozen=True)
class Read:
    """Wants a ``Reading``. ``pose``: where the hand has turned the shaft."""

    experiment: Experiment
    pose: Pose


@dataclass(frozen=True)
class SetZero:
    """Tell a device with an encoder that its shaft stands at 0. Wants nothing."""

    experiment: Experiment


@dataclass(frozen=True)
class StrokesSeen:
    """How a breakaway check ended.

    fault            what ended it; None: it came to its end
    plus_V, minus_V  drive at the first motion to each side, V; nan after a fault
    folder           the run folder, as text
    notes            what the run noted, a sentence each
    """

    fault: Fault | None
    plus_V: float
    minus_V: float
    folder: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Strokes:
    """THE MOTOR MOVES: the breakaway check, short strokes to and fro, guarded and recorded. Wants ``StrokesSeen``."""

    experiment: Experiment


@dataclass(frozen=True)
class Hold:
    """THE BRIDGE DRIVES, with no motor at it: one drive for some seconds. Wants how far the shaft turned, rad.

    It ends as soon as the shaft moves.
    """

    experiment: Experiment
    u_V: float
    seconds: float


Motion = Read | SetZero | Strokes | Hold
"""What the bench does. ``Strokes`` and ``Hold`` drive: each comes after a question to which somebody has said yes."""

Request = Say | Ask | Motion

Dialogue = Generator[Request, Any, Any]
