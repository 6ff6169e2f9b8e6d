"""The keeper's own process, without a servo: what it hears of its host, what it writes, what it believes."""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from servo_bench import Bench

from rig.backends.clock import VirtualClock
from rig.backends.links.open_link import OpenLink
from rig.backends.servo import keeper as keepers
from rig.backends.servo.keeper import ServoKeeper
from rig.core import heartbeat
from rig.core.faults import Fault
from rig.core.halted import Halts
from rig.core.heartbeat import SIZE, Heartbeat
from rig.core.memory_file import create_file
from rig.running.keeper.silence import Kept, Order, keep


class Timed(Kept):
    """Notes when it is stopped, and does nothing else."""

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__(cast(Any, clock), (), ())
        self.stops_s: list[float] = []

    def stop(self) -> bool:
        self.stops_s.append(self.now_s() - 100.0)
        return True


class Keeping:
    """``keep`` and its host in virtual time: at each of its times the host does what is beside it, and then is gone."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *events: tuple[float, str]) -> None:
        memory = create_file(SIZE)
        self.host, keepers = Heartbeat(memory), Heartbeat(memory)
        os.close(memory)
        self._clock, self._events = VirtualClock(), list(events)
        self._clock.sleep_until(100.0)
        self.found_silent: list[bool] = []  # before each of the host's beats
        self.kept = Timed(self._clock)
        monkeypatch.setattr(heartbeat, "time", SimpleNamespace(monotonic=self._clock.now_s))
        self.is_done = keep(self._told, keepers, 0.06, self.kept)
        for one in (self.host, keepers):
            one.close()

    def _told(self, wait_s: float | None) -> bytes | None:
        """What the host does until then; a word of it ends the wait."""
        until_s = math.inf if wait_s is None else self._clock.now_s() + wait_s
        while self._events and 100.0 + self._events[0][0] <= until_s:
            at_s, what = self._events.pop(0)
            self._clock.sleep_until(100.0 + at_s)
            if what == "beats":
                self.found_silent.append(self.host.was_silent)
                self.host.beat()
            elif what == "rests":
                self.host.rest()
            else:
                return b"" if what == "is gone" else what.encode("ascii")
        self._clock.sleep_until(until_s)
        return None


def test_a_host_that_falls_silent_is_stopped_and_again_until_it_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    """So long after its last beat, whenever the keeper looked before; it needs no word to be heard again.

    What it was just writing may come after a stop, and a stop may be lost: where it stays silent the next one follows.
    """
    beats = [(t_s, "beats") for t_s in (0.0, 0.03, 0.05, 0.1, 0.5, 0.52)]
    keeping = Keeping(monkeypatch, beats[0], (0.0, "l"), *beats[1:], (1.7, "rests"), (9.0, "is gone"))
    assert keeping.kept.stops_s == pytest.approx([0.16, 0.58, 1.08, 1.58])
    assert keeping.found_silent == [False, False, False, False, True, True]


def test_a_host_at_rest_may_be_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    keeping = Keeping(monkeypatch, (0.0, "l"), (1.0, "beats"), (1.0, "l"), (1.03, "rests"), (2.0, "is gone"))
    assert keeping.kept.stops_s == []


@pytest.mark.parametrize(("ends", "is_done"), [("is gone", False), ("d", True)])
def test_a_host_that_is_gone_is_not_one_that_is_done(ends: str, is_done: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    keeping = Keeping(monkeypatch, (0.0, "beats"), (0.0, "l"), (0.01, ends))
    assert keeping.is_done == is_done and keeping.kept.stops_s == []


def test_a_host_that_rests_was_not_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    keeping = Keeping(monkeypatch, (0.0, "beats"), (0.0, "l"), (0.5, "rests"), (0.6, "beats"), (0.61, "is gone"))
    assert keeping.kept.stops_s == pytest.approx([0.06]) and keeping.found_silent == [False, False]


ORDERS = (Order(b"duty", b"ok"), Order(b"torque", b"ok"))


class Scripted(Kept):
    """A device that confirms each order or not, as ``confirms`` says, in order; the last one for ever."""

    def __init__(self, stop: Sequence[Order], restore: Sequence[Order], confirms: list[bool]) -> None:
        super().__init__(OpenLink(-1), stop, restore)
        self.heard: list[bytes] = []
        self._confirms = confirms

    def _confirmed(self, order: Order, answers_s: float) -> bool:
        self.heard.append(order.data)
        time.sleep(1e-3)
        return self._confirms.pop(0) if len(self._confirms) > 1 else self._confirms[0]


def test_a_stop_goes_out_three_times_though_the_first_is_confirmed() -> None:
    device = Scripted(ORDERS, (), [True])
    assert device.stop()
    assert device.heard == [b"duty", b"torque"] * 3


def test_the_torque_alone_confirms_a_stop() -> None:
    assert Scripted(ORDERS, (), [False, True, False, True, False, True]).stop()


def test_what_is_not_confirmed_is_not_called_a_stop_and_is_tried_on() -> None:
    device = Scripted(ORDERS, (), [False])
    assert not device.stop()
    assert len(device.heard) > 6


def test_a_restoring_goes_on_until_every_order_is_confirmed() -> None:
    device = Scripted((), ORDERS, [True, False, True])
    assert device.restore()
    assert device.heard == [b"duty", b"torque", b"torque"]


def test_no_order_of_a_restoring_goes_out_before_the_one_ahead_is_confirmed() -> None:
    """The first takes the torque away: to clear a watchdog without that would let the old duty act again."""
    device = Scripted((), (Order(b"torque off", b"ok"), Order(b"watchdog 0", b"ok"), Order(b"last", b"ok")), [False])
    assert not device.restore()
    assert set(device.heard) == {b"torque off", b"last"} and device.heard[-1] == b"last"


@pytest.fixture
def started() -> Iterator[ServoKeeper]:
    """A keeper of a servo behind a link on which nobody answers."""
    near, far = socket.socketpair()
    bench = Bench()
    bench.store.save(bench.setup.model, bench.own.id, {"operating_mode": 3})
    yield ServoKeeper(bench.driver._link, bench.store, near.fileno(), 1.0)
    near.close()
    far.close()


@pytest.mark.skipif(sys.platform != "linux", reason="there a process may name itself")
def test_who_kills_every_python_or_all_that_is_called_rig_leaves_the_keeper_alive(started: ServoKeeper) -> None:
    own = Path(f"/proc/{started._process.pid}")
    name, command = (own / "comm").read_text(encoding="ascii").strip(), (own / "cmdline").read_bytes()
    started.end(restored=True)
    assert name == heartbeat.KEEPER and "rig" not in name and "python" not in name and started._process.returncode == 0
    interpreter = os.fsencode(Path(sys.executable).resolve())  # may be anywhere
    assert command.startswith(interpreter) and b"rig" not in command.removeprefix(interpreter)


def test_a_keeper_that_nobody_answers_goes_on_when_its_command_is_over(
    started: ServoKeeper, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plug of a servo that drives on may come back a little later."""
    monkeypatch.setattr(keepers, "_ENDS_S", 0.05)
    started.end(restored=False)
    lives = started._process.poll() is None
    started._process.kill()
    started._process.wait()
    assert lives and keepers._left_running.pop() is started._process


class Jammed(Kept):
    """A device that nothing reaches until its bus is free again; None: never."""

    def __init__(self, link: int, free_after: int | None) -> None:
        port, self._clock = OpenLink(link), VirtualClock()
        port.now_s = self._clock.now_s  # of this one alone
        super().__init__(port, (), (), lambda s: self._clock.sleep_until(self._clock.now_s() + s))
        self.tried, self._free_after = 0, free_after

    def stop(self) -> bool:
        self.tried += 1
        return self._free_after is not None and self.tried > self._free_after

    def restore(self) -> bool:
        return self._free_after is not None and self.tried > self._free_after


def test_who_outlives_its_host_tries_until_the_stop_is_confirmed_or_the_port_is_gone() -> None:
    near, far = socket.socketpair()
    jammed, dead = Jammed(near.fileno(), 3), Jammed(near.fileno(), None)
    assert jammed.outlive() == (True, True) and jammed.tried == 4
    assert dead.outlive() == (False, False) and dead.tried > 4  # another program may need the port
    far.close()
    gone = Jammed(near.fileno(), None)
    assert gone.outlive() == (False, False) and gone.tried == 1
    near.close()


@pytest.mark.parametrize(("stopped", "restored", "words"), [
    (True, True, "stopped it and put its registers back"),
    (True, False, "stopped it"),
    (False, False, "could not see that it stopped"),
])  # fmt: skip
def test_it_leaves_word_and_the_values_that_nobody_has_put_back(
    stopped: bool, restored: bool, words: str, tmp_path: Path
) -> None:
    before, note = tmp_path / "servo.json", tmp_path / "servo.txt"
    before.write_text("{}")
    Kept(OpenLink(-1), (), ()).tell(str(before), str(note), stopped=stopped, restored=restored)
    assert note.read_text() == words and before.exists() != restored
    assert {file.name for file in tmp_path.iterdir()} <= {"servo.json", "servo.txt"}


def test_a_link_that_is_gone_confirms_nothing() -> None:
    near, far = socket.socketpair()
    far.close()
    assert not Kept(OpenLink(near.fileno()), ORDERS, ()).stop()
    near.close()


def test_a_keeper_that_somebody_has_stopped_is_a_fault_before_the_next_drive() -> None:
    """It hears nothing: if the command died then, the servo would drive on."""
    keeper = ServoKeeper.__new__(ServoKeeper)
    heard, keeper._pipe = os.pipe()
    memory = create_file(SIZE)
    keeper._heart, keeper._drives = Heartbeat(memory), False
    os.close(memory)
    waits = [sys.executable, "-c", "input()"]
    with subprocess.Popen(waits, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as keeper._process:
        keeper._halts = Halts(keeper._process)
        keeper.beat()
        keeper._process.send_signal(signal.SIGSTOP)
        until_s, said = time.monotonic() + 20.0, ""
        while not said and time.monotonic() < until_s:  # for a while it may be that the whole machine stood still
            try:
                keeper.beat()
            except Fault as fault:
                said = str(fault)
            time.sleep(1e-3)
        keeper.end(restored=False)
        ended = keeper._process.returncode
        keeper._process.kill()
        assert ended == -signal.SIGKILL
        assert "SERVO_UNWATCHED" in said and "SIGSTOP" in said
    os.close(heard)
