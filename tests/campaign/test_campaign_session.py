"""Sessions: the same rows whoever does them, in however many goes, whatever ended them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
from joblib.externals.loky.process_executor import TerminatedWorkerError
from small_campaign import UNREPEATABLE, small

from rig.campaign import results, session
from rig.campaign.random_motors import BrokenOffError, CampaignError
from rig.campaign.trial import COLUMNS, Row, run_trial
from rig.config import Campaign, dump

COUNT = 24


@cache
def expected() -> dict[str, Any]:
    """The columns of the rows that nobody but this process does."""
    rows = [run_trial(small(), k) for k in range(COUNT)]
    return {name: np.array([row[name] for row in rows]) for name in COLUMNS}


def assert_rows(folder: Path, count: int = COUNT) -> None:
    table = results.read(folder)
    assert table["number"].tolist() == list(range(count))
    for name in COLUMNS:
        if name not in UNREPEATABLE:
            np.testing.assert_array_equal(table[name], expected()[name][:count], err_msg=name)


def test_processes_give_the_rows_of_none(tmp_path: Path) -> None:
    told = []
    done = session.run(small(COUNT), tmp_path, jobs=2, on_progress=lambda *count: told.append(count))
    assert_rows(tmp_path)
    assert (done.done, done.added, done.interrupted) == (COUNT, COUNT, False)
    assert told[0] == (0, COUNT)
    assert told[-1] == (COUNT, COUNT)
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["number"] == COUNT
    assert {path.name for path in tmp_path.iterdir()} == {
        "campaign.png", "config.yaml", "meta.json", "report.html", "results.csv", "summary.json",
    }  # fmt: skip


@pytest.mark.usefixtures("no_report")
def test_what_is_there_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session.run(small(10), tmp_path, jobs=1)
    asked = []
    stream = session.stream_trials

    def noted(campaign: Campaign, numbers: Sequence[int]) -> Generator[list[Row]]:
        asked.append(list(numbers))
        return stream(campaign, numbers)

    monkeypatch.setattr(session, "stream_trials", noted)
    more = session.run(small(14), tmp_path, jobs=1)
    again = session.run(small(14), tmp_path, jobs=1)
    assert asked == [[10, 11, 12, 13]]
    assert (more.added, again.added) == (4, 0)
    assert again.summary is not None and again.summary["number"] == 14
    assert_rows(tmp_path, 14)
    before = (tmp_path / "summary.json").read_bytes()
    with pytest.raises(CampaignError, match="up to number 13 already"):
        session.run(small(5), tmp_path, jobs=1)
    assert (tmp_path / "summary.json").read_bytes() == before


@pytest.mark.usefixtures("no_report")
def test_ctrl_c_keeps_the_rows_so_far(tmp_path: Path) -> None:
    def interrupt(done: int, of: int) -> None:
        if done:
            raise KeyboardInterrupt

    done = session.run(small(COUNT), tmp_path, jobs=1, on_progress=interrupt)
    assert done.interrupted
    assert done.done == done.added == session.CHUNK
    assert session.run(small(COUNT), tmp_path, jobs=1).added == COUNT - session.CHUNK
    assert_rows(tmp_path)


def started(tmp_path: Path, *options: str) -> subprocess.Popen[str]:
    """`rig campaign` in a process group of its own, once its first rows are there."""
    config = tmp_path / "small.yaml"
    config.write_text(dump(small(400)), encoding="utf-8")
    command = [sys.executable, "-c", "from rig.__main__ import run; run()", "campaign", str(config)]
    process = subprocess.Popen(
        [*command, "--out", str(tmp_path), "--jobs", "2", *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    while len(rows_of(tmp_path)) < 9:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    return process


def rows_of(tmp_path: Path) -> list[str]:
    files = list(tmp_path.glob("campaign-*/results.csv"))
    return files[0].read_text(encoding="utf-8").splitlines() if files else []


@pytest.mark.usefixtures("no_report")
def test_a_killed_campaign_goes_on_where_it_was_and_leaves_no_worker(tmp_path: Path) -> None:
    process = started(tmp_path)
    process.kill()
    process.communicate()  # the end of its output: no worker holds it any more
    folder = results.folder_for(tmp_path, small(400))
    killed = len(rows_of(tmp_path)) - 1
    assert 8 <= killed < 400
    path = folder / results.RESULTS
    path.write_bytes(path.read_bytes()[:-25])  # and the disk tore its last line
    left = set(results.read(folder)["number"].tolist())
    assert len(left) == killed - 1
    done = session.run(small(COUNT), folder, jobs=2)
    assert done.added == len(set(range(COUNT)) - left)
    table = results.read(folder)
    assert set(table["number"].tolist()) == left | set(range(COUNT))
    for name in COLUMNS:
        if name not in UNREPEATABLE:
            known = table["number"] < COUNT
            np.testing.assert_array_equal(table[name][known], expected()[name][table["number"][known]], err_msg=name)


@pytest.mark.evidence
def test_ctrl_c_on_the_terminal_is_two_lines_that_say_how_to_go_on(tmp_path: Path) -> None:
    process = started(tmp_path)
    os.killpg(process.pid, signal.SIGINT)
    output, error = process.communicate()
    assert process.returncode == 1
    assert output == ""
    lines = error.splitlines()
    assert len(lines) == 2, error
    assert f"interrupted: {len(rows_of(tmp_path)) - 1} of 400" in lines[0]
    assert "goes on" in lines[1]


@pytest.mark.evidence  # make test joins one that is there
def test_a_dask_cluster_gives_the_same_rows(tmp_path: Path) -> None:
    """In a process of its own: a cluster that is started in a worker of pytest-xdist hangs. Without a page."""
    program = (
        "import sys; from pathlib import Path; from rig.campaign import report, session; "
        "from small_campaign import small; "
        "report.write_report = lambda *_: None; "
        "print(session.run(small(int(sys.argv[1])), Path(sys.argv[2]), jobs=2, backend=sys.argv[3]).added)"
    )
    path = os.pathsep.join(str(folder) for folder in (Path(__file__).parent, *sys.path))
    command = [sys.executable, "-W", "ignore", "-c", program, str(COUNT), str(tmp_path), "dask"]
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.PIPE, text=True, check=True
    )
    assert int(done.stdout) == COUNT
    assert_rows(tmp_path)


@pytest.mark.usefixtures("no_report")
def test_a_cluster_that_is_there_is_joined_and_left_running(tmp_path: Path) -> None:
    from distributed import LocalCluster  # it loads slowly, and the other tests need it not

    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, host="127.0.0.1", protocol="tcp", dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        assert session.run(small(9), tmp_path, jobs=1, backend="dask", scheduler=address).added == 9
        assert session.run(small(10), tmp_path, jobs=1, backend="dask", scheduler=address).added == 1
    assert_rows(tmp_path, 10)


def test_no_cluster_at_an_address_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "JOIN_S", 0.5)
    with pytest.raises(CampaignError, match="no dask scheduler at tcp://127"):
        session.run(small(1), tmp_path, jobs=1, backend="dask", scheduler="tcp://127.0.0.1:9")


def test_a_killed_worker_is_said_and_keeps_the_rows_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = [run_trial(small(), k) for k in range(session.CHUNK)]

    def chunks(*_: object) -> Iterator[list[Row]]:
        yield first
        raise TerminatedWorkerError("killed")

    monkeypatch.setattr(joblib, "Parallel", lambda **_: chunks)
    with pytest.raises(BrokenOffError, match="a worker process was killed") as caught:
        session.run(small(COUNT), tmp_path, jobs=2)
    assert "run the command again" in caught.value.cure
    assert_rows(tmp_path, session.CHUNK)


def failing(*numbers: int) -> Callable[[Campaign, int], Row]:
    """``run_trial`` with a defect that some experiments run into."""

    def trial(campaign: Campaign, number: int) -> Row:
        if number in numbers:
            raise ZeroDivisionError("no\nway")
        return run_trial(campaign, number)

    return trial


def test_a_defect_is_one_experiments_row_and_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.campaign.trial.run_trial", failing(0, 5))
    done = session.run(small(COUNT), tmp_path, jobs=1)
    table = results.read(tmp_path)
    assert table["number"].tolist() == list(range(COUNT))
    assert np.flatnonzero(table["verdict"] == "failed").tolist() == [0, 5]
    assert table["reasons"][5].startswith("ZeroDivisionError: no way (test_campaign_session.py:")
    assert np.isnan(table["tau_s"][5])
    for name in ("tau_s", "true_tau_s", "verdict"):
        assert np.delete(table[name], [0, 5]).tolist() == np.delete(expected()[name], [0, 5]).tolist()
    assert done.summary is not None and done.summary["failed"] == [0, 5]
    assert done.summary["verdicts"]["failed"] == 2
    assert sum(done.summary["verdicts"].values()) == COUNT
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "failed, by a defect of the program: 2 (0, 5)" in page
    assert "ZeroDivisionError: no way" in page
    assert f"rig campaign {tmp_path / 'config.yaml'} --experiment 0" in page


@pytest.mark.usefixtures("no_report")
def test_a_session_that_adds_experiments_survives_a_bad_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session.run(small(10), tmp_path, jobs=1)
    monkeypatch.setattr("rig.campaign.trial.run_trial", failing(10))
    summary = session.run(small(11), tmp_path, jobs=1).summary
    assert summary is not None and summary["failed"] == [10]


@pytest.mark.parametrize("count", [3, 100])
def test_where_all_fail_it_ends_at_once_and_keeps_no_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    seen = []

    def fails(campaign: Campaign, number: int) -> float:
        seen.append(number)
        return 1 / 0

    monkeypatch.setattr("rig.campaign.trial.run_trial", fails)
    with pytest.raises(BrokenOffError) as caught:
        session.run(small(count), tmp_path, jobs=1)
    assert f"the first {min(count, 16)} experiments all failed" in caught.value.cause
    assert "ZeroDivisionError: division by zero (test_campaign_session.py:" in caught.value.cause
    assert caught.value.cure == f"repeat it to see where: rig campaign {tmp_path / 'config.yaml'} --experiment 0"
    assert len(seen) < 40
    assert results.read(tmp_path)["number"].size == 0
    monkeypatch.undo()
    with session.workers("joblib", jobs=1):
        assert len(list(session.stream_trials(small(), [0]))) == 1
