"""The advisor in a process of its own: it advises on a growing folder, and whatever happens to it, no loop notices."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from processes import PATIENCE_S

from rig.design.advisor import Advice, AdvisorSettings
from rig.design.planned_test import Design, Reach, Reading, RelayGains, Room
from rig.identification.live import LiveSettings
from rig.run_folder.recording.writer import SAMPLES
from rig.running.experiment import live_process
from rig.running.experiment.live_process import LiveProcess

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests/golden/simulated"
SETTINGS = AdvisorSettings(
    0.1, LiveSettings(0.01, 0.003, 0.0041, 3.0), Room(-1.0, 1.0, 3.0, 4.6), Reading(0.01, 0.003), turn_rad=0.08
)


@pytest.fixture
def process(tmp_path: Path) -> Iterator[LiveProcess]:
    with closing(LiveProcess(tmp_path)) as started:
        yield started


def heard(process: LiveProcess, is_heard: Callable[[Advice | None], bool]) -> Advice | None:
    """Ask as the loop does until this is heard."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        advice = process.advice(0, 0.0)
        if is_heard(advice):
            return advice
        time.sleep(0.01)
    raise AssertionError("not heard")


def test_it_reads_the_folder_as_it_grows_and_advises_about_once_a_second_of_the_run(
    process: LiveProcess, tmp_path: Path
) -> None:
    rows = (GOLDEN / SAMPLES).read_text().splitlines(keepends=True)
    process.begin(SETTINGS)
    (tmp_path / SAMPLES).write_text("".join(rows[:900]))
    first = heard(process, lambda advice: advice is not None)
    assert first is not None and first.estimate is not None and first.estimate.row <= 899
    with (tmp_path / SAMPLES).open("a") as file:
        file.write("".join(rows[900:1100]))
    second = heard(process, lambda advice: advice is not None)
    assert second is not None and second.estimate is not None and second.estimate.row > 900
    assert process.trouble == ""
    process.braked()  # it designs anew, and says so, without a new row
    again = heard(process, lambda advice: advice is not None)
    assert again is not None and again.design is not None


def test_a_test_designed_before_the_guard_had_to_brake_is_not_driven(process: LiveProcess) -> None:
    advice = Advice(None, Design(RelayGains(0.3, 0.6), 1.0, 1.0, Reach(-0.5, 0.5, 2.0)))
    process.braked()
    process._said.put((advice, 0))  # on its way meanwhile
    assert process.advice(0, 0.0) == Advice(None)
    process._said.put((advice, 1))
    assert process.advice(0, 0.0) == advice


@pytest.mark.evidence
def test_it_ends_with_the_one_that_started_it_and_files_of_the_folder_that_rig_is_called_in_are_not_its_modules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "queue.py").write_text("raise SystemExit(7)\n")
    monkeypatch.chdir(tmp_path)
    with closing(LiveProcess(tmp_path)) as process:
        assert process._process is not None and process._process.stdin is not None
        process._process.stdin.close()  # it gets no settings, so it ends
        assert process._process.wait(600.0) == 0


def test_a_process_that_was_killed_is_trouble_and_nothing_else(process: LiveProcess) -> None:
    assert process._process is not None
    process.begin(SETTINGS)
    process._process.kill()
    heard(process, lambda _: process.trouble != "")
    assert process.trouble == "its process was killed by signal 9"
    process.braked()


def test_a_process_that_fails_says_why_as_the_end_of_its_traceback_does(process: LiveProcess) -> None:
    process._tell(b"no settings")
    heard(process, lambda _: process.trouble != "")
    assert process.trouble.startswith("its process ended with status 1: AttributeError: 'bytes' object has no")
    assert process.last_words.startswith("Traceback") and "live_process.py" in process.last_words


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="no such signal")
def test_a_process_that_hangs_is_trouble_and_can_be_closed(
    process: LiveProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_process, "SILENT_S", 0.2)
    assert process._process is not None
    os.kill(process._process.pid, signal.SIGSTOP)
    process.begin(SETTINGS)
    heard(process, lambda _: process.trouble != "")
    assert process.trouble == "its process has said nothing for 0.2 s"
    process.close()
    assert process._process.poll() is not None


def test_without_a_process_there_is_trouble_and_no_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with closing(LiveProcess(tmp_path)) as none:
        none.begin(SETTINGS)
        assert none.advice(0, 0.0) is None and "did not start" in none.trouble
