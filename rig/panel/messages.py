"""What the panel tells a page, as JSON: its answers over HTTP, its messages on the WebSocket, a calibration's talk.

Plain dicts whose keys mypy checks: nothing is validated or copied, for a page is told 25 times a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NotRequired, TypedDict

from rig.core.errors import RigError
from rig.run_folder.live.view import Estimate, LiveNumbers, SeenFault
from rig.run_folder.results import JsonObject


class Plan(TypedDict):
    """What a run of a config may do; ``jog_V`` moves any shaft that a run would accept. No travel limits: endless."""

    name: str
    largest_drive_V: float
    jog_V: float
    stopping_distance_rad: float
    soft_rad: list[float] | None
    hard_rad: list[float] | None
    max_speed_rad_s: float
    lasts_s: float | None


class Verdict(TypedDict):
    """The verdict of `rig check`: ``lines`` of text with a severity each, and the plan; null if it is refused."""

    lines: list[dict[str, str]]
    may_run: bool
    plan: Plan | None


class Prospect(Verdict):
    """With the digest of the file that was checked, unless it is refused: for the panel, not for the page."""

    digest: NotRequired[str]


class Checked(Verdict):
    """With what a start has to be confirmed; null if it is refused."""

    confirmation: str | None


class Started(TypedDict):
    """A process that was started, and has no run folder yet; of a jog, its largest drive."""

    run: None
    pid: int
    jog_V: NotRequired[float]


class State(TypedDict):
    """What a page shows before anything moves. ``running``: name and pid of each run that goes on."""

    version: str
    config: str | None
    config_path: str | None
    runs_folder: str
    run: str | None
    running: list[dict[str, str | int]]
    opening: str | None
    operator: bool
    has_token: bool
    uplot: bool


class RunRow(TypedDict):
    """What came of a run. ``estimate``: tau, K and f_c, each with half its 95 % interval."""

    name: str
    when: str | None
    command: str | None
    config: str
    backend: str
    emulated: bool
    rehearsal: bool
    verdict: str | None
    fault: str | None
    estimate: dict[str, tuple[float, float | None] | None] | None
    says: list[str]
    lasts_s: float | None
    report: bool
    notes: list[str]


class Drawn(TypedDict):
    """A run's curves by name, thin enough to draw; its stages and faults, as the run has them."""

    series: dict[str, list[float | None]]
    rows: int
    first_switch_s: float | None
    stages: list[JsonObject]
    faults: list[JsonObject]
    notes: list[str]


class Compared(TypedDict):
    """`rig compare` of some runs; null, and why, where fewer than two can be compared."""

    comparison: JsonObject | None
    why: str


class Refusal(TypedDict):
    """Instead of an answer: what is wrong, and what to do."""

    error: dict[str, str]


class Answer(TypedDict, total=False):
    """One of these: an answer, names of steps, that the step is left out, or that the calibration ends."""

    answer: str
    steps: list[str]
    skip: bool
    end: bool


class Said(TypedDict):
    """What a calibration has said, or was answered."""

    kind: str
    words: str
    drawings: list[dict[str, str]]


class Question(TypedDict):
    """A question, as ``calibrate.dialogue.Ask``; of kind `steps`: which to go through. The panel numbers it."""

    words: str
    kind: str
    choices: Sequence[tuple[str, str]]
    skips: bool
    default: NotRequired[str]
    empty: NotRequired[str]
    commands: NotRequired[Sequence[tuple[str, str]]]
    number: NotRequired[int]


class Doing(TypedDict):
    """What it does now."""

    words: str


class CalibrationEnd(TypedDict):
    """How it ended."""

    written: bool
    words: str
    cure: str


class CalibrationShown(TypedDict):
    """All that a page shows of a calibration."""

    said: list[Said]
    question: Question | None
    end: CalibrationEnd | None
    does: str | None


class Operator(TypedDict):
    """Whether this page may drive."""

    type: Literal["operator"]
    you: bool


class CalibrationChanged(TypedDict):
    """There is something new of the calibration."""

    type: Literal["calibration"]
    changes: int


class Idle(TypedDict):
    """The panel lives. ``opening``: the command that opens its device."""

    type: Literal["idle"]
    opening: str | None
    words: str


class Live(LiveNumbers):
    """The numbers of a run, and its newest rows, column by column."""

    type: Literal["live"]
    n: int
    run: str
    rows: dict[str, list[float | None]]


class LiveEstimate(Estimate):
    """A live estimate of a run."""

    type: Literal["estimate"]
    run: str


class LiveFault(SeenFault):
    """A fault of a run."""

    type: Literal["fault"]
    run: str


class RunEnded(TypedDict):
    """A run is over, or a command ended before it had a run folder."""

    type: Literal["ended"]
    run: str | None
    why: str
    verdict: str | None
    exit: int | None
    words: str


class Stop(TypedDict):
    """A Stop was taken; whether the device has confirmed 0 V. null: not known yet."""

    type: Literal["stop"]
    received: Literal[True]
    run: str | None
    drive_zero: bool | None
    after_ms: int | None
    why: str


class Trouble(TypedDict):
    """Something to look after."""

    type: Literal["trouble"]
    what: str
    code: NotRequired[str]
    cure: NotRequired[str]


class Refused(TypedDict):
    """What this page asked for is not done."""

    type: Literal["refused"]
    what: str
    cure: str


News = RunEnded | Stop | Trouble
Message = Operator | CalibrationChanged | Idle | Live | LiveEstimate | LiveFault | News


class RefusedError(RigError):
    """An answer that is no: HTTP status, what is wrong, what to do."""

    def __init__(self, status: int, what: str, cure: str) -> None:
        self.status, self.what, self.cure = status, what, cure
        super().__init__(f"{what}\n{cure}")
