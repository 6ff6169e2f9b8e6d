"""The keeper of a run: a process that stops the device where a law of a user's own never returns (docs/safety.md).

``python -m rig.running.keeper.hung_law MEMORY SIGNALS`` gets its settings as one line on standard input, and says that
it is ready on standard output. MEMORY is the descriptor of the ``LawLease``. From the descriptor SIGNALS it reads the
number of each signal of the loop's process: the system writes it there even where the law holds the interpreter.
It looks at the run's stop flag, too, which the loop cannot while the law is at work.

What counts against a law is its own: the CPU time of its thread, and the time that it sleeps. Time in which the machine
gave the law no processor, or in which it was stopped, does not; nor does time in which this process itself was late.
First the keeper asks the law to end, by a signal. After the lease it takes the link, stops the device, kills the
loop's process, which nothing else can end, and writes down what happened as soon as the recorder has ended.

Between two steps the loop may stand still, too: a thread that the law has started may hold the interpreter. Where a
drive may be on, and the loop has not looked for long, the keeper ends its process, and then stops the device.

If the loop's process dies by itself meanwhile, as by `kill -9`, the keeper stops the device, too, and says so where the
law was at work: a law that ends the process in C may leave the status 0.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rig.control.loop.stop_request import STOP_SIGNALS
from rig.core.faults import Fault
from rig.core.strict_json import JsonObject
from rig.run_folder.live.law_lease import LawLease
from rig.run_folder.live.stop_flag import AskedStop
from rig.running.keeper.law_times import END, READY, LawTimes, asks, too_long_words

if TYPE_CHECKING:
    from rig.backends.driver import Driver

LOOK_EVERY_S: Final = 0.005
_ASKS_AT: Final = 0.8  # of the lease: a law that sleeps so long would not be back in time
_ASLEEP: Final = "SD"  # states of a thread; any other but R: stopped, or gone
_GOES_ON_S: Final = 0.1  # after a look of the loop nothing is amiss
_RECORDED_S: Final = 30.0
_DIES_S: Final = 2.0


@dataclass(frozen=True)
class Loop:
    """The loop's process, and what it told when it started the keeper.

    pid, tid    of the process, and of the thread in which the law works
    folder      the run folder
    law         its name
    times       what a step may take; ``cpu_s`` infinite in virtual time
    zero_s      of the monotonic clock at the run's time 0, s; None in virtual time
    watchdog_s  of the device, s; None: it has none
    backend     the bench in words
    """

    pid: int
    tid: int
    folder: Path
    law: str
    times: LawTimes
    zero_s: float | None
    watchdog_s: float | None
    backend: str

    @property
    def is_real(self) -> bool:
        """Whether its time is the machine's."""
        return self.zero_s is not None

    @property
    def lives(self) -> bool:
        """Whether it is still this process's parent."""
        return os.getppid() == self.pid

    def kill(self) -> None:
        """End it, unless it has just ended by itself: its number may then be another process's, or nobody's."""
        with contextlib.suppress(ProcessLookupError):
            if self.lives:
                os.kill(self.pid, signal.SIGKILL)

    def now_s(self) -> float | None:
        """Time of the run, s; None in virtual time."""
        return None if self.zero_s is None else time.monotonic() - self.zero_s

    def thread(self) -> tuple[str, float]:
        """State of the law's thread by the letter of /proc, and its CPU time, s, up to some ms old. Raises OSError."""
        folder = Path(f"/proc/{self.pid}/task/{self.tid}")
        fields = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        with contextlib.suppress(OSError):
            ran_ns = int((folder / "schedstat").read_text(encoding="ascii").split()[0])
            if ran_ns:
                return fields[0], 1e-9 * ran_ns
        return fields[0], (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass
class Charge:
    """What one step of the law has used up so far, s; in virtual time since somebody asked for a stop.

    step      its number
    from_s    CPU time of the thread when it began
    began_s   when it was looked at first
    looked_s  when it was looked at last
    cpu_s     CPU time
    asleep_s  time asleep
    asked     the law was asked to end
    """

    step: int
    from_s: float
    began_s: float = field(default_factory=time.monotonic)
    looked_s: float = field(default_factory=time.monotonic)
    cpu_s: float = 0.0
    asleep_s: float = 0.0
    asked: bool = False

    @property
    def used_s(self) -> float:
        """At work or asleep, s."""
        return self.cpu_s + self.asleep_s

    @property
    def late_s(self) -> float:
        """Time that was nobody's, s: the machine gave law or keeper no processor."""
        return max(self.looked_s - self.began_s - self.used_s, 0.0)

    def look(self, state: str, ran_s: float) -> None:
        """Charge what has passed since the last look. A look that comes late charges no more sleep than two in time."""
        now_s = time.monotonic()
        before_s, self.cpu_s = self.cpu_s, max(ran_s - self.from_s, 0.0)
        passed_s = min(now_s - self.looked_s, 2.0 * LOOK_EVERY_S)
        if state in _ASLEEP:
            self.asleep_s += max(passed_s - (self.cpu_s - before_s), 0.0)
        self.looked_s = now_s


class Watch:
    """Looks after the law until the run needs it no more, or the link is the keeper's.

    signals   descriptor from which the loop's signals are read
    can_stop  whether it can stop the device once the loop's process is gone
    """

    def __init__(self, loop: Loop, lease: LawLease, signals: int, *, can_stop: bool) -> None:
        self.signal = ""  # the first that asked the loop to stop
        self.flagged = ""  # who did by the stop flag
        self.charge: Charge | None = None
        self.still: Charge | None = None  # of the loop, since its last look
        self._looks, self._looked_s = -1, 0.0
        self._loop, self._lease, self._signals, self._can_stop = loop, lease, signals, can_stop

    def hear_of(self, flag: AskedStop) -> None:
        """Look at the run's flag until somebody asks for a stop; in a thread of its own, since a disk may hang."""
        while not self.flagged:
            self.flagged = flag.by()
            time.sleep(LOOK_EVERY_S)

    def serve(self) -> str:
        """Returns how it ended: "in order", "loop died", "taken", or "still"."""
        while True:
            ready = select.select([0, self._signals], [], [], LOOK_EVERY_S)[0]
            if 0 in ready:
                return "in order" if os.read(0, len(END)) == END else "loop died"
            if not self._loop.lives:
                return "loop died"
            if self._signals in ready:
                self._hear(os.read(self._signals, 4096))
            try:
                if self._is_over():
                    return "taken"
                if self._stands_still():
                    return "still"
            except OSError:
                continue  # the loop's process is just ending: the next look sees that

    def _hear(self, numbers: bytes) -> None:
        asked = next((number for number in numbers if number in STOP_SIGNALS), None)
        if asked is not None and not self.signal:
            self.signal = signal.Signals(asked).name

    def _is_over(self) -> bool:
        """Look at the law once; ask it to end, or take the link, when it is time."""
        loop, times = self._loop, self._loop.times
        step = self._lease.at_work
        if step == 0 or (not loop.is_real and not self.signal and not self.flagged):
            self.charge = None
            return False
        state, ran_s = loop.thread()
        if self._lease.at_work != step:
            return False  # what ran may have been the loop's own
        charge = self.charge
        if charge is None or charge.step != step:
            # in virtual time what the law did before somebody asked for a stop is no fault of it
            self.charge = Charge(step, 1e-9 * self._lease.cpu_ns if loop.is_real else ran_s)
            return False
        charge.look(state, ran_s)
        too_long = charge.cpu_s > times.cpu_s or charge.used_s > _ASKS_AT * times.lease_s
        if not charge.asked and (self.flagged or too_long):
            charge.asked = True
            if loop.is_real or self.flagged:  # else the signal itself has asked
                self._lease.ask(step)
                os.kill(loop.pid, asks())
            return False
        return charge.asked and charge.used_s >= times.lease_s and self._lease.take(step)

    def _stands_still(self) -> bool:
        """Whether the loop has slept, or been at work, for too long between two steps, with a drive that may be on.

        Where it waits for no reply, it has a period more than a law that sleeps: a thread of the law holds Python. A
        loop whose device only its own driver can stop may yet do that: there somebody has to ask for it.
        """
        loop, lease, now_s = self._loop, self._lease, time.monotonic()
        if lease.looks != self._looks or lease.at_work or not lease.drives:
            self._looks, self._looked_s, self.still = lease.looks, now_s, None
        elif (lease.idle or now_s - self._looked_s > _GOES_ON_S) and (self._can_stop or self.signal or self.flagged):
            state, ran_s = loop.thread()
            self.still = self.still or Charge(0, ran_s)
            self.still.look(state, ran_s)
            # to wait for Python may cost CPU time: as much as the law's switch interval is short
            return self.still.used_s > (loop.times.idle_s if lease.idle else loop.times.still_s)
        return False


def main(arguments: list[str]) -> int:
    """Keep the run until its loop says that it is over, or is not."""
    for number in STOP_SIGNALS:  # one to the whole group must not end it
        signal.signal(number, signal.SIG_IGN)
    lease, signals = LawLease(int(arguments[0])), int(arguments[1])
    settings = json.loads(_line())
    _go_before_the_loop(settings["priority"])
    told = settings["loop"]
    loop = Loop(**told | {"folder": Path(told["folder"]), "times": LawTimes(*told["times"])})
    link = settings["link"]
    stopper = _stopper(loop.folder, link)
    with contextlib.suppress(OSError):  # it is gone already, which the watch sees
        os.write(1, READY)
    watch = Watch(loop, lease, signals, can_stop=stopper is not None)
    threading.Thread(target=watch.hear_of, args=(AskedStop(loop.folder),), daemon=True).start()
    ended = watch.serve()
    if ended == "in order":
        return 0
    if ended == "still":  # first, or it could go on and speak on the link
        loop.kill()
    # if the loop died nobody holds the lease: its last drive would stay on where the device has no watchdog
    confirmed = _stop(stopper)
    if ended == "taken":
        loop.kill()
    if ended == "still" or (ended == "taken" and not confirmed):
        _await_death(loop)  # its end may take longer than the stop; what it was just writing may have come after that
        confirmed = _stop(stopper)
    if link is not None:
        os.close(link)  # the next run may have the port
    charge = watch.still if ended == "still" else watch.charge
    if ended == "loop died" or charge is None:
        if lease.at_work:  # as by `_exit` in C, whose status may be 0
            _say(
                f"the process of this run ended within a step of the law {loop.law}: the law ended it, or crashed, or "
                f"somebody killed it; {_stopped_words(loop, confirmed)}",
                "there is no result: `rig identify` reads what was recorded",
                loop,
            )
        _add_events(loop, _stop_event(loop, confirmed, 0.0))
    else:
        fault = Fault("LAW_TIME", _words(loop, watch, charge, confirmed, still=ended == "still"))
        _conclude(loop, fault, _stop_event(loop, confirmed, charge.late_s))
    return 0


def _line() -> bytes:
    """The first line of standard input, byte by byte: what follows is not for this reader."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        if not byte:
            raise EOFError("no settings came")
        line += byte
    return line


def _go_before_the_loop(priority: int) -> None:
    """A law that spins at the loop's priority leaves its core to nobody at or below it.

    Raises SystemExit where there is no other core, and nothing above: this process would never have a turn.
    """
    for mine in (priority + 1, priority) if priority > 0 else ():
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(mine))
        except OSError:  # beyond this user's limit, or 99; the loop does not have it either
            continue
        if mine == priority and len(os.sched_getaffinity(0)) == 1:
            raise SystemExit(f"rig: no process can go before the law: loop.priority: {max(priority - 1, 1)}")
        return


def _stopper(folder: Path, link: int | None) -> Driver | None:
    """What can stop the device; loaded before it is needed. None: there is no such."""
    if link is None:
        return None
    from rig import config
    from rig.backends.registry import backend_of
    from rig.run_folder.recording.folder import CONFIG

    e = config.load(folder / CONFIG, follows_links=False)
    return backend_of(e.device).stopper(e.device, link)


def _stop(stopper: Driver | None) -> bool:
    """Whether the device confirmed the stop."""
    try:
        return stopper is not None and stopper.safe_stop()
    except Exception:  # noqa: BLE001 - a broken driver must not keep the process that hangs alive
        return False


def _await_death(loop: Loop) -> None:
    until_s = time.monotonic() + _DIES_S
    while loop.lives and time.monotonic() < until_s:
        time.sleep(LOOK_EVERY_S)


def _words(loop: Loop, watch: Watch, charge: Charge, confirmed: bool, *, still: bool) -> str:
    """What happened, for people."""
    if still:
        what = (
            f"the law {loop.law}: between two of its steps rig had no turn for {charge.used_s:.1f} s, as where a "
            "thread that the law has started holds Python"
        )
    elif loop.is_real:
        what = too_long_words(loop.law, "its step did not return: it had taken", charge.cpu_s, loop.times)
    else:
        what = f"the law {loop.law}: its step did not return within {loop.times.lease_s:g} s of its time"
    asked = watch.signal or (watch.flagged and f"the Stop by {watch.flagged}")
    heeded = f"it heeded no signal{f', nor {asked}' if asked else ''}, so rig's process was ended"
    return f"{what}; {heeded}; {_stopped_words(loop, confirmed)}"


def _stopped_words(loop: Loop, confirmed: bool) -> str:
    if not loop.is_real:
        return "nothing moves in virtual time"
    return "the keeper stopped the device" if confirmed else f"no stop could be written: {_left(loop)}"


def _left(loop: Loop) -> str:
    if loop.watchdog_s is None:
        return "cut the motor's supply"
    return f"the device's watchdog sets 0 V after {1e3 * loop.watchdog_s:g} ms; if the shaft turns, cut its supply"


def _stop_event(loop: Loop, confirmed: bool, late_s: float) -> list[JsonObject]:
    """What the run's events are told of the stop; nothing in virtual time, where there is none."""
    if not loop.is_real:
        return []
    late_ms = round(1e3 * late_s, 3)
    return [{"t_s": loop.now_s(), "kind": "stop", "confirmed": confirmed, "by": "keeper", "late_ms": late_ms}]


def _say(what: str, cure: str, loop: Loop) -> None:
    with contextlib.suppress(OSError):  # the terminal is gone, as after SIGHUP: the files say the same
        sys.stderr.write(f"rig: {what}\n     {cure}\n     recorded so far: {loop.folder}\n")
        sys.stderr.flush()


def _conclude(loop: Loop, fault: Fault, stopped: list[JsonObject]) -> None:
    """Say it, and write events and result, so that the folder is read as that of any run."""
    from rig.run_folder.recording.errors import RecordingError
    from rig.run_folder.recording.folder import RESULT, json_text, write_whole
    from rig.run_folder.results import FaultReport, RunResult

    _say(str(fault), fault.cure, loop)
    _add_events(loop, [*stopped, {"t_s": loop.now_s(), "kind": "fault", **fault.as_dict()}])
    result = RunResult(
        backend=loop.backend,
        faults=(FaultReport(**fault.as_dict()),),
        notes=("the process of this run was ended, because its law did not return: nothing was identified",),
    )
    with contextlib.suppress(RecordingError):  # the events say the same
        write_whole(loop.folder / RESULT, json_text(result), follows_links=False)


def _add_events(loop: Loop, events: list[JsonObject]) -> None:
    """Add what happened to the run's events, once the recorder has written its last."""
    from rig.core.plain_file import open_folder, open_plain
    from rig.run_folder.recording.writer import EVENTS

    until_s = time.monotonic() + _RECORDED_S
    with contextlib.suppress(OSError):  # what the terminal was told stays
        at = open_folder(loop.folder)
        with os.fdopen(open_plain(EVENTS, os.O_RDWR | os.O_APPEND, folder=at), "r+b") as file:
            while b'"loop_died"' not in file.read() and time.monotonic() < until_s:
                time.sleep(0.02)
                file.seek(0)
            file.write(b"".join(json.dumps(event).encode("ascii") + b"\n" for event in events))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
