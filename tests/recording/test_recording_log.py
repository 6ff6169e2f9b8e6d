"""A log of one's own: any columns and units; what cannot be read is an error with line and what to type."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import LogColumn, LogFormat, LogFormatError
from rig.run_folder.recording.log_mends import summed_up
from rig.run_folder.recording.reader import read
from rig.run_folder.recording.recording import Recording

TURN = 2.0 * math.pi
COUNTED = LogFormat(LogColumn("ms"), LogColumn("pwm"), LogColumn("counts"), counts_per_turn=1440, full=255, supply_V=12)
ROWS = "0,255,0\n10,-51,360\n20,0,720\n"
LONGER = "".join(f"{10 * k},{(-1) ** k * 255},{k}\n" for k in range(30))
NAMED = f"millis,pwm,counts\n{ROWS}"


def parse(folder: Path, text: str, log: LogFormat = COUNTED) -> Recording:
    path = folder / "log.csv"
    path.write_text(text)
    return read(path, log)


@pytest.mark.parametrize(
    "text",
    [
        NAMED,
        ROWS,
        ROWS.replace(",", " "),
        ROWS.replace(",", ";"),
        f"pm,255\n{ROWS}",  # a capture that began within a line
        f"# made by hand\n{ROWS}",
        f"# millis pwm counts\n{ROWS}",
        f"time,duty,position\n[ms],[pwm],[counts]\n{ROWS}",  # the row of units is right
        f"# my bench\nTime (ms),Motor PWM,Encoder counts\n{ROWS}",
        f"{NAMED.splitlines()[0]}\n# motor test 3\nms,-,-\n{ROWS}",  # as many words as there are columns
        "counts,other,pwm,t\n0,a,255,0\n360,b,-51,10\n720,,0,20\n",
        "Lage,andere,Spannung,Zeit\n0,a,255,0\n360,b,-51,10\n720,,0,20\n",
        "current,speed,ms,pwm,counts\n9,9,0,255,0\n9,9,10,-51,360\n9,9,20,0,720\n",
    ],
)
def test_columns_by_their_usual_names_or_their_order(tmp_path: Path, text: str) -> None:
    recording = parse(tmp_path, text)
    assert recording.t_s.tolist() == [0.0, 0.01, 0.02]
    assert recording.u_V.tolist() == pytest.approx([12.0, -2.4, 0.0])
    assert recording.y_rad.tolist() == pytest.approx([0.0, 0.25 * TURN, 0.5 * TURN])
    assert recording.units_stated
    assert any("(255 is 12 V)" in note and "(1440 a turn)" in note for note in recording.notes)


@pytest.mark.parametrize(
    "head", ["# time a b", "# time\ta\tb", "my bench,a,b\n# time a b", "# one two three\n# time a b"]
)
def test_names_behind_a_sign_of_a_remark_stand_apart_as_they_like(tmp_path: Path, head: str) -> None:
    """A header of numpy has blanks where the rows have commas; with one usual name it was refused."""
    named = (LogColumn("ms", "time"), LogColumn("pwm", "a"), LogColumn("counts", "b"))
    log = LogFormat(*named, counts_per_turn=1440, full=255, supply_V=12)
    assert parse(tmp_path, f"{head}\n{ROWS}", log).y_rad[2] == pytest.approx(0.5 * TURN)
    below = parse(tmp_path, f"time,a,b\n# motor test 3\n{ROWS}", log)
    assert below.y_rad[2] == pytest.approx(0.5 * TURN)


@pytest.mark.parametrize(
    ("time", "drive", "position"),
    [("a:ms", "b:pwm", "c:counts"), ("1:ms", "2:pwm", "3:counts"), ("ms", "2:pwm", "c:counts")],
)
def test_columns_by_name_and_by_number(tmp_path: Path, time: str, drive: str, position: str) -> None:
    log = LogFormat(
        LogColumn.parse("time", time),
        LogColumn.parse("drive", drive),
        LogColumn.parse("position", position),
        counts_per_turn=1440,
        full=255,
        supply_V=12,
    )
    first = "a" if ":" in time else "t"
    assert parse(tmp_path, f"{first},b,c\n{ROWS}", log).y_rad[2] == pytest.approx(0.5 * TURN)


@pytest.mark.parametrize(
    ("log", "u_V", "y_rad"),
    [
        (LogFormat(LogColumn("s"), LogColumn("V"), LogColumn("rad")), 0.5, 0.25),
        (LogFormat(LogColumn("s"), LogColumn("mV"), LogColumn("deg")), 0.0005, math.radians(0.25)),
        (LogFormat(LogColumn("s"), LogColumn("duty"), LogColumn("turns"), supply_V=10), 5.0, 0.25 * TURN),
        (LogFormat(LogColumn("s"), LogColumn("percent"), LogColumn("rad"), supply_V=10, reversed=True), 0.05, -0.25),
    ],
)
def test_units(tmp_path: Path, log: LogFormat, u_V: float, y_rad: float) -> None:
    recording = parse(tmp_path, "0,0.5,0.25\n1,0,0\n2,0,0\n", log)
    assert (recording.t_s[1], recording.u_V[0], recording.y_rad[0]) == pytest.approx((1.0, u_V, y_rad))


def test_a_column_that_says_which_way_gives_the_drive_its_sign(tmp_path: Path) -> None:
    for back, forth in (
        ("0", "1"),
        ("-1", "1"),
        ("REV", "FWD"),
        ("backward", "forward"),
        ("CCW", "CW"),
        ("LOW", "HIGH"),
        ("-", "+"),
        ("0.0", "1"),
    ):
        rows = "".join(f"{10 * k},{9 + k},{k},{forth if k % 2 else back}\n" for k in range(4))
        log = LogFormat(LogColumn("ms"), LogColumn("V"), LogColumn("rad"), direction="way")
        assert parse(tmp_path, f"t,u,y,way\n{rows}", log).u_V.tolist() == [-9.0, 10.0, -11.0, 12.0]
    with pytest.raises(RecordingError, match="column 'y' says 4 things, such as '0', '1', '2'"):
        parse(tmp_path, f"t,u,y,way\n{rows}", replace(log, direction="y"))


def test_a_log_of_one_way_has_one_direction_and_what_it_says_at_no_drive_says_nothing(tmp_path: Path) -> None:
    """Files of one way each were refused, and N at rest was the positive way."""
    log = LogFormat(LogColumn("ms"), LogColumn("V"), LogColumn("rad"), direction="way")
    for word, way in (("R", -1.0), ("ccw", -1.0), ("-1", -1.0), ("F", 1.0), ("cw", 1.0), ("1", 1.0)):
        rows = f"t,u,y,way\n0,0,0,N\n10,9,0,{word}\n20,8,1,{word}\n30,0,2,N\n"
        assert parse(tmp_path, rows, log).u_V.tolist() == [0.0, way * 9.0, way * 8.0, 0.0]
    with pytest.raises(RecordingError, match="column 'way' says 1 things, such as '0'"):
        parse(tmp_path, "t,u,y,way\n0,9,0,0\n10,9,0,0\n20,8,1,0\n", log)


def test_a_drive_with_a_sign_of_its_own_agrees_with_the_column_of_directions_or_is_refused(tmp_path: Path) -> None:
    """Its sign was dropped: under a column that came late K was 20 % off beside 17 %."""
    log = LogFormat(LogColumn("ms"), LogColumn("V"), LogColumn("rad"), direction="way")
    rows = "t,u,y,way\n0,9,0,1\n10,-9,1,0\n20,8,2,1\n30,-0.1,3,1\n"
    assert parse(tmp_path, rows, log).u_V.tolist() == [9.0, -9.0, 8.0, 0.1]
    with pytest.raises(RecordingError, match=r":3: the drive has a sign of its own.*leave --direction out"):
        parse(tmp_path, rows.replace("-9,1,0", "-9,1,1").replace("-0.1,3,1", "-1,3,0"), log)


def test_a_direction_that_is_not_said_is_as_it_was_in_a_log_of_changes_and_else_refused(tmp_path: Path) -> None:
    """An empty field once was a direction of its own: with 0 and 1 the drive was 0 wherever a column said 0."""
    log = LogFormat(LogColumn("ms"), LogColumn("V"), LogColumn("rad"), direction="way")
    changes = parse(tmp_path, "t,u,y,way\n0,9,0,1\n10,,1,\n20,,2,\n30,8,3,0\n40,,4,\n50,,5,\n60,,6,\n", log)
    assert changes.u_V.tolist() == [9.0, 9.0, 9.0, -8.0, -8.0, -8.0, -8.0]
    with pytest.raises(RecordingError, match=r":3: column way: is empty"):
        parse(tmp_path, "t,u,y,way\n0,9,0,1\n10,9,1,\n20,9,2,0\n30,9,3,0\n", log)


def test_a_unit_that_is_left_out_is_that_of_samples_csv(tmp_path: Path) -> None:
    log = LogFormat(position=LogColumn("deg"))
    recording = parse(tmp_path, "t_s,u_V,angle\n0,1,0\n1,1,180\n2,1,90\n", log)
    assert recording.y_rad.tolist() == pytest.approx([0.0, math.pi, 0.5 * math.pi])
    with pytest.raises(
        RecordingError, match=r"no column t_s; there are: 't', 'u_V', 'angle'.*--time t:UNIT.*s, ms, us"
    ):
        parse(tmp_path, "t,u_V,angle\n0,1,0\n1,1,180\n2,1,90\n", log)


def test_what_the_link_still_held_of_another_run_is_left_out(tmp_path: Path) -> None:
    """Of a published log it is the first row: 1.074 s, then 0.008 s."""
    log = LogFormat(LogColumn("s"), LogColumn("V"), LogColumn("rad"))
    rows = "".join(f"{0.008 + 0.01 * k:.3f},1,{k}\n" for k in range(40))
    recording = parse(tmp_path, f"1.074,0,9\n{rows}", log)
    assert recording.y_rad.tolist() == list(range(40))
    assert any("1 rows before it were left out" in note for note in recording.notes)


def test_a_velocity_from_a_counter_gives_back_its_counts(tmp_path: Path) -> None:
    """Differences of counts over time, as a sketch has them, rounded, with rows that come at uneven times."""
    rng = np.random.default_rng(2)
    t_ms = np.cumsum(rng.integers(8, 13, 60))
    counts = np.cumsum(rng.integers(-3, 6, 60))
    rpm = np.diff(counts, prepend=counts[0]) / np.diff(t_ms, prepend=t_ms[0] - 10) * 60e3 / 1440
    log = LogFormat(LogColumn("ms"), LogColumn("pwm"), velocity=LogColumn("rpm"), full=255, supply_V=12)
    recording = parse(tmp_path, "".join(f"{t},1,{v:.1f}\n" for t, v in zip(t_ms, rpm, strict=True)), log)
    assert recording.y_rad == pytest.approx((counts - counts[0]) * TURN / 1440, abs=0.1 * TURN / 1440)
    assert any("the mean since the row before" in note for note in recording.notes)


def test_a_velocity_that_is_rounded_nearly_as_coarsely_as_its_counter_steps_gives_back_its_counts(
    tmp_path: Path,
) -> None:
    """As published: steps of 0.128 rpm to one decimal. It was a tachometer's, and each row the mean of two."""
    t_s = 0.1 * np.arange(400)
    rpm = 26.0 + 24.0 * np.sin(t_s) + np.random.default_rng(3).normal(size=t_s.size)
    counts = np.floor(np.cumsum(rpm) * 0.1 * 4704 / 60)
    log = LogFormat(LogColumn("s"), LogColumn("V"), velocity=LogColumn("rpm"))
    said = np.diff(counts, prepend=0.0) * 60 / 0.1 / 4704
    recording = parse(tmp_path, "".join(f"{t:.1f},1,{v:.1f}\n" for t, v in zip(t_s, said, strict=True)), log)
    assert recording.y_rad - recording.y_rad[0] == pytest.approx((counts - counts[0]) * TURN / 4704, abs=0.01)


def test_steps_of_a_counter_are_looked_for_no_longer_in_a_long_log() -> None:
    """Of 20,000 noisy rows it took 53 s of CPU, before any fit."""
    rng = np.random.default_rng(3)
    t_s = np.cumsum(0.01 + rng.uniform(0.0, 1e-3, 20_000))
    v_rad_s = np.round(1000.0 * np.sin(t_s) + 10.0 * rng.normal(size=t_s.size)) * TURN / 60
    times = []
    for rows in (1000, 20_000):
        begin = time.process_time()
        assert summed_up(v_rad_s[:rows], t_s[:rows], [], TURN / 120).adds_up
        times.append(time.process_time() - begin)
    assert times[1] < 6.0 * times[0]


@pytest.mark.parametrize(
    ("option", "log"), [("direction", replace(COUNTED, direction="way")), ("run", replace(COUNTED, run="way"))]
)
def test_a_column_without_a_unit_that_is_not_there_or_is_there_twice_is_told_how_to_name(
    tmp_path: Path, option: str, log: LogFormat
) -> None:
    with pytest.raises(RecordingError, match=rf"no column way; .* for example --{option} millis$"):
        parse(tmp_path, NAMED, log)
    twice = NAMED.replace("\n", ",1,1\n").replace("counts,1,1", "counts,way,way")
    with pytest.raises(RecordingError, match=rf"column way twice; number it: --{option} 1$"):
        parse(tmp_path, twice, log)


@pytest.mark.filterwarnings("error")
def test_velocities_of_few_rows_are_summed() -> None:
    assert summed_up(np.array([0.3]), np.array([0.0]), []).y_rad.tolist() == [0.0]


def test_samples_of_a_velocity_change_evenly_in_between(tmp_path: Path) -> None:
    t_s = 0.01 * np.arange(60)
    log = LogFormat(LogColumn("s"), LogColumn("V"), velocity=LogColumn("rad/s"))
    recording = parse(tmp_path, "".join(f"{t:.2f},1,{3.1 * t + 0.7}\n" for t in t_s), log)
    assert recording.y_rad == pytest.approx(0.5 * 3.1 * t_s**2 + 0.7 * t_s)
    assert any("as of a tachometer" in note for note in recording.notes)


def test_a_clock_and_a_counter_that_wrap_go_on(tmp_path: Path) -> None:
    log = LogFormat(LogColumn("us"), LogColumn("V"), LogColumn("counts"), counts_per_turn=65536)
    recording = parse(tmp_path, "4294960000,1,32000\n4294967000,1,32767\n6704,1,-32768\n13704,1,-32000\n", log)
    assert np.diff(recording.t_s).tolist() == pytest.approx([0.007, 0.007, 0.007])
    assert recording.y_rad[-1] == pytest.approx(33536 / 65536 * TURN)
    assert sum("wrapped" in note or "begins anew" in note for note in recording.notes) == 2


def test_an_angle_within_one_turn_goes_on(tmp_path: Path) -> None:
    log = LogFormat(LogColumn("s"), LogColumn("V"), LogColumn("deg"))
    recording = parse(tmp_path, "0,1,350\n1,1,359\n2,1,8\n3,1,355\n", log)
    assert np.degrees(recording.y_rad).tolist() == pytest.approx([350.0, 359.0, 368.0, 355.0])
    assert any("within one turn" in note for note in recording.notes)
    far = parse(tmp_path, "0,1,350\n1,1,359\n2,1,8\n3,1,900\n", log)
    assert np.degrees(far.y_rad).tolist() == pytest.approx([350.0, 359.0, 8.0, 900.0])


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (
            "x,pwm,counts\n" + ROWS,
            1,
            r"no column is called like a time; there are: 'x', 'pwm', 'counts'; type --period 10ms.*--time x:UNIT",
        ),
        ("t,millis,pwm,counts\n0,0,1,1\n1,1,1,1\n2,2,1,1\n", 1, "several columns may be the time: 't', 'millis'"),
        ("0,1\n1,1\n2,1\n", 1, "has 2 columns, and time, drive, position are 3; add what is missing"),
        ("0,1,2,3\n1,1,2,3\n2,1,2,3\n", 1, r"4 columns without names; number them from 1: --time 1:ms --drive 2:pwm"),
        (NAMED.replace("360", "36x"), 3, "column counts: '36x' is not a number; correct or delete this line"),
        (ROWS.replace("360", "36x"), 2, "column 3: '36x' is not a number"),
        (ROWS.replace("-51,360", "360"), 2, "the line has 2 fields, and the first line 3"),
        (NAMED.replace("-51,360", "360"), 3, "the line has 2 fields, and the header 3"),
        (NAMED.replace("10,", "0,"), 3, "repeats the time"),
        (NAMED.replace("360", "1e300"), 3, "column counts: 1e.300 is too large"),
        ("millis,pwm,counts\n0,1,2\n1,1,2\n", 1, "has 2 rows"),
        ("millis,pwm,counts,counts\n0,1,2,2\n1,1,2,2\n2,1,2,2\n", 1, "several columns may be the position"),
    ],
)
def test_a_broken_log_is_an_error_with_line_and_what_to_type(tmp_path: Path, text: str, line: int, words: str) -> None:
    with pytest.raises(RecordingError, match=words) as caught:
        parse(tmp_path, text)
    assert caught.value.line == line
    assert "\n" not in str(caught.value)


def test_a_column_that_is_not_there_and_one_that_is_taken_twice(tmp_path: Path) -> None:
    three = LogFormat(LogColumn("s", "7"), LogColumn("V", "2"), LogColumn("rad", "3"))
    with pytest.raises(RecordingError, match="no column 7; it has 3, without names"):
        parse(tmp_path, ROWS, three)
    twice = LogFormat(LogColumn("s", "a"), LogColumn("V", "b"), LogColumn("rad", "b"))
    with pytest.raises(RecordingError, match="'b' is both drive and position"):
        parse(tmp_path, "a,b,c\n" + ROWS, twice)


@pytest.mark.parametrize(
    ("text", "log", "cause", "cure"),
    [
        (
            NAMED,
            replace(COUNTED, time=LogColumn("us")),
            "column 'millis' sounds like ms, and --time says us",
            "type --time ms; or",
        ),
        (
            NAMED,
            LogFormat(LogColumn("ms"), LogColumn("V"), LogColumn("rad")),
            "column 'pwm' sounds like pwm",
            "if it is in V: --drive pwm:V",
        ),
        (
            NAMED.replace("\n", "\n(us),(pwm),(counts)\n", 1),
            COUNTED,
            "column 'millis' is in us, by the row of units, and --time says ms",
            "type --time us",
        ),
        (
            NAMED,
            LogFormat(LogColumn("ms"), LogColumn("V", "pwm"), LogColumn("rad")),
            "column 'counts' sounds like counts",
            "type --position counts",
        ),
        (
            NAMED.replace("pwm,counts", 'pwm,"angle of the wheel, deg"'),
            COUNTED,
            "column 'angle of the wheel, deg' sounds like deg",
            "if it is in counts: --position 'angle of the wheel, deg:counts'",
        ),
        (LONGER, replace(COUNTED, time=LogColumn("s")), "in s its samples are 10 s apart", "type --time ms"),
        (LONGER, replace(COUNTED, time=LogColumn("us")), "in us its samples are 1e-05 s apart", "type --time ms"),
        ("255,0,0\n-51,10,360\n0,20,720\n", COUNTED, "goes back in time", "--time 1:ms --drive 2:pwm --position 3:"),
    ],
)
def test_a_unit_that_cannot_be_is_an_error_with_what_to_type(
    tmp_path: Path, text: str, log: LogFormat, cause: str, cure: str
) -> None:
    with pytest.raises(RecordingError) as refused:
        parse(tmp_path, text, log)
    assert cause in refused.value.cause and cure in refused.value.cure


def test_a_column_that_is_named_may_have_any_unit(tmp_path: Path) -> None:
    log = LogFormat(LogColumn("ms"), LogColumn("V", "pwm"), LogColumn("rad", "counts"))
    assert parse(tmp_path, NAMED, log).u_V.tolist() == [255.0, -51.0, 0.0]


def test_a_run_folder_has_its_own_columns(tmp_path: Path) -> None:
    (tmp_path / "samples.csv").write_text("t_s,u_V,y_rad\n" + ROWS)
    with pytest.raises(RecordingError, match="is a run folder"):
        read(tmp_path, COUNTED)


def test_a_format_that_cannot_be_says_what_to_type() -> None:
    for quantity, text, words in (
        ("time", "min", "'min' is no unit of time"),
        ("drive", "pwm:volts", "give one of V, mV, pwm, duty, percent"),
        ("position", ":deg", "names no column"),
        ("time", "ms:1", "column comes first, then its unit\ntype --time 1:ms"),
        ("velocity", "rpm:12", "column comes first, then its unit\ntype --velocity 12:rpm"),
    ):
        with pytest.raises(LogFormatError, match=words):
            LogColumn.parse(quantity, text)
    counts, pwm = LogColumn("counts"), LogColumn("pwm")
    cannot: tuple[tuple[dict[str, Any], str], ...] = (
        ({"position": counts}, "needs --counts-per-turn.*--counts-per-turn 1440"),
        ({"drive": pwm, "supply_V": 12}, "needs --full"),
        ({"drive": pwm, "full": 255}, "needs --supply-V"),
        (
            {"drive": pwm, "position": counts},
            "counts and pwm needs .*: --counts-per-turn 1440 --full 255 --supply-V 12",
        ),
        ({"full": 255}, "--full is for pwm, and this log has V"),
        ({"drive": pwm, "full": 0, "supply_V": 12}, "--full 0 is not above 0"),
        ({"position": counts, "velocity": LogColumn("rpm"), "counts_per_turn": 4}, "both given"),
    )
    for given, words in cannot:
        with pytest.raises(LogFormatError, match=f"(?s){words}"):
            LogFormat(**given)
