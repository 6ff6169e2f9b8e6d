"""A command that dies or hangs at any phase: its keeper takes the duty away, and puts the registers back.

In real time, so nothing is said of how long it takes. No servo's own watchdog is on here: the keeper is alone.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
from evidence import evidence
from servo_bench import PROTOCOLS, Bench
from servo_peers import violations_in

from rig.backends.links.open_link import OpenLink
from rig.backends.links.serial_port import SerialPort
from rig.backends.servo import keeper as keepers
from rig.backends.servo.before import BeforeStore, values_of
from rig.backends.servo.bus import ServoLink, servo_link
from rig.backends.servo.emulated.servo_board import ServoBoard
from rig.backends.servo.keeper import ServoKeeper
from rig.core.faults import Fault
from rig.core.heartbeat import AT_REST
from rig.core.link_turn import turn_on

PHASES = 200
SILENCE_S = 0.06
PATIENCE_S = 20.0

pytestmark = pytest.mark.realtime


@pytest.fixture(params=PROTOCOLS)
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[str, Bench, ServoBoard]]:
    bench = Bench(request.param)
    with ServoBoard() as one:
        one.start([bench.own], violations=tmp_path / "violations")
        yield one.port, bench, one
        assert violations_in(tmp_path / "violations") == []


def link_to(port: SerialPort, bench: Bench) -> ServoLink:
    return servo_link(port, bench.setup.model, bench.own.id, bench.own.baud, 1.0)


class Saved(NamedTuple):
    """A servo whose registers are in the file, as before a command changes them."""

    bench: Bench
    port: SerialPort
    link: ServoLink
    store: BeforeStore

    def keeper(self, silence_s: float = 30.0) -> ServoKeeper:
        return ServoKeeper(self.link, self.store, self.port.descriptor, silence_s)


@pytest.fixture
def saved(board: tuple[str, Bench, ServoBoard], tmp_path: Path) -> Iterator[Saved]:
    name, bench, _ = board
    port = SerialPort(name, bench.own.baud)
    link, store = link_to(port, bench), BeforeStore(tmp_path / "servo.json")
    store.save(bench.setup.model, bench.own.id, values_of(link))
    yield Saved(bench, port, link, store)
    port.close()


def drive(name: str, bench: Bench, path: Path, told: int, phase: int) -> None:
    """The command, in a process of its own: changes registers, drives, and tells when. It never stops by itself."""
    rng = random.Random(phase)
    port = SerialPort(name, bench.own.baud)
    link, store, roles = link_to(port, bench), BeforeStore(path), bench.setup.model.roles
    store.save(bench.setup.model, bench.own.id, values_of(link))
    link.put(roles["torque"], 0)
    link.hold(roles["mode"], bench.setup.model.pwm_mode)
    link.put(roles["drive"], 0)
    keeper = ServoKeeper(link, store, port.descriptor, SILENCE_S)
    keeper.beat()
    link.put(roles["torque"], 1)
    ends_s = time.monotonic() + rng.uniform(0.02, 0.06)
    is_told = False
    while True:
        keeper.beat()
        link.put(roles["drive"], rng.choice([-1, 1]) * rng.randrange(50, 150))
        if not is_told and time.monotonic() > ends_s:
            os.write(told, b"x")
            is_told = True
        time.sleep(rng.uniform(0.0, 0.01))


def forked(run: Callable[[int], None]) -> int:
    """A process that runs this; its number, once it has told that it drives."""
    told, tells = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            run(tells)
        finally:
            os._exit(1)
    os.close(tells)
    assert os.read(told, 1) == b"x"
    os.close(told)
    return pid


def wait_for(holds: Callable[[], bool]) -> bool:
    until_s = time.monotonic() + PATIENCE_S
    while not holds():
        if time.monotonic() > until_s:
            return False
        time.sleep(0.01)
    return True


def stands(link: ServoLink, port: int) -> bool:
    """Whether nothing drives the servo. The keeper speaks on the bus, too: its answers are not for this question."""
    roles = link.model.roles
    with turn_on(port, PATIENCE_S):
        return link.value(roles["torque"]) == 0 and link.value(roles["applied"]) == 0


def reopened(name: str, bench: Bench) -> SerialPort:
    """Once the keeper has let go of the port."""
    until_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return SerialPort(name, bench.own.baud)
        except Fault:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.01)


def ends(board: tuple[str, Bench, ServoBoard], path: Path, phase: int, *, hangs: bool) -> None:
    name, bench, _ = board
    roles = bench.setup.model.roles
    before = bench.servo.of("mode")
    pid = forked(lambda tells: drive(name, bench, path, tells, phase))
    if hangs:
        time.sleep(random.Random(phase).uniform(0.0, 0.02))
        os.kill(pid, signal.SIGSTOP)
        time.sleep(4.0 * SILENCE_S)  # it must have acted before the process is ended
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    assert wait_for(path.with_suffix(".txt").exists), phase
    assert "stopped it and put its registers back" in path.with_suffix(".txt").read_text(), phase
    path.with_suffix(".txt").unlink()
    assert not path.exists(), phase
    port = reopened(name, bench)
    link = link_to(port, bench)
    assert link.value(roles["torque"]) == 0 and link.value(roles["applied"]) == 0, phase
    assert link.value(roles["mode"]) == before, phase
    port.close()


@pytest.mark.parametrize("hangs", [False, True])
@pytest.mark.parametrize("first", [0, *evidence(*range(5, PHASES, 5))])
def test_who_dies_or_hangs_while_it_drives_is_outlived_by_a_stop(
    board: tuple[str, Bench, ServoBoard], tmp_path: Path, first: int, hangs: bool
) -> None:
    for phase in range(first, first + 5):
        ends(board, tmp_path / "servo.json", phase, hangs=hangs)


def test_a_command_that_hangs_is_stopped_before_it_ends(board: tuple[str, Bench, ServoBoard], tmp_path: Path) -> None:
    """Looked at beside the keeper, while the command still stands still."""
    name, bench, _ = board
    path = tmp_path / "servo.json"
    pid = forked(lambda tells: drive(name, bench, path, tells, 1))
    os.kill(pid, signal.SIGSTOP)
    time.sleep(2.0 * SILENCE_S)
    beside = os.open(name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        link = servo_link(OpenLink(beside), bench.setup.model, bench.own.id, bench.own.baud, 1.0)
        assert wait_for(lambda: stands(link, beside))
    finally:
        os.close(beside)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    assert wait_for(path.with_suffix(".txt").exists)


def test_a_keeper_writes_nothing_while_it_hears_its_command(saved: Saved) -> None:
    link, store, torque = saved.link, saved.store, saved.bench.setup.model.roles["torque"]
    keeper = saved.keeper()
    keeper.beat()
    link.put(torque, 0)
    before = link.client.statistics["stale_bytes"]
    for _ in range(20):
        keeper.beat()
        assert link.value(torque) == 0
    keeper.rest()
    keeper.end(restored=True)
    assert link.client.statistics["stale_bytes"] == before
    assert store.path is not None and store.path.exists()  # whose command has put the registers back clears it itself


def test_a_keeper_of_a_command_that_could_not_put_back_does_it(saved: Saved) -> None:
    model, link, store = saved.bench.setup.model, saved.link, saved.store
    mode = model.roles["mode"]
    before = link.value(mode)
    link.hold(mode, model.pwm_mode)
    saved.keeper().end(restored=False)
    assert link.value(mode) == before != model.pwm_mode
    assert store.path is not None and not store.path.exists()


def test_a_keeper_that_has_ended_is_a_fault_before_the_next_drive(saved: Saved) -> None:
    keeper = saved.keeper()
    keeper._process.kill()
    keeper._process.wait()
    with pytest.raises(Fault, match="SERVO_UNWATCHED"):
        keeper.beat()
    keeper.end(restored=True)


def test_a_keeper_that_does_not_begin_is_a_fault_and_ended(saved: Saved, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []
    start = subprocess.Popen

    def mute(*_: object, **options: Any) -> subprocess.Popen[bytes]:
        started.append(start(["sleep", "600"], **options))
        return started[-1]

    monkeypatch.setattr(keepers, "_STARTS_S", 0.1)
    monkeypatch.setattr("rig.backends.servo.keeper.subprocess.Popen", mute)
    with pytest.raises(Fault, match="SERVO_UNWATCHED"):
        saved.keeper()

    def ctrl_c(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(keepers, "select", SimpleNamespace(select=ctrl_c))
    with pytest.raises(KeyboardInterrupt):
        saved.keeper()
    assert None not in [one.returncode for one in started]  # one that comes late would write to another program's servo


def test_a_keeper_ends_with_its_command_though_a_copy_of_it_lives(saved: Saved) -> None:
    """As one that a law has forked: it must not keep the servo from being put back."""
    keeper = saved.keeper()
    copy = os.fork()
    if copy == 0:
        signal.pause()
        os._exit(1)
    try:
        keeper._let_go()  # as where the command dies
        assert keeper._process.wait(PATIENCE_S) == 0
    finally:
        os.kill(copy, signal.SIGKILL)
        os.waitpid(copy, 0)
    keeper.end(restored=False)


def test_a_keeper_that_has_acted_is_heard_until_nothing_drives(saved: Saved) -> None:
    one = saved.keeper(SILENCE_S)
    one.beat()
    assert wait_for(lambda: one.has_acted)
    told = [one.has_acted]  # it stays said
    one.rest()
    assert [*told, one.has_acted] == [True, False]
    time.sleep(4.0 * SILENCE_S)  # by then it sleeps, until it is told
    one.beat()
    assert wait_for(lambda: one.has_acted)
    one.rest()
    one.end(restored=True)


def test_a_wait_for_an_answer_is_heard_while_the_servo_is_driven(saved: Saved) -> None:
    one = saved.keeper(PATIENCE_S)
    heard_s = []
    for tells in (one.waits, one.beat, one.waits):
        tells()
        heard_s.append(one._heart.heard_s)
    assert heard_s[0] == AT_REST < heard_s[1] < heard_s[2]
    one.rest()
    one.end(restored=True)


def test_a_drive_that_was_on_its_way_when_the_keeper_acted_does_not_last(saved: Saved) -> None:
    """A command that stands still ahead of a write, goes on, and stands still again behind it."""
    link, roles = saved.link, saved.bench.setup.model.roles
    link.put(roles["torque"], 0)
    link.hold(roles["mode"], saved.bench.setup.model.pwm_mode)
    link.put(roles["drive"], 0)
    one = saved.keeper(SILENCE_S)
    one.beat()
    assert wait_for(lambda: one.has_acted)
    time.sleep(2.0 * SILENCE_S)  # its stop is over
    with turn_on(saved.port.descriptor, PATIENCE_S):
        link.put(roles["torque"], 1)
        link.put(roles["drive"], 100)
    assert wait_for(lambda: stands(link, saved.port.descriptor))
    one.rest()
    one.end(restored=True)
