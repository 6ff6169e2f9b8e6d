"""What a page may make the bench do: check a config, start a run, jog, stop. Each run is a process of its own."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rig.live.lease import Leaser
from rig.live.running import Running, running
from rig.live.stop_flag import StopError, request_stop
from rig.panel import processes
from rig.panel.aside import answer_of
from rig.panel.errors import RefusedError
from rig.panel.processes import Ended, StartedProcess

_CONFIRMED_FOR_S: Final = 600.0


@dataclass(frozen=True)
class StopAnswer:
    """What became of a Stop.

    runs   folders of the runs that it reached
    waits  commands that have no run folder yet and were interrupted
    why    what did not work; empty: all of it did
    """

    runs: tuple[Path, ...]
    waits: int
    why: str


@dataclass(frozen=True)
class _Confirmation:
    key: str
    digest: str
    until_s: float


@dataclass(frozen=True)
class _Jog:
    """A jog that waits for leases: who holds it, and how much a whole share of drive is."""

    holder: str
    leaser: Leaser


class Bench:
    """The runs below one folder, and the one config that is started from here.

    config  None: this panel starts nothing
    out     folder of the run folders
    """

    def __init__(self, config: Path | None, out: Path) -> None:
        self.config, self.out = config, out
        self._started = processes.found_again(out)
        self._confirmation: _Confirmation | None = None
        self._jog_V = 0.0
        self._jog: _Jog | None = None
        self._running: list[Running] = []

    # ------------------------------------------------------------------ what goes on

    def look(self) -> None:
        """Look anew which runs go on. It reads the folder."""
        self._running = running(self.out)
        pids = {one.runner.pid for one in self._running}
        for process in self._started:
            process.has_folder |= process.pid in pids

    @property
    def running(self) -> list[Running]:
        """The runs that went on at the last look, the newest last; whoever started them."""
        return self._running

    @property
    def opening(self) -> list[StartedProcess]:
        """What was started here, goes on, and has no run folder yet."""
        return [process for process in self._started if not process.has_folder and process.lives]

    def ended(self) -> list[Ended]:
        """What was started here and has ended since the last call."""
        over = [process for process in self._started if not process.lives]
        self._started = [process for process in self._started if process not in over]
        return [process.end() for process in over]

    def _require_idle(self) -> None:
        self.look()
        if busy := [one.folder.name for one in self._running] + [one.command for one in self.opening]:
            raise RefusedError(409, f"{busy[-1]} goes on already", "wait for its end, or press Stop")

    # ------------------------------------------------------------------ start

    def _own_config(self) -> Path:
        if self.config is None:
            raise RefusedError(409, "this panel has no config to start", "start it as: rig panel CONFIG")
        return self.config

    async def check(self) -> dict[str, Any]:
        """What `rig check` says of the config, and a ``confirmation`` with which it may be started."""
        config = self._own_config()
        digest = await asyncio.to_thread(_digest, config)
        found = await answer_of("rig.panel.prospect", config)
        confirmation = None
        if found.get("may_run"):
            confirmation = secrets.token_urlsafe(12)
            self._confirmation = _Confirmation(confirmation, digest, time.monotonic() + _CONFIRMED_FOR_S)
            self._jog_V = float(found["plan"]["jog_V"])
        return {**found, "confirmation": confirmation}

    def start(self, confirmation: object) -> dict[str, Any]:
        """Start ``rig run`` on the config as it was checked. Raises RefusedError if anything is in the way."""
        config = self._own_config()
        given, self._confirmation = self._confirmation, None  # each starts once
        if given is None or confirmation != given.key or time.monotonic() > given.until_s:
            raise RefusedError(409, "this start was not confirmed, or too long ago", "check the config again")
        if _digest(config) != given.digest:
            raise RefusedError(409, f"{config.name} has changed since it was checked", "check it again")
        self._require_idle()
        process = processes.start(self.out, "run", [str(config)])
        self._started.append(process)
        return {"run": None, "pid": process.pid}

    # ------------------------------------------------------------------ stop

    def stop(self, name: str | None = None, by: str = "panel") -> StopAnswer:
        """Stop the run of this name, or without a name all that goes on. Raises nothing: it says what did not work."""
        self.release()
        self.look()
        reached, failed = [], []
        for one in self._running:
            if name is None or one.folder.name == name:
                try:
                    request_stop(one.folder, by)
                    reached.append(one.folder)
                except StopError as error:
                    failed.append(str(error))
        waiting = self.opening if name is None else []
        for process in waiting:
            process.interrupt()
        return StopAnswer(tuple(reached), len(waiting), "; ".join(failed))

    # ------------------------------------------------------------------ jog

    async def start_jog(self) -> dict[str, Any]:
        """Start ``rig jog --leased`` on the config. It drives nothing until a page holds a lease."""
        config = self._own_config()
        found = await answer_of("rig.panel.prospect", config)
        if not found.get("may_run"):
            raise RefusedError(409, "rig refuses this config", "press START: the check says why")
        self._jog_V = float(found["plan"]["jog_V"])
        self._require_idle()
        process = processes.start(self.out, "jog", [str(config), "--leased"])
        self._started.append(process)
        return {"run": None, "pid": process.pid, "jog_V": self._jog_V}

    def jog(self, holder: str, share: float) -> None:
        """Drive with this share of the jog's voltage, -1 to 1, until the lease runs out.

        holder  the socket that asks; another one cannot while this one holds
        Raises RefusedError if no jog goes on.
        """
        if self._jog is not None and self._jog.holder != holder:
            raise RefusedError(409, "another page holds the jog", "let go there")
        if self._jog is None:
            self._jog = _Jog(holder, self._leaser())
        try:
            self._jog.leaser.drive(min(max(share, -1.0), 1.0) * self._jog_V)
        except OSError as error:
            self._drop()
            raise RefusedError(409, f"the jog takes no lease: {error.strerror}", "start it again") from error

    def release(self, holder: str | None = None) -> None:
        """Give the lease back at once, if ``holder`` has it; None: whoever has it."""
        if self._jog is not None and holder in (None, self._jog.holder):
            try:
                self._jog.leaser.release()
            except OSError:
                pass  # the jog is over, or its lease runs out by itself
            finally:
                self._drop()

    def _leaser(self) -> Leaser:
        for one in reversed(self._running):
            try:
                return Leaser(one.folder)
            except (OSError, ValueError):
                continue
        raise RefusedError(409, "no jog goes on", "press Jog first, and wait until the device is open")

    def _drop(self) -> None:
        if self._jog is not None:
            self._jog.leaser.close()
        self._jog = None


def _digest(config: Path) -> str:
    try:
        return hashlib.sha256(config.read_bytes()).hexdigest()
    except OSError as error:
        raise RefusedError(409, f"{config} cannot be read: {error.strerror}", "check the path") from error
