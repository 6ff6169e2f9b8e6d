"""STOP by another process: in every stage of a run, before the first, while it computes, and what is refused."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from rig.backends.simulated.driver import SimulatedDriver
from rig.config import Experiment, load
from rig.core.signals import Sample
from rig.identification import Identification, IdentifyError, identify
from rig.output.report import write_report
from rig.run_folder.live import shared_page
from rig.run_folder.live.running import Seen, running
from rig.run_folder.live.stop_flag import NAME, StopError, StopFlag, Unrecorded, request_stop, runner_of
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.recording import Recording
from rig.running import session
from rig.running.experiment import script, stages
from rig.running.replay import replay
from rig.running.session import Outcome

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    """Given gains, one cycle, one short tracking run."""
    config = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    config["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.85}], "cycles": 3}
    config["tracking"] |= {"duration_s": 2.0, "methods": ["sampled-data"]}
    path = tmp_path_factory.mktemp("config") / "quick.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return load(path)


def asked(folder: Path) -> None:
    request_stop(folder, "test")


class Asks:
    """Asks the run to stop in the middle of a tick of one stage: the worst instant, right after the loop has looked."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, stage: str, ask: Callable[[Path], object] | None = None
    ) -> None:
        self.driver: SimulatedDriver | None = None
        self.folder: Path | None = None
        ticks = 0
        read, event = SimulatedDriver.read, Recorder.event

        def reading(driver: SimulatedDriver) -> Sample:
            nonlocal ticks
            sample = read(driver)
            ticks += self.folder is not None
            if ticks == 7 and self.folder is not None:
                self.driver = driver
                (ask or asked)(self.folder)
            return sample

        def noted(recorder: Recorder, t_s: float, kind: str, **fields: Any) -> None:
            event(recorder, t_s, kind, **fields)
            if kind == "stage" and fields["name"] == stage:
                self.folder = recorder.folder

        monkeypatch.setattr(SimulatedDriver, "read", reading)
        monkeypatch.setattr(Recorder, "event", noted)


def nothing_to_identify(recordings: Sequence[Recording]) -> Identification:
    """What was driven before the stop is identified, too: that takes seconds, and is tested elsewhere."""
    raise IdentifyError("not in this test", "none")


def interrupted(outcome: Outcome, by: str = "test") -> None:
    assert outcome.fault is not None
    assert (outcome.fault.code, outcome.fault.detail) == ("INTERRUPTED", f"Stop by {by}")
    assert not (outcome.folder / NAME).exists()
    assert (outcome.folder / "report.html").is_file()


@pytest.mark.parametrize("stage", ["breakaway", "search", "relay-1", "survey", "track:sampled-data", "jog"])
def test_a_stop_in_any_stage_ends_it_with_the_next_tick_and_a_replay_ends_there_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, experiment: Experiment, stage: str
) -> None:
    asks = Asks(monkeypatch, stage)
    monkeypatch.setattr(session, "identify", nothing_to_identify)
    if stage == "jog":
        outcome = script.jog(experiment, 0.6, 2.0, tmp_path)
    elif stage == "survey":
        outcome = script.run_survey(experiment, tmp_path)
    elif stage == "search":
        outcome = script.run(load(ROOT / "config/quick.yaml"), tmp_path)
    else:
        outcome = script.run(experiment, tmp_path)
    interrupted(outcome)
    assert asks.driver is not None and asks.driver.bench.pin_counts == 0
    recording = read_run(outcome.folder)
    last, stop = recording.rows()[-1], [event for event in recording.events if event.kind == "stop"][-1]
    assert last.stage == stage
    assert stop.t_s is not None and stop.t_s - last.t_s <= 2 * experiment.period_s
    monkeypatch.undo()
    again = replay(outcome.folder)
    assert again.is_same and again.replayed == again.rows


@pytest.mark.parametrize("size", [0, 1])
def test_a_flag_that_somebody_cuts_short_is_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, experiment: Experiment, size: int
) -> None:
    """Nobody could set it any more; to read it where it is mapped would kill the process, with its drive on."""
    asks = Asks(monkeypatch, "jog", lambda folder: os.truncate(folder / NAME, size))
    outcome = script.jog(experiment, 0.6, 2.0, tmp_path)
    interrupted(outcome, "whoever cut its stop flag short")
    assert asks.driver is not None and asks.driver.bench.pin_counts == 0


def test_a_stop_before_anything_drives_and_one_while_it_identifies_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, experiment: Experiment
) -> None:
    def ask(folder: Path, notes: tuple[str, ...]) -> None:
        seen = running(tmp_path)
        assert [one.folder for one in seen] == [folder] and seen[0].runner.pid == os.getpid()
        request_stop(folder, "the first")
        request_stop(folder, "another")  # changes nothing

    outcome = script.jog(experiment, 0.6, 2.0, tmp_path, ask)
    interrupted(outcome, "the first")
    assert (outcome.folder / "samples.csv").read_text().count("\n") == 1  # no row, only their names
    assert running(tmp_path) == []

    original = identify

    def computing(recordings: Sequence[Recording]) -> Identification:
        request_stop(running(tmp_path)[0].folder, "test")
        return original(recordings)

    monkeypatch.setattr(stages, "identify", computing)
    outcome = script.run_relay(experiment, tmp_path)
    interrupted(outcome)
    assert outcome.result.estimates  # as after Ctrl-C


def test_a_stop_after_the_end_is_told_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, experiment: Experiment
) -> None:
    close = Recorder.close

    def closing(recorder: Recorder) -> None:
        close(recorder)
        request_stop(recorder.folder, "test")

    monkeypatch.setattr(Recorder, "close", closing)
    outcome = script.jog(experiment, 0.3, 0.1, tmp_path)
    assert outcome.fault is None
    assert outcome.failure == "Stop by test came after the experiment had ended"


@pytest.mark.parametrize("between", [False, True], ids=["while the report is written", "between two runs"])
def test_a_stop_ends_a_series_of_runs_also_where_none_drives(
    between: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, experiment: Experiment
) -> None:
    written = write_report

    def stop() -> None:
        going = running(tmp_path)
        assert len(going) == 1  # the flag of the series
        request_stop(going[0].folder, "test")

    def report(*given: Any) -> None:
        written(*given)
        if not between:
            stop()

    def perform(start: Callable[[Callable[..., None]], Outcome]) -> Outcome:
        outcome = start(lambda *_: None)
        if between and outcome.fault is None:
            stop()
        return outcome

    monkeypatch.setattr(session, "write_report", report)
    short = experiment.model_copy(update={"tracking": None})
    outcomes = script.repeated(short, 3, tmp_path, perform)
    assert outcomes[0].fault is None
    if between:
        interrupted(outcomes[1])
        assert (outcomes[1].folder / "samples.csv").read_text().count("\n") == 1  # no row
    else:
        assert outcomes[0].failure == "Stop by test came after the experiment had ended"
    assert len(outcomes) == 1 + between
    assert running(tmp_path) == []


def test_a_folder_that_cannot_hold_the_flag_costs_the_flag_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, experiment: Experiment
) -> None:
    def full(descriptor: int, size: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shared_page, "allocate", full)
    outcome = script.jog(experiment, 0.3, 0.1, tmp_path)
    assert outcome.fault is None
    assert [note for note in outcome.result.notes if "no stop flag" in note and "No space left on device" in note]
    assert sorted(path.name for path in outcome.folder.iterdir() if path.name.startswith((".", "stop"))) == []


def test_nothing_is_driven_where_a_stop_would_read_that_nothing_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, experiment: Experiment
) -> None:
    """The disk becomes read-only while the device is opened: the flag still says that the drive is off."""
    told = StopFlag.tell
    write = shared_page.MappedPage.write
    driven: list[float] = []

    def read_only(page: shared_page.MappedPage, at: int, data: bytes) -> None:
        raise OSError(30, "Read-only file system")

    def tell(flag: StopFlag, zero_s: float, period_s: float) -> None:
        told(flag, zero_s, period_s)
        monkeypatch.setattr(shared_page.MappedPage, "write", read_only)

    monkeypatch.setattr(StopFlag, "tell", tell)
    monkeypatch.setattr(SimulatedDriver, "write", lambda driver, u_V: driven.append(u_V))
    outcome = script.jog(experiment, 0.3, 0.1, tmp_path)
    monkeypatch.setattr(shared_page.MappedPage, "write", write)
    assert outcome.fault is not None and outcome.fault.code == "RECORDER_DEAD"
    assert "Read-only file system" in outcome.fault.detail
    assert driven == []


HOLDS = """
import sys, time
from pathlib import Path
from rig.run_folder.live.stop_flag import StopFlag
with StopFlag() as flag:
    flag.begin(Path(sys.argv[1]))
    flag.tell(time.monotonic(), 0.01)
    print("holds", flush=True)
    while not flag.asked_by():
        time.sleep(0.001)
    print(flag.asked_by(), flush=True)
"""


def test_between_processes_a_stop_arrives_and_whoever_is_killed_is_known_to_be_gone(tmp_path: Path) -> None:
    def holder() -> subprocess.Popen[str]:
        process = subprocess.Popen([sys.executable, "-c", HOLDS, str(tmp_path)], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None and process.stdout.readline() == "holds\n"
        return process

    with pytest.raises(StopError, match="no run goes on there"):
        request_stop(tmp_path)
    with holder() as process:
        runner = runner_of(tmp_path)
        assert runner is not None and runner.pid == process.pid and runner.period_s == 0.01
        assert request_stop(tmp_path, "pan\x1bel") == runner
        assert process.communicate()[0] == "pan\\x1bel\n"
    assert not (tmp_path / NAME).exists()
    with holder() as process:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert (tmp_path / NAME).exists()
        assert runner_of(tmp_path) is None and running(tmp_path.parent) == []
        with pytest.raises(StopError):
            request_stop(tmp_path)


def test_a_flag_that_cannot_be_written_is_a_signal_to_its_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a disk that has become read-only."""
    sent: list[tuple[int, int]] = []

    def read_only(page: shared_page.OthersPage, at: int, data: bytes) -> None:
        raise OSError(30, "Read-only file system")

    def kill(pid: int, number: int) -> None:
        sent.append((pid, number))
        if len(sent) > 1:
            raise PermissionError(1, "Operation not permitted")

    with StopFlag() as flag:
        flag.begin(tmp_path)
        monkeypatch.setattr(shared_page.OthersPage, "write", read_only)
        monkeypatch.setattr(os, "kill", kill)
        request_stop(tmp_path)
        assert sent == [(os.getpid(), signal.SIGTERM)]
        with pytest.raises(StopError, match="use the e-stop"):
            request_stop(tmp_path)


def test_the_number_in_a_page_of_another_user_is_sent_no_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder that others write in, too: it may be the number of any process of this user."""
    sent: list[int] = []
    own = os.geteuid()
    with StopFlag() as flag:
        flag.begin(tmp_path)
        monkeypatch.setattr(os, "geteuid", lambda: own + 1)
        monkeypatch.setattr(os, "kill", lambda pid, number: sent.append(pid))

        def read_only(page: shared_page.OthersPage, at: int, data: bytes) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(shared_page.OthersPage, "write", read_only)
        with pytest.raises(StopError, match="takes no signal of this user"):
            request_stop(tmp_path)
    assert sent == []


@pytest.mark.parametrize("make", [lambda p: p.write_bytes(bytes(4096)), lambda p: p.write_bytes(b"x"), os.mkfifo,
                                  lambda p: p.symlink_to("/dev/zero"), lambda p: p.mkdir()])  # fmt: skip
def test_what_only_looks_like_a_flag_is_no_run_and_takes_no_time(
    tmp_path: Path, make: Callable[[Path], object]
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    make(folder / NAME)
    assert runner_of(folder) is None
    assert running(tmp_path) == []
    with pytest.raises(StopError):
        request_stop(folder)


def test_what_is_not_recorded_is_at_0_V_only_if_it_said_so(tmp_path: Path) -> None:
    """Also after its flag was deleted, or taken along by a run."""
    for is_on, known in ((True, False), (False, True)):
        with StopFlag() as flag:
            flag.open(tmp_path, "home")
            (one,) = running(tmp_path)
            seen = Unrecorded(one.folder)
            assert (seen.pid, seen.is_at_zero()) == (os.getpid(), True), "nothing was armed yet"
            flag.tell_drive(is_on=True)
            assert seen.is_at_zero() is None
            if not is_on:
                flag.begin(tmp_path)
                flag.tell_drive(is_on=False)
        assert seen.is_at_zero() is known
        seen.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("lose", ["delete the hidden folder", "rename the runs", "rename the runs, and make new ones"])
def test_what_is_not_recorded_goes_on_for_a_panel_though_somebody_takes_its_page_away(
    lose: str, tmp_path: Path
) -> None:
    """Its process still holds the page: else no Stop would reach the homing."""
    seen, runs = Seen(), tmp_path / "runs"
    with StopFlag() as flag:
        flag.open(runs, "home")
        (one,) = seen.unrecorded(running(runs), ())
        if lose == "delete the hidden folder":
            shutil.rmtree(one.folder)
        else:
            runs.rename(tmp_path / "old")
        if "new ones" in lose:
            runs.mkdir()
        assert running(runs) == []
        assert seen.unrecorded([], ()) == [one] and seen.goes_on(one)
    assert not seen.goes_on(one) and seen.unrecorded([], ()) == []


def test_a_run_that_has_taken_its_page_along_is_no_longer_unrecorded(tmp_path: Path) -> None:
    seen, folder = Seen(), tmp_path / "run"
    folder.mkdir()
    with StopFlag() as flag:
        flag.open(tmp_path, "run")
        seen.unrecorded(running(tmp_path), ())
        flag.begin(folder)
        (run,) = running(tmp_path)
        assert seen.unrecorded([], [run.runner.pid]) == []


@pytest.mark.parametrize("how", ["renamed", "deleted", "replaced"])
def test_a_run_of_a_series_can_be_stopped_whatever_became_of_the_one_before(how: str, tmp_path: Path) -> None:
    """Its folder was renamed or deleted, and the flag with it; and a Stop that came before that counts on."""
    for is_stopped in (False, True):
        runs = tmp_path / f"{is_stopped}"
        first, second = runs / "first", runs / "second"
        with StopFlag() as flag:
            flag.open(runs, "run")
            first.mkdir()
            second.mkdir()
            flag.begin(first)
            if is_stopped:
                request_stop(first, "panel")
            if how == "renamed":
                first.rename(runs / "kept")
            else:
                (first / NAME).unlink()
            if how == "replaced":
                (first / NAME).write_text("somebody's own")
            flag.begin(second)
            assert flag.asked_by() == ("panel" if is_stopped else "")
            assert [one.folder for one in running(runs)] == [second]
            request_stop(second, "another")
            assert flag.asked_by() == ("panel" if is_stopped else "another")
            assert how != "replaced" or (first / NAME).read_text() == "somebody's own"
