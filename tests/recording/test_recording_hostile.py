"""What may stand in a run folder: each reader refuses the same things, in a sentence, in a bounded time."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from rig.config import ConfigError, load
from rig.core import strict_json
from rig.core.plain_file import NotPlainError, TooLargeError, open_plain, read_plain
from rig.core.strict_json import MOST_DIGITS, MOST_LEVELS, MOST_VALUES, JsonError
from rig.output.compare.comparison import CompareError, compare
from rig.output.report.source import load as load_for_report
from rig.panel.past_runs import Runs
from rig.panel.watch import Follower, Scene
from rig.run_folder.catalogue import INDEX, catalogue
from rig.run_folder.live.view import LiveView
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.reader import read_meta, read_result, read_run

GOOD = Path(__file__).parents[2] / "tools" / "fuzz" / "run"
NAME = "20260101T000000Z-run"

# this one, and a nesting of 100,000, took for ever, or all memory
BOMB = "m0: &m0 {k: 1}\n" + "".join(f"m{k}: &m{k} {{<<: [{', '.join([f'*m{k - 1}'] * 8)}]}}\n" for k in range(1, 11))
VALUES = {  # of JSON; each with a word of what is said
    "infinite": ("1e400", "too large for a number"),
    "minus infinite": ("-1E+999", "too large for a number"),
    "nan": ("NaN", "NaN is no JSON number"),
    "infinity": ("-Infinity", "-Infinity is no JSON number"),
    "digits": ("9" * 5000, "5000 digits"),
    "deep list": ("[" * 20_000 + "]" * 20_000, "levels deep"),
    "deep object": ('{"a":' * 900 + "1" + "}" * 900, "levels deep"),
    "very deep": ("[" * 1_000_000, "more than"),
    "wide": ("[" + "0," * MOST_VALUES + "0]", "more than"),
    "twice": ('{"b": 1, "b": 2}', "given twice"),
    "surrogate": (r'"\ud800"', "surrogate"),
    "nul": ('"\0"', "binary"),
    "not utf-8": ('"\udcff"', "UTF-8"),
    "torn": ('{"b": [1', "broken JSON"),
}
CONFIGS = {
    "bomb": (BOMB, "anchors"),
    "date": ("2001-99-99: 2001-99-99\nb: 2001-99-99\n", "unknown key"),
    "digits": ("period_s: " + "9" * 5000 + "\n", "5000 characters"),
    "deep": ("a: " + "[" * 100_000 + "\n", "levels deep"),
    "wide": ("".join(f"k{k}: 1\n" for k in range(10_000)), "more than"),
    "large": ("a: " + "x" * (2**20 + 1), "1 MiB|1048576 characters"),
    "not utf-8": ("a: \udcff", "UTF-8"),
}


def run_of(tmp_path: Path) -> Path:
    return Path(shutil.copytree(GOOD, tmp_path / NAME))


def shown(folder: Path) -> list[dict[str, Any]]:
    """What a page is told of a run, as its JSON.parse takes it."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} for a page")

    view = LiveView(folder)
    for _ in range(20):
        snapshot = view.read()
    told = Follower(0).due(Scene(run=folder.name, snapshot=snapshot), operator=False, now_s=1.0)
    return [json.loads(message, parse_constant=refuse) for message in told]


def put(path: Path, text: str) -> None:
    path.write_bytes(text.encode("utf-8", errors="surrogateescape"))


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("file", ["meta.json", "result.json"])
def test_a_hostile_value_in_a_small_file_is_named_by_each_reader(tmp_path: Path, file: str, value: str) -> None:
    folder, (text, said) = run_of(tmp_path), VALUES[value]
    put(folder / file, f'{{"name": "x",\n"a": {text}}}')
    with pytest.raises(RecordingError, match=said) as told:
        (read_meta if file == "meta.json" else read_result)(folder)
    assert told.value.path == folder / file and told.value.cure
    assert any(missing.startswith(file) and said in missing for missing in load_for_report(folder).missing)
    (row,) = catalogue(tmp_path).runs
    assert row.state == "damaged" and said in (row.problem or "")
    assert any(said in note for note in Runs(tmp_path).row(folder)["notes"])
    assert [message["type"] for message in shown(folder)] == ["operator", "live"]


@pytest.mark.parametrize("value", VALUES)
def test_a_hostile_value_in_an_event_costs_that_line_and_no_other(tmp_path: Path, value: str) -> None:
    folder, (text, said) = run_of(tmp_path), VALUES[value]
    good = (folder / "events.jsonl").read_text()
    put(folder / "events.jsonl", f'{{"kind": "link", "errors": {text}}}\n{good}')
    with pytest.raises(RecordingError, match=said) as told:
        read_run(folder)
    assert told.value.line == 1
    view = LiveView(folder)
    assert view.read().damaged == 1 and view.read().numbers["is_over"]
    messages = shown(folder)
    assert messages[-1]["is_over"]
    report = load_for_report(folder)
    assert len(report.events) == good.count("\n") and any(said in missing for missing in report.missing)


@pytest.mark.parametrize(
    "event",
    [
        {"kind": "cycle", "number": 1, "amplitude_rad": "wide", "period_s": [], "settled": True},
        {"kind": "cycle", "number": 10**39, "amplitude_rad": 1.0, "period_s": 1.0, "settled": True},
        {"kind": "search", "h1_V": {}, "h2_V": 1.0, "outcome": "x"},
        {"kind": "gains", "h1_V": "a", "h2_V": "b"},
        {"kind": "link", "errors": 2.5},
        {"kind": "link", "errors": 10**39},
        {"kind": "link"},
        {"kind": "stop"},
        {"kind": ["stage"], "name": {}},
        {"kind": "live", "t_s": 10**39, "tau_s": True, "tau_percent": "1"},
        {"kind": "stage", "name": "__proto__", "t_s": None, "__proto__": {"polluted": 1}},
        {"kind": "stage", "name": {"a": 1}},
        {"kind": "stage", "name": "x" * 100_000},
        {"kind": "fault", "code": "x" * 100_000, "cause": ["a"], "detail": {"b": 1}, "cure": None},
        {"kind": "decided", "what": "stop", "why": "y" * 100_000},
        [], 1, "text", None,
    ],
)  # fmt: skip
def test_an_event_of_any_form_never_ends_the_live_view(tmp_path: Path, event: object) -> None:
    folder = run_of(tmp_path)
    good = (folder / "events.jsonl").read_text()
    (folder / "events.jsonl").write_text(json.dumps(event) + "\n" + good)
    messages = shown(folder)
    (live,) = (message for message in messages if message["type"] == "live")
    assert live["is_over"] and len(json.dumps(messages)) < 100_000
    read_run(folder) if isinstance(event, dict) else None


@pytest.mark.parametrize(
    "event",
    [
        {"kind": "cycle", "number": 1, "amplitude_rad": 1.0, "period_s": None, "settled": True},
        {"kind": "cycle", "number": 10**39, "amplitude_rad": 1.0, "period_s": 1.0, "settled": True},
        {"kind": "gains", "h1_V": "a", "h2_V": 1.0},
        {"kind": "link", "errors": 2.5},
        {"kind": "link", "errors": 10**39},
    ],
)
def test_a_wrong_number_in_an_event_is_damage_and_reaches_no_page(tmp_path: Path, event: dict[str, object]) -> None:
    folder = run_of(tmp_path)
    (folder / "events.jsonl").write_text(json.dumps(event) + "\n")
    seen = LiveView(folder).read()
    told = seen.numbers
    assert (seen.damaged, told["cycles"], told["planes"], told["loop"]["link_errors"]) == (1, None, None, None)


@pytest.mark.parametrize(
    "row", [
        f"{'9' * 5000},0,1.0,1.0,0,0,0,0,0,0,relay-1,0,0,0", f"{10**17},0,1.0,1.0,0,0,0,0,0,0,relay-1,0,0,0",
        "0,0,1e400,1.0,0,0,0,0,0,0,relay-1,0,0,0", "0,0,nan,1.0,0,0,0,0,0,0,relay-1,0,0,0",
        "0,0,1.0,1.0,inf,0,0,-inf,1e999,nan,relay-1,nan,0,0", "," * 1_000_000, "0,0,,,,,,,,,,,,", "\0" * 14,
    ],
)  # fmt: skip
def test_a_row_of_any_form_never_ends_the_live_view(tmp_path: Path, row: str) -> None:
    folder = run_of(tmp_path)
    with (folder / "samples.csv").open("a") as file:
        file.write(row + "\n")
    assert shown(folder)[-1]["type"] == "live"
    assert LiveView(folder).read().damaged == (0 if row.startswith("0,0,1.0,1.0,inf") else 1)


@pytest.mark.parametrize("config", CONFIGS)
def test_a_hostile_config_is_named_by_check_and_by_report(tmp_path: Path, config: str) -> None:
    folder, (text, said) = run_of(tmp_path), CONFIGS[config]
    put(folder / "config.yaml", text)
    with pytest.raises(ConfigError, match=said):
        load(folder / "config.yaml")
    report = load_for_report(folder)
    is_yaml = config == "date"  # only not of an experiment
    assert is_yaml or any("config.yaml" in said_of and re.search(said, said_of) for said_of in report.missing)
    assert shown(folder)[-1]["limits"]["drive_V"] is None


def a_link(path: Path) -> None:
    target = path.with_name(f"{path.name}.elsewhere")
    path.rename(target)
    path.symlink_to(target)


def a_dangling_link(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere")


def a_device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def full_of_holes(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**30)


@pytest.mark.parametrize("make", [a_link, a_dangling_link, a_device, a_pipe, a_folder, full_of_holes])
@pytest.mark.parametrize("file", ["samples.csv", "events.jsonl", "meta.json", "result.json", "config.yaml"])
def test_what_is_no_plain_file_in_a_run_folder_is_named_and_holds_nobody_up(
    tmp_path: Path, file: str, make: Callable[[Path], None]
) -> None:
    folder = run_of(tmp_path)
    make(folder / file)
    told = "larger than" if make is full_of_holes else "is a folder" if make is a_folder else "is a (link|pipe|device)"
    if make is a_dangling_link and file == "samples.csv":
        told = "has no samples.csv"
    with pytest.raises(RecordingError, match=told) as error:
        read_run(folder)
        read_result(folder)
    assert error.value.path.name in (file, NAME)
    assert any(missing.startswith(file) for missing in load_for_report(folder).missing)
    catalogue(tmp_path)
    try:
        view = LiveView(folder)
        view.read()
    except OSError as trouble:  # which the panel tells its pages
        assert trouble.strerror and file in ("samples.csv", "events.jsonl")


@pytest.mark.parametrize("make", [a_link, a_dangling_link, a_device, a_pipe, a_folder, full_of_holes])
def test_an_index_that_is_no_plain_file_is_made_anew_or_left_out(tmp_path: Path, make: Callable[[Path], None]) -> None:
    run_of(tmp_path)
    catalogue(tmp_path)
    index = tmp_path / INDEX
    victim = tmp_path / f"{INDEX}.elsewhere"
    make(index)
    before = victim.read_bytes() if victim.exists() else b""
    found = catalogue(tmp_path)
    assert [run.name for run in found.runs] == [NAME] and bool(found.notes) == (make is a_folder)
    assert not victim.exists() or victim.read_bytes() == before


def test_rows_that_are_no_rows_are_named_by_their_line(tmp_path: Path) -> None:
    folder = run_of(tmp_path)
    with (folder / "samples.csv").open("ab") as file:
        file.write(b"1" * 2**21 + b"\n")
    with pytest.raises(RecordingError, match="the line has 2097152 characters") as told:
        read_run(folder)
    assert told.value.line == (GOOD / "samples.csv").read_bytes().count(b"\n") + 1
    (folder / "samples.csv").write_bytes(b"\n" * 5_000_000)
    with pytest.raises(RecordingError, match="more than 4000000 lines"):
        read_run(folder)


@pytest.mark.evidence
def test_more_events_than_any_run_has_are_refused_and_not_made(tmp_path: Path) -> None:
    folder = run_of(tmp_path)
    event = b'{"t_s": 0.0, "kind": "stop", "confirmed": true}\n'
    (folder / "events.jsonl").write_bytes(event * 100_000)
    assert len(read_run(folder).events) == 100_000
    (folder / "events.jsonl").write_bytes(event * 200_000)
    with pytest.raises(RecordingError, match="more than 100000 lines"):
        read_run(folder)


def test_very_many_wrong_values_are_counted_not_listed(tmp_path: Path) -> None:
    folder = run_of(tmp_path)
    (folder / "meta.json").write_text(
        json.dumps({"truth": {"law": [1] * 5000}, **{f"strange{k}": 1 for k in range(5000)}})
    )
    _, notes = read_meta(folder)
    assert len(notes) < 30 and any("more values are wrong" in note for note in notes) and max(map(len, notes)) < 1000


def test_a_file_that_grows_while_it_is_read_gives_its_whole_lines(tmp_path: Path) -> None:
    folder = run_of(tmp_path)
    good = (folder / "events.jsonl").read_bytes()
    half = good.rindex(b"\n", 0, len(good) - 1) + 10
    (folder / "events.jsonl").write_bytes(good[:half])
    view = LiveView(folder)
    assert not view.read().numbers["is_over"]
    with (folder / "events.jsonl").open("ab") as file:
        file.write(good[half:])
    assert view.read().numbers["is_over"] and view.read().damaged == 0


def test_of_several_runs_a_damaged_one_is_left_out_of_a_comparison(tmp_path: Path) -> None:
    folders = [Path(shutil.copytree(GOOD, tmp_path / f"20260101T00000{k}Z-run")) for k in range(3)]
    (folders[1] / "result.json").write_text("[" * 100)
    with pytest.raises(CompareError) as told:  # the good ones are of a jog, and measured no motor
        compare(folders)
    assert "levels deep" in str(told.value)


def test_a_folder_that_cannot_be_looked_into_hides_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_of(tmp_path)
    (tmp_path / "locked").mkdir()

    def looks(path: Path) -> bool:
        if path.name == "locked":
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return path.name == NAME

    monkeypatch.setattr("rig.run_folder.catalogue.is_run", looks)
    found = catalogue(tmp_path)
    assert [run.name for run in found.runs] == [NAME]
    assert len(found.notes) == 1 and "locked cannot be looked into: Permission denied" in found.notes[0]


# ---------------------------------------------------------------------- the two readers below all others


@pytest.mark.parametrize(
    "text", ['{"a": [1, 2.5, -1e-3, true, null, "\\ud83d\\ude00 \\u00e4"], "b": {}}', "[]", '"[[[[["', "-0.0", " 1 "]
)
def test_json_is_read_as_ever(text: str) -> None:
    assert strict_json.parse(text) == json.loads(text)


@pytest.mark.parametrize("inner", ["", '"]"', r'"\""', r'"\\"', '"a", "[[[["'])
def test_levels_are_counted_outside_of_strings(inner: str) -> None:
    strict_json.parse("[" * MOST_LEVELS + inner + "]" * MOST_LEVELS)
    strict_json.parse(json.dumps("[" * 1000 + '"' + "{" * 1000))
    with pytest.raises(JsonError, match="levels"):
        strict_json.parse("[" * (MOST_LEVELS + 1) + inner + "]" * (MOST_LEVELS + 1))


def test_values_are_counted_outside_of_strings() -> None:
    strict_json.parse(json.dumps(["," * MOST_VALUES]))
    strict_json.parse(json.dumps([0] * (MOST_VALUES - 1)))
    with pytest.raises(JsonError, match="values"):
        strict_json.parse(json.dumps([0] * (MOST_VALUES + 1)))


def test_a_number_at_the_bound_is_read_and_the_line_of_one_beyond_is_told() -> None:
    assert strict_json.parse("9" * MOST_DIGITS) == int("9" * MOST_DIGITS)
    with pytest.raises(JsonError) as told:
        strict_json.parse("{\n\n" + f'"a": {"9" * (MOST_DIGITS + 1)}}}')
    assert told.value.line == 3


def test_a_string_without_an_end_is_no_work(tmp_path: Path) -> None:
    for text in ('["' + "\\" * 3_000_001, "[[" * 60 + '"' + 'a\\"' * 2_000_000):
        with pytest.raises(JsonError):
            strict_json.parse(text)


def test_a_plain_file_is_opened_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    assert read_plain(tmp_path / "file", 5) == b"12345" == read_plain(tmp_path / "link", 5, follows_links=True)
    with pytest.raises(TooLargeError):
        read_plain(tmp_path / "file", 4)
    with pytest.raises(NotPlainError):
        read_plain(tmp_path / "link", 5)
    with pytest.raises(NotPlainError, match="device"):
        read_plain("/dev/zero", 5, follows_links=True)
    with pytest.raises(FileNotFoundError):
        open_plain(tmp_path / "none")


def test_a_pipe_is_read_to_its_end_only_where_a_user_may_have_named_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(NotPlainError, match="pipe"):
        read_plain(tmp_path / "pipe", 5)
    for content, most_bytes in ((b"12345", 5), (b"123456", 5)):
        writer = Thread(target=(tmp_path / "pipe").write_bytes, args=(content,))
        writer.start()
        if len(content) > most_bytes:
            with pytest.raises(TooLargeError):
                read_plain(tmp_path / "pipe", most_bytes, takes_pipe=True)
        else:
            assert read_plain(tmp_path / "pipe", most_bytes, takes_pipe=True) == content
        writer.join()
    with pytest.raises(NotPlainError, match="device"):
        read_plain("/dev/zero", 5, takes_pipe=True)


@pytest.mark.parametrize("swapped_in", [lambda p: p.symlink_to("file"), os.mkfifo])
def test_what_is_swapped_in_after_the_look_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swapped_in: Callable[[Path], None]
) -> None:
    (tmp_path / "file").write_bytes(b"1")
    swapped_in(tmp_path / "swapped")
    looked = (tmp_path / "file").stat()
    monkeypatch.setattr(os, "stat", lambda *_, **__: looked)  # the look finds a file, as it was a moment ago
    with pytest.raises(NotPlainError) as told:
        open_plain(tmp_path / "swapped")
    assert told.value.errno == errno.EINVAL
