"""What the pages are told, 25 times a second: one look at the run for all of them, and for each page what it lacks.

Nothing is queued. A page that takes its time gets the newest rows later, all at once.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from rig.panel.bench import CALIBRATION, Bench, StopAnswer
from rig.panel.messages import Live, Message, News, RunEnded, Stop
from rig.panel.past_runs import Runs
from rig.panel.processes import Ended
from rig.run_folder.live.stop_flag import Unrecorded, command_of, is_recorded
from rig.run_folder.live.view import KEPT_ROWS, LiveRow, LiveView, Snapshot, rounded

PERIOD_S: Final = 0.04
ALIVE_S: Final = 0.25  # a page that hears nothing for longer says that it is not connected
_LOOK_EVERY: Final = 6  # ticks between two looks at which runs go on
_MOST_UNSEEN: Final = 10  # live messages on their way to a page that says what it has seen
_MOST_NEWS: Final = 20
_MOST_TICKS_TO_EXIT: Final = 100
_ZERO_WITHIN_S: Final = 1.0
STARTING: Final = "the run that was starting"
_NOT_CONFIRMED: Final = "the device has not confirmed 0 V"
_OVER: Final = "the run is over, and the device has never confirmed 0 V"


@dataclass(frozen=True)
class Scene:
    """What there is to tell at one moment.

    run          the folder's name; None: nothing runs, and nothing was opened
    opening      the command that was started and has no folder yet; opens_with: the last that it said
    snapshot     of the run
    ended        the message that it is over; None: it goes on
    news         messages for every page, each with its number
    calibration  how often it has changed what a page shows of it
    """

    run: str | None = None
    opening: str | None = None
    opens_with: str = ""
    snapshot: Snapshot | None = None
    ended: RunEnded | None = None
    news: tuple[tuple[int, News], ...] = ()
    calibration: int = 0


@dataclass
class _Asked:
    """A Stop on its way: when it came, what it is for, and whether the pages know that 0 V is not confirmed.

    view  of a run; None: it is not recorded, or its page was gone by then
    """

    at_s: float
    view: LiveView | Unrecorded | None
    told: bool = False


class Watch:
    """Looks at the bench, and has what the pages are told."""

    def __init__(self, bench: Bench, runs: Runs, opened: Path | None = None) -> None:
        self._bench, self._runs = bench, runs
        self._view = None if opened is None else LiveView(opened)
        self._ended: RunEnded | None = None
        self._statuses: dict[int, Ended] = {}
        self._pid: int | None = None
        self._asked: dict[Path, _Asked] = {}
        self._starting: dict[int, float] = {}  # commands that a Stop interrupted before their run folder, and when
        self._unconfirmed: list[str] = []  # runs that were stopped and are over, and of which 0 V was never confirmed
        self._news: list[tuple[int, News]] = []
        self._number = 0
        self._ticks = 0
        self._over_ticks = 0
        self._troubles: dict[str, str] = {}  # by run; "": of none
        self._lost: Path | None = None  # folder of the run whose flag the pages know to be gone
        self.scene = Scene()
        self._followers: set[Follower] = set()

    async def go(self) -> None:
        """Look and tell until cancelled."""
        next_s = time.monotonic()
        loop, thread = asyncio.get_running_loop(), ThreadPoolExecutor(1, "look")  # its own: no reader is in its way
        while True:
            await loop.run_in_executor(thread, self.look)
            for follower in self._followers:
                follower.wake.set()
            next_s = max(next_s + PERIOD_S, time.monotonic() + 0.25 * PERIOD_S)
            await asyncio.sleep(next_s - time.monotonic())

    def follow(self) -> Follower:
        """A page that came."""
        follower = Follower(self._news[-1][0] if self._news else 0)
        self._followers.add(follower)
        return follower

    def leave(self, follower: Follower) -> None:
        """A page that went."""
        self._followers.discard(follower)

    def stop_asked(self, answer: StopAnswer) -> Stop:
        """A Stop was given on: the message for who asked. What comes of it is told to every page."""
        at_s = time.monotonic()
        if (answer.runs or answer.waits) and not (self._asked or self._starting):
            self._unconfirmed = []
        for folder in answer.runs:
            if folder not in self._asked:
                self._asked[folder] = _Asked(at_s, _seen(folder))
        for pid in answer.waits:
            self._starting.setdefault(pid, at_s)
        if answer.runs or answer.waits:
            return _stop_message(_name(answer.runs[-1]) if answer.runs else STARTING, None, answer.why, None)
        why = answer.why or (f"{_OVER}: {', '.join(self._unconfirmed)}" if self._unconfirmed else "")
        return _stop_message(None, None, why, None)  # what nobody told of may drive all the same

    # ------------------------------------------------------------------ looking; in a thread of its own

    def look(self) -> None:
        """Look once."""
        try:
            self._look()
        except OSError as error:  # a disk that fails: say so, go on
            self._say("", f"{error.strerror}: {error.filename}")

    def _say(self, run: str, trouble: str) -> None:
        """Tell of the trouble with a run once, though it is met with each look."""
        if self._troubles.get(run) != trouble:
            self._troubles[run] = trouble
            self._tell({"type": "trouble", "what": trouble})

    def _look(self) -> None:
        bench = self._bench
        if self._ticks % _LOOK_EVERY == 0:
            bench.look(at_all=False)
            self._choose()
        self._ticks += 1
        folder = None if self._view is None else self._view.folder
        snapshot = None if self._view is None else self._read(self._view)
        self._take_ends(folder, snapshot)
        self._watch_stops(folder, snapshot)
        opening = bench.opening
        self.scene = Scene(
            None if folder is None else folder.name,
            opening[0].command if opening else None,
            opening[0].last_words().rpartition("\n")[2] if opening else "",
            snapshot,
            self._ended,
            tuple(self._news),
            bench.calibration_changes,
        )

    def _seen(self, view: LiveView) -> Snapshot | None:
        """A run as it is now. None, and the pages are told, where it cannot be read: the others are shown all the same.

        Its folder may be deleted, or its files may be no files. What else is in them the view judges; should it fail
        at that, this one run is not shown.
        """
        try:
            return view.read(lost=self._bench.lost(view.folder))
        except OSError as error:
            self._say(view.folder.name, f"{view.folder.name} cannot be shown: {error.filename} {error.strerror}")
        except (ValueError, ArithmeticError, LookupError, TypeError, AttributeError, RecursionError) as error:
            name = view.folder.name
            self._say(name, f"{name} cannot be shown ({type(error).__name__}: {error}): try rig report on it")
        return None

    def _read(self, view: LiveView) -> Snapshot | None:
        """The run that is followed; whoever deletes its flag does not make it look over."""
        snapshot = self._seen(view)
        if snapshot is not None and snapshot.state == "died" and self._ended is None:
            self._bench.look(at_all=False)
            snapshot = self._seen(view)
        if self._bench.lost(view.folder) is not None and self._lost != view.folder:
            self._lost = view.folder
            self._tell(
                {
                    "type": "trouble", "code": "Stop flag gone",
                    "what": f"{view.folder.name} goes on without its stop.flag: Stop is a signal to its process",
                    "cure": "press Stop, and find out what deletes files of a run that goes on",
                }
            )  # fmt: skip
        return snapshot

    def _choose(self) -> None:
        """Follow the newest run that goes on, once the one that is followed is over."""
        going = [one.folder for one in self._bench.running]
        if going and (self._view is None or self._view.folder not in going):
            self._view, self._ended, self._pid, self._over_ticks = LiveView(going[-1]), None, None, 0
            if self._unconfirmed and not (self._asked or self._starting):  # who starts again has looked at the bench
                self._unconfirmed = []
                self._tell(_stop_message(None, None, "", None))

    def _take_ends(self, folder: Path | None, snapshot: Snapshot | None) -> None:
        """Tell of the run that is over, and of commands that ended before they had a run folder."""
        for ended in self._bench.ended():
            self._statuses[ended.pid] = ended
        if snapshot is not None and snapshot.runner is not None:
            self._pid = snapshot.runner.pid
        if folder is not None and snapshot is not None and snapshot.state != "runs" and self._ended is None:
            # a process that was started here still has to say its last words and its exit status
            self._over_ticks += 1
            if self._pid not in self._bench.pids or self._over_ticks > _MOST_TICKS_TO_EXIT:
                self._end(folder, snapshot)
        for pid in [pid for pid in self._statuses if pid != self._pid]:
            early = self._statuses.pop(pid)
            if (asked_s := self._starting.pop(pid, None)) is not None:
                self._settled(STARTING, asked_s, at_zero=not early.began)
            if early.status != 0 and not early.began:  # one that began and took its time to exit was told of already
                self._tell(_ended_early(early))

    def _end(self, folder: Path, snapshot: Snapshot) -> None:
        """The run is over."""
        row = self._runs.row(folder)
        mine = self._statuses.pop(self._pid, None) if self._pid is not None else None
        died = "the process died, and left no end" if snapshot.state == "died" else ""
        self._ended = {
            "type": "ended", "run": folder.name, "why": row["fault"] or died, "verdict": row["verdict"],
            "exit": None if mine is None else mine.status, "words": "" if mine is None else mine.words,
        }  # fmt: skip

    def _watch_stops(self, folder: Path | None, snapshot: Snapshot | None) -> None:
        for one in self._bench.running:
            if (asked_s := self._starting.pop(one.runner.pid, None)) is not None:  # it has its folder now
                self._asked.setdefault(one.folder, _Asked(asked_s, LiveView(one.folder)))
        now_s = time.monotonic()
        for asked, stop in list(self._asked.items()):
            at_zero = self._at_zero(asked, stop, snapshot if asked == folder else None)
            if at_zero is not None:
                del self._asked[asked]
                if isinstance(stop.view, Unrecorded):
                    stop.view.close()
                self._settled(_name(asked), stop.at_s, at_zero=at_zero)
            elif now_s - stop.at_s > _ZERO_WITHIN_S and not stop.told:
                stop.told = True
                self._tell(_stop_message(_name(asked), False, _NOT_CONFIRMED, round(1e3 * (now_s - stop.at_s))))

    def _at_zero(self, asked: Path, stop: _Asked, snapshot: Snapshot | None) -> bool | None:
        """Whether the device of this run has confirmed 0 V; False: the run is over without that; None: not yet.

        snapshot  of the run; None: it is read here
        """
        if asked == CALIBRATION:
            calibration = self._bench.calibration
            return None if calibration is not None and calibration.works else True
        if not isinstance(stop.view, LiveView):
            return False if stop.view is None else stop.view.is_at_zero()
        if snapshot is None:
            snapshot = self._seen(stop.view)
        if snapshot is None:
            return None  # nobody can know
        if snapshot.numbers["drive_is_off"] and snapshot.state != "absent":
            return True
        return False if snapshot.numbers["is_over"] or snapshot.state != "runs" else None

    def _settled(self, run: str, asked_s: float, *, at_zero: bool) -> None:
        """A stopped run is over, or at 0 V. The pages have one word for all runs: 0 only if each of them is at 0."""
        after_ms = round(1e3 * (time.monotonic() - asked_s))
        if not at_zero:
            self._unconfirmed.append(run)
            self._tell(_stop_message(run, False, _OVER, after_ms))
        elif not (self._asked or self._starting or self._unconfirmed):
            self._tell(_stop_message(run, True, "", after_ms))

    def _tell(self, message: News) -> None:
        self._number += 1
        self._news = [*self._news[1 - _MOST_NEWS :], (self._number, message)]


def _seen(folder: Path) -> LiveView | Unrecorded | None:
    """What a Stop was for, as its end is seen."""
    if is_recorded(folder):
        return LiveView(folder)
    try:
        return Unrecorded(folder)
    except (OSError, ValueError):
        return None


def _name(folder: Path) -> str:
    """What a Stop was for, for people."""
    return folder.name if is_recorded(folder) else command_of(folder)


@dataclass(eq=False)
class Follower:
    """What one page has been told already."""

    news: int
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    _run: str | None = None
    _after_row: int = -1
    _estimates: int = 0
    _faults: int = 0
    _ended: bool = False
    _number: int = 0
    _seen: int | None = None
    _spoke_s: float = -math.inf
    _operator: bool | None = None
    _calibration: int = 0

    def seen(self, number: int) -> None:
        """The page says which live message it has shown."""
        self._seen = max(number, self._seen or 0)

    def due(self, scene: Scene, *, operator: bool, now_s: float) -> list[str]:
        """The messages that the page lacks, now."""
        messages: list[Message] = []
        if operator != self._operator:
            self._operator = operator
            messages.append({"type": "operator", "you": operator})
        if scene.calibration != self._calibration:
            self._calibration = scene.calibration
            messages.append({"type": "calibration", "changes": scene.calibration})
        messages += [message for number, message in scene.news if number > self.news]
        self.news = max(self.news, scene.news[-1][0] if scene.news else 0)
        if scene.run is not None and scene.snapshot is not None:
            messages += self._of_run(scene, scene.run, scene.snapshot, now_s)
        if not messages and now_s - self._spoke_s >= ALIVE_S - 0.5 * PERIOD_S:
            messages.append({"type": "idle", "opening": scene.opening, "words": scene.opens_with})
        if messages:
            self._spoke_s = now_s
        return [json.dumps(message, allow_nan=False, separators=(",", ":")) for message in messages]

    def _of_run(self, scene: Scene, run: str, snapshot: Snapshot, now_s: float) -> list[Message]:
        if run != self._run:
            self._run, self._after_row, self._estimates, self._faults, self._ended = run, -1, 0, 0, False
        messages: list[Message] = []
        rows = snapshot.rows[_first_after(snapshot.rows, self._after_row) :]
        is_silent = now_s - self._spoke_s >= ALIVE_S - 0.5 * PERIOD_S
        too_many = self._seen is not None and self._number - self._seen >= _MOST_UNSEEN
        if not self._ended and (is_silent or (rows and not too_many)):
            self._number += 1
            self._after_row = rows[-1].number if rows else self._after_row
            messages.append(live(run, self._number, snapshot, rows))
        for estimate in snapshot.estimates[self._estimates :]:
            messages.append({"type": "estimate", "run": run, **estimate})
        for fault in snapshot.faults[self._faults :]:
            messages.append({"type": "fault", "run": run, **fault})
        self._estimates, self._faults = len(snapshot.estimates), len(snapshot.faults)
        if scene.ended is not None and not self._ended:
            self._ended = True
            messages.append(scene.ended)
        return messages


def live(run: str, number: int, snapshot: Snapshot, rows: Sequence[LiveRow]) -> Live:
    """The numbers of a run, and its newest rows."""
    return {
        "type": "live", "n": number, "run": run,
        "rows": {
            "t_s": [rounded(row.t_s, 4) for row in rows],
            "y_rad": [rounded(row.y_rad, 5) for row in rows],
            "u_V": [rounded(row.u_V, 4) for row in rows],
            "z_rad_s": [rounded(row.z_rad_s, 5) for row in rows],
        },
        **snapshot.numbers,
    }  # fmt: skip


def _first_after(rows: Sequence[LiveRow], number: int) -> int:
    """Index of the first row after this number; the rows are numbered without gaps."""
    return 0 if not rows else min(max(number + 1 - rows[0].number, 0), KEPT_ROWS)


def _ended_early(over: Ended) -> RunEnded:
    """A command ended before it had a run folder."""
    why = f"rig {over.command} was stopped before it drove" if over.stopped else f"rig {over.command} did not start"
    return {
        "type": "ended", "run": None, "why": why, "verdict": None, "exit": over.status, "words": over.words,
    }  # fmt: skip


def _stop_message(run: str | None, drive_zero: bool | None, why: str, after_ms: int | None) -> Stop:
    return {
        "type": "stop", "received": True, "run": run, "drive_zero": drive_zero, "after_ms": after_ms, "why": why,
    }  # fmt: skip
