"""Reading: every good file gives arrays, every other one an error with file, line and cure; nothing else comes out."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from evidence import examples
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from rig.run_folder.recording import csv_table
from rig.run_folder.recording.csv_file import read_csv
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.reader import read, read_run
from rig.run_folder.recording.recording import Recording, from_columns
from rig.run_folder.recording.sample_columns import COLUMNS, HEADER, SampleRow, format_row
from rig.run_folder.recording.text_file import MAX_BYTES
from rig.run_folder.results import RunMeta

PLAIN = "t_s,u_V,y_rad\n0.00,1.8,0.1\n0.01,-0.2,0.2\n0.02,-0.2,0.3\n"


def csv_file(folder: Path, text: str | bytes) -> Path:
    path = folder / "log.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def parse(folder: Path, text: str | bytes) -> Recording:
    return read_csv(csv_file(folder, text))


def run_text(rows: int) -> str:
    nan = math.nan
    names = ["breakaway", "relay-1", "relay-2"]
    return HEADER + "".join(
        format_row(
            SampleRow(
                2 * k,
                k,
                0.01 * k,
                0.01 * k + 0.002,
                0.1 * k,
                500 + k,
                nan,
                1.0,
                0.5 * k,
                nan,
                names[3 * k // rows],
                9.0,
                1e3,
                4,
            )
        )
        for k in range(rows)
    )


def test_a_plain_csv_has_what_it_has_and_says_so(tmp_path: Path) -> None:
    recording = parse(tmp_path, PLAIN)
    assert recording.t_s.tolist() == [0.0, 0.01, 0.02]
    assert recording.u_V.tolist() == [1.8, -0.2, -0.2]
    assert recording.y_rad.tolist() == [0.1, 0.2, 0.3]
    assert recording.columns_present == ("t_s", "u_V", "y_rad")
    assert recording.tick.tolist() == [0, 1, 2]
    assert recording.y_counts.tolist() == recording.seq.tolist() == [-1, -1, -1]
    assert recording.flags.tolist() == [0, 0, 0]
    for name in ("t_u_s", "v_rad_per_s", "z_rad_s", "yd_rad", "late_us", "io_us"):
        assert np.isnan(getattr(recording, name)).all()
    assert recording.stages() == []
    assert (recording.meta, recording.config_text, recording.events, recording.notes) == (RunMeta(), None, (), ())
    assert recording.source == tmp_path / "log.csv"


def test_arrays_are_a_recording_with_the_columns_that_are_given() -> None:
    t_s, u_V, y_rad = (np.array(values) for values in ([0.0, 0.01, 0.02], [1.8, -0.2, -0.2], [0.1, 0.2, 0.3]))
    plain = from_columns(Path("arrays"), t_s, u_V, y_rad)
    assert plain.columns_present == ("t_s", "u_V", "y_rad") and np.isnan(plain.late_us).all()
    timed = from_columns(Path("arrays"), t_s, u_V, y_rad, late_us=1e6 * t_s)
    assert timed.columns_present == ("t_s", "u_V", "y_rad", "late_us")
    assert timed.late_us.tolist() == (1e6 * t_s).tolist()


@pytest.mark.parametrize(
    "text",
    [
        PLAIN.replace(",", ";"),
        PLAIN.replace(",", "\t"),
        PLAIN.replace(",", " , "),
        PLAIN.replace("\n", "\r\n"),
        "\ufeff" + PLAIN,
        "# made by hand\n\n" + PLAIN.replace("0.02,", "# half\n  \n0.02,"),
        PLAIN.replace("\n", "\r"),
        "sep=;\n" + PLAIN.replace(",", ";"),
        PLAIN.replace(",", ";").replace(".", ","),
        PLAIN.replace(",", "\t").replace(".", ","),
        PLAIN.replace(",", "   "),
        "  t_s u_V   y_rad\n   0.0e+00  1.8   1.0E-1\n 1e-2 -0.2  0.2\n  2e-2 -.2 3e-1  \n\n \n",
        '"t_s","u_V","y_rad"\n"0","1.8","0.1"\n0.01,-0.2,0.2\n"0.02",-2e-1,.3\n',
        "t_s,u_V,y_rad,\n0.00,1.8,0.1,\n0.01,-0.2,0.2,\n0.02,-0.2,0.3,\n",
        "# by hand\n# " + PLAIN.replace(",", " "),  # as numpy writes names
        PLAIN.replace("y_rad\n", "y_rad\n(s),(V),(rad)\n"),
        "y_rad,other,t_s,u_V\n0.1,a,0,1.8\n0.2,,0.01,-0.2\n0.3,7,0.02,-0.2\n",
    ],
)
def test_forms_of_the_same_file(tmp_path: Path, text: str) -> None:
    recording, plain = parse(tmp_path, text), parse(tmp_path, PLAIN)
    for name in COLUMNS:
        assert np.array_equal(getattr(recording, name), getattr(plain, name), equal_nan=name != "stage")


def test_decimal_commas_are_said(tmp_path: Path) -> None:
    recording = parse(tmp_path, PLAIN.replace(",", ";").replace(".", ","))
    assert recording.notes == ("decimal commas were read as decimal points",)


def test_a_run_folder_has_it_all(tmp_path: Path) -> None:
    (tmp_path / "samples.csv").write_text(run_text(9))
    (tmp_path / "meta.json").write_text('{"backend": "simulated"}')
    (tmp_path / "config.yaml").write_text("name: demo\n")
    (tmp_path / "events.jsonl").write_text('{"t_s": 0.0, "kind": "stage"}\n{"t_s": 0.1, "kind": "limit"}\n')
    run = read(tmp_path)
    assert run.source == tmp_path
    assert run.columns_present == COLUMNS
    assert (run.meta, run.config_text) == (RunMeta(backend="simulated"), "name: demo\n")
    assert [event.kind for event in run.events] == ["stage", "limit"]
    assert run.stages() == ["breakaway", "relay-1", "relay-2"]
    assert run.stage_rows("relay-1") == slice(3, 6)
    assert run.y_counts[run.stage_rows("relay-2")].tolist() == [506, 507, 508]
    assert run.notes == ()


@pytest.mark.parametrize("back", [4, 1])
def test_a_run_whose_device_was_reset_is_read_up_to_there(tmp_path: Path, back: int) -> None:
    """Older runs recorded on, with a time that goes back or stands still; a CSV of one's own is refused."""
    lines = run_text(12).splitlines(keepends=True)
    text = "".join([*lines[:9], lines[9 - back], *lines[10:]])  # eight rows, then one of before
    (tmp_path / "samples.csv").write_text(text)
    run = read(tmp_path)
    assert len(run) == 8
    assert "line 10: t_s" in run.notes[0] and "4 rows are left out" in run.notes[0]
    with pytest.raises(RecordingError, match=r"goes back|repeats"):
        parse(tmp_path, text)
    (tmp_path / "samples.csv").write_text("".join([*lines[:3], lines[1], *lines[4:]]))  # nothing worth keeping
    with pytest.raises(RecordingError, match="goes back"):
        read(tmp_path)


def test_select_includes_both_ends(tmp_path: Path) -> None:
    (tmp_path / "samples.csv").write_text(run_text(9))
    run = read_run(tmp_path)
    part = run.select(2, 5)
    assert part.tick.tolist() == [4, 6, 8, 10]
    assert part.stage.tolist() == ["breakaway", "relay-1", "relay-1", "relay-1"]
    assert len(part) == 4
    for first, last in ((-1, 3), (4, 3), (0, 9)):
        with pytest.raises(IndexError):
            run.select(first, last)


def test_arrays_are_read_only(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="read-only"):
        parse(tmp_path, PLAIN).y_rad[0] = 0.0


def test_stages_missing_or_in_pieces_are_errors(tmp_path: Path) -> None:
    text = "t_s,u_V,y_rad,stage\n0,0,0,b\n1,0,0,a\n2,0,0,b\n"
    recording = parse(tmp_path, text)
    assert recording.stages() == ["b", "a"]
    assert recording.stage_rows("a") == slice(1, 2)
    with pytest.raises(RecordingError, match="no stage 'relay'; the stages there are: b, a"):
        recording.stage_rows("relay")
    with pytest.raises(RecordingError, match="interrupted by another"):
        recording.stage_rows("b")


# -- what a killed run leaves -----------------------------------------------------------------------------------------


def test_a_torn_last_line_is_left_out_and_noted_wherever_it_tears(tmp_path: Path) -> None:
    whole = run_text(6).encode()
    last = whole.rstrip(b"\n").rfind(b"\n") + 1
    for end in range(last, len(whole)):
        (tmp_path / "samples.csv").write_bytes(whole[:end])
        run = read_run(tmp_path)
        assert len(run) == 5
        torn = [note for note in run.notes if "torn" in note]
        assert torn == ([] if end == last else [f"line 7, the last, is torn and was left out ({end - last} bytes)"])


def test_zeros_after_a_power_cut_are_a_torn_line(tmp_path: Path) -> None:
    recording = parse(tmp_path, PLAIN.encode() + b"0.03,1" + bytes(500))
    assert len(recording) == 3
    assert "torn" in recording.notes[0]


def test_a_run_without_meta_and_with_a_torn_event_is_read(tmp_path: Path) -> None:
    (tmp_path / "samples.csv").write_text(run_text(6))
    (tmp_path / "events.jsonl").write_text('{"t_s": 0.0, "kind": "stage"}\n{"t_s": 0.')
    run = read_run(tmp_path)
    assert len(run.events) == 1
    assert run.notes == ("meta.json is missing", "events.jsonl: line 2, the last, is torn and was left out (10 bytes)")


@pytest.mark.parametrize(("end", "name"), [('"order"', "demo"), ('"emulated"', "demo"), ('"name"', "")])
def test_a_meta_json_that_ends_early_is_read_as_far_as_its_keys_are_whole(tmp_path: Path, end: str, name: str) -> None:
    (tmp_path / "samples.csv").write_text(run_text(6))
    whole = '{\n  "schema": 1,\n  "name": "demo",\n  "host": {\n    "os": "x"\n  },\n  "emulated": true,\n'
    whole += '  "order": "a"\n}\n'
    (tmp_path / "meta.json").write_text(whole[: whole.index(end) + 5])
    run = read_run(tmp_path)
    assert run.meta.name == name
    assert "meta.json: ends early; rig reads what is there" in run.notes
    with pytest.raises(RecordingError, match="is broken JSON"):
        read_run(tmp_path, strict=True)


# -- what is refused --------------------------------------------------------------------------------------------------

ROWS = "0,1,0.1\n1,1,0.2\n2,1,0.3\n"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", None, "is empty"),
        ("\n\n", None, "holds no rows"),
        ("t_s,u_V,y_rad", None, "holds no rows"),
        ("t_s,u_V,y_rad\n0,1,2\n1,1,2\n", 1, "has 2 rows; record at least 22"),
        ("time,u_V,position\n" + ROWS, 1, "no column t_s, y_rad.*did you mean 'time' for t_s, 'position' for y_rad"),
        ("T_S,u_v,y_rads\n" + ROWS, 1, "did you mean 'T_S' for t_s, 'u_v' for u_V, 'y_rads' for y_rad"),
        ("a,b,c\n" + ROWS, 1, "no column t_s, u_V, y_rad; there are: 'a', 'b', 'c'"),
        (ROWS, 1, "no column names"),
        ("# made,by,hand\n" + ROWS, 2, "no column names"),
        ("t_s,u_V,y_rad,u_V\n0,1,2,3\n1,1,2,3\n2,1,2,3\n", 1, "column u_V twice"),
        ("t_s,u_V,y_rad\n0,1,0.1\n1,1\n2,1,0.3\n", 3, "the line has 2 fields, and the header 3"),
        ("t_s,u_V,y_rad\n0,1\n1,1\n2,1\n", 2, "so has every line: take the names without a column out of line 1"),
        ("t_s,u_V,y_rad\n0,1,0.1\n1,1,0.2,5\n2,1,0.3\n", 3, "the line has 4 fields, and the header 3"),
        ("t_s,u_V,y_rad\n0,1,0.1\n1,x1,0.2\n2,1,0.3\n", 3, "column u_V: 'x1' is not a number"),
        ("t_s,u_V,y_rad\n0,1,0.1\n1,1_0,0.2\n2,1,0.3\n", 3, "'1_0' is not a number"),
        ("t_s,u_V,y_rad\n0,1,0.1\n1,1,nan\n2,1,0.3\n", 3, "y_rad: 'nan' is not a finite number"),
        ("t_s,u_V,y_rad\n0,1,0.1\n1,1e999,2\n2,1,0.3\n", 3, "u_V: '1e999' is not a finite number"),
        ("t_s,u_V,y_rad\n0,1,0.1\n,1,0.2\n2,1,0.3\n", 3, "t_s: is empty; fill it in"),
        ("t_s;u_V;y_rad\n0;1;0,1\n1;1.5;0,2\n2;1;0,3\n", 2, "'0,1' is not a number; use a decimal point"),
        ("t_s;u_V;y_rad\n0,0;1;2\n1,0;1;1,2,3\n2;1;3\n", 3, "'1.2.3' is not a number"),
        ("t_s u_V y_rad\n0 1 0.1\n1 1\n2 1 0.3\n", 3, "the line has 2 fields, and the header 3"),
        ("t_s,u_V,y_rad\n0,1,0,1\n1,1,0,2\n2,1,0,3\n", 2, "the line has 4 fields, and the header 3"),
        ("t_s,u_V,y_rad\ns,V,deg\n0,1,0.1\n1,1,0.2\n2,1,0.3\n", 2, "'deg', by.*type --position y_rad:deg"),
        ("t_s,u_V,y_rad\nnow,1,0.1\n1,1,0.2\n2,1,0.3\n", 2, "column t_s: 'now' is not a number"),
        (
            "t u y_deg\n" + ROWS.replace(",", " "),
            1,
            "such as --time t:UNIT --drive u:UNIT --position deg, with the column's own unit for UNIT: of time s,"
            " ms, us or ns, of drive V, mV, .* or percent$",
        ),
        ("time_ms,voltage_mV,angle_deg\n" + ROWS, 1, "--time ms --drive mV --position deg$"),
        (
            "millis,pwm,count\n" + ROWS,
            1,
            "--time ms --drive pwm --position counts; of pwm also --full 255 --supply-V 12",
        ),
        ("t_s,u_V,rpm\n" + ROWS, 1, "--velocity rpm$"),
        (b"\x1f\x8b\x08\x00rest", None, "gzip.*gunzip"),
        (b"PK\x03\x04rest\n", None, "Excel workbook"),
        ("t_s,u_V,y_rad\n0,1,0.1\n\n# c\n0,1,0.2\n2,1,0.3\n", 5, "repeats the time"),
        ("t_s,u_V,y_rad\n0,1,0.1\n3,1,0.2\n2,1,0.3\n", 4, r"goes back in time \(t_s = 2 after 3\)"),
        ("t_s,u_V,y_rad,flags\n0,1,2,0\n1,1,2,0.5\n2,1,2,0\n", 3, "flags: '0.5' is not an integer"),
        ("t_s,u_V,y_rad,t_u_s\n0,1,2,\n1,1,2,inf\n2,1,2,0\n", 3, "t_u_s: 'inf' is not a finite number"),
        ("t_s,u_V,y_rad,stage\n0,1,2,a\n1,1,2," + 99 * "a" + "\n2,1,2,a\n", 3, "stage: a name of 99 characters"),
        ('t_s,u_V,y_rad\n0,1,0.1\n1,"1,2\n2,1,0.3\n', 3, "broken quotes"),
        (b"t_s,u_V,y_rad\n0,1,0.1\n1,\xff,2\n2,1,0.3\n", 3, "'ÿ' is not a number"),
        (PLAIN.encode("utf-16-le"), 1, "binary"),
        (b"\x7fELF\0\0\0\n1\n", 1, "binary"),
    ],
)
def test_a_broken_file_is_an_error_with_line_and_cure(
    tmp_path: Path, text: str | bytes, line: int | None, words: str
) -> None:
    path = csv_file(tmp_path, text)
    with pytest.raises(RecordingError, match=words) as caught:
        read(path)
    assert (caught.value.path, caught.value.line) == (path, line)
    assert caught.value.cure
    assert "\n" not in str(caught.value)


def test_things_that_are_no_file(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is not there"):
        read(tmp_path / "gone.csv")
    with pytest.raises(RecordingError, match="not a file"):
        read(Path("/dev/zero"))
    with pytest.raises(RecordingError, match="is not there"):
        read(Path("a\0b"))
    with pytest.raises(RecordingError, match="cannot be read"):
        read(tmp_path / ("x" * 5000))
    with pytest.raises(RecordingError, match="is a folder without a run"):
        read(tmp_path)
    with pytest.raises(RecordingError, match="is a CSV file, not a run folder"):
        read_run(csv_file(tmp_path, PLAIN))


def test_a_huge_file_is_refused_without_being_parsed(tmp_path: Path) -> None:
    path = csv_file(tmp_path, PLAIN)
    with path.open("r+b") as file:
        file.truncate(MAX_BYTES + 1)  # a hole: takes no disk
    with pytest.raises(RecordingError, match="larger than 256 MiB"):
        read(path)


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("meta.json", '{\n"a": nan}', 2),
        ("meta.json", '{"a": NaN}', 1),
        ("meta.json", "[1]", None),
        ("meta.json", "[" * 100_000, None),
        ("events.jsonl", '{"a": 1}\nbroken\n', 2),
        ("events.jsonl", '{"a": 1}\n3\n', 2),
        ("config.yaml", b"\xff", 1),
    ],
)
def test_broken_small_files_are_errors_too(tmp_path: Path, name: str, text: str | bytes, line: int | None) -> None:
    (tmp_path / "samples.csv").write_text(run_text(6))
    (tmp_path / name).write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(RecordingError) as caught:
        read_run(tmp_path)
    assert (caught.value.path, caught.value.line) == (tmp_path / name, line)


# -- nothing else comes out -------------------------------------------------------------------------------------------


@st.composite
def damaged_files(draw: st.DrawFn) -> bytes:
    """A good file with bytes cut, doubled or replaced: deeper into the parser than noise would get."""
    content = bytearray(
        draw(
            st.sampled_from(
                [
                    PLAIN,
                    PLAIN.replace(",", ";").replace(".", ","),
                    run_text(5),
                    PLAIN.replace(",", " "),
                    '"t_s",u_V,y_rad\n' + ROWS,
                ]
            )
        ),
        "utf-8",
    )
    pieces = st.one_of(
        st.binary(max_size=4),
        st.sampled_from(
            [b",", b"\n", b'"', b"\r", b"nan", b"inf", b"#", b"_", b"1e308", b"\0", b"\x0b", b"-", b"\xe2\x80\xa8"]
        ),
    )
    for _ in range(draw(st.integers(1, 5))):
        start = draw(st.integers(0, len(content)))
        end = start + draw(st.integers(0, 3))
        content[start:end] = draw(pieces)
    return bytes(content)


@settings(
    max_examples=examples(600),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(content=st.one_of(damaged_files(), st.binary(max_size=200)))
@example(b't_s,u_V,y_rad\n0,"1\r2",0\n1,1,1\n2,1,1\n')
@example(b"t_s,u_V,y_rad\n-1e308,0,0\n1e308,0,0\n1.5e308,0,0\n")
@example(b"t_s,u_V,y_rad\n\x0b\n" + ROWS.encode())
@example(b"\xef\xbb\xbf\n")
def test_any_bytes_give_a_recording_or_a_recording_error(tmp_path: Path, content: bytes) -> None:
    path = csv_file(tmp_path, content)
    try:
        recording = read(path)
    except RecordingError as error:
        assert error.path == path
        assert error.line is None or 1 <= error.line <= content.count(b"\n") + 1
        return
    assert len(recording) >= 3
    assert (recording.t_s[1:] > recording.t_s[:-1]).all()
    for name in ("t_s", "u_V", "y_rad"):
        assert np.isfinite(getattr(recording, name)).all()
    for name in COLUMNS:
        assert len(getattr(recording, name)) == len(recording)


@settings(
    max_examples=examples(200),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    content=st.one_of(
        st.binary(max_size=80),
        st.recursive(st.none() | st.floats() | st.text(), st.lists).map(lambda v: json.dumps(v).encode()),
    )
)
def test_any_bytes_as_small_files_likewise(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "samples.csv").write_text(run_text(6))
    for name in ("meta.json", "events.jsonl", "config.yaml"):
        (tmp_path / name).write_bytes(content)
        try:
            read_run(tmp_path)
        except RecordingError as error:
            assert error.path == tmp_path / name
        (tmp_path / name).unlink()


@settings(
    max_examples=examples(200),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(values=st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 2), min_size=3, max_size=20))
def test_every_double_is_read_back_exactly(tmp_path: Path, values: list[tuple[float, float]]) -> None:
    nan = math.nan
    rows = (
        format_row(SampleRow(k, k, 0.01 * k, nan, y_rad, 0, nan, u_V, 0.0, nan, "a", 0.0, 0.0, 0))
        for k, (y_rad, u_V) in enumerate(values)
    )
    recording = parse(tmp_path, HEADER + "".join(rows))
    assert list(zip(recording.y_rad.tolist(), recording.u_V.tolist(), strict=True)) == values


def test_reading_costs_little_more_than_the_numbers_themselves(tmp_path: Path) -> None:
    text = run_text(20_000)
    path = csv_file(tmp_path, text)

    def best_s(work: Callable[[], object]) -> float:
        times = []
        for _ in range(3):
            begin = time.process_time()
            work()
            times.append(time.process_time() - begin)
        return min(times)

    fields = [field for field in text.replace("\n", ",").split(",") if field]
    bare_s = best_s(lambda: [float(field) for field in fields if field[0].isdigit()])
    assert best_s(lambda: read(path)) < 20 * bare_s


@pytest.mark.parametrize(("before", "after"), [(6, 6), (6, 9), (3, 9000)])
def test_rows_that_were_read_before_are_not_parsed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: int, after: int
) -> None:
    """A run that goes on: what is read is what reading all of it anew gives, and each row is parsed once."""
    lines = run_text(after).splitlines(keepends=True)
    path = csv_file(tmp_path, "".join(lines[: before + 1]))
    known = read_csv(path)
    path.write_text("".join(lines))
    whole = read_csv(path)
    parsed: list[int] = []
    parse_rows = csv_table._parse_rows

    def counted(table: csv_table.CsvTable, numbers: Sequence[int]) -> dict[str, np.ndarray]:
        parsed.extend(numbers)
        return parse_rows(table, numbers)

    monkeypatch.setattr(csv_table, "_parse_rows", counted)
    again = read_csv(path, known=known)
    assert len(parsed) == after - before
    for name in COLUMNS:
        assert np.array_equal(getattr(again, name), getattr(whole, name), equal_nan=name not in ("stage",))
        assert not getattr(again, name).flags.writeable


def test_a_reading_of_another_file_is_no_use(tmp_path: Path) -> None:
    known = read_csv(csv_file(tmp_path, run_text(9)))
    assert read_csv(csv_file(tmp_path, run_text(6)), known=known).t_s.size == 6
    assert read_csv(csv_file(tmp_path, PLAIN), known=known).y_rad.tolist() == [0.1, 0.2, 0.3]
