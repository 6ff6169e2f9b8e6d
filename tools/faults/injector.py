"""Fault injection: a device in virtual time, with faults put into link, host and shaft, and its output watched."""

from __future__ import annotations

import math
import os
import random
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from emulated_chips.truth import Contact
from faults.damage import Damage
from faults.fork import fork
from faults.language import ASKED, Language, Reading
from rig.core.faults import Fault

GRAIN_S = 5e-4  # between two looks at the output, from the fault on
CONTACTS: tuple[Contact, ...] = ("e_stop", "end_low", "end_high")
_ROUNDING_S = 1e-9
_CLOSE_V = 0.02  # drives that differ by less are the same, but for rounding


class Truth(Protocol):
    """The true state of the device and the bench."""

    @property
    def t_s(self) -> float: ...  # noqa: D102
    @property
    def pin_V(self) -> float: ...  # noqa: D102
    @property
    def y_rad(self) -> float: ...  # noqa: D102
    @property
    def v_rad_per_s(self) -> float: ...  # noqa: D102
    @property
    def pin_changed_s(self) -> float: ...  # noqa: D102


class FaultInjector:
    """Port and clock for the host, in place of the device. The fault comes at ``fault_s`` of the device's time.

    device     in virtual time: port, clock, ``truth``
    language   its wire format
    hard_rad   limits that the shaft should stay within
    timeout_s  of a reply: a later one does not count
    folder     with the config and the runs
    """

    absolute = True

    def __init__(
        self,
        device: Any,
        language: Language,
        hard_rad: tuple[float, float],
        timeout_s: float,
        folder: Path,
        seed: int,
    ) -> None:
        self.device = device
        self.hard_rad = hard_rad
        self.folder = folder
        self.down: Damage | None = None  # to the host
        self.up: Damage | None = None  # to the device
        self.is_gone = False  # the port
        self.stall_s: Callable[[random.Random], float] | None = None  # of the host, each time it has slept
        self.after_death: Callable[[], None] | None = None  # what a killed host leaves to do
        self.spare_s = 0.0  # of the time-out, beside the exchange
        self.too_late_s = 0.0  # by which a reply comes after the watchdog
        self.hangs: tuple[str, ...] = ()  # what of the device's program may stand still, by name
        self.too_fast_rad_s = math.nan  # of a shaft whose encoder makes more edges than the chip counts
        self.home_in_vain: Callable[[], None] = lambda: None  # a `rig home` that fails
        self.to_undo: list[Callable[[], None]] = []
        self.written: Callable[[], None] = lambda: None  # waits until the recorder has written everything
        self.push: Callable[[], None] | None = None  # on the shaft, from the fault on
        self.fault_s = math.inf
        self.is_watched = False
        self.readings: list[Reading] = []
        self.closing: set[int] = set()  # keys of readings after which the host sent a stop
        self.closed: set[int] = set()  # of these, those after which the run went on
        self.moments: list[tuple[str, float]] = []  # stages and stops of the run, and requests "to stop", "to arm"
        self.handing_over: set[int] = set()  # keys of readings after which it let the device's relay drive
        self.beyond_rad = 0.0
        self.astray_s = 0.0  # longest time in which the drive was not the one that the host commanded
        self.stale_s = 0.0  # longest time between two commands that reached the device, with a drive other than 0
        self.first_drive_s = math.nan  # of a run, at the pin
        self.driven_s = math.nan  # first instant from the fault on at which there was a drive at the pin
        self.read_at: list[tuple[int, float]] = []  # key and time of each question
        self._language = language
        self._timeout_s = timeout_s
        self.rng = random.Random(seed)
        self._act: Callable[[FaultInjector], None] | None = None
        self._later: tuple[float, Callable[[], object]] | None = None
        self._held: list[tuple[float, int, bytes]] = []  # on the way to the host
        self._count = 0
        self._asked: tuple[int, float] | None = None
        self._said_V = 0.0  # nan: the device chooses
        self._said_s = math.nan
        self._is_disarmed = True
        self._since_s = math.nan  # since then the drive is not the one that the host commanded
        self._is_interrupted = False
        self._asleep_s = self._asleep_before_s = 0.0

    @property
    def language(self) -> Language:
        """The wire format."""
        return self._language

    # ------------------------------------------------------------------ faults

    def schedule(self, fault_s: float, act: Callable[[FaultInjector], None]) -> None:
        """Let ``act`` happen at ``fault_s``."""
        self.fault_s, self._act = fault_s, act

    def forget(self) -> None:
        """Forget what was seen so far: a new run begins."""
        self.readings, self.closing, self.closed, self.handing_over, self.read_at = [], set(), set(), set(), []
        self.first_drive_s = math.nan
        self._asleep_before_s = self._asleep_s
        self._held.clear()

    def later(self, in_s: float, act: Callable[[], object]) -> None:
        """Let something happen a while after the fault."""
        self._later = self.now_s() + in_s, act

    def happens_now(self) -> None:
        """The fault begins only now."""
        self.fault_s = self.now_s()

    def comes_to(self, moment: str) -> None:
        """The run begins a stage, or reports that it has stopped the drive ("stop")."""
        self.moments.append((moment, self.now_s()))
        if moment != "stop":
            self.closed |= self.closing
            self.closing = set()

    def cure(self) -> None:
        """Undo the faults of wire, port, shaft and host."""
        self.down = self.up = self.stall_s = self.push = None
        self.is_gone = False
        while self.to_undo:
            self.to_undo.pop()()

    def bring_home(self) -> None:
        """Mend wiring and contacts, and put the shaft at the centre."""
        self.push = None
        self.device.rewire()
        for which in CONTACTS if hasattr(self.device, "contact") else ():
            self.device.contact(which, is_open=False)
        self.device.place(0.0)
        self.watch(0.01)

    def tell_host(self, number: signal.Signals) -> None:
        """A signal to this process, which is the host; it ends its sleep."""
        os.kill(os.getpid(), number)
        self._is_interrupted = True

    def freeze_host(self, for_s: float) -> None:
        """Let the host do nothing for a while, as after SIGSTOP."""
        self._pass(self.now_s() + for_s)

    def suspend_host(self, for_s: float) -> None:
        """The host's machine sleeps: its clock stands still, the device's goes on."""
        self.device.sleep_until(self.device.now_s() + for_s)
        self._asleep_s += for_s

    def asleep_s(self) -> float:
        """For how long the host's machine has slept in this run, s: a run makes a clock of its own."""
        return self._asleep_s - self._asleep_before_s

    def kill_host(self) -> None:
        """SIGKILL to this process; the device lives on in a copy of it."""
        if self.after_death is None:
            raise RuntimeError("after_death is not set: the device would have no host to watch it")
        if fork() == 0:
            self.after_death()
            os._exit(1)
        os.kill(os.getpid(), signal.SIGKILL)

    # ------------------------------------------------------------------ clock

    def now_s(self) -> float:
        """Virtual time of the host, s: the device's, without what the host's machine has slept."""
        now_s: float = self.device.now_s()
        return now_s - self._asleep_s

    def _to_device_s(self, t_s: float) -> float:
        """The device's time at an instant of the host's, s; not before it by rounding."""
        return t_s + self._asleep_s + _ROUNDING_S if self._asleep_s else t_s

    def sleep_until(self, t_s: float) -> float:
        """Let time pass; a signal ends it. Returns when that was."""
        self._is_interrupted = False
        self._pass(t_s)
        if self.stall_s is not None:
            self._pass(self.now_s() + self.stall_s(self.rng))
        return self.now_s()

    def _pass(self, t_s: float) -> None:
        while (now_s := self.now_s()) < t_s and not self._is_interrupted:
            self.device.sleep_until(self._to_device_s(self._step(now_s, t_s)))
            self._look()

    def _step(self, now_s: float, until_s: float) -> float:
        """The next instant to check."""
        if now_s < self.fault_s and self._act is not None:
            return min(until_s, self.fault_s)
        return min(until_s, now_s + GRAIN_S) if self.is_watched else until_s

    def _look(self) -> None:
        if not self.is_watched and self.first_drive_s == self.first_drive_s and self.now_s() < self.fault_s:
            return  # nothing to see yet
        truth: Truth = self.device.truth()
        if self._act is not None and truth.t_s >= self.fault_s:
            act, self._act = self._act, None
            act(self)
            self.is_watched = self._act is None  # else it has put it off
            return
        if math.isnan(self.first_drive_s) and truth.pin_V != 0.0:
            self.first_drive_s = truth.pin_changed_s
        if not self.is_watched:
            return
        if self.push is not None:
            self.push()
        if self._later is not None and truth.t_s >= self._later[0]:
            (_, act_later), self._later = self._later, None
            act_later()
        if math.isnan(self.driven_s) and truth.pin_V != 0.0:
            self.driven_s = max(truth.pin_changed_s, self.fault_s)
        low, high = self.hard_rad
        self.beyond_rad = max(self.beyond_rad, truth.y_rad - high, low - truth.y_rad)
        if math.isnan(self._said_V) or abs(truth.pin_V - self._said_V) < _CLOSE_V:
            self._since_s = math.nan
        elif math.isnan(self._since_s):
            self._since_s = truth.t_s
        else:
            self.astray_s = max(self.astray_s, truth.t_s - self._since_s)

    def watch(self, for_s: float) -> None:
        """Let time pass without the host."""
        self._is_interrupted = False
        self._pass(self.now_s() + for_s)

    # ------------------------------------------------------------------ port

    def write(self, data: bytes) -> None:
        """A request of the host."""
        if self.is_gone:
            raise Fault("LINK_LOST", "the port is gone")
        pieces = [(0.0, data)] if self.up is None else self.up(data, self.rng)
        drive_V = self._language.drive_V(data)
        if drive_V is not None:
            self._said(drive_V, is_heard=any(piece == data for _, piece in pieces))
        if self._language.is_arm(data):
            self.moments.append(("to arm", self.now_s()))
            self._is_disarmed = False
        if self._language.is_stop(data):
            self.moments.append(("to stop", self.now_s()))
            self._asked = None  # a reply still to come is waited for by nobody
            self._is_disarmed = True
            self._said_s = math.nan  # 0 V need not be said again
            if self.readings:
                self.closing.add(self.readings[-1].key)
        if self._language.hands_over(data) and self.readings:
            self.handing_over.add(self.readings[-1].key)
        key = self._language.asked(data)
        if key is not None and not self._is_disarmed:
            self._asked = key, self.now_s()
            self.read_at.append(self._asked)
        for _, piece in pieces:
            self.device.write(piece)

    def _said(self, drive_V: float, *, is_heard: bool) -> None:
        now_s = self.now_s()
        before_V, self._said_V = self._said_V, drive_V
        if not is_heard:
            return
        if self.is_watched and not math.isnan(self._said_s) and before_V != 0.0:  # 0 V is as good when it is old
            self.stale_s = max(self.stale_s, now_s - self._said_s)
        self._said_s = now_s

    def read(self, timeout_s: float) -> bytes:
        """What has arrived at the host."""
        until_s = self.now_s() + timeout_s
        while True:
            if self.is_gone:
                raise Fault("LINK_LOST", "the port is gone")
            now_s = self.now_s()
            if arrived := self._arrived(now_s):
                return arrived
            if now_s >= until_s:
                # a last look: what has come at this instant counts
                self._take(self.device.read(0.0))
                return self._arrived(now_s)
            next_s = self._step(now_s, min([until_s, *(due_s for due_s, _, _ in self._held)]))
            if (whole_s := now_s + self._language.to_come_s()) > now_s:  # one look for many bytes
                now_s = self.device.sleep_until(self._to_device_s(min(next_s, whole_s))) - self._asleep_s
            # the sum of two clocks may round to no wait at all, and then time would stand still
            self._take(self.device.read(next_s - now_s + (_ROUNDING_S if self._asleep_s else 0.0)))
            self._look()

    def close(self) -> None:
        """The device lives on."""

    def connected(self) -> FaultInjector:
        """The host's end of a new connection, where the device is behind a network. Raises Fault LINK_OPEN."""
        if self.is_gone:
            raise Fault("LINK_OPEN", "there is no network")
        self.device.connect()
        return self

    def _take(self, data: bytes) -> None:
        for reply in self._language.replies(data):
            for delay_s, piece in [(0.0, reply)] if self.down is None else self.down(reply, self.rng):
                self._count += 1
                # nothing on a line overtakes what was sent before it
                before_s = self._held[-1][0] if self._held else 0.0
                self._held.append((max(self.now_s() + delay_s, before_s), self._count, piece))

    def _arrived(self, now_s: float) -> bytes:
        pieces = [piece for due_s, _, piece in self._held if due_s <= now_s]
        self._held = self._held[len(pieces) :]
        for piece in pieces:
            self._note(piece, now_s)
        return b"".join(pieces)

    def _note(self, piece: bytes, now_s: float) -> None:
        """Note the samples that reached the host intact: the one that it asked for, in time, and unasked ones."""
        for reading in self._language.readings(piece):
            if reading.row != ASKED:
                self.readings.append(reading)
            elif self._asked is not None:
                key, asked_s = self._asked
                if reading.key == key and now_s <= asked_s + self._timeout_s:
                    self.readings.append(reading)
                    self._asked = None
