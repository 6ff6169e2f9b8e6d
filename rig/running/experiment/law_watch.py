"""A law of a user's own under watch: how long each step takes, and what happens to one that never returns.

In the loop's process a step's CPU time is compared with its bound when it has returned. While it has not, another
process watches: the keeper (``rig.running.keeper.hung_law``). It asks first: a signal of its own raises out of the law,
as Ctrl-C does. If the law heeds no signal, the keeper takes the link, stops the device, and ends this process.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, chdir, contextmanager
from types import FrameType
from typing import IO, Final, NoReturn

from rig.backends.clock import MonotonicClock
from rig.control.law import Stopped, Timed, is_of_own_law
from rig.core.copies import keep_from_copies, no_longer_own
from rig.core.faults import Fault
from rig.core.halted import Halts, end_within
from rig.core.memory_file import create_file
from rig.core.signals import Sample
from rig.run_folder.live.law_lease import SIZE, LawLease
from rig.running.keeper.law_times import END, READY, LawTimes, asks, law_times, too_long_words
from rig.running.session import Session

_STARTS_S: Final = 30.0
_CLOSES_S: Final = 5.0
_LOOK_EVERY_STEPS: Final = 50
_NOBODY: Final = "no process watches the law: one that never returns cannot be ended but by `kill -9`"


class WatchedLaw(Timed):
    """The law, with a bound on the CPU time of each step, and a keeper for one that does not return.

    law         the law
    times       what a step may take
    check_stop  raises the fault of a stop that somebody asks for
    """

    def __init__(self, law: Timed, times: LawTimes, check_stop: Callable[[], None] = lambda: None) -> None:
        super().__init__(law.law, law.duration_s, law.name)
        self.keeper: Keeper | None = None
        self.trouble = ""  # what is wrong with its watch
        self._times = times
        self._check_stop = check_stop
        self._lease = LawLease(-1)
        self._steps = 0
        self._exited: Fault | None = None
        self._began_cpu_ns = 0
        self._pid = os.getpid()

    def step(self, sample: Sample) -> float:
        """As of ``Timed``. Raises Fault LAW_TIME and LAW_UNWATCHED besides."""
        keeper = self.keeper
        lease = self._lease if keeper is None else keeper.lease
        self._began_cpu_ns = time.thread_time_ns()
        lease.begin(self._began_cpu_ns)
        try:
            u_V = super().step(sample)
        finally:
            if os.getpid() != self._pid:
                os._exit(1)  # a copy of this process that the law has forked: the bench is not its own
            if not lease.end() and keeper is not None:
                self._heed(keeper.await_verdict())
        if self._exited is not None:
            raise self._exited
        if self._cpu_s() > self._times.cpu_s:
            raise self._too_long("one step took")
        self._steps += 1
        if keeper is not None and self._steps % _LOOK_EVERY_STEPS == 0:
            self._heed(keeper.amiss())
        return u_V

    def exits(self, status: int) -> NoReturn:
        """In place of ``os._exit`` while the law is at work: the run ends with a fault, and its result.

        Raises Stopped out of the law; SystemExit in a thread of the law's, which that ends.
        """
        self._exited = Fault("LAW_FAILED", f"{self.name}: it called os._exit({status}), which would leave no result")
        if is_of_own_law(sys._getframe()):
            raise Stopped(self._exited)
        raise SystemExit(status)

    def unwatched(self, why: str) -> None:
        """Nobody watches the law. Raises Fault LAW_UNWATCHED where a motor could move; else it is a note."""
        if math.isfinite(self._times.cpu_s):
            raise Fault("LAW_UNWATCHED", why)
        self.trouble = f"{_NOBODY}: {why}"

    def asked_to_end(self, number: int, frame: FrameType | None) -> None:
        """The handler of the keeper's signal: raises Stopped. Out of that step it does nothing."""
        if not (is_of_own_law(frame) and self.keeper is not None and self.keeper.lease.is_asked):
            return
        try:
            self._check_stop()
        except Fault as asked:
            raise Stopped(asked) from None
        raise Stopped(self._too_long("its step was ended: it had taken"))

    def _heed(self, amiss: str) -> None:
        if amiss and not self.trouble:
            self.unwatched(amiss)

    def _cpu_s(self) -> float:
        return 1e-9 * (time.thread_time_ns() - self._began_cpu_ns)

    def _too_long(self, what: str) -> Fault:
        return Fault("LAW_TIME", too_long_words(self.name, what, self._cpu_s(), self._times))


class Keeper:
    """The loop's side of the process that watches a law. It hears of stop signals even where a law holds Python.

    lease  who may speak on the link
    Raises OSError where it cannot be started, or is not ready in time.
    """

    def __init__(self, session: Session, law: Timed, times: LawTimes) -> None:
        e, loop = session.experiment, session.loop
        is_real = isinstance(session.bench.clock, MonotonicClock)
        link = getattr(session.bench.driver, "descriptor", None) if is_real else None
        failsafe = session.bench.driver.failsafe
        kept = {
            "pid": os.getpid(), "tid": threading.get_native_id(), "folder": str(session.folder.absolute()),
            "law": law.name, "times": times, "zero_s": -loop.since_start_s(0.0) if is_real else None,
            "watchdog_s": None if failsafe is None else failsafe.time_s, "backend": session.bench.driver.backend,
        }  # fmt: skip
        settings = {"loop": kept, "link": link, "priority": e.loop.priority if is_real else 0}
        with ExitStack() as stack:
            memory = create_file(SIZE)
            stack.callback(os.close, memory)
            self.lease = LawLease(memory)
            heard, self._signals = os.pipe()
            stack.callback(os.close, heard)
            os.set_blocking(self._signals, False)
            keep_from_copies(self._signals)
            descriptors = (memory, heard) if link is None else (memory, heard, link)
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-m", "rig.running.keeper.hung_law", str(memory), str(heard)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    bufsize=0,
                    pass_fds=descriptors,
                    env={**os.environ, "PYTHONWARNINGS": "ignore::RuntimeWarning:runpy"},
                    start_new_session=True,  # Ctrl-C in the terminal is not meant for it
                )
            except OSError:
                self.let_go()
                raise
        self._verdict_s, self._halts = times.still_s, Halts(self._process)
        for pipe in self._pipes:
            keep_from_copies(pipe.fileno())
        try:
            self._tell(json.dumps(settings).encode("ascii") + b"\n")
            self._await_ready()
        except OSError:
            self.close()
            self.let_go()
            raise

    @property
    def _pipes(self) -> list[IO[bytes]]:
        return [pipe for pipe in (self._process.stdin, self._process.stdout) if pipe is not None and not pipe.closed]

    def amiss(self) -> str:
        """Why it watches no more: it is gone, though nobody ended it, or somebody has stopped it. Empty: it watches."""
        return self._halts.words

    @property
    def signals(self) -> int:
        """Descriptor to which the system is to write each signal (``signal.set_wakeup_fd``)."""
        return self._signals

    def await_verdict(self) -> str:
        """Wait while the link is the keeper's: it gives it back at once (empty), or ends this process.

        If it does neither, it is ended, so that it never speaks again, and the link is the loop's. Returns why.
        """
        until_s, why = time.monotonic() + self._verdict_s, ""
        while self.lease.is_taken and not why:
            why = self.amiss() or ("the keeper had the link for too long" if time.monotonic() > until_s else "")
            time.sleep(0.001)
        if why:
            self._process.kill()
            self._process.wait()
            self.lease.give_back()
        return why

    def close(self) -> None:
        """End the process in order."""
        with contextlib.suppress(OSError):
            self._tell(END)
        for pipe in self._pipes:
            no_longer_own(pipe.fileno())
            pipe.close()
        if self._process.poll() is None and self._halts.is_stopped:
            self._process.kill()
        end_within(self._process, _CLOSES_S)

    def let_go(self) -> None:
        """Free what was shared with it."""
        no_longer_own(self._signals)
        os.close(self._signals)
        self.lease.close()

    def _tell(self, message: bytes) -> None:
        if self._process.stdin is not None:
            self._process.stdin.write(message)

    def _await_ready(self) -> None:
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], _STARTS_S)[0]:
            raise TimeoutError(f"the keeper was not ready within {_STARTS_S:g} s")
        if self._process.stdout.read(len(READY)) != READY:
            raise ChildProcessError(f"the keeper ended with status {self._process.wait()}")


@contextmanager
def watched(session: Session, law: Timed) -> Iterator[WatchedLaw]:
    """The law under watch, for the block; its device is armed within it. Notes where nobody watches.

    Raises Fault LAW_UNWATCHED before anything is armed, where the keeper cannot start and a motor could move.
    """
    virtual = not isinstance(session.bench.clock, MonotonicClock)
    times = law_times(session.experiment, virtual=virtual)
    one = WatchedLaw(law, times, session.loop.check_stop)
    with ExitStack() as stack, chdir("."):  # a law may go elsewhere; the run folder's path is from here
        if sys.platform.startswith("linux"):
            try:
                keeper = one.keeper = Keeper(session, law, times)
            except OSError as error:
                one.unwatched(error.strerror or str(error))
            else:
                stack.callback(keeper.let_go)
                stack.enter_context(_heard(one, keeper))
                stack.callback(keeper.close)  # first: while it lives it may send its signal
                stack.enter_context(session.loop.kept(keeper.lease))
        else:
            one.trouble = f"{_NOBODY}: {sys.platform} has not been tried"
        stack.enter_context(_never_exits(one))
        try:
            yield one
        finally:
            if one.trouble:
                session.found.notes.append(one.trouble)


@contextmanager
def _never_exits(law: WatchedLaw) -> Iterator[None]:
    """Within the block ``os._exit`` does not end this process; a copy of it, as of a pool of processes, it does."""
    ends, own = os._exit, os.getpid()

    def exits(status: int) -> NoReturn:
        (law.exits if os.getpid() == own else ends)(status)

    os._exit = exits
    try:
        yield
    finally:
        os._exit = ends


@contextmanager
def _heard(law: WatchedLaw, keeper: Keeper) -> Iterator[None]:
    """Within the block the keeper's signal reaches the law, and each signal of this process the keeper."""
    before = signal.signal(asks(), law.asked_to_end)
    others = signal.set_wakeup_fd(keeper.signals, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(others)
        signal.signal(asks(), before)
