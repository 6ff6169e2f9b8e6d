"""A run as another process sees it live: read from the growing run folder, so that no row goes from the loop to it.

The writer process puts each row on disk within some milliseconds of its tick, and each event. ``LiveView`` reads what
is new. What the run folder does not say, the stop flag does: who runs, whether it lives, and its time 0.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypedDict

from rig.config import ConfigError, Experiment, load
from rig.core.signals import FLAG_SKIPPED, plain
from rig.run_folder.live.stop_flag import Runner, runner_of
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CONFIG, META
from rig.run_folder.recording.follow import Progress, Tail, event_of, live_remark, number, real
from rig.run_folder.recording.reader import read_meta
from rig.run_folder.recording.sample_columns import COLUMNS
from rig.run_folder.recording.stage import StageKind, kind_of
from rig.run_folder.recording.writer import EVENTS, SAMPLES
from rig.run_folder.results import JsonObject, ScriptCall

KEPT_ROWS: Final = 1024
KEPT_ESTIMATES: Final = 4096
_FIRST_BYTES: Final = 4_000_000  # of a recording that has grown before it is looked at: half an hour at 10 ms
_FIRST_EVENTS: Final = 64_000_000  # bytes of its events: days
_MOST_BYTES: Final = _FIRST_BYTES  # that one read takes of each file, so that none takes long
_MOST_FAULTS: Final = 200
_MOST_STAGES: Final = 1000
_LONGEST_WORD, _LONGEST_WORDS = 200, 2000  # characters of a name, and of a sentence, that the pages are told
_LARGEST_COUNT: Final = 2**53  # a page's numbers are floats
_LATE_SHARE: Final = 0.1  # of the period, beyond which a tick counts as late
_COMPUTES: Final = "identify"  # the stage in which nothing drives
_TESTS: Final = (StageKind.SEARCH, StageKind.RELAY, StageKind.STROKES)

State = Literal["absent", "runs", "ended", "died"]


class LiveRow(NamedTuple):
    """A row of the run.

    number   counts the rows that this view has seen, from 0
    z_rad_s  integral of the position, as the law has it; nan without one; yd_rad: reference, likewise
    u_V      drive that acts; late_us: how late the tick began; nan of a tick of the device
    """

    number: int
    tick: int
    t_s: float
    y_rad: float
    u_V: float
    z_rad_s: float
    yd_rad: float
    stage: str
    late_us: float
    flags: int


class Estimate(TypedDict):
    """A live estimate: when, and each value with half its 95 % interval; None: not known yet.

    remark  the laws that it has, and whether its residual is too large; else empty
    """

    t_s: float
    tau_s: tuple[float, float] | None
    K_rad_s_V: tuple[float, float] | None
    fc_V: tuple[float, float] | None
    remark: str


class SeenFault(TypedDict):
    """A fault, as the event tells it. Of a stop, ``detail`` says who asked for it."""

    t_s: float
    code: str
    cause: str
    detail: str
    cure: str


class LiveNumbers(TypedDict):
    """What a page shows of a run beside its rows. null: not known, or there is none.

    age_ms    since the newest row was sampled
    words     what comes of the stage, as `rig run` shows it
    stage_left_s, run_left_s   at most so many seconds
    cycles    number of the newest cycle of the present stage, whose amplitude and period follow
    drive_is_off  whether the device has confirmed 0 V and nothing was driven since; True, too, before the first stage
    is_over   whether the run has its end: no stage follows
    loop      late: how many of the kept ticks began late; latest_us: the latest of them; skipped: of the rows that were
              seen; link_errors: what went wrong on the link so far
    limits    soft_rad, hard_rad and drive_V, as the config has them; null: not known, or endless
    planes    y_rad and z_rad_s, at which the relay that drives switches, by h1_V and h2_V
    """

    command: str | None
    pid: int | None
    age_ms: int | None
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
    limits: dict[str, list[float] | float | None]
    planes: dict[str, list[float] | float] | None


@dataclass(frozen=True)
class Snapshot:
    """The run at one moment.

    state         absent: no run folder; runs: a process makes it; ended: it has come to its end; died: nobody makes
                  it, and it has no end
    runner        the process that makes it; None: none does
    rows          the newest rows, the oldest first; at most KEPT_ROWS
    age_s         since the newest row was sampled; None: no row, or nobody knows
    damaged       lines of the folder's files that are no rows and no events
    """

    state: State
    runner: Runner | None
    rows: tuple[LiveRow, ...]
    age_s: float | None
    numbers: LiveNumbers
    estimates: tuple[Estimate, ...]
    faults: tuple[SeenFault, ...]
    stages: tuple[tuple[float, str], ...]
    damaged: int


class LiveView:
    """Follows the run in ``folder``. It never waits for the run, and the run never waits for it.

    Not for two threads at once. Of a long recording it begins with the last rows. What has grown by more than
    ``_MOST_BYTES`` is read piece by piece, one with each ``read``.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._samples = Tail(folder / SAMPLES, _FIRST_BYTES, _MOST_BYTES)
        self._events = Tail(folder / EVENTS, _FIRST_EVENTS, _MOST_BYTES)
        self._rows: deque[LiveRow] = deque(maxlen=KEPT_ROWS)
        self._seen = 0  # rows
        self._skipped = 0
        self._damaged = 0
        self._story = _Story()
        self._experiment: Experiment | None = None
        self._script = ScriptCall(name="")
        self._knows_folder = False

    def read(self, lost: Runner | None = None) -> Snapshot:
        """The run now. Raises OSError where its files cannot be read.

        lost  who is known to make it although its flag is gone; None: nobody
        """
        runner = runner_of(self.folder) or lost  # first: what it wrote before its end is read below
        for line in self._events.lines():
            self._damaged += not self._story.take(line)
        for line in self._samples.lines():
            self._take_row(line)
        self._read_folder()
        story, now_s = self._story, self._run_time(runner)
        age_s = None if not self._rows or now_s is None else max(now_s - self._rows[-1].t_s, 0.0)
        return Snapshot(
            state=self._state(runner),
            runner=runner,
            rows=tuple(self._rows),
            age_s=age_s,
            numbers=self._numbers(runner, now_s, age_s),
            estimates=tuple(story.estimates),
            faults=tuple(story.faults),
            stages=tuple(story.stages),
            damaged=self._damaged,
        )

    def _numbers(self, runner: Runner | None, now_s: float | None, age_s: float | None) -> LiveNumbers:
        story = self._story
        limits = None if self._experiment is None else self._experiment.device.arming
        stage_s, run_s = self._left(now_s)
        late_us = [row.late_us for row in self._rows if not math.isnan(row.late_us)]
        too_late_us = _LATE_SHARE * 1e6 * runner.period_s if runner is not None else math.nan
        number, amplitude_rad, period_s = story.cycle or (None, None, None)
        return {
            "command": _text(self._script.name, _LONGEST_WORD) or None, "pid": None if runner is None else runner.pid,
            "age_ms": None if age_s is None else round(1e3 * age_s),
            "stage": story.stages[-1][1] if story.stages else None,
            "words": _text(story.progress.detail, _LONGEST_WORDS),
            "stage_left_s": rounded(stage_s, 1), "run_left_s": rounded(run_s, 1),
            "cycles": number, "amplitude_rad": rounded(amplitude_rad, 5), "period_s": rounded(period_s, 5),
            "drive_is_off": story.drive_is_off, "is_over": story.progress.ended,
            "loop": {
                "late": None if math.isnan(too_late_us) else sum(one > too_late_us for one in late_us),
                "latest_us": rounded(max(late_us, default=None), 0), "skipped": self._skipped,
                "link_errors": story.link_errors,
            },
            "limits": {
                "soft_rad": None if limits is None else _finite(limits.soft_rad),
                "hard_rad": None if limits is None else _finite(limits.hard_rad),
                "drive_V": None if limits is None else limits.max_u_V,
            },
            "planes": story.planes,
        }  # fmt: skip

    def _take_row(self, line: str) -> None:
        try:
            row = _row(self._seen, line)
        except ValueError:
            self._damaged += line.split(",", 1)[0] != COLUMNS[0]  # else it is the header
            return
        if row.flags & FLAG_SKIPPED:
            self._skipped += max(row.tick - self._rows[-1].tick - 1, 1) if self._rows else 1
        self._rows.append(row)
        self._seen += 1

    def _read_folder(self) -> None:
        """Read config and script, once they are there."""
        if self._knows_folder or not (self.folder / META).exists():
            return
        self._knows_folder = True
        try:
            meta, _ = read_meta(self.folder)
            self._script = (meta and meta.script) or self._script
            self._experiment = load(self.folder / CONFIG, follows_links=False)
        except (RecordingError, ConfigError):
            return  # of an older version, or damaged: the view goes on without limits

    def _run_time(self, runner: Runner | None) -> float | None:
        if runner is None or math.isnan(runner.zero_s):
            return None
        return time.monotonic() - runner.zero_s

    def _state(self, runner: Runner | None) -> State:
        if runner is not None:
            return "runs"
        if self._story.progress.ended:
            return "ended"
        return "died" if self._seen or self._story.stages or (self.folder / META).exists() else "absent"

    def _left(self, now_s: float | None) -> tuple[float | None, float | None]:
        """At most so many seconds of stage and run, s; None: nothing bounds it, or nobody knows yet."""
        e, story = self._experiment, self._story
        if e is None or not story.stages or story.progress.ended:
            return None, None
        if now_s is None:
            now_s = self._rows[-1].t_s if self._rows else story.stages[-1][0]
        began_s, stage = story.stages[-1]
        kind = kind_of(stage)
        stage_s: float | None = None
        if kind is StageKind.TRACK and e.tracking is not None:
            stage_s = e.tracking.duration_s
        elif kind in (StageKind.LAW, StageKind.JOG):
            stage_s = self._script.duration_s
        elif kind in _TESTS and e.relay.until is not None:
            began_s = next(t_s for t_s, name in story.stages if kind_of(name) in _TESTS)
            stage_s = e.relay.until.longest_s
        if stage_s is None:
            return None, None
        stage_s = max(began_s + stage_s - now_s, 0.0)
        return stage_s, stage_s + self._tracking_after_s(e, stage)

    def _tracking_after_s(self, e: Experiment, stage: str) -> float:
        """Of the tracking runs that follow this stage, at most."""
        if e.tracking is None or self._script.name not in ("run", "track"):
            return 0.0
        names = [f"track:{method}" for method in e.tracking.methods]
        after = len(names) - 1 - names.index(stage) if stage in names else len(names)
        return after * e.tracking.duration_s


class _Story:
    """What the events tell."""

    def __init__(self) -> None:
        self.progress = Progress()
        self.stages: list[tuple[float, str]] = []
        self.estimates: deque[Estimate] = deque(maxlen=KEPT_ESTIMATES)
        self.faults: list[SeenFault] = []
        self.cycle: tuple[int, float, float] | None = None  # number, amplitude, rad, and period, s, of the newest
        self.planes: dict[str, list[float] | float] | None = None
        self.link_errors: int | None = None
        self.drive_is_off = True
        self._gains: dict[str, list[float] | float] | None = None  # of the stage that begins next

    def take(self, line: str) -> bool:
        """Take a line of events.jsonl. Returns False if it is no event."""
        try:
            event = event_of(line)
            self.progress.take_event(event)
            self._take(event)
        except (ValueError, KeyError, TypeError):
            return False
        return True

    def _take(self, event: JsonObject) -> None:
        kind, t_s = event.get("kind"), number(event.get("t_s")) or 0.0
        if kind == "stage":
            name = _text(event["name"], _LONGEST_WORD)
            del self.stages[_MOST_STAGES:]  # what is left out is in the middle: the first ones and the newest count
            self.stages.append((t_s, name))
            self.drive_is_off = self.drive_is_off and name == _COMPUTES
            self.cycle = None
            drives = kind_of(name) in (StageKind.RELAY, StageKind.SEARCH)
            self.planes, self._gains = (self._gains if drives else None), None
        elif kind == "stop":
            self.drive_is_off = bool(event["confirmed"])
            self.planes = None
        elif kind in ("gains", "decided", "search"):
            gains = _planes(event) if event.get("h1_V") is not None else None
            if kind == "search":
                self.planes = gains
            else:
                self._gains = gains
        elif kind == "cycle":
            self.cycle = _count(event["number"]), real(event["amplitude_rad"]), real(event["period_s"])
        elif kind == "live":
            self.estimates.append(
                {
                    "t_s": t_s,
                    "tau_s": _with_half(event, "tau_s", "tau_percent"),
                    "K_rad_s_V": _with_half(event, "K_rad_s_V", "K_percent"),
                    "fc_V": _with_half(event, "fc_V", "fc_percent"),
                    "remark": live_remark(event),
                }
            )
        elif kind == "fault" and len(self.faults) < _MOST_FAULTS:
            code, cause, detail, cure = (
                _text(event.get(name), _LONGEST_WORDS) for name in ("code", "cause", "detail", "cure")
            )
            self.faults.append(SeenFault(t_s=t_s, code=code, cause=cause, detail=detail, cure=cure))
        elif kind == "link":
            self.link_errors = _count(event["errors"])


def _row(seen: int, line: str) -> LiveRow:
    """A line of samples.csv. Raises ValueError if it is none."""
    row = dict(zip(COLUMNS, line.split(",", len(COLUMNS)), strict=True))
    reals = {name: float(row[name] or "nan") for name in ("t_s", "y_rad", "u_V", "z_rad_s", "yd_rad", "late_us")}
    if not math.isfinite(reals["t_s"]):
        raise ValueError("a row without a time")
    tick, flags = _count(int(row["tick"])), _count(int(row["flags"]))
    return LiveRow(seen, tick, **reals, stage=_text(row["stage"], _LONGEST_WORD), flags=flags)


def _planes(event: JsonObject) -> dict[str, list[float] | float]:
    """Where a relay with the gains of this event switches."""
    return {"y_rad": [0.0], "z_rad_s": [0.0], "h1_V": real(event["h1_V"]), "h2_V": real(event["h2_V"])}


def _with_half(event: JsonObject, name: str, percent: str) -> tuple[float, float] | None:
    value, half = number(event.get(name)), number(event.get(percent))
    return None if value is None or half is None else (value, abs(value) * half / 100.0)


def _count(value: object) -> int:
    """A whole number that a page can hold. Raises ValueError for anything else."""
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) > _LARGEST_COUNT:
        raise ValueError("no count")
    return value


def _text(value: object, longest: int) -> str:
    """A text for the pages; empty for what is none."""
    return plain(value[:longest]) if isinstance(value, str) else ""


def rounded(value: float | None, digits: int) -> float | None:
    """``value``, in whatever unit, as a number for the pages; None for what is none."""
    return round(value, digits) if value is not None and math.isfinite(value) else None


def _finite(pair: tuple[float, float]) -> list[float] | None:
    return list(pair) if all(map(math.isfinite, pair)) else None
