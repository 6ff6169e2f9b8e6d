"""The keeper of a device that has no watchdog: a process that stops it when the host dies or falls silent.

``main([LINK, PIPE, MEMORY])`` gets its orders as one line of JSON on standard input, and says that it is ready on
standard output. LINK is the descriptor of the open port, MEMORY that of the ``Heartbeat`` by
which the host tells that it lives. PIPE ends with the host; a byte on it says that the host begins to drive, or that it
is done. While the host lives this process writes nothing. It knows no protocol: the host has given it the bytes.

It covers the end of the host's process. Cable, adapter and machine it does not, nor what ends both at once.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from rig.backends.links.open_link import OpenLink
from rig.core.faults import Fault
from rig.core.heartbeat import AT_REST, KEEPER, Heartbeat
from rig.core.link_turn import turn_on

if TYPE_CHECKING:
    from rig.backends.driver import Transport

# What the host says within so many s, None: however long. Empty: it is gone; None: it said nothing
Told = Callable[["float | None"], "bytes | None"]
Sleep = Callable[[float], object]

READY: Final = b"ready\n"
DONE: Final = b"d"  # the device is as it was: end; any other byte: look at the heartbeat
_ATTEMPTS: Final = 3  # of a stop, at least
_PERSISTS_S: Final = 1.0  # with a stop, or a restoring, that nobody confirms
_ANSWERS_S: Final = 0.015
_RESTORES_S: Final = 0.1  # an EEPROM takes its time
_AGAIN_S: Final = 0.5  # between two stops of a host that stays silent, or of a device that does not confirm them
_GIVES_UP_S: Final = 30.0  # to stop the device of a host that is gone
_TURN_S: Final = 0.2  # longest wait for another process that stops the device
_STOPS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Order(NamedTuple):
    """Bytes to write, and bytes that must come back; empty: none must."""

    data: bytes
    answer: bytes


Orders = Sequence[Order]


def main(arguments: list[str]) -> int:
    """Keep the device until the host says that it is done, or is gone."""
    for number in _STOPS:  # one to the whole group must not end it
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(KEEPER, encoding="ascii")
    link, pipe, memory = map(int, arguments)
    orders = json.loads(sys.stdin.buffer.readline())
    stop, restore = _orders(orders["stop"]), _orders(orders["restore"])
    with contextlib.suppress(OSError):
        os.write(1, READY)
    kept = Kept(OpenLink(link), stop, restore, zero=_orders(orders["zero"]))
    ahead_of, text = orders["mark"]
    kept.marks(ahead_of, text, orders["before"])
    if not keep(
        lambda wait_s: os.read(pipe, 4096) if select.select([pipe], [], [], wait_s)[0] else None,
        Heartbeat(memory), orders["silence_s"], kept,
    ):  # fmt: skip
        stopped, restored = kept.outlive()
        kept.tell(orders["before"], orders["note"], stopped=stopped, restored=restored)
    return 0


def keep(told: Told, heart: Heartbeat, silence_s: float, kept: Kept) -> bool:
    """Until the host is done (True) or gone (False). Stops the device each time the host falls silent.

    It wakes when the last beat that it has seen is ``silence_s`` old, and looks whether another has come meanwhile. It
    stops the device again while the host stays silent: what that was just writing may have come after the stop, and a
    stop may be lost.
    """
    answered_s, again_s = AT_REST, math.inf  # the last beat after which it has stopped the device, and when it is again
    while True:
        wait_s: float | None = None
        if (heard_s := heart.heard_s) != AT_REST:
            due_s = again_s if heard_s == answered_s else heard_s + silence_s
            wait_s = min(due_s - kept.now_s(), silence_s)
            if wait_s <= 0.0:
                heart.tell_silent()  # first: a host that goes on just now must not drive
                kept.stop_in_turn()
                answered_s, again_s = heard_s, kept.now_s() + _AGAIN_S
                continue
        if (words := told(wait_s)) is None:
            continue
        if not words:
            return False
        if DONE in words:
            return True


class Kept:
    """The device behind an open port, and the bytes that stop it and put it back; all times are of the port's clock."""

    def __init__(
        self, port: Transport, stop: Orders, restore: Orders, sleep: Sleep = time.sleep, zero: Orders = ()
    ) -> None:
        self.now_s = port.now_s
        self._port, self._stop, self._restore, self._sleep, self._zero = port, stop, restore, sleep, zero
        self._descriptor: int | None = getattr(port, "descriptor", None)
        self._mark: tuple[int, str, str] = (-1, "", "")

    def marks(self, ahead_of: int, text: str, before: str) -> None:
        """Ahead of that order of a restoring the file ``before`` gets this text; no file: an empty name."""
        self._mark = (ahead_of if before else -1, text, before)

    def stop(self) -> bool:
        """Write the stop, three times, and on until one is confirmed, for a second; whether one was."""
        confirmed, until_s = False, self.now_s() + _PERSISTS_S
        written = 0
        while written < _ATTEMPTS or not (confirmed or self.now_s() > until_s):
            # the last order alone stops the device where it refuses those before
            confirmed = self._given(self._stop, _ANSWERS_S)[-1] or confirmed
            written += 1
        return confirmed

    def stop_in_turn(self) -> bool:
        """As ``stop``, but not while the keeper of a law stops the device: a reply tells not to whom it is."""
        with turn_on(self._descriptor, _TURN_S):
            return self.stop()

    def outlive(self) -> tuple[bool, bool]:
        """The host is gone: stop the device and put it back; whether each was confirmed.

        Who else talks on a bus may jam it for a while: the stop is tried until it is confirmed, or the port is gone.
        """
        until_s = self.now_s() + _GIVES_UP_S
        while True:
            with turn_on(self._descriptor, _TURN_S):
                stopped, restored = self.stop(), self.restore()
                is_over = stopped or self._is_gone() or self.now_s() > until_s
            if is_over:
                return stopped, restored
            self._sleep(_AGAIN_S)

    def _is_gone(self) -> bool:
        """Whether the port is, as after its cable was pulled."""
        try:
            self._port.read(0.0)
        except Fault:
            return True
        return False

    def restore(self) -> bool:
        """Put the device back, one order after the other; whether each was confirmed.

        None goes out before the one ahead of it was confirmed: the first takes the torque away, and without that the
        next ones could let an old drive act again. What may stay on in between the last one ends, whatever became of
        the others.
        """
        until_s = self.now_s() + _PERSISTS_S
        for number, order in enumerate(self._restore):
            if number == 1:
                all(self._confirmed(one, _ANSWERS_S) for one in self._zero)  # none behind one that is not confirmed
            if number == self._mark[0]:
                with contextlib.suppress(OSError):
                    _write_whole(Path(self._mark[2]), self._mark[1])
            while not self._confirmed(order, _RESTORES_S):
                if self.now_s() > until_s:
                    self._given(self._restore[-1:], _RESTORES_S)
                    return False
        return True

    def _given(self, orders: Orders, answers_s: float) -> list[bool]:
        """Whether each order was confirmed. Each goes out, whatever became of the one before."""
        return [self._confirmed(order, answers_s) for order in orders]

    def _confirmed(self, order: Order, answers_s: float) -> bool:
        heard = b""
        try:
            with contextlib.suppress(Fault):  # what cannot be read from may still take a stop
                while self._port.read(0.0):
                    pass  # late bytes
            self._port.write(order.data)
            until_s = self.now_s() + answers_s
            while order.answer not in heard and (left_s := until_s - self.now_s()) > 0.0:
                heard += self._port.read(left_s)
        except Fault:
            return False
        return order.answer in heard

    def tell(self, before: str, note: str, *, stopped: bool, restored: bool) -> None:
        """Leave word for the next run: what happened; and nothing to put back where all of it was confirmed."""
        words = "stopped it" if stopped else "could not see that it stopped"
        words += " and put its registers back" if restored else ""
        with contextlib.suppress(OSError):
            if restored and before:
                Path(before).unlink(missing_ok=True)
            if note:
                _write_whole(Path(note), words)


def _write_whole(path: Path, text: str) -> None:
    """The file is there as it was, or as it will be."""
    fresh = Path(f"{path}.{os.getpid()}")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(path)


def _orders(pairs: Sequence[Sequence[str]]) -> list[Order]:
    return [Order(bytes.fromhex(data), bytes.fromhex(answer)) for data, answer in pairs]
