"""What a calibration asks for: questions, readings, strokes. A terminal or a page brings the answers.

A step gets a ``Talk``: through it, it says, asks, reads and drives, and knows no terminal and no device. A question may
raise ``Skipped``, which leaves the step out; a reading a ``Refusal``: the step shows it, and asks again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol

from rig.config.schema import Experiment
from rig.core.errors import CauseError, RigError
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


SayKind = Literal["step", "found", "note", "refused"]
AskKind = Literal["enter", "angle", "number", "choice"]
Pairs = tuple[tuple[str, str], ...]

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
    kind: SayKind = "note"
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
    kind: AskKind = "enter"
    default: str = ""
    choices: Pairs = ()
    empty: str = ""
    commands: Pairs = ()
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


class Front(Protocol):
    """What shows and asks."""

    def say(self, what: Say) -> None:
        """Show it."""

    def ask(self, question: Ask) -> str:
        """The answer as text. Raises Skipped; NotWrittenError if somebody ends the calibration."""

    def does(self, motion: Motion) -> None:
        """Rig is about to read or to drive."""

    def writes(self) -> None:
        """Rig is about to write the config: from here on nobody may say that nothing is written."""


class Talk:
    """Who answers, and the bench, as a step sees both.

    front    shows and asks
    bench    does readings and strokes: ``HandBench.perform``
    """

    def __init__(self, front: Front, bench: Callable[[Motion], Any]) -> None:
        self._front, self._bench = front, bench

    def say(self, words: str, kind: SayKind = "note", drawings: tuple[Wiring, ...] = ()) -> None:
        """Show this; as of ``Say``."""
        self._front.say(Say(words, kind, drawings))

    def refuse(self, refusal: Refusal) -> None:
        """Show why something is refused."""
        self.say(f"{refusal.cause}\n{refusal.cure}", "refused", refusal.drawings)

    def ask(self, words: str, kind: AskKind = "enter", **more: Any) -> str:
        """The answer; as of ``Ask``. Raises Skipped, and what ``Front.ask`` does."""
        return self._front.ask(Ask(words, kind, **more))

    def choice(self, before: Say | None, words: str, choices: Pairs, *, skips: bool = True) -> str:
        """One of these answers; the first is the default. Raises as ``ask``; ``skips``: as of ``Ask``."""
        if before is not None:
            self._front.say(before)
        names = [name for name, _ in choices]
        while True:
            answer = self.ask(words, "choice", default=names[0], choices=choices, skips=skips).strip().lower()
            if answer == "":
                return names[0]
            meant = [name for name in names if name.startswith(answer)]
            if len(meant) == 1:
                return meant[0]
            self.refuse(Refusal(f"{answer!r} is no answer here", f"type one of {', '.join(names)}"))

    def perform(self, motion: Motion) -> Any:
        """What this motion wants. Raises Refusal."""
        self._front.does(motion)
        return self._bench(motion)
