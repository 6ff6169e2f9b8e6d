"""A run seen from another process: what a view makes of a growing, torn, damaged or dead folder."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.run_folder.live.running import Lookout, running
from rig.run_folder.live.stop_flag import Runner, StopFlag
from rig.run_folder.live.view import KEPT_ROWS, Estimate, LiveView
from rig.run_folder.recording.sample_columns import HEADER, SampleRow, format_row

ROOT = Path(__file__).resolve().parents[2]


def row(tick: int, stage: str = "relay-1", flags: int = 0, late_us: float = 20.0) -> str:
    t_s = 0.01 * tick
    return format_row(
        SampleRow(tick, tick, t_s, t_s + 0.001, 0.3, 580, math.nan, 0.9, 0.02, math.nan, stage, late_us, 160.0, flags)
    )


def event(kind: str, t_s: float = 1.0, **fields: object) -> str:
    return json.dumps({"t_s": t_s, "kind": kind, **fields}) + "\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run that has just begun."""
    (tmp_path / "config.yaml").write_text((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    (tmp_path / "meta.json").write_text('{"script": {"name": "run"}}')
    (tmp_path / "samples.csv").write_text(HEADER)
    (tmp_path / "events.jsonl").write_text("")
    return tmp_path


@pytest.fixture
def flag(folder: Path) -> Iterator[StopFlag]:
    """The run lives."""
    with StopFlag() as held:
        held.begin(folder)
        yield held


def planes(h1_V: float, h2_V: float) -> dict[str, Any]:
    return {"y_rad": [0.0], "z_rad_s": [0.0], "h1_V": h1_V, "h2_V": h2_V}


def write(folder: Path, name: str, *lines: str) -> None:
    with (folder / name).open("a") as file:
        file.writelines(lines)


def test_rows_come_once_whole_and_with_their_age(folder: Path, flag: StopFlag) -> None:
    view = LiveView(folder)
    first = view.read()
    assert (first.state, first.numbers["command"], first.numbers["stage"], first.rows, first.age_s) == (
        "runs",
        "run",
        None,
        (),
        None,
    )
    assert first.numbers["drive_is_off"] and first.numbers["limits"]["soft_rad"] == [-1.1, 1.1]
    flag.tell(time.monotonic() - 10.0, 0.01)
    write(folder, "samples.csv", row(100), row(101), row(102)[:20])
    seen = view.read()
    assert [one.number for one in seen.rows] == [0, 1]
    assert seen.rows[1][1:6] == (101, 1.01, 0.3, 0.9, 0.02)
    assert math.isnan(seen.rows[1].yd_rad) and seen.rows[1].stage == "relay-1"
    assert seen.age_s is not None and seen.age_s >= 10.0 - 1.01
    write(
        folder, "samples.csv", row(102)[20:], "no, row\n", row(105, flags=4, late_us=700.0), row(106, late_us=math.nan)
    )
    seen = view.read()
    assert [one.tick for one in seen.rows[2:]] == [102, 105, 106]
    assert seen.damaged == 1
    # none of the loop's ticks began a tenth of a period late; the latest; those skipped; no link
    assert seen.numbers["loop"] == {"late": 0, "latest_us": 700.0, "skipped": 2, "link_errors": None}
    write(folder, "samples.csv", *(row(tick) for tick in range(200, 200 + KEPT_ROWS)))
    assert len(view.read().rows) == KEPT_ROWS


def test_the_story_of_a_run_is_told_by_its_events(folder: Path, flag: StopFlag) -> None:
    view = LiveView(folder)
    write(
        folder,
        "events.jsonl",
        event("stage", 3.0, name="search"),
        event("search", 4.0, h1_V=0.3, h2_V=0.7, period_s=None, amplitude_rad=None, outcome="no oscillation"),
    )
    seen = view.read()
    assert (seen.numbers["stage"], seen.numbers["planes"], seen.numbers["drive_is_off"]) == (
        "search",
        planes(0.3, 0.7),
        False,
    )
    assert "no oscillation" in seen.numbers["words"]
    assert seen.numbers["stage_left_s"] == pytest.approx(60.0)  # relay.until.longest_s, and no row has come
    assert (seen.numbers["run_left_s"] or 0.0) > 60.0  # tracking follows
    live = {"tau_s": 0.17, "tau_percent": 2.0, "K_rad_s_V": 6.5, "K_percent": None, "fc_V": 0.48, "fc_percent": 1.0}
    write(
        folder,
        "events.jsonl",
        event("decided", 5.0, row=9, by="advice", what="relay", h1_V=0.42, h2_V=0.85),
        event("gains", 5.0, stage="relay-1", h1_V=0.42, h2_V=0.85, cycles=4),
        event("stage", 5.1, name="relay-1"),
        event("cycle", 6.0, stage="relay-1", number=2, settled=True, period_s=1.0, amplitude_rad=0.58),
        event("live", 7.0, row=70, of_s=6.9, laws="sag", residual_over_noise=1.04, **live),
        event("link", 7.5, errors=3, most="timeouts"),
        "{torn\n",
        "[1]\n",
        event("stage", 7.6),
    )
    seen = view.read()
    assert (seen.numbers["stage"], seen.numbers["planes"]) == ("relay-1", planes(0.42, 0.85))
    assert [seen.numbers[name] for name in ("cycles", "amplitude_rad", "period_s")] == [2, 0.58, 1.0]
    assert seen.estimates == (
        Estimate(
            t_s=7.0,
            tau_s=(0.17, 0.17 * 2.0 / 100.0),
            K_rad_s_V=None,
            fc_V=(0.48, 0.48 * 1.0 / 100.0),
            remark="with sag",
        ),
    )
    assert (seen.numbers["loop"]["link_errors"], seen.damaged) == (3, 3)
    write(
        folder,
        "events.jsonl",
        event("stop", 8.0, confirmed=True),
        event("fault", 8.1, code="INTERRUPTED", cause="the run was interrupted", cure="again", detail="Stop by panel"),
    )
    seen = view.read()
    assert (seen.numbers["drive_is_off"], seen.numbers["planes"], seen.numbers["is_over"]) == (True, None, False)
    assert (seen.faults[0]["code"], seen.faults[0]["detail"]) == ("INTERRUPTED", "Stop by panel")
    write(folder, "events.jsonl", event("end", 8.2))
    seen = view.read()
    assert (seen.state, seen.numbers["is_over"]) == ("runs", True)  # it identifies, and writes its report
    assert seen.numbers["run_left_s"] is None
    assert [name for _, name in seen.stages] == ["search", "relay-1"]
    for stage, is_off in (("identify", True), ("rest", False), ("identify", False)):
        write(folder, "events.jsonl", event("stage", 9.0, name=stage))
        assert view.read().numbers["drive_is_off"] is is_off, "while rig identifies, nothing drives that did not before"


def test_a_run_that_nobody_makes_has_ended_or_died_or_was_never_there(folder: Path, tmp_path: Path) -> None:
    view = LiveView(folder)
    write(folder, "events.jsonl", event("stage", 0.0, name="breakaway"))
    assert (view.read().state, view.read().runner) == ("died", None)
    write(folder, "events.jsonl", event("end"))
    assert view.read().state == "ended"
    assert LiveView(tmp_path / "none").read().state == "absent"


def test_a_long_recording_begins_with_its_last_rows_and_a_broken_folder_with_what_it_has(folder: Path) -> None:
    line = row(1)
    write(folder, "samples.csv", *(line for _ in range(6_000_000 // len(line))))
    write(folder, "samples.csv", row(900_000))
    (folder / "config.yaml").write_text("no: [config")
    (folder / "meta.json").write_text('{"script": 3}')
    seen = LiveView(folder).read()
    assert seen.rows[-1].tick == 900_000 and seen.rows[-1].number < 4_000_000 // len(line) + 1
    assert (seen.damaged, seen.numbers["command"], seen.numbers["stage_left_s"]) == (0, None, None)
    assert set(seen.numbers["limits"].values()) == {None}


def test_a_file_that_has_grown_by_gigabytes_is_read_piece_by_piece(folder: Path) -> None:
    """One look stays short, and no line is lost; what has no end of line is no line of a run."""
    fault = json.dumps({"kind": "fault", "t_s": 1.0, "code": "NOISE", "cause": "x" * 1000, "detail": "", "cure": ""})
    with (folder / "events.jsonl").open("w") as events:
        for _ in range(9000):
            events.write(fault + "\n")
        events.write(json.dumps({"kind": "stage", "t_s": 2.0, "name": "relay-1"}) + "\n")
    view = LiveView(folder)
    stages = [view.read().numbers["stage"] for _ in range(4)]
    assert stages == [None, None, "relay-1", "relay-1"]
    assert len(view.read().faults) == 200
    with (folder / "events.jsonl").open("ab") as events:
        events.truncate(events.tell() + (1 << 30))  # zeros
    with (folder / "samples.csv").open("ab") as samples:
        samples.truncate(1 << 30)
    assert view.read().damaged <= 2
    assert LiveView(folder).read().rows == ()


def test_a_look_sees_each_run_though_it_does_not_look_at_each_old_folder_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[str] = []

    def runner_of(folder: Path) -> Runner | None:
        looked.append(folder.name)
        return Runner(1, 0.0, 0.01)

    monkeypatch.setattr("rig.run_folder.live.running.runner_of", runner_of)
    for number in range(700):
        (tmp_path / f"2026-{number:04}").mkdir()
    (tmp_path / "2026-link").symlink_to(tmp_path / "2026-0000")
    lookout = Lookout(tmp_path)

    def look() -> list[str]:
        return [one.folder.name for one in lookout.look()]

    assert look() == []
    for name in ("2026-0000", "2026-0649", "2026-0699"):
        (tmp_path / name / "stop.flag").touch()
    assert look() == ["2026-0699"], "the newest at once"
    seen = [look() for _ in range(4)]
    assert seen[-1] == ["2026-0000", "2026-0649", "2026-0699"], "the others in turn; what was seen, each time"
    (tmp_path / "2026-0000" / "stop.flag").unlink()
    assert look() == ["2026-0649", "2026-0699"]
    assert [one.folder.name for one in running(tmp_path)] == ["2026-0649", "2026-0699"]
    assert running(tmp_path / "nowhere") == [] == Lookout(tmp_path / "nowhere").look()
