"""A law of the user's own under watch: the bound on its CPU time, and the keeper."""

from __future__ import annotations

import errno
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from command_line import rig as command
from evidence import evidence
from processes import PLAIN_RIG, alive, wait_until
from simulated_bench import LIMITS, PERIOD_S, simulated_bench

import rig
from faults import hanging_laws
from rig.config import load
from rig.control.law import Rest, Timed
from rig.core.faults import Fault
from rig.core.halted import Halts
from rig.core.signals import Sample
from rig.run_folder.live.law_lease import LawLease
from rig.run_folder.live.stop_flag import request_stop
from rig.run_folder.recording.errors import RecordingError
from rig.running.experiment import law_watch
from rig.running.experiment.law_watch import WatchedLaw
from rig.running.keeper import hung_law as law_keeper
from rig.running.keeper.hung_law import LOOK_EVERY_S, Charge
from rig.running.keeper.law_times import LawTimes, asks, law_times

ROOT = Path(__file__).resolve().parents[2]
HUNG_S = 180.0  # far beyond what a loaded machine needs


class Clocks:
    """Time and CPU time, as a test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = self.cpu_s = 0.0
        fake = SimpleNamespace(
            monotonic=lambda: self.now_s, thread_time_ns=lambda: round(1e9 * self.cpu_s), sleep=time.sleep
        )
        monkeypatch.setattr(law_watch, "time", fake)


class Takes:
    """A law whose 12th step takes so long."""

    def __init__(self, clocks: Clocks, cpu_s: float, wall_s: float) -> None:
        self._clocks, self._cpu_s, self._wall_s, self._steps = clocks, cpu_s, wall_s, 0

    def step(self, sample: Sample) -> float:
        self._steps += 1
        if self._steps == 12:
            self._clocks.cpu_s += self._cpu_s
            self._clocks.now_s += self._wall_s
        return 0.3


def times(**loop: Any) -> LawTimes:
    config = yaml.safe_load(rig.ready("demo").read_text(encoding="utf-8"))
    e = load({**config, "loop": loop})
    return law_times(e, virtual=False)


def driven(law: Timed) -> tuple[Fault | None, Any]:
    bench = simulated_bench()
    bench.guard.sign_proven = True
    fault = None
    try:
        with bench.loop.armed(LIMITS):
            bench.loop.run(law, "law")
    except Fault as seen:
        fault = seen
    return fault, bench


@pytest.mark.parametrize(
    ("given", "bound_s", "key"),
    [
        ({}, PERIOD_S / 2, "loop.law_cpu_s, by default half a period, 2 ms at least"),
        ({"law_cpu_s": 0.008}, 0.008, "loop.law_cpu_s"),
    ],
)
def test_the_cpu_time_of_a_step_is_bounded(
    monkeypatch: pytest.MonkeyPatch, given: dict[str, float], bound_s: float, key: str
) -> None:
    clocks, bounds = Clocks(monkeypatch), times(**given)
    within, _ = driven(WatchedLaw(Timed(Takes(clocks, 0.98 * bound_s, 0.0), 0.3, "own"), bounds))
    assert within is None
    beyond, bench = driven(WatchedLaw(Timed(Takes(clocks, 1.02 * bound_s, 0.0), 0.3, "own"), bounds))
    assert beyond is not None and beyond.code == "LAW_TIME"
    words = f"the law own: one step took {1.02e3 * bound_s:.4g} ms of CPU time, bound {1e3 * bound_s:g} ms ({key})"
    assert beyond.detail == words
    assert bench.driver.bench.pin_counts == 0 and len(bench.record.rows) == 11


def test_a_stall_of_the_host_is_no_fault_of_the_law(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks(monkeypatch)
    fault, _ = driven(WatchedLaw(Timed(Takes(clocks, 0.001, 5.0), 0.3, "own"), times()))
    assert fault is None


def test_virtual_time_bounds_no_cpu_time_so_a_run_is_the_same_on_any_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    virtual = law_times(load(yaml.safe_load(rig.ready("simulated").read_text(encoding="utf-8"))), virtual=True)
    assert virtual.cpu_s == math.inf
    fault, _ = driven(WatchedLaw(Timed(Takes(Clocks(monkeypatch), 60.0, 60.0), 0.3, "own"), virtual))
    assert fault is None


def test_a_page_fault_ends_no_fast_loop() -> None:
    config = yaml.safe_load(rig.ready("simulated").read_text(encoding="utf-8"))
    fast = load({**config, "period_s": 0.001})
    assert law_times(fast, virtual=False).cpu_s == 0.002


def test_the_lease_is_as_long_as_a_watchdog_waits_or_twice_the_cpu_time() -> None:
    assert times().lease_s == 0.1
    assert times(law_cpu_s=0.4).lease_s == 0.8


def test_a_slow_loop_may_sleep_for_its_period_however_short_the_lease() -> None:
    """With a watchdog of 20 ms and a law of 1 ms the lease is a fifth of the period: no thread holds Python there."""
    config = yaml.safe_load(rig.ready("simulated").read_text(encoding="utf-8"))
    slow = load({**config, "period_s": 0.1, "daq": {**config["daq"], "watchdog_s": 0.02}, "loop": {"law_cpu_s": 0.001}})
    assert law_times(slow, virtual=False).lease_s < slow.period_s < law_times(slow, virtual=False).idle_s
    virtual = law_times(slow, virtual=True)
    assert virtual.idle_s == virtual.still_s


# ---------------------------------------------------------------------- who may speak on the link


def test_a_law_that_comes_back_before_the_keeper_looks_keeps_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    lease = LawLease(-1)
    lease.begin(7)
    step = lease.at_work
    # it comes back between the claim and the look
    monkeypatch.setattr("rig.run_folder.live.law_lease.time", SimpleNamespace(sleep=lambda _: lease.end()))
    assert lease.take(step) is False and not lease.is_taken
    lease.begin(8)
    assert lease.take(step) is False, "another step is no step that is over"
    assert lease.end() is True


def test_a_law_that_comes_back_after_the_keeper_looked_finds_the_link_taken() -> None:
    lease = LawLease(-1)
    lease.begin(7)
    assert lease.take(lease.at_work) is True
    assert lease.end() is False and lease.is_taken


def test_a_loop_whose_link_is_taken_does_not_speak_until_the_keeper_is_gone() -> None:
    lease, waited = LawLease(-1), list[int]()
    keeper = SimpleNamespace(lease=lease, await_verdict=lambda: waited.append(1))
    law = WatchedLaw(Timed(SimpleNamespace(step=lambda _: float(not lease.take(lease.at_work))), 1.0, "own"), times())
    law.keeper = keeper  # type: ignore[assignment]  # what a step needs of it
    law.step(Sample(0.0, 0.0, 512))
    assert waited == [1]


# ---------------------------------------------------------------------- what counts against a law


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr(law_keeper, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def looked_at(clock: list[float], state: str, cpu_share: float, looks: int, apart_s: float = LOOK_EVERY_S) -> Charge:
    clock[0] = 0.0
    charge = Charge(1, 2.0, clock[0], clock[0])
    for k in range(1, looks + 1):
        clock[0] = k * apart_s
        charge.look(state, 2.0 + cpu_share * clock[0])
    return charge


def test_what_counts_is_cpu_time_and_sleep(clock: list[float]) -> None:
    assert looked_at(clock, "R", 1.0, 20).used_s == pytest.approx(20 * LOOK_EVERY_S)
    assert looked_at(clock, "S", 0.0, 20).used_s == pytest.approx(20 * LOOK_EVERY_S)
    assert looked_at(clock, "D", 0.5, 20).used_s == pytest.approx(20 * LOOK_EVERY_S)


@pytest.mark.parametrize("state", ["R", "T", "t", "Z"])
def test_a_law_without_a_processor_or_stopped_uses_up_nothing(clock: list[float], state: str) -> None:
    starved = looked_at(clock, state, 0.0, 20)
    assert starved.used_s == 0.0 and starved.late_s == pytest.approx(20 * LOOK_EVERY_S)


def test_a_keeper_that_was_late_itself_charges_no_more_sleep_than_two_looks(clock: list[float]) -> None:
    assert looked_at(clock, "S", 0.0, 1, apart_s=3.0).used_s == pytest.approx(2 * LOOK_EVERY_S)


class Watched:
    """A keeper's watch over a loop that is not there: what the law has run, and what the keeper did."""

    def __init__(self, clock: list[float], monkeypatch: pytest.MonkeyPatch, bounds: LawTimes, *, is_real: bool) -> None:
        self.clock, self.asked = clock, list[float]()
        self.ran_s, self.state = 0.0, "R"
        self.lease = LawLease(-1)
        loop: Any = SimpleNamespace(pid=1, is_real=is_real, times=bounds, thread=lambda: (self.state, self.ran_s))
        self.watch = law_keeper.Watch(loop, self.lease, -1, can_stop=is_real)
        kill = SimpleNamespace(kill=lambda pid, number: self.asked.append(clock[0]))
        monkeypatch.setattr(law_keeper, "os", kill)

    def taken_after_s(self, for_s: float, cpu_share: float = 1.0) -> float:
        """When the keeper took the link, s from the begin of this step; nan if it did not."""
        self.asked.clear()
        self.lease.begin(round(1e9 * self.ran_s))
        began_s = self.clock[0]
        while self.clock[0] < began_s + for_s:
            if self.watch._is_over():
                return self.clock[0] - began_s
            self.clock[0] += LOOK_EVERY_S
            self.ran_s += cpu_share * LOOK_EVERY_S
        self.lease.end()
        return math.nan


@pytest.mark.parametrize(("state", "cpu_share", "asked_after_s"), [("R", 1.0, 0.005), ("S", 0.0, 0.08)])
def test_the_keeper_asks_first_once_and_takes_the_link_when_the_lease_is_over(
    clock: list[float], monkeypatch: pytest.MonkeyPatch, state: str, cpu_share: float, asked_after_s: float
) -> None:
    one = Watched(clock, monkeypatch, times(), is_real=True)
    one.state = state
    began_s = clock[0]
    assert 0.1 <= one.taken_after_s(1.0, cpu_share) <= 0.1 + 2.5 * LOOK_EVERY_S
    [asked_s] = one.asked
    assert asked_after_s < asked_s - began_s <= asked_after_s + 2.5 * LOOK_EVERY_S


def test_the_keeper_leaves_alone_a_law_that_is_back_in_time_or_has_no_processor(
    clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = Watched(clock, monkeypatch, times(), is_real=True)
    for _ in range(50):  # a step's charge is its own
        assert math.isnan(one.taken_after_s(0.095, 0.04)) and one.asked == []
    assert math.isnan(one.taken_after_s(5.0, 0.0)) and one.asked == []


def test_time_that_is_the_loops_own_does_not_count(clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    """The law comes back while the keeper looks, and the loop then runs for long."""
    one = Watched(clock, monkeypatch, times(), is_real=True)
    one.lease.begin(0)
    assert one.watch._is_over() is False
    clock[0], one.ran_s = LOOK_EVERY_S, 3.0
    thread = one.watch._loop.thread
    one.watch._loop.thread = lambda: (one.lease.end(), thread())[1]  # type: ignore[method-assign]  # of a stand-in
    assert one.watch._is_over() is False and one.asked == []


def test_what_was_asked_of_one_step_ends_no_other() -> None:
    lease, raised = LawLease(-1), list[str]()
    law: WatchedLaw

    def step(sample: Sample) -> float:
        if sample.t_s > 0.0:
            lease.ask(lease.at_work)
        try:
            law.asked_to_end(0, sys._getframe())
        except BaseException as error:
            raised.append(str(error))
            raise
        return 0.3

    law = WatchedLaw(Timed(SimpleNamespace(step=step), 1.0, "own"), times())
    law.keeper = SimpleNamespace(lease=lease)  # type: ignore[assignment]  # what a step needs of it
    lease.ask(7)
    assert law.step(Sample(0.0, 0.0, 512)) == 0.3 and raised == []
    with pytest.raises(Fault, match="the law own: its step was ended"):
        law.step(Sample(0.01, 0.0, 512))


def test_in_virtual_time_the_keeper_waits_for_a_signal(clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    one = Watched(clock, monkeypatch, LawTimes(math.inf, 1.0, ""), is_real=False)
    assert math.isnan(one.taken_after_s(30.0))
    one.watch._hear(bytes([signal.SIGCHLD]))
    assert math.isnan(one.taken_after_s(30.0))
    one.watch._hear(bytes([signal.SIGCHLD, signal.SIGINT]))
    assert 1.0 <= one.taken_after_s(30.0) <= 1.0 + 3 * LOOK_EVERY_S
    assert one.asked == [], "the signal itself has asked"


@pytest.mark.parametrize("is_real", [True, False])
def test_the_keeper_asks_at_once_where_somebody_has_pressed_stop(
    clock: list[float], monkeypatch: pytest.MonkeyPatch, is_real: bool
) -> None:
    """The loop looks at the flag once a tick, and the law does not return to it."""
    one = Watched(clock, monkeypatch, LawTimes(math.inf, 1.0, ""), is_real=is_real)
    one.watch.flagged = "panel"
    began_s = clock[0]
    assert 1.0 <= one.taken_after_s(30.0) <= 1.0 + 3 * LOOK_EVERY_S
    [asked_s] = one.asked
    assert asked_s - began_s <= 2.5 * LOOK_EVERY_S


def ended_still_after_s(one: Watched, for_s: float, looks_every_s: float = math.inf, cpu_share: float = 0.0) -> float:
    """When the keeper ends a loop that stands still between two steps, s; nan: it does not. Its looks end that."""
    began_s = looked_s = one.clock[0]
    while one.clock[0] < began_s + for_s:
        if one.watch._stands_still():
            return one.clock[0] - began_s
        one.clock[0] += LOOK_EVERY_S
        one.ran_s += cpu_share * LOOK_EVERY_S
        if one.clock[0] - looked_s >= looks_every_s:
            one.lease.look()
            looked_s = one.clock[0]
    return math.nan


def test_a_loop_that_stands_still_between_two_steps_is_ended_where_a_drive_may_be_on(
    clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = Watched(clock, monkeypatch, times(), is_real=True)
    one.state = "S"
    still_s = times().still_s
    assert still_s > times().lease_s + 1.0, "what stops a drive has its time"
    assert math.isnan(ended_still_after_s(one, 10.0)), "nothing drives"
    one.lease.tell_drive(is_on=True)
    assert math.isnan(ended_still_after_s(one, 10.0, looks_every_s=1.0)), "the loop goes on"
    one.state = "T"
    assert math.isnan(ended_still_after_s(one, 10.0)), "somebody has stopped it"
    one.state = "R"
    one.lease.look()
    assert math.isnan(ended_still_after_s(one, 10.0)), "the machine gives it no processor"
    one.lease.look()
    assert still_s < ended_still_after_s(one, 10.0, cpu_share=1.0) < still_s + 0.2, "it asks for Python again and again"
    one.state = "S"
    one.lease.look()
    assert still_s < ended_still_after_s(one, 10.0) < still_s + 0.2
    one.lease.look()
    one.lease.tell_idle(is_idle=True)
    assert times().idle_s < ended_still_after_s(one, 10.0) < times().idle_s + 0.2, "it waits for no reply"
    one.lease.tell_idle(is_idle=False)
    one.lease.begin(0)
    assert math.isnan(ended_still_after_s(one, 10.0)), "the law is at work: it has a lease of its own"


def test_a_loop_that_the_keeper_could_not_replace_is_ended_only_if_somebody_asks(
    clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = Watched(clock, monkeypatch, times(), is_real=False)
    one.state = "S"
    one.lease.tell_drive(is_on=True)
    assert math.isnan(ended_still_after_s(one, 10.0))
    one.watch._hear(bytes([signal.SIGTERM]))
    assert ended_still_after_s(one, 10.0) > times().still_s


@pytest.mark.parametrize(
    ("priority", "limit", "cores", "has"),
    [
        (60, 99, 1, 61),
        (60, 60, 2, 60),
        (60, 0, 1, 0),
        (99, 99, 2, 99),
        (0, 99, 1, 0),
        (60, 60, 1, None),
        (99, 99, 1, None),
    ],
)
def test_the_keeper_goes_before_a_law_that_spins_or_has_a_core_of_its_own(
    monkeypatch: pytest.MonkeyPatch, priority: int, limit: int, cores: int, has: int | None
) -> None:
    granted = [0]

    def schedule(pid: int, policy: int, wanted: Any) -> None:
        if wanted > limit:
            raise PermissionError(1, "Operation not permitted")
        granted.append(wanted)

    system = {"SCHED_FIFO": os.SCHED_FIFO, "sched_param": int, "sched_setscheduler": schedule}
    monkeypatch.setattr(law_keeper, "os", SimpleNamespace(**system, sched_getaffinity=lambda _: range(cores)))
    if has is None:
        with pytest.raises(SystemExit, match="no process can go before the law"):
            law_keeper._go_before_the_loop(priority)
    else:
        law_keeper._go_before_the_loop(priority)
        assert granted[-1] == has


# ---------------------------------------------------------------------- the keeper's process


def hanging(folder: Path, way: str) -> subprocess.Popen[str]:
    """`rig run` on config/simulated.yaml with a law that hangs; returns once it does."""
    config = yaml.safe_load(rig.ready("simulated").read_text(encoding="utf-8"))
    config["law"] = hanging_laws.section(way, folder / "mark")
    path = folder / "hangs.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    with hanging_laws.offered(folder):
        places = [str(ROOT), str(ROOT / "tools"), str(folder)]
        host = subprocess.Popen(
            [sys.executable, "-c", PLAIN_RIG, "run", str(path), "--out", str(folder / "runs")],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(places)},
        )
    wait_until(lambda: (folder / "mark").exists() or host.poll() is not None)
    return host


def keepers_of(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    named = {int(child): Path(f"/proc/{child}/cmdline").read_bytes() for child in children}
    return [child for child, line in named.items() if b"rig.running.keeper" in line]


def cpu_s(pid: int) -> float:
    """CPU time that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.parametrize(
    ("way", "numbers", "is_gone"),
    [
        ("in C", [signal.SIGHUP], True),
        *evidence(("in C", [signal.SIGINT, signal.SIGINT], False), ("swallows", [signal.SIGHUP], False)),
    ],
)
def test_a_law_that_heeds_no_signal_is_ended_and_its_run_is_read_also_where_the_terminal_is_gone(
    tmp_path: Path, way: str, numbers: list[signal.Signals], is_gone: bool
) -> None:
    """Nothing is kept out of the folder by a terminal that nobody reads."""
    host = hanging(tmp_path, way)
    [keeper] = keepers_of(host.pid)
    assert host.stderr is not None
    if is_gone:
        host.stderr.close()
    had_s = cpu_s(host.pid)
    wait_until(lambda: cpu_s(host.pid) > had_s + 0.05)  # it is in the loop: a moment before, a signal would end the run
    for number in numbers:
        host.send_signal(number)
    said = "" if is_gone else host.stderr.read()
    host.stderr.close()
    assert host.wait(HUNG_S) == -signal.SIGKILL
    wait_until(lambda: not alive(keeper))
    [folder] = (tmp_path / "runs").iterdir()
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    [fault] = result["faults"]
    assert fault["code"] == "LAW_TIME" and "law hangs:" in fault["detail"] and numbers[0].name in fault["detail"]
    assert "LAW_TIME" in said or "LAW_TIME" in (folder / "events.jsonl").read_text(encoding="utf-8")
    run = rig.read(folder)
    assert run.failure.startswith("LAW_TIME") and len(run["law"]) > 50
    kinds = [event.kind for event in run.events]
    assert kinds[-2:] == ["loop_died", "fault"] and "end" not in kinds
    again = tmp_path / "again"
    again.mkdir()
    with hanging_laws.offered(again):
        assert command("replay", folder).exit_code == 0
    assert command("report", folder).exit_code == 0


def test_a_law_that_ends_the_process_ends_its_run_with_a_fault_and_a_result(tmp_path: Path) -> None:
    """By `os._exit(0)`: else the status says that all is well, and nothing else says that it is not."""
    host = hanging(tmp_path, "exits")
    said = host.communicate(timeout=HUNG_S)[1]
    assert host.returncode == 1 and "LAW_FAILED" in said and "os._exit(0)" in said
    [folder] = (tmp_path / "runs").iterdir()
    [fault] = json.loads((folder / "result.json").read_text(encoding="utf-8"))["faults"]
    assert fault["code"] == "LAW_FAILED" and "loop_died" not in (folder / "events.jsonl").read_text(encoding="utf-8")


def test_a_law_that_ends_the_process_in_c_does_not_do_so_without_a_word(tmp_path: Path) -> None:
    """Its status is 0, and there is no result: the keeper says so."""
    host = hanging(tmp_path, "exits in C")
    said = host.communicate(timeout=HUNG_S)[1]
    assert host.returncode == 0 and "ended within a step of the law hangs" in said and "there is no result" in said


@pytest.mark.parametrize("in_thread", [False, True])
def test_a_law_that_swallows_what_keeps_the_process_alive_drives_no_further(in_thread: bool) -> None:
    law: WatchedLaw

    def exits() -> None:
        with suppress(BaseException):
            law.exits(0)

    def step(_: Sample) -> float:
        if in_thread:
            thread = threading.Thread(target=exits)
            thread.start()
            thread.join()
        else:
            exits()
        return 0.3

    law = WatchedLaw(Timed(SimpleNamespace(step=step), 1.0, "own"), times(law_cpu_s=0.5))
    fault, bench = driven(law)
    assert fault is not None and fault.code == "LAW_FAILED" and [row["u_V"] for row in bench.record.rows] in ([], [0.0])


def test_a_thread_of_a_law_that_holds_python_between_two_steps_does_not_keep_a_signal_away(tmp_path: Path) -> None:
    host = hanging(tmp_path, hanging_laws.THREAD_AT_ONCE)
    host.terminate()
    said = host.communicate(timeout=HUNG_S)[1]
    assert host.returncode == -signal.SIGKILL and "LAW_TIME" in said and "SIGTERM" in said
    [folder] = (tmp_path / "runs").iterdir()
    wait_until(lambda: '"fault"' in (folder / "events.jsonl").read_text(encoding="utf-8"))


def test_a_stop_of_a_panel_ends_a_law_that_does_not_return(tmp_path: Path) -> None:
    host = hanging(tmp_path, "spins")
    [folder] = (tmp_path / "runs").glob("2*")
    request_stop(folder)
    said = host.communicate()[1]
    assert host.returncode == 1 and "INTERRUPTED" in said and "Stop by panel" in said
    assert [event.kind for event in rig.read(folder).events][-3:] == ["stop", "fault", "end"]


def test_a_run_whose_loop_is_killed_leaves_no_keeper(tmp_path: Path) -> None:
    host = hanging(tmp_path, "spins")
    [keeper] = keepers_of(host.pid)
    host.kill()
    host.communicate()
    wait_until(lambda: not alive(keeper))
    [folder] = (tmp_path / "runs").iterdir()
    wait_until(lambda: '"loop_died"' in (folder / "events.jsonl").read_text(encoding="utf-8"))
    assert "fault" not in [event.kind for event in rig.read(folder).events], "nobody knows why it was killed"


class KillsItsKeeper:
    """A law during which the keeper dies, or gets another signal."""

    def __init__(self, number: signal.Signals = signal.SIGKILL) -> None:
        self._steps, self._number = 0, number

    def step(self, sample: Sample) -> float:
        self._steps += 1
        if self._steps == 10:
            for keeper in keepers_of(os.getpid()):
                os.kill(keeper, self._number)
        time.sleep(0.002)
        return 0.3


def test_a_run_without_its_keeper_goes_on_and_says_so(tmp_path: Path) -> None:
    run = rig.run(rig.ready("simulated"), law=KillsItsKeeper(), duration_s=2.0, out=tmp_path)
    assert run.failure == "" and run.result is not None
    assert any("no process watches the law" in note and "status -9" in note for note in run.result.notes)
    assert keepers_of(os.getpid()) == [] and signal.getsignal(asks()) is signal.SIG_DFL


@pytest.mark.parametrize(
    ("number", "why"), [(signal.SIGKILL, "status -9"), (signal.SIGSTOP, "somebody has stopped the keeper")]
)
def test_where_a_motor_could_move_no_law_goes_on_without_its_keeper(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals, why: str
) -> None:
    bounded = law_times(load(rig.ready("simulated")), virtual=True)._replace(cpu_s=60.0)
    monkeypatch.setattr(law_watch, "law_times", lambda *_, **__: bounded)
    run = rig.run(rig.ready("simulated"), law=KillsItsKeeper(number), duration_s=2.0, out=tmp_path)
    assert "LAW_UNWATCHED" in run.failure and why in run.failure
    assert [event.kind for event in run.events][-3:] == ["stop", "fault", "end"]
    assert keepers_of(os.getpid()) == []


def test_a_keeper_that_is_stopped_while_it_has_the_link_never_speaks_again_and_the_loop_stops_the_drive() -> None:
    """As by SIGSTOP between its claim and its stop: it neither gives the link back nor ends the loop's process."""
    lease, keeper = LawLease(-1), law_watch.Keeper.__new__(law_watch.Keeper)
    keeper.lease, keeper._verdict_s = lease, 10.0
    law = WatchedLaw(Timed(SimpleNamespace(step=lambda _: float(lease.take(lease.at_work))), 1.0, "own"), times())
    law.keeper = keeper
    waits = [sys.executable, "-c", "input()"]
    with subprocess.Popen(waits, stdin=subprocess.PIPE) as keeper._process:
        keeper._halts = Halts(keeper._process)
        keeper._process.send_signal(signal.SIGSTOP)
        with pytest.raises(Fault, match=r"LAW_UNWATCHED.*somebody has stopped the keeper"):
            law.step(Sample(0.0, 0.0, 512))
        assert keeper._process.returncode == -signal.SIGKILL and not lease.is_taken


def test_where_a_motor_could_move_no_law_begins_without_its_keeper(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    bounded = law_times(load(rig.ready("simulated")), virtual=True)._replace(cpu_s=60.0)
    monkeypatch.setattr(law_watch, "law_times", lambda *_, **__: bounded)
    monkeypatch.setattr(law_watch, "Keeper", full)
    with pytest.raises(Fault, match=r"LAW_UNWATCHED.*Resource temporarily unavailable"):
        rig.run(rig.ready("simulated"), law=KillsItsKeeper(), duration_s=2.0, out=tmp_path)
    [samples] = tmp_path.glob("*/samples.csv")
    assert len(samples.read_text(encoding="utf-8").splitlines()) == 1, "a header, and no row"


class GoesAway:
    """A law that goes to another folder."""

    def step(self, sample: Sample) -> float:
        os.chdir("/")
        return 0.3


def test_a_law_that_changes_the_folder_leaves_the_run_in_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = rig.run(rig.ready("simulated"), law=GoesAway(), duration_s=0.5, out=Path("runs"))
    assert run.failure == "" and Path.cwd() == tmp_path
    [folder] = (tmp_path / "runs").glob("2*")
    assert (folder / "report.html").exists() and not (folder / "stop.flag").exists()


class Swaps:
    """A law during which somebody moves the run's folder away, and puts a link, or a folder, in its place."""

    def __init__(self, runs: Path, victim: Path, *, is_link: bool = True) -> None:
        self._runs, self._victim, self._is_link, self._steps = runs, victim, is_link, 0

    def step(self, sample: Sample) -> float:
        self._steps += 1
        if self._steps == 10:
            [folder] = self._runs.glob("2*")
            folder.rename(folder.with_name("moved"))
            if self._is_link:
                folder.symlink_to(self._victim)
            else:
                self._victim.rename(folder)
        return 0.3


def test_a_link_in_the_place_of_the_runs_folder_leads_nothing_elsewhere(tmp_path: Path) -> None:
    """Rows and events go on in the folder that rig has made."""
    (victim := tmp_path / "victim").mkdir()
    for name in ("result.json", "report.html", "stop.flag"):
        (victim / name).write_text("precious")
    law = Swaps(tmp_path / "runs", victim)
    with pytest.raises(RecordingError, match="a folder without a run"):
        rig.run(rig.ready("simulated"), law=law, duration_s=1.0, out=tmp_path / "runs")
    assert {path.read_text() for path in victim.iterdir()} == {"precious"} and len(list(victim.iterdir())) == 3
    moved = tmp_path / "runs" / "moved"
    assert not (moved / "stop.flag").exists() and "loop_died" not in (moved / "events.jsonl").read_text()
    assert len((moved / "samples.csv").read_text().splitlines()) > 100


def test_another_folder_in_the_place_of_the_runs_stays_as_it_is(tmp_path: Path) -> None:
    (victim := tmp_path / "victim").mkdir()
    for name in ("result.json", "samples.csv", "meta.json"):
        (victim / name).write_text("precious")
    law = Swaps(tmp_path / "runs", victim, is_link=False)
    with suppress(RecordingError):  # what is there is no run
        rig.run(rig.ready("simulated"), law=law, duration_s=1.0, out=tmp_path / "runs")
    [there] = (tmp_path / "runs").glob("2*")
    assert {path.read_text() for path in there.iterdir()} == {"precious"} and len(list(there.iterdir())) == 3
    assert len((tmp_path / "runs" / "moved" / "samples.csv").read_text().splitlines()) > 100


class Forks:
    """A law that makes a copy of the process, which goes on, too."""

    copy: int | None = None

    def step(self, sample: Sample) -> float:
        if self.copy is None:
            self.copy = os.fork()
        return 0.3


class EndsACopy:
    """A law that forks, and says which open file its copy has in the place of the one for the loop's signals."""

    def __init__(self) -> None:
        self.keeper: law_watch.Keeper | None = None
        self.copys = ""

    def step(self, sample: Sample) -> float:
        assert self.keeper is not None
        if not self.copys:
            told, tells = os.pipe()
            pid = os.fork()
            if pid == 0:
                os.write(tells, bytes(Path(f"/proc/self/fd/{self.keeper.signals}").readlink()))
                os._exit(0)
            self.copys = os.read(told, 100).decode()
            os.waitpid(pid, 0)
            os.close(told)
            os.close(tells)
        return 0.3


def test_a_signal_of_a_copy_that_a_law_has_forked_is_not_the_loops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a pool of processes that ends its workers. Taken for a Stop, it costs a slow law its process."""
    law = EndsACopy()

    class Kept(law_watch.Keeper):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            law.keeper = self

    monkeypatch.setattr(law_watch, "Keeper", Kept)
    assert rig.run(rig.ready("simulated"), law=law, duration_s=0.1, out=tmp_path).failure == ""
    assert law.copys == os.devnull


def test_a_copy_of_the_process_that_a_law_has_forked_drives_nothing() -> None:
    law = Forks()
    try:
        fault, _ = driven(WatchedLaw(Timed(law, 0.3, "own"), times(law_cpu_s=0.5)))
    finally:
        if law.copy == 0:
            os._exit(7)  # the copy has come out of the loop
    assert fault is None and law.copy is not None
    assert os.waitstatus_to_exitcode(os.waitpid(law.copy, 0)[1]) == 1


@pytest.mark.parametrize("raised", [KeyboardInterrupt, SystemExit])
def test_what_is_raised_into_the_loop_itself_ends_a_run_with_its_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, raised: type[BaseException]
) -> None:
    """As by a law's own handler of a signal, or by a thread of its own."""
    step, steps = Rest.step, [0]

    def fails(rest: Rest, sample: Sample) -> float:
        steps[0] += 1
        if steps[0] > 9:
            raise raised
        return step(rest, sample)

    monkeypatch.setattr(Rest, "step", fails)
    run = rig.run(rig.ready("simulated"), law=GoesAway(), duration_s=0.5, out=tmp_path)
    assert run.failure.startswith("INTERRUPTED" if raised is KeyboardInterrupt else "INTERNAL")
    assert [event.kind for event in run.events][-2:] == ["fault", "end"]
