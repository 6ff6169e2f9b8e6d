"""What a page may make the bench do: check a config, start a run, calibrate, jog, stop.

Each run and each calibration is a process of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import itertools
import secrets
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rig.config.yaml12 import MOST_BYTES
from rig.core.plain_file import read_plain
from rig.panel import processes
from rig.panel.aside import answer_of
from rig.panel.calibration import EVERY_S, Calibration
from rig.panel.messages import Checked, RefusedError, Started
from rig.panel.processes import Ended, StartedProcess
from rig.panel.prospect import prospect
from rig.run_folder.live.lease import Leaser
from rig.run_folder.live.running import Lookout, Running, Seen, running
from rig.run_folder.live.stop_flag import Runner, StopError, command_of, is_recorded, request_stop, runner_of

HOLD_ENDS_S: Final = 0.3  # without a renewal: two leases
CALIBRATION: Final = Path("the calibration")  # stands for one of this panel that has no flag yet
_MOST_LOOKS: Final = 5  # of a Stop
_CONFIRMED_FOR_S: Final = 600.0
_AS_WATCHED: Final = ("--pace", "1")  # of a device in virtual time; the time of any other has that pace


@dataclass(frozen=True)
class StopAnswer:
    """What became of a Stop.

    runs   folders of the runs that it reached, and of what is not recorded; or ``CALIBRATION``
    waits  processes of commands that have no run folder yet and were interrupted
    why    what did not work; empty: all of it did
    """

    runs: tuple[Path, ...]
    waits: tuple[int, ...]
    why: str


@dataclass(frozen=True)
class _Confirmation:
    key: str
    digest: str
    until_s: float


@dataclass
class _Hold:
    """A button that a page holds: which page, its leases, and when the last one was given."""

    holder: str
    leaser: Leaser
    at_s: float


class Bench:
    """The runs below one folder, and the one config that is started from here.

    config  None: this panel starts nothing
    out     folder of the run folders
    """

    def __init__(self, config: Path | None, out: Path) -> None:
        self.config, self.out = config, out
        # the look, a Stop and the pages come from different threads
        self._lock, self._jog_lock = threading.Lock(), threading.RLock()
        self._started = processes.found_again(out)
        self._confirmation: _Confirmation | None = None
        self._jog_V = 0.0
        self._hold: _Hold | None = None
        self._interrupted: set[str] = set()  # pages whose hold was interrupted, until they let go
        self._running: list[Running] = []
        self._unrecorded: list[Running] = []
        self._lookout, self._seen = Lookout(out), Seen()
        self._lost: list[Running] = []
        self.calibration: Calibration | None = None
        self.calibration_changes = 0
        self._changes = itertools.count(1)

    # ------------------------------------------------------------------ what goes on

    def look(self, *, at_all: bool = True) -> None:
        """Look anew which runs go on. It reads the folder.

        at_all  False: a look as one of many; not for two threads
        """
        going = running(self.out) if at_all else self._lookout.look()
        found = [one for one in going if is_recorded(one.folder)]
        others = self._seen.others(found)
        self._lost = [one for one in others if runner_of(one.folder) is None]
        self._running = [*others, *found]
        pids = {one.runner.pid for one in self._running}
        self._unrecorded = self._seen.unrecorded([one for one in going if not is_recorded(one.folder)], pids)
        others_started = processes.of_others(self.out, self.pids)  # it reads the disk: not with the lock
        with self._lock:
            known = {process.pid for process in self._started}
            self._started += [process for process in others_started if process.pid not in known]
            for process in self._started:
                process.has_folder |= process.pid in pids

    @property
    def running(self) -> list[Running]:
        """The runs that went on at the last look, the newest last; whoever started them."""
        return self._running

    @property
    def unrecorded(self) -> list[Running]:
        """What drove, or may drive, without a run folder at the last look; a run that opens its device, too."""
        return self._unrecorded

    def lost(self, folder: Path) -> Runner | None:
        """Who makes the run in this folder if its flag is gone, and he goes on all the same."""
        return next((one.runner for one in self._lost if one.folder == folder), None)

    @property
    def opening(self) -> list[StartedProcess]:
        """What was started here, goes on, and has no run folder yet."""
        with self._lock:
            return [process for process in self._started if not process.has_folder and process.lives]

    @property
    def pids(self) -> set[int]:
        """The processes that were started here and whose end was not told yet."""
        with self._lock:
            return {process.pid for process in self._started}

    def ended(self) -> list[Ended]:
        """What was started here and has ended since the last call."""
        with self._lock:
            over = [process for process in self._started if not process.lives]
            self._started = [process for process in self._started if process not in over]
        return [process.end() for process in over]

    def _start(self, command: str, *arguments: str) -> Started:
        """Start a command, if nothing else goes on."""
        with processes.one_at_a_time(self.out):  # two panels of one folder must not both find it at rest
            self.look()
            with self._lock:
                self._require_rest()
                process = processes.start(self.out, command, arguments)
                self._started.append(process)
        return {"run": None, "pid": process.pid}

    def _require_rest(self) -> None:
        """Raise RefusedError if anything goes on; the lock is held."""
        opening = [process.command for process in self._started if not process.has_folder and process.lives]
        if self.calibration is not None and self.calibration.goes_on:
            raise RefusedError(409, "a calibration goes on already", "finish it, or end it, on the page Calibrate")
        unrecorded = [command_of(one.folder) for one in self._unrecorded]
        if busy := unrecorded + [one.folder.name for one in self._running] + opening:
            raise RefusedError(409, f"{busy[-1]} goes on already", "wait for its end, or press Stop")

    # ------------------------------------------------------------------ start

    def _own_config(self) -> Path:
        if self.config is None:
            raise RefusedError(409, "this panel has no config to start", "start it as: rig panel CONFIG")
        return self.config

    async def check(self) -> Checked:
        """What `rig check` says of the config, and a ``confirmation`` with which it may be started."""
        found = await answer_of(prospect, self._own_config())
        confirmation = None
        if found["plan"] is not None:
            confirmation = secrets.token_urlsafe(12)
            self._confirmation = _Confirmation(confirmation, found["digest"], time.monotonic() + _CONFIRMED_FOR_S)
        return {
            "lines": found["lines"], "may_run": found["may_run"], "plan": found["plan"], "confirmation": confirmation,
        }  # fmt: skip

    def start(self, confirmation: object) -> Started:
        """Start ``rig run`` on the config as it was checked. Raises RefusedError if anything is in the way."""
        config = self._own_config()
        given, self._confirmation = self._confirmation, None  # each starts once
        if given is None or confirmation != given.key or time.monotonic() > given.until_s:
            raise RefusedError(409, "this start was not confirmed, or too long ago", "check the config again")
        if _digest(config) != given.digest:
            raise RefusedError(409, f"{config.name} has changed since it was checked", "check it again")
        return self._start("run", str(config), *_AS_WATCHED, "--as-checked", given.digest)

    # ------------------------------------------------------------------ calibrate

    def calibrate(self) -> None:
        """Begin a calibration of the config. Raises RefusedError if anything is in the way."""
        config = self._own_config()
        with processes.one_at_a_time(self.out):
            self.look()
            with self._lock:
                self._require_rest()
                self.calibration = Calibration(config, self.out, self._calibration_changed)
        self._calibration_changed()

    async def attend(self) -> None:
        """Promise to a calibration that this panel is there, until cancelled.

        By the event loop, which also takes a Stop: if it hangs, the drive ends.
        """
        while True:
            if self.calibration is not None:
                self.calibration.attend()
            await asyncio.sleep(EVERY_S)

    def _calibration_changed(self) -> None:
        self.calibration_changes = next(self._changes)  # from several threads: no two changes look like one

    # ------------------------------------------------------------------ stop

    def stop(self, name: str | None = None, by: str = "panel") -> StopAnswer:
        """Stop the run of this name, or without a name all that goes on. Raises nothing: it says what did not work."""
        self.release()
        reached: list[Path] = []
        failed: dict[Path, str] = {}
        waiting: set[int] = set()
        for attempt in range(_MOST_LOOKS):  # first what is known, then what a look at all folders finds
            if attempt > 0:
                self.look()
            failed, has_moved = {}, False
            own = {process.pid for process in self.opening}
            own |= set() if self.calibration is None else {self.calibration.pid}
            unrecorded = [one for one in self._unrecorded if one.runner.pid not in own]  # those get a signal
            for one in [*self._running, *unrecorded]:
                if one.folder not in reached and name in (None, one.folder.name):
                    try:
                        if self._stop(one, by):
                            reached.append(one.folder)
                        else:
                            has_moved = True  # over, or its flag is in its run folder by now
                    except StopError as error:
                        failed[one.folder] = str(error)
            for process in self.opening if name is None else ():
                if process.pid not in waiting:  # a second signal would cost it its report
                    process.interrupt()
                    waiting.add(process.pid)
            if attempt > 0 and not has_moved:
                break
        if self.calibration is not None and name is None:
            is_run = self.calibration.pid in {one.runner.pid for one in self._running if one.folder in reached}
            if self.calibration.works and not is_run:
                pid = self.calibration.pid
                flagged = (one.folder for one in self._unrecorded if one.runner.pid == pid and runner_of(one.folder))
                reached.append(next(flagged, CALIBRATION))
            self.calibration.stop(by_flag=is_run)
        if name is not None and not reached and not failed:
            return StopAnswer((), (), f"no run {name!r} goes on here: a stop without a name stops all")
        return StopAnswer(tuple(reached), tuple(sorted(waiting)), "; ".join(failed.values()))

    def _stop(self, one: Running, by: str) -> bool:
        """Stop this run: by its flag, or where that is gone by a signal. Raises StopError.

        Returns False if it has come to its end since the look.
        """
        try:
            request_stop(one.folder, by)
        except StopError:
            if runner_of(one.folder) is not None:
                raise
            if not self._seen.goes_on(one):
                return False
            try:
                one.runner.terminate()
            except OSError as error:
                raise StopError(
                    f"{one.folder} has no stop flag any more, and process {one.runner.pid} takes no signal of this "
                    "user: use the e-stop"
                ) from error
        return True

    # ------------------------------------------------------------------ jog

    async def start_jog(self) -> Started:
        """Start ``rig jog --leased`` on the config. It drives nothing until a page holds a lease.

        Raises RefusedError if anything is in the way.
        """
        config = self._own_config()
        found = await answer_of(prospect, config)
        if found["plan"] is None:
            raise RefusedError(409, "rig refuses this config", "press Check and start…: the check says why")
        self._jog_V = found["plan"]["jog_V"]
        as_checked = (*_AS_WATCHED, "--as-checked", found["digest"])
        started = await asyncio.to_thread(self._start, "jog", str(config), "--leased", *as_checked)
        return {**started, "jog_V": self._jog_V}

    def end_jog(self) -> None:
        """End the jog that waits for leases, in order: it is no fault. Raises RefusedError if there is none."""
        with self._jog_lock:
            self._drop()
            leaser = self._leaser()
            try:
                leaser.end()
            except OSError as error:
                raise RefusedError(409, f"the jog cannot be ended: {error.strerror}", "press Stop") from error
            finally:
                leaser.close()

    def jog(self, holder: str, share: float) -> None:
        """Drive with this share of the jog's voltage, -1 to 1, until the lease runs out.

        holder  the socket that asks; another one cannot while this one holds
        Raises RefusedError if no jog goes on.
        """
        now_s = time.monotonic()
        with self._jog_lock:
            if self._hold is not None and now_s - self._hold.at_s > HOLD_ENDS_S:
                self._interrupted.add(self._hold.holder)
                self._drop()
            if holder in self._interrupted:  # what comes now may be old: the page, the network or this panel slept
                raise RefusedError(409, "the hold was interrupted", "let go, then press again")
            if self._hold is not None and self._hold.holder != holder:
                raise RefusedError(409, "another page holds the jog", "let go there")
            hold = self._hold = self._hold or _Hold(holder, self._leaser(), now_s)
            hold.at_s = now_s
            try:
                if hold.leaser.is_anothers:  # what this one has given is not the newest: there is nothing to give back
                    hold.leaser.close()
                    self._hold = None
                    raise RefusedError(409, "another panel holds the jog", "let go there")
                hold.leaser.drive(min(max(share, -1.0), 1.0) * self._jog_V)
            except OSError as error:
                self._drop()
                raise RefusedError(409, f"the jog takes no lease: {error.strerror}", "start it again") from error

    def release(self, holder: str | None = None) -> None:
        """Give the lease back at once, if ``holder`` has it; None: whoever has it."""
        with self._jog_lock:
            self._interrupted.discard(holder or "")
            if self._hold is not None and holder in (None, self._hold.holder):
                self._drop()

    def _leaser(self) -> Leaser:
        for one in reversed(self._running):
            try:
                return Leaser(one.folder)
            except (OSError, ValueError):
                continue
        raise RefusedError(409, "no jog goes on", "press Get ready to jog, and wait until the device is open")

    def _drop(self) -> None:
        if self._hold is not None:
            with contextlib.suppress(OSError):  # the jog is over, or its lease runs out by itself
                self._hold.leaser.release()
            self._hold.leaser.close()
        self._hold = None


def _digest(config: Path) -> str:
    try:
        return hashlib.sha256(read_plain(config, MOST_BYTES, follows_links=True)).hexdigest()
    except OSError as error:
        raise RefusedError(409, f"{config} cannot be read: {error.strerror}", "check the path") from error
