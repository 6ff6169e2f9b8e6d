"""What the panel tells a page, as JSON: its answers over HTTP, its messages on the WebSocket, a calibration's talk."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

from rig.results import JsonObject

Half = tuple[float, float]
"""A value, and half its 95 % interval."""

# ---------------------------------------------------------------------- a config, and what is started with it


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


class Prospect(TypedDict):
    """The verdict of `rig check`: ``lines`` of text with a severity each, and the plan; null if it is refused."""

    lines: list[dict[str, str]]
    may_run: bool
    plan: Plan | None


class Checked(Prospect):
    """With what a start has to be confirmed; null if it is refused."""

    confirmation: str | None


class Started(TypedDict):
    """A process that was started, and has no run folder yet; of a jog, its largest drive."""

    run: None
    pid: int
    jog_V: NotRequired[float]


# ---------------------------------------------------------------------- past runs


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


# ---------------------------------------------------------------------- a calibration


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
    choices: list[list[str]]
    skips: bool
    default: NotRequired[str]
    empty: NotRequired[str]
    commands: NotRequired[list[list[str]]]
    number: NotRequired[int]


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


# ---------------------------------------------------------------------- on the WebSocket


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


class LiveLimits(TypedDict):
    """Travel and drive, as the config has them; null: not known, or endless."""

    soft_rad: list[float] | None
    hard_rad: list[float] | None
    drive_V: float | None


class LivePlanes(TypedDict):
    """Where the relay switches, and by how much."""

    y_rad: list[float]
    z_rad_s: list[float]
    h1_V: float
    h2_V: float


class Live(TypedDict):
    """The numbers of a run, and its newest rows, column by column."""

    type: Literal["live"]
    n: int
    run: str
    command: str | None
    pid: int | None
    age_ms: int | None
    rows: dict[str, list[float | None]]
    stage: str | None
    words: str
    stage_left_s: float | None
    run_left_s: float | None
    cycles: int | None
    amplitude_rad: float | None
    period_s: float | None
    drive_is_off: bool
    is_over: bool
    loop: dict[str, float | None]
    limits: LiveLimits
    planes: LivePlanes | None


class LiveEstimate(TypedDict):
    """A live estimate."""

    type: Literal["estimate"]
    run: str
    t_s: float
    tau_s: Half | None
    K_rad_s_V: Half | None
    fc_V: Half | None
    remark: str


class LiveFault(TypedDict):
    """A fault."""

    type: Literal["fault"]
    run: str
    t_s: float
    code: str
    cause: str
    detail: str
    cure: str


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
