"""Live progress: what it makes of a growing folder, and that it ends by itself."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from rig.run_folder.recording.follow import Progress, Tail, stage_line
from rig.run_folder.recording.sample_columns import HEADER
from rig.run_folder.results import JsonObject

EVENTS: list[JsonObject] = [
    {"t_s": 0.0, "kind": "stage", "name": "breakaway"},
    {"t_s": 3.0, "kind": "breakaway", "plus_V": 0.61, "minus_V": 0.57, "noise_rad": 0.003},
    {"t_s": 3.1, "kind": "stage", "name": "search"},
    {"t_s": 6.0, "kind": "search", "h1_V": 0.3, "h2_V": 0.7, "period_s": None, "amplitude_rad": None,
     "outcome": "no oscillation"},
    {"t_s": 9.0, "kind": "stage", "name": "relay-1"},
    {"t_s": 11.0, "kind": "cycle", "stage": "relay-1", "number": 2, "settled": True, "period_s": 1.0,
     "amplitude_rad": 0.58},
    {"t_s": 12.0, "kind": "fault", "code": "POLARITY", "cause": "the shaft moves against the drive", "cure": "swap"},
    {"t_s": 12.1, "kind": "end"},
]  # fmt: skip


def shown(progress: Progress, most_done: int = 0, *, draws: bool = False) -> str:
    console = Console(width=140, record=True, file=open("/dev/null", "w"))  # noqa: SIM115, PTH123
    with console.file:
        console.print(progress.picture(most_done, draws=draws))
        return console.export_text()


def test_each_stage_is_shown_with_what_came_of_it() -> None:
    progress = Progress()
    for event in EVENTS[:6]:
        progress.take_event(event)
    progress.take_row("812,9,11.5,11.501,0.41,612,,0.9,0.02,,relay-1,80.0,160.0,0")
    text = shown(progress)
    assert "moves at +0.61 V and -0.57 V" in text
    assert "cycle 2 (settled): 0.580 rad, 1.000 s" in text
    assert "+0.41 rad +0.90 V" in text
    for event in EVENTS[6:]:
        progress.take_event(event)
    assert progress.ended
    assert "POLARITY" in shown(progress)


def test_a_tail_begins_with_the_last_whole_lines_and_waits_for_no_pipe(tmp_path: Path) -> None:
    long = tmp_path / "long.csv"
    long.write_text("".join(f"{number:03d}\n" for number in range(100)))
    tail = Tail(long, last_bytes=10)
    assert tail.lines() == ["098", "099"]
    with long.open("a") as file:
        file.write("100\n10")
    assert tail.lines() == ["100"]
    assert Tail(long, last_bytes=10_000).lines()[0] == "000"
    long.write_text("0123456789" * 3 + "\n100\n101\n102\n")
    pieces = Tail(long, most_bytes=10)
    assert [pieces.lines() for _ in range(7)] == [*[["0123456789"]] * 3, ["", "100", "101"], ["102"], [], []]
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is a pipe"):
        Tail(tmp_path / "pipe").lines()


def test_a_stage_that_has_several_laws_is_shown_once(tmp_path: Path) -> None:
    """The search of relay.until begins with pushes: two laws, one stage."""
    events: list[JsonObject] = [{"t_s": t_s, "kind": "stage", "name": "search"} for t_s in (6.4, 6.5)]
    progress = Progress()
    for event in events:
        progress.take_event(event)
    progress.take_event({"t_s": 7.6, "kind": "stage", "name": "strokes-1"})
    assert [stage for _, stage, _ in progress.done] == ["search"]
    (tmp_path / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    told = subprocess.run(
        [sys.executable, "-m", "rig.run_folder.recording.follow", str(tmp_path)],
        input="",
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stderr == "    6.4 s  search\n"
    # the report of a run that is over takes its time: a line says so while nobody has ended the progress yet
    ended = {"t_s": 12.1, "kind": "end"}
    with subprocess.Popen(
        [sys.executable, "-m", "rig.run_folder.recording.follow", str(tmp_path)],
        stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as drawing:  # fmt: skip
        assert drawing.stdin is not None and drawing.stderr is not None
        assert drawing.stderr.readline() == "    6.4 s  search\n"
        with (tmp_path / "events.jsonl").open("a") as file:
            file.write(json.dumps(ended) + "\n")
        assert drawing.stderr.readline() == "   12.1 s  report\n"
        drawing.stdin.close()
        assert drawing.stderr.read() == ""


LIVE: JsonObject = {
    "t_s": 9.41, "kind": "live", "tau_s": 0.17098, "tau_percent": 0.796, "fc_V": 0.48138, "fc_percent": None,
    "K_rad_s_V": 6.5418, "K_percent": 0.652,
}  # fmt: skip


def test_a_live_estimate_and_why_the_tests_ended_are_shown_and_are_lines_in_a_pipe() -> None:
    enough: JsonObject = {"t_s": 10.4, "kind": "decided", "row": 941, "by": "advice", "what": "stop"}
    enough["why"] = "all is known"
    progress = Progress()
    progress.take_event({"t_s": 7.4, "kind": "stage", "name": "strokes-1"})
    progress.take_event(LIVE)
    progress.take_event(enough)
    assert "tau 0.171 s ±0.8 %, K 6.542 ±0.65 %; enough: all is known" in shown(progress)
    assert stage_line(LIVE) == "    9.4 s    tau 0.171 s ±0.8 %, K 6.542 ±0.65 %"
    with_laws = LIVE | {"laws": "force_over_position, sag", "residual_over_noise": 1.2}
    assert stage_line(with_laws) == f"{stage_line(LIVE)}, with force over position and sag"
    lacking = LIVE | {"laws": "", "residual_over_noise": 12.6}
    assert stage_line(lacking) == f"{stage_line(LIVE)}: the residual is 13 times the noise, so ± is too small"
    assert stage_line(enough) == "   10.4 s    enough: all is known"
    bound = enough | {"by": "loop", "what": "rest", "why": "the guard had to brake"}
    assert stage_line(bound) == "   10.4 s    broken off: the guard had to brake"
    assert stage_line(enough | {"by": "loop"}) == "   10.4 s    over: all is known"
    assert stage_line(enough | {"what": "relay"}) is None  # the stage itself has a line


def test_a_stage_without_rows_says_that_it_computes_and_for_how_long() -> None:
    progress = Progress()
    progress.take_event({"t_s": 60.0, "kind": "stage", "name": "identify"})
    assert "computing" not in shown(progress)
    progress.still_s = 7.4
    text = shown(progress)
    assert "identify" in text and "computing, 7 s" in text


def test_the_present_stage_stays_in_sight_and_the_report_is_one() -> None:
    """A terminal cuts the end of what is higher than it."""
    progress = Progress()
    for number in range(30):
        progress.take_event({"t_s": float(number), "kind": "stage", "name": f"strokes-{number}"})
    text = shown(progress, most_done=5)
    assert [f"strokes-{number} " in text for number in (23, 24, 28, 29)] == [False, True, True, True]
    progress.take_event({"t_s": 30.0, "kind": "end"})
    assert "report" in shown(progress, draws=True) and "report" not in shown(progress)


def test_behind_a_fault_the_terminal_says_that_the_motor_is_identified_and_for_how_long() -> None:
    """Ctrl-C was followed by seconds in which nothing moved."""
    progress = Progress()
    progress.take_event({"t_s": 2.0, "kind": "fault", "code": "INTERRUPTED", "cause": "the run was interrupted"})
    progress.take_event({"t_s": 2.0, "kind": "end"})
    progress.still_s = 4.4
    assert "the motor is identified, and drawn, 4 s" in shown(progress, draws=True)


def test_only_whole_lines_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    tail = Tail(path)
    assert tail.lines() == []
    path.write_text('{"a": 1}\n{"b"')
    assert tail.lines() == ['{"a": 1}']
    assert tail.lines() == []
    path.write_text('{"a": 1}\n{"b": 2}\n')
    assert tail.lines() == ['{"b": 2}']


def test_the_viewer_ends_when_the_one_who_started_it_is_gone(tmp_path: Path) -> None:
    (tmp_path / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in EVENTS[:-1]))
    (tmp_path / "samples.csv").write_text(HEADER)
    viewer = subprocess.Popen(
        [sys.executable, "-m", "rig.run_folder.recording.follow", str(tmp_path)],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    _, error = viewer.communicate()  # closes its standard input
    assert viewer.returncode == 0
    assert "POLARITY" in error.decode()


def test_files_of_the_folder_that_rig_is_called_in_are_not_its_modules(tmp_path: Path) -> None:
    (tmp_path / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in EVENTS))
    (tmp_path / "samples.csv").write_text(HEADER)
    (tmp_path / "queue.py").write_text("raise SystemExit(7)\n")
    (tmp_path / "rich.py").write_text("raise SystemExit(7)\n")
    follow = "from rig.run_folder.recording.follow import Path, following\nwith following(Path('.')): pass"
    done = subprocess.run([sys.executable, "-P", "-c", follow], cwd=tmp_path, capture_output=True)
    assert done.returncode == 0 and "POLARITY" in done.stderr.decode()


def test_on_a_terminal_it_draws_what_there_is(tmp_path: Path) -> None:
    (tmp_path / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in EVENTS))
    (tmp_path / "samples.csv").write_text(HEADER)
    ours, theirs = pty.openpty()
    viewer = subprocess.Popen(
        [sys.executable, "-m", "rig.run_folder.recording.follow", str(tmp_path)], stdin=subprocess.PIPE, stderr=theirs
    )
    os.close(theirs)
    assert viewer.stdin is not None
    viewer.stdin.close()
    drawn = b""
    with contextlib.suppress(OSError):  # the terminal is gone with its last user
        while more := os.read(ours, 65536):
            drawn += more
    os.close(ours)
    assert viewer.wait(30) == 0
    assert "POLARITY" in drawn.decode(errors="replace")
