"""A signal while a law of the user's own is at work, in virtual time: the drive at the pin of the compiled firmware."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest
from simulated_bench import DEMO, GUARD, LIMITS, PERIOD_S, SCALING, ListSink

from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.control.guard import Guard
from rig.control.law import OwnLaw, Timed
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import STOP_SIGNALS, StopRequest, stop_on_signals
from rig.core.faults import Fault
from rig.core.signals import Sample

FROM_TICK = 30
DRIVE_V = 0.62


class HangsFrom:
    """A fixed drive; from a tick on it does something else, and never returns unless that does."""

    def __init__(self, hang: Callable[[], None]) -> None:
        self._hang, self._ticks = hang, 0

    def step(self, sample: Sample) -> float:
        self._ticks += 1
        if self._ticks == FROM_TICK:
            self._hang()
        return DRIVE_V


def spins() -> None:
    while True:
        pass


def sleeps() -> None:
    time.sleep(3600.0)


def tidies_up() -> None:
    """What is in ``finally`` runs; an ``except Exception`` around it all catches nothing."""
    while True:
        with suppress(Exception):
            try:
                spins()
            finally:
                sum(range(1000))


@contextmanager
def sent(*numbers: int) -> Iterator[Callable[[], None]]:
    """What it yields is called just before a hang: another thread sends the signals then."""
    begun = threading.Event()

    def send() -> None:
        begun.wait(60.0)
        for number in numbers:
            time.sleep(0.02)
            os.kill(os.getpid(), number)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield begun.set
    finally:
        begun.set()
        thread.join()


def loop_on(device: Any, stop: StopRequest) -> tuple[Loop, ListSink]:
    driver = SerialDriver(device, SCALING, emulated=True)
    driver.open()
    guard, record = Guard(GUARD), ListSink()
    guard.sign_proven = True
    return Loop(driver, device, guard, record, PERIOD_S, stop), record


@pytest.mark.parametrize("number", STOP_SIGNALS)
@pytest.mark.parametrize("hang", [spins, sleeps, tidies_up])
def test_a_signal_raises_out_of_a_law_that_does_not_return(number: signal.Signals, hang: Callable[[], None]) -> None:
    device = VirtualBoard(DEMO, 3)
    before = signal.getsignal(number)
    # the second comes while the first ends the law, or stops the drive: it changes nothing
    with stop_on_signals() as stop, sent(number, number) as begins:
        loop, record = loop_on(device, stop)
        law = Timed(HangsFrom(lambda: (begins(), hang())[1]), 5.0, "own")  # type: ignore[func-returns-value]
        with pytest.raises(Fault) as caught, loop.armed(LIMITS):
            loop.run(law, "law")
    assert (caught.value.code, caught.value.detail) == ("INTERRUPTED", number.name)
    assert device.truth().pin_V == 0.0 and record.rows[-1]["u_V"] == pytest.approx(DRIVE_V, abs=0.02)
    assert record.events[-1]["kind"] == "stop" and record.events[-1]["confirmed"] is True
    # the reading that no law decided on is no row, and completes the one before
    assert len(record.rows) == FROM_TICK - 1 and record.rows[-1]["t_u_s"] is not None
    assert signal.getsignal(number) is before


def test_the_chip_is_stopped_as_well() -> None:
    device = VirtualChip(DEMO, 3)
    with stop_on_signals() as stop, sent(signal.SIGINT) as begins:
        loop, _ = loop_on(device, stop)
        law = Timed(HangsFrom(lambda: (begins(), spins())[1]), 5.0, "own")  # type: ignore[func-returns-value]
        with pytest.raises(Fault, match="SIGINT"), loop.armed(LIMITS):
            loop.run(law, "law")
    assert device.truth().pin_V == 0.0


def test_a_law_that_swallows_the_signal_and_returns_ends_at_the_next_tick() -> None:
    device = VirtualBoard(DEMO, 3)
    with stop_on_signals() as stop, sent(signal.SIGINT) as begins:
        loop, record = loop_on(device, stop)

        def swallows() -> None:
            begins()
            with suppress(BaseException):
                spins()

        with pytest.raises(Fault, match="SIGINT"), loop.armed(LIMITS):
            loop.run(Timed(HangsFrom(swallows), 5.0, "own"), "law")
    assert device.truth().pin_V == 0.0 and len(record.rows) == FROM_TICK


def ignores() -> None:
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def blocks() -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)


@pytest.mark.parametrize("takes", [ignores, blocks])
def test_a_law_that_takes_the_signals_does_not_keep_them(takes: Callable[[], None]) -> None:
    """Here it takes them in its 30th step; the signal comes while the loop reads in the tick after it."""
    device, seen = VirtualBoard(DEMO, 3), list[str]()
    with stop_on_signals() as stop:
        loop, record = loop_on(device, stop)
        read, ticks = loop._driver.read, [0]

        def interrupted() -> Sample:
            ticks[0] += 1
            if ticks[0] == FROM_TICK + 1:
                signal.raise_signal(signal.SIGINT)
                seen.append("SIGINT")
            return read()

        loop._driver.read = interrupted  # type: ignore[method-assign]
        with pytest.raises(Fault, match="SIGINT"), loop.armed(LIMITS):
            loop.run(Timed(HangsFrom(takes), 5.0, "own"), "law")
    assert seen and device.truth().pin_V == 0.0
    assert record.events[-1]["kind"] == "stop" and record.events[-1]["confirmed"] is True


def defaults() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.mark.parametrize("takes", [lambda: None, defaults])
def test_a_run_under_nohup_outlives_its_terminal(takes: Callable[[], None]) -> None:
    """A SIGHUP that was ignored when it began stays ignored, whatever a law does; any other signal stops it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        device = VirtualBoard(DEMO, 3)
        with stop_on_signals() as stop:
            loop, record = loop_on(device, stop)
            read, ticks = loop._driver.read, [0]

            def interrupted() -> Sample:
                ticks[0] += 1
                if ticks[0] == FROM_TICK + 1:
                    signal.raise_signal(signal.SIGHUP)
                if ticks[0] == FROM_TICK + 20:
                    signal.raise_signal(signal.SIGTERM)
                return read()

            loop._driver.read = interrupted  # type: ignore[method-assign]
            with pytest.raises(Fault, match="SIGTERM"), loop.armed(LIMITS):
                loop.run(Timed(HangsFrom(takes), 5.0, "own"), "law")
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        assert device.truth().pin_V == 0.0 and len(record.rows) > FROM_TICK
    finally:
        signal.signal(signal.SIGHUP, before)


def interrupting(owner: Any, name: str, seen: list[str]) -> None:
    """Let a signal arrive in each call of this method, from its 20th on; ``seen`` grows when it has run to its end."""
    method = getattr(owner, name)
    calls = [0]

    def call(*given: Any, **named: Any) -> Any:
        calls[0] += 1
        if calls[0] >= (1 if name == "safe_stop" else 20):
            signal.raise_signal(signal.SIGINT)
            found = method(*given, **named)
            signal.raise_signal(signal.SIGTERM)
            seen.append(name)
            return found
        return method(*given, **named)

    setattr(owner, name, call)


@pytest.mark.parametrize("where", ["read", "write", "safe_stop", "sample", "complete", "allow", "law's time"])
def test_a_signal_never_raises_in_what_is_not_the_law(where: str) -> None:
    device, seen = VirtualBoard(DEMO, 3), list[str]()
    with stop_on_signals() as stop:
        loop, record = loop_on(device, stop)
        law = Timed(HangsFrom(lambda: None), 1.0, "own")
        for owner in (loop._driver, record, loop.guard):
            if hasattr(owner, where):
                interrupting(owner, where, seen)
        if where == "law's time":
            interrupting(law._rest, "step", seen)
        try:
            with loop.armed(LIMITS):
                loop.run(law, "law")
        except Fault as fault:
            assert fault.code == "INTERRUPTED"
        assert stop.reason == "SIGINT"
    assert seen, "the signal came while that was at work, and it ran to its end"
    assert loop.unconfirmed_stops == 0 and device.truth().pin_V == 0.0


@pytest.mark.parametrize("raised", [SystemExit(3), GeneratorExit(), ZeroDivisionError()])
def test_whatever_a_law_raises_is_a_fault_that_names_it(raised: BaseException) -> None:
    def fails() -> None:
        raise raised

    law: OwnLaw = HangsFrom(fails)
    timed = Timed(law, math.pi, "own")
    with pytest.raises(Fault, match=f"own: {type(raised).__name__}") as caught:
        for k in range(FROM_TICK):
            timed.step(Sample(0.01 * k, 0.0, 512))
    assert caught.value.code == "LAW_FAILED" and caught.value.__cause__ is raised
