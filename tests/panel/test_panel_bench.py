"""What a page may make the bench do, without a process: starts, holds, Stop, and what comes of it."""

from __future__ import annotations

import asyncio
import hashlib
import itertools
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from processes import PATIENCE_S

from rig.panel import bench as module
from rig.panel import processes
from rig.panel.access import Access, Address
from rig.panel.app import Panel
from rig.panel.bench import HOLD_ENDS_S, Bench, StopAnswer
from rig.panel.messages import RefusedError, Stop
from rig.panel.processes import StartedProcess
from rig.panel.watch import ALIVE_S, PERIOD_S, Follower
from rig.run_folder.live import running as running_module
from rig.run_folder.live.lease import HeldLease, Leaser
from rig.run_folder.live.own_folder import NAME
from rig.run_folder.live.running import Running, running
from rig.run_folder.live.stop_flag import Runner, StopFlag, born

SILENCE = Path(__file__).parent / "browser" / "silence.mjs"


def refused(what: Callable[[], object]) -> str:
    with pytest.raises(RefusedError) as error:
        what()
    return error.value.what


def test_each_confirmation_starts_once_and_only_the_config_that_was_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[object] = []
    config = tmp_path / "bench.yaml"
    config.write_text("as checked")

    async def answer_of(name: str, *paths: Path) -> dict[str, Any]:
        digest = hashlib.sha256(config.read_bytes()).hexdigest()
        return {"lines": [], "may_run": True, "plan": {"jog_V": 1.0}, "digest": digest}

    def start(out: Path, command: str, arguments: Sequence[str]) -> StartedProcess:
        started.append((command, arguments[-2:]))
        return StartedProcess(tmp_path, "note.json", command, 1, "", None)

    monkeypatch.setattr(module, "answer_of", answer_of)
    monkeypatch.setattr("rig.panel.processes.start", start)
    bench = Bench(config, tmp_path / "runs")
    assert "not confirmed" in refused(lambda: bench.start(None))
    key = asyncio.run(bench.check())["confirmation"]
    assert "not confirmed" in refused(lambda: bench.start("made up"))
    assert "not confirmed" in refused(lambda: bench.start(key)), "whoever guesses ends it"
    key = asyncio.run(bench.check())["confirmation"]
    bench.start(key)
    assert "not confirmed" in refused(lambda: bench.start(key))
    key = asyncio.run(bench.check())["confirmation"]
    config.write_text("changed")
    assert "has changed" in refused(lambda: bench.start(key))
    key = asyncio.run(bench.check())["confirmation"]
    monkeypatch.setattr("rig.panel.bench.time.monotonic", lambda: 1e12)
    assert "too long ago" in refused(lambda: bench.start(key))
    digest = hashlib.sha256(b"as checked").hexdigest()
    assert started == [("run", ("--as-checked", digest))]  # which it compares with the bytes that it reads
    assert bench._jog_V == 0.0  # a check changes the drive of no jog that goes on


class Lease:
    """Takes what a hold gives."""

    is_anothers = False

    def __init__(self, folder: Path) -> None:
        self.given: list[float | None] = GIVEN

    def drive(self, u_V: float) -> None:
        self.given.append(u_V)

    def release(self) -> None:
        self.given.append(None)

    def close(self) -> None:
        pass


GIVEN: list[float | None] = []


def test_one_page_holds_the_jog_and_what_comes_after_a_pause_drives_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    GIVEN.clear()
    monkeypatch.setattr(module, "Leaser", Lease)
    monkeypatch.setattr("rig.panel.bench.time.monotonic", lambda: now_s)
    bench = Bench(None, tmp_path)
    assert "no jog goes on" in refused(lambda: bench.jog("one", 0.5))
    jogs = [Running(tmp_path, Runner(1, 0.0, 0.01))]
    bench._running, bench._jog_V = jogs, 2.0
    bench.jog("one", 0.5)
    assert "another page" in refused(lambda: bench.jog("other", 0.5))
    bench.release("other")
    bench.jog("one", -7.0)
    now_s += HOLD_ENDS_S + 0.01
    for _ in range(2):
        assert "interrupted" in refused(lambda: bench.jog("one", 0.5))
    bench.jog("other", 1.0)
    bench.stop()
    bench._running = jogs
    bench.release("one")
    bench.jog("one", 0.25)
    assert GIVEN == [1.0, -2.0, None, 2.0, None, 0.5]


def test_of_two_panels_one_holds_the_jog_and_the_other_takes_nothing_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "Leaser", partial(Leaser, now_ns=lambda: 1_000_000_000))
    monkeypatch.setattr("rig.panel.bench.time.monotonic", lambda: 1.0)
    one, other = Bench(None, tmp_path), Bench(None, tmp_path)
    for bench in (one, other):
        bench._running, bench._jog_V = [Running(tmp_path, Runner(1, 0.0, 0.01))], 1.0
    with HeldLease(tmp_path, lambda: 1_000_000_000) as held:
        for _ in range(3):
            one.jog("page", 0.5)
            assert "another panel" in refused(lambda: other.jog("its page", -1.0))
            other.release("its page")
            assert held.u_V() == 0.5
        one.release("page")
        other.jog("its page", -1.0)
        assert held.u_V() == -1.0


@pytest.mark.parametrize("instead", [lambda path: None, Path.mkdir, lambda path: path.symlink_to("/dev/zero")])
def test_a_run_whose_flag_is_gone_is_known_and_stopped_by_a_signal_until_it_ends(
    instead: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[tuple[int, int]] = []
    monkeypatch.setattr("rig.run_folder.live.stop_flag.os.kill", lambda *given: sent.append(given))
    bench = Bench(None, tmp_path)
    (folder := tmp_path / "20260101T000000Z-run-goes").mkdir()
    with StopFlag() as flag:
        flag.begin(folder)
        for _ in range(2):
            bench.look()
            assert [one.folder for one in bench.running] == [folder] and bench.lost(folder) is None
    instead(folder / "stop.flag")
    bench.look()
    assert running(tmp_path) == [] and [one.folder for one in bench.running] == [folder]
    assert bench.lost(folder) is not None
    assert "no run 'another' goes on here" in bench.stop("another").why
    assert bench.stop() == StopAnswer((folder,), (), "")
    assert sent == [(os.getpid(), signal.SIGTERM)]
    (folder / "events.jsonl").write_text('{"kind": "stop"}\n{"kind": "end", "t_s": 3.0}\n')
    assert bench.stop() == StopAnswer((), (), ""), "its process lives a moment longer than the run"
    bench.look()
    assert bench.running == [] and len(sent) == 1


@pytest.mark.parametrize("after", ["", '{"t_s": 3.1, "kind": "stop", "by": "keeper"}\n{"t_s": 3.1, "kind": "fault"}\n'])
def test_a_run_that_died_goes_on_in_no_process_that_has_its_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: str
) -> None:
    """As of a run in a container: its number is that of a strange process here."""
    sent: list[int] = []
    monkeypatch.setattr("rig.run_folder.live.stop_flag.os.kill", lambda pid, number: sent.append(pid))
    bench = Bench(None, tmp_path)
    (folder := tmp_path / "20260101T000000Z-run-dies").mkdir()
    with StopFlag() as flag:
        flag.begin(folder)
        bench.look()
    (folder / "events.jsonl").write_text('{"t_s": 3.0, "kind": "loop_died"}\n' + after)
    bench.look()
    assert bench.running == [] and bench.stop() == StopAnswer((), (), "") and sent == []


def test_what_another_panel_starts_is_known_here_stopped_here_and_cleaned_up_there(tmp_path: Path) -> None:
    """Else a Stop on a second panel would miss a run whose device is being opened, and a start would be another."""
    bench = Bench(None, tmp_path)
    (tmp_path / NAME).mkdir()
    note = tmp_path / NAME / f"{'1' * 16}.json"
    with subprocess.Popen(["sleep", "60"]) as other:
        note.write_text(json.dumps({"command": "run", "pid": other.pid, "born": born(other.pid)}))
        (tmp_path / NAME / f"{'2' * 16}.json").write_text('{"command": "run", "p')
        bench.look()
        bench.look()
        assert [one.pid for one in bench.opening] == [other.pid]
        assert "run goes on already" in refused(lambda: bench._start("run", "config"))
        assert bench.stop() == StopAnswer((), (other.pid,), "")
        assert other.wait(PATIENCE_S) == -signal.SIGTERM
    assert [one.stopped for one in bench.ended()] == [True]
    bench.look()
    assert bench.opening == [] and note.exists()
    Bench(None, tmp_path)
    assert not note.exists(), "a panel that starts cleans up"


def test_a_process_that_has_ended_makes_no_run_without_a_flag(tmp_path: Path) -> None:
    bench = Bench(None, tmp_path)
    with subprocess.Popen(["sleep", "60"]) as other:
        bench._seen.others([Running(tmp_path, Runner(other.pid, 0.0, 0.01))])
        bench.look()
        assert [one.runner.pid for one in bench.running] == [other.pid]
        other.kill()
    bench.look()
    assert bench.running == []


def test_a_drive_that_is_not_confirmed_within_a_second_of_a_stop_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    panel = Panel.of(Access(Address("127.0.0.1", 8470)), tmp_path)
    (folder := tmp_path / "20260101T000000Z-run-hangs").mkdir()
    monkeypatch.setattr("rig.panel.watch.time.monotonic", lambda: now_s)

    def told() -> list[tuple[str | None, bool | None, int | None]]:
        panel.watch.look()
        stops = [one for _, one in panel.watch.scene.news if one["type"] == "stop"]
        assert len(stops) == len(panel.watch.scene.news)
        return [(one["run"], one["drive_zero"], one["after_ms"]) for one in stops]

    with StopFlag() as flag:
        flag.begin(folder)
        (folder / "events.jsonl").write_text('{"kind": "stage", "t_s": 0, "name": "relay-1"}\n')
        assert panel.watch.stop_asked(panel.bench.stop())["drive_zero"] is None
        now_s = 0.9
        assert told() == []
        now_s = 1.1
        for _ in range(2):
            assert told() == [(folder.name, False, 1100)]
        with (folder / "events.jsonl").open("a") as events:
            events.write('{"kind": "stop", "t_s": 1, "confirmed": true}\n')
        now_s = 1.5
        assert told() == [(folder.name, False, 1100), (folder.name, True, 1500)]


class Stopped:
    """A panel with runs that a test writes by hand, each with a process, and what its pages are told of a Stop."""

    def __init__(self, tmp_path: Path, stack: ExitStack, *names: str) -> None:
        self.panel = Panel.of(Access(Address("127.0.0.1", 8470)), tmp_path)
        self.flags: dict[str, ExitStack] = {}
        self.runners: dict[str, subprocess.Popen[bytes]] = {}
        for name in names:
            self.runners[name] = stack.enter_context(subprocess.Popen(["sleep", "60"]))
            stack.callback(self.runners[name].kill)
            (folder := tmp_path / f"20260101T000000Z-run-{name}").mkdir()
            (folder / "events.jsonl").write_text('{"kind": "stage", "t_s": 0, "name": "relay-1"}\n')
            self.flags[name] = stack.enter_context(ExitStack())
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("rig.run_folder.live.stop_flag.os.getpid", lambda pid=self.runners[name].pid: pid)
                self.flags[name].enter_context(StopFlag()).begin(folder)
        self.out = tmp_path
        self.look()

    def look(self) -> list[tuple[str | None, bool | None, str]]:
        for _ in range(7):  # every sixth looks at which runs go on
            self.panel.watch.look()
        stops = [one for _, one in self.panel.watch.scene.news if one["type"] == "stop"]
        return [(one["run"], one["drive_zero"], one["why"]) for one in stops]

    def die(self, name: str) -> None:
        self.runners[name].kill()
        self.runners[name].wait()
        self.flags[name].close()

    def stop(self) -> Stop:
        return self.panel.watch.stop_asked(self.panel.bench.stop())

    def event(self, name: str, **event: object) -> None:
        with (self.out / f"20260101T000000Z-run-{name}" / "events.jsonl").open("a") as events:
            events.write(json.dumps({"t_s": 1.0, **event}) + "\n")


@pytest.mark.parametrize("how", ["ends", "dies"])
def test_a_run_that_is_over_without_a_confirmed_0_V_is_never_called_at_0(tmp_path: Path, how: str) -> None:
    """A pulled cable: the run ends with LINK_TIMEOUT, and nobody knows what the device does."""
    with ExitStack() as stack:
        bench = Stopped(tmp_path, stack, "cut")
        assert bench.stop()["drive_zero"] is None
        if how == "ends":
            bench.event("cut", kind="stop", confirmed=False)
            bench.event("cut", kind="end")
        else:
            bench.die("cut")
        [(run, at_zero, why)] = bench.look()
        assert run is not None and run.endswith("cut") and at_zero is False and "never confirmed 0 V" in why
        bench.die("cut")
        bench.look()
        again = bench.stop()
        assert again["drive_zero"] is None and "never confirmed 0 V: 20260101T000000Z-run-cut" in again["why"]


def test_of_two_runs_that_are_stopped_the_drive_is_called_at_0_when_both_are(tmp_path: Path) -> None:
    with ExitStack() as stack:
        bench = Stopped(tmp_path, stack, "a", "b")
        bench.stop()
        bench.event("b", kind="stop", confirmed=True)
        assert bench.look() == []
        bench.event("a", kind="stop", confirmed=True)
        assert [at_zero for _, at_zero, _ in bench.look()] == [True]


def test_one_of_two_runs_that_never_confirms_0_V_is_not_outdone_by_the_other(tmp_path: Path) -> None:
    with ExitStack() as stack:
        bench = Stopped(tmp_path, stack, "a", "b")
        bench.stop()
        bench.die("b")
        assert [at_zero for _, at_zero, _ in bench.look()] == [False]
        bench.event("a", kind="stop", confirmed=True)
        assert [at_zero for _, at_zero, _ in bench.look()] == [False]


@pytest.mark.parametrize("file", ["samples.csv", "events.jsonl"])
def test_a_run_that_cannot_be_read_hides_no_other_one_and_its_stop_is_still_watched(tmp_path: Path, file: str) -> None:
    """Whatever stands in place of its files: the pages hear of it once, and of the Stop of the other one as ever."""
    with ExitStack() as stack:
        bench = Stopped(tmp_path, stack, "a", "b")
        watch = bench.panel.watch
        watch.look()
        assert watch.scene.run is not None and watch.scene.run.endswith("b")
        broken = tmp_path / watch.scene.run / file
        broken.unlink(missing_ok=True)
        os.mkfifo(broken)
        bench.stop()
        bench.event("a", kind="stop", confirmed=True)
        for _ in range(3):
            watch.look()
        told = [news["what"] for _, news in watch.scene.news if news["type"] == "trouble"]
        assert len(told) == 1 and file in told[0] and "is a pipe" in told[0]
        assert not any("run-a" in str(asked) for asked in watch._asked), "the other one's Stop was watched to its end"


def test_a_view_that_fails_says_so_and_ends_no_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A defect of ours in reading one run: the last wall before all pages go blind."""

    def fails(*_: object, **__: object) -> None:
        raise OverflowError("cannot convert")

    with ExitStack() as stack:
        bench = Stopped(tmp_path, stack, "a")
        monkeypatch.setattr("rig.run_folder.live.view.LiveView.read", fails)
        bench.panel.watch.look()
        [(_, told)] = bench.panel.watch.scene.news
        assert told["type"] == "trouble" and "cannot be shown (OverflowError: cannot convert)" in told["what"]


@pytest.mark.parametrize("at", ["the list of folders is read", "the flag is set"])
def test_a_stop_reaches_a_run_that_takes_its_flag_into_its_folder_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    folder = tmp_path / "20260101T000000Z-run-x"
    with StopFlag() as flag:
        flag.open(tmp_path, "run")

        def moves(*_: object) -> None:
            if not folder.exists():
                folder.mkdir()
                flag.begin(folder)

        bench = Bench(None, tmp_path)
        of, name = (running_module, "_folders") if at == "the list of folders is read" else (module, "request_stop")
        original = getattr(of, name)

        def raced(*arguments: Any) -> Any:
            if of is module:
                moves()
                return original(*arguments)
            found = original(*arguments)
            moves()
            return found

        monkeypatch.setattr(of, name, raced)
        assert bench.stop() == StopAnswer((folder,), (), "")
        assert flag.asked_by() == "panel"


def test_a_stop_of_a_run_that_is_not_there_says_so(tmp_path: Path) -> None:
    with ExitStack() as stack:
        bench = Stopped(tmp_path, stack, "goes")
        said = bench.panel.watch.stop_asked(bench.panel.bench.stop("typo"))
        assert said["drive_zero"] is None and "no run 'typo'" in said["why"]


def test_two_panels_of_one_folder_do_not_both_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each looks first, then starts: between the two the other one may not."""
    begun: list[subprocess.Popen[bytes]] = []

    def start(out: Path, command: str, arguments: Sequence[str]) -> StartedProcess:
        time.sleep(0.2)  # the other one looks now, if it may
        child = subprocess.Popen(["sleep", "60"])
        begun.append(child)
        note = f"{child.pid:016x}.json"
        (out / NAME / note).write_text(json.dumps({"command": command, "pid": child.pid, "born": born(child.pid)}))
        return StartedProcess(out, note, command, child.pid, born(child.pid), child)

    monkeypatch.setattr("rig.panel.bench.processes.start", start)
    benches = [Bench(None, tmp_path), Bench(None, tmp_path)]

    def try_to(bench: Bench) -> bool:
        try:
            bench._start("run", "config")
        except RefusedError:
            return False
        return True

    try:
        with ThreadPoolExecutor(2) as threads:
            assert sorted(threads.map(try_to, benches)) == [False, True]
    finally:
        for child in begun:
            child.kill()
            child.wait()


def test_a_panel_that_is_frozen_in_its_start_does_not_hang_another_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.panel.processes._WAIT_S", 0.0)
    with processes.one_at_a_time(tmp_path):
        assert "another panel of this folder" in refused(lambda: Bench(None, tmp_path)._start("run", "config"))


def test_a_page_says_within_a_second_that_it_is_not_connected_and_then_sends_nothing_but_stop() -> None:
    """The page's own code, with a clock that the test moves."""
    told = subprocess.run(["node", SILENCE], stdout=subprocess.PIPE, check=True, timeout=PATIENCE_S)
    seen = json.loads(told.stdout)
    assert seen["lively"] == 1, "a page that hears something says nothing of the kind"
    assert [what for what, _ in seen["said"]] == ["alive", "silent", "alive", "silent"]
    (_, frozen_ms), (_, dead_ms) = seen["said"][1], seen["said"][3]
    assert 700 <= frozen_ms <= 1000
    assert dead_ms == 0, "a socket that closes says so at once"
    assert seen["sent"] == [False, True, ["stop"]]
    assert seen["connects_again"]


def test_a_run_that_is_over_is_not_called_silent_while_its_report_is_drawn() -> None:
    """The page's own code."""
    lives = [
        {"age_ms": 10, "is_over": False, "stage": "relay-1"},
        {"age_ms": 3100, "is_over": False, "stage": "relay-1"},
        {"age_ms": 3100, "is_over": False, "stage": "identify"},
        {"age_ms": 3100, "is_over": True, "stage": "track"},
    ]
    words = SILENCE.parents[3] / "rig" / "panel" / "static" / "words.js"
    says = f"console.log(JSON.stringify({json.dumps(lives)}.map(whyOld)))"
    program = f'import {{ whyOld }} from "{words.as_uri()}"; {says}'
    told = subprocess.run(
        ["node", "--input-type=module", "-e", program], stdout=subprocess.PIPE, check=True, timeout=PATIENCE_S
    )
    assert json.loads(told.stdout) == [
        "",
        "The run is silent: no reading for 3 s.",
        "The run computes: no reading for 3 s.",
        "The run is over: rig draws the report.",
    ]


def test_a_page_hears_something_at_least_four_times_a_second(tmp_path: Path) -> None:
    """A page that hears nothing for 0.7 s says that it is not connected."""
    watch = Panel.of(Access(Address("127.0.0.1", 8470)), tmp_path).watch
    watch.look()
    follower = Follower(0)
    looks_s = [PERIOD_S * number for number in range(100)]
    spoke_s = [at_s for at_s in looks_s if follower.due(watch.scene, operator=False, now_s=at_s)]
    pauses_s = [later - earlier for earlier, later in itertools.pairwise(spoke_s)]
    assert max(pauses_s) <= ALIVE_S + 1e-9
    assert len(spoke_s) < 30, "and no more often than it must"
    assert json.loads(follower.due(watch.scene, operator=True, now_s=4.0)[0]) == {"type": "operator", "you": True}
