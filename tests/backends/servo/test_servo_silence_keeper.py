"""The keeper's own process, without a servo: what it hears on its pipe, what it writes, what it believes."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from rig.backends.servo.keeper import ServoKeeper
from rig.core.faults import Fault
from rig.core.halted import Halts
from rig.running.keeper.silence import BEAT, DONE, REST, Kept, Order, keep


class Counted(Kept):
    """Counts the stops, and does nothing else."""

    def __init__(self) -> None:
        super().__init__(-1, (), ())
        self.stops = 0
        self.stopped = threading.Event()

    def stop(self) -> bool:
        self.stops += 1
        self.stopped.set()
        return True


class Keeping:
    """``keep`` in a thread, and the host's end of its pipe."""

    def __init__(self, silence_s: float) -> None:
        self.heard, self.tells = os.pipe()
        self.kept, self.ended = Counted(), []  # type: tuple[Counted, list[bool]]
        self.thread = threading.Thread(target=self._keep, args=(self.heard, silence_s), daemon=True)
        self.thread.start()

    def _keep(self, heard: int, silence_s: float) -> None:
        self.ended.append(keep(heard, silence_s, self.kept))

    def over(self) -> bool:
        self.thread.join(20.0)
        os.close(self.heard)
        return self.ended[0]


@pytest.fixture(autouse=True)
def _quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """It tells its host on standard output, which is the test runner's here."""
    real = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: len(data) if fd == 1 else real(fd, data))


def test_a_host_that_falls_silent_is_stopped_once_until_it_is_heard_again() -> None:
    keeping = Keeping(0.01)
    for _ in range(2):
        keeping.kept.stopped.clear()
        os.write(keeping.tells, BEAT)
        assert keeping.kept.stopped.wait(20.0)
    os.write(keeping.tells, DONE)
    assert keeping.over() and keeping.kept.stops == 2


def test_a_host_at_rest_may_be_silent() -> None:
    keeping = Keeping(0.01)
    os.write(keeping.tells, BEAT + REST)
    assert not keeping.kept.stopped.wait(0.2)
    os.close(keeping.tells)
    assert not keeping.over() and keeping.kept.stops == 0


def test_a_host_that_is_gone_is_not_one_that_is_done() -> None:
    keeping = Keeping(30.0)
    os.write(keeping.tells, BEAT)
    os.close(keeping.tells)
    assert not keeping.over()


ORDERS = (Order(b"duty", b"ok"), Order(b"torque", b"ok"))


class Scripted(Kept):
    """A device that confirms each order or not, as ``confirms`` says, in order; the last one for ever."""

    def __init__(self, stop: Sequence[Order], restore: Sequence[Order], confirms: list[bool]) -> None:
        super().__init__(-1, stop, restore)
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
    Kept(-1, (), ()).tell(str(before), str(note), stopped=stopped, restored=restored)
    assert note.read_text() == words and before.exists() != restored
    assert {file.name for file in tmp_path.iterdir()} <= {"servo.json", "servo.txt"}


def test_a_link_that_is_gone_confirms_nothing() -> None:
    near, far = socket.socketpair()
    far.close()
    assert not Kept(near.fileno(), ORDERS, ()).stop()
    near.close()


def test_a_keeper_that_somebody_has_stopped_is_a_fault_before_the_next_drive() -> None:
    """It hears nothing: if the command died then, the servo would drive on."""
    keeper = ServoKeeper.__new__(ServoKeeper)
    heard, keeper._pipe = os.pipe()
    waits = [sys.executable, "-c", "input()"]
    with subprocess.Popen(waits, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as keeper._process:
        keeper._halts = Halts(keeper._process.pid)
        keeper.beat()
        keeper._process.send_signal(signal.SIGSTOP)
        until_s, said = time.monotonic() + 20.0, ""
        while not said and time.monotonic() < until_s:  # for a while it may be that the whole machine stood still
            try:
                keeper.beat()
            except Fault as fault:
                said = str(fault)
            time.sleep(1e-3)
        keeper.end(restored=True)
        assert keeper._process.returncode == -signal.SIGKILL
        assert "SERVO_UNWATCHED" in said and "SIGSTOP" in said
    os.close(heard)
