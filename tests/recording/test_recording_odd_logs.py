"""Odd logs: each is read, or refused with a cause, and with options that then read it when typed."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path
from typing import Final

import click
import numpy as np
import pytest
from click.testing import CliRunner

from rig.cli.log_options import log_options
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import LogFormat, units_said
from rig.run_folder.recording.reader import read
from rig.run_folder.recording.recording import Recording

T_S: Final = 0.01 * np.arange(30)
U_V: Final = np.where(np.arange(30) // 5 % 2, -1.5, 1.5)
Y_RAD: Final = 0.25 * np.sin(20.0 * T_S) + 0.1


def log(names: str, mark: str = ",", row: str = "{t:.2f}{m}{u}{m}{y:.4f}", end: str = "\n") -> str:
    """A log of this motion, below these names; ``row`` may take t, u, y, the mark between columns and the number k."""
    rows = [row.format(t=t, u=u, y=y, m=mark, k=k) for k, (t, u, y) in enumerate(zip(T_S, U_V, Y_RAD, strict=True))]
    return end.join([*([names] if names else []), *rows, ""])


@click.command()
@click.argument("path", type=click.Path(path_type=Path))
@log_options
def reading(path: Path, log: LogFormat | None) -> None:
    """Read a log with the options of a log, as `rig identify` does."""
    recording = read(path, log)
    assert len(recording) == 30


def test_logs_that_are_read_as_they_are(tmp_path: Path) -> None:
    decimal = log("t_s;u_V;y_rad", ";").replace(".", ",")
    for text in (
        log("t_s|u_V|y_rad", "|"),
        "\ufeff" + log("t_s,u_V,y_rad", end="\r\n"),
        log('"t_s","u_V","y_rad"', row='"{t:.2f}","{u}","{y:.4f}"'),
        log("t_s,u_V,y_rad", row="{t:.2f},{u},{y:.4f},"),
        log("t_s;u_V;y_rad;", ";", row="{t:.2f};{u};{y:.4f};"),
        decimal,
        decimal.replace(";", "|"),
        log("t_s,u_V,y_rad", row='"{t:.2f}";"{u}";"{y:.4f}"').replace(".", ",").replace(";", ","),
        log("t_s,u_V,y_rad").replace("\n0.10", "\n\n\n0.10"),
        "sep=;\n" + log("t_s;u_V;y_rad", ";"),
        log("t_s,u_V,y_rad\n(s),(V),(rad)"),
        log("t_s,u_V,y_rad").replace("-", "\N{MINUS SIGN}"),
        log("t_s,u_V,y_rad", row="({t:.2f}, {u}, {y:.4f})"),
        log("t_s,u_V,y_rad", row="[{t:.2f}, {u}, {y:.4f}],"),
        log("t_s u_V y_rad", " ", row=" [{t:.2f}  {u}  {y:.4f}]"),
    ):
        path = tmp_path / "log.csv"
        path.write_text(text, newline="")
        recording = read(path)
        assert recording.t_s == pytest.approx(T_S) and recording.u_V == pytest.approx(U_V), text[:40]
        assert recording.y_rad == pytest.approx(Y_RAD, abs=1e-4)


ODD = {  # for each: the log, what the error says, what to type by it
    "German": (log("Zeit (s);Spannung (V);Winkel (Grad)", ";"), "did you mean", "--time s --drive V --position deg"),
    "French": (log("Temps (s);Tension (V);Angle (tours)", ";"), "did you mean", "--time s --drive V --position turns"),
    "units row": (log("time,voltage,angle\ns,V,deg"), "did you mean", "--time s --drive V --position deg"),
    "German units row": (
        log("Zeit;Spannung;Drehzahl\ns;mV;U/min", ";"), "did you mean", "--time s --drive mV --velocity rpm"
    ),
    "percent": (log("time_s,duty_%,angle_rad"), "did you mean", "--time s --drive percent --position rad"),
    "percent, in words": (log("t_s,duty_percent,y_rad"), "did you mean", "--drive percent"),
    "pwm and volts": (log("t_s,pwm_V,y_rad"), "for UNIT: of drive V, mV", "--drive pwm_V:UNIT"),
    "rows of blanks": (log("millis pwm counts", " ", row="{k} {k} {k}"), "", "--time ms --drive pwm --position counts"),
    "no time": (log("u_V,y_rad", row="{u},{y:.4f}"), "no column is called like a time", "--period 10ms"),
    "no time, other names": (
        log("volts,deg", row="{u},{y:.4f}"), "row to row", "--period 10ms --drive V --position deg"
    ),
    "a speed of the motor": (
        log("Sample,PWM,targetSpeed,Motor Speed (RPM)", row="{k},{u},1,{y:.4f}"), "row to row",
        "--period 10ms --drive PWM:pwm --velocity 'Motor Speed (RPM):rpm'",
    ),
    "dates": (
        log("timestamp,u_V,y_rad", row="2026-01-02T03:04:05.{k:02d}0,{u},{y:.4f}"),
        "did you mean", "--time timestamp:s",
    ),
    "clock times": (
        log("time;Spannung [V];Lage [°]", ";", row="12:00:00.{k:02d}0;{u};{y:.4f}"), "did you mean",
        "--time time:s --drive V --position deg",
    ),
    "nanoseconds": (log("stamp_ns,u_V,y_rad", row="{k}0000000,{u},{y:.4f}"), "did you mean", "--time ns"),
    "Chinese": (log("时间(s),电压(V),角度(deg)"), "did you mean", "--time s --drive V --position deg"),
    "a plotter's labels": (
        log("", row="ms:{k}0,pwm:{u},rad:{y:.4f}"), "did you mean", "--time ms --drive pwm --position rad"
    ),
    "camel case": (log("timeMs,motorPwm,angleDeg", row="{k}0,{u},{y:.4f}"), "did you mean",
        "--time ms --drive pwm --position deg"),
    "dates beside decimal commas": (
        log("Zeit;Spannung (V);Winkel (Grad)", ";").replace(".", ",").replace("\n0,", "\n30.11.2026 07:30:00,"),
        "did you mean", "--time Zeit:s --drive V --position deg",
    ),
    "a speed in turns": (log("t_s,u_V,speed_rev_s"), "of velocity rad/s", "--velocity speed_rev_s:UNIT"),
    "a drive called speed": (
        log("millis,speed,angle_deg", row="{k}0,{u},{y:.4f}"), "of drive V",
        "--time ms --drive speed:UNIT --position deg",
    ),
    "a speed": (log("t [s],u [V],omega [rad/s]"), "no column", "--time s --drive V --velocity rad/s"),
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_an_odd_log_is_refused_with_options_that_read_it(tmp_path: Path, name: str) -> None:
    text, words, options = ODD[name]
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(RecordingError) as caught:
        read(path)
    said = str(caught.value)
    assert words in said and options in said
    typed = shlex.split(options.replace("UNIT", "rpm" if "velocity" in options else "V"))
    typed += [part for part in re.findall(r"of \w+ also ([^,;]+)", said) for part in part.split()]
    result = CliRunner().invoke(reading, [str(path), *typed])
    assert result.exit_code == 0, (result.output, result.exception)


@pytest.mark.parametrize(
    ("text", "options", "cause"),
    [
        (log("millis,speed,angle", row="{k}0,{u},{y:.4f}"), "--time ms --position deg", "--drive speed:UNIT"),
        (log("t_s,current_A,y_rad"), "", "a current is a torque"),
        (log("t_s,motor current,y_rad"), "--drive V", "a current is a torque"),
        (log("t_s,current_A,y_rad"), "--drive current_A:V", "a current is a torque"),
        (log("t_s,current_A,y_rad"), "--drive current_A", "a current is a torque"),
        (log("t_s,i_mA,y_rad"), "--drive V", "a current is a torque"),
        (log("time,torque,position"), "", "a current is a torque"),
        (log("Zeit;Strom (A);Winkel", ";"), "", "a current is a torque"),
        (log("t_s,drive,y_rad\ns,A,rad"), "--drive V", "a current is a torque"),
        (log("t_s,u_V,y_rad\ns,A,rad"), "", "a current is a torque"),
        (log("t_s,u_V,y_rad", row="{t:.2f},33%,{y:.4f}"), "", "sed 's/%//g'"),
        (log("t_s,u_V,y_rad", row="{t:.2f},1.5 V,{y:.4f}"), "", "the number alone, without V"),
        (log("t_s,u_V,y_rad", row="{t:.2f},28.фев,{y:.4f}"), "", "a spreadsheet took a number such as 28.2 for a date"),
        (log("t_s,u_V,y_rad", row="{t:.2f},2-Apr,{y:.4f}"), "", "a spreadsheet took a number such as 28.2 for a date"),
        (log("t_s,u_V,y_rad", row="{t:.2f};{u};{y:.4f}"), "", "the names stand between ',', and the rows between ';'"),
        (
            log("t_s,u_V,y_rad", row="{k},1,5,0,3"),
            "",
            "if decimal commas stand between commas, save it with semicolons",
        ),
        (log("    1.0e+03 *", row="  {t:.4f}  {u}  {y:.4f}"), "", "all numbers are to be taken times this, 1.0e+03 *"),
        (log("t_s,duty,y_rad", row="{t:.2f},{u}e-1,{y:.4f}"), "--drive duty:percent --supply-V 12", "COLUMN:duty"),
        (
            log("", row="{u}90;{t};{y}"),
            "--time s --drive percent --supply-V 8 --position rad",
            "number them: --time 1:s",
        ),
        (log("", row="2026-01-02 03:04:05.{k:02d},{u},{y:.4f}"), "", "--period 10ms --drive pwm --position counts"),
        (log("t_s,u_V,y_rad", row=""), "", "has 0 rows; record at least 22"),
        (
            "t,u,n\n1,,5250\ns\n1,,5250\n20,0,720\n",
            "--time t:s --drive u:V --position n:deg",
            "rows with a position in a run",
        ),
        ("y_rad\n" + "0.1\n" * 30, "", "has no column t_s, u_V"),
    ],
)
def test_an_odd_log_is_refused_with_what_to_do(tmp_path: Path, text: str, options: str, cause: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    result = CliRunner().invoke(reading, [str(path), *re.findall(r"--drive|[^ ]+", options)])
    assert result.exit_code != 0 and cause in f"{result.output} {result.exception}"


def test_a_log_with_decimal_commas_between_commas_is_refused_with_a_command_that_makes_it_plain(tmp_path: Path) -> None:
    path = tmp_path / "my log.csv"
    path.write_text(log("t_s,u_V,y_rad").replace(",", ", ").replace(".", ",").replace(", ", ","))
    with pytest.raises(RecordingError, match="has 6 fields") as caught:
        read(path)
    subprocess.run(["sh", "-c", caught.value.cure.partition("has one: ")[2]], cwd=tmp_path, check=True)
    assert whole(read(tmp_path / "plain.csv"))


def test_a_second_table_with_other_names_is_refused_and_no_restart_is_one(tmp_path: Path) -> None:
    """Its rows would be read under the first one's names."""
    path, rows = tmp_path / "log.csv", log("t_s,u_V,y_rad").splitlines()
    for names in ("t_s,y_rad,u_V", "t_s,u_V,y_deg"):
        path.write_text("\n".join([*rows[:15], names, *rows[15:], ""]))
        with pytest.raises(RecordingError, match=r"csv:16: .*other columns than line 1"):
            read(path)
    path.write_text("\n".join([*rows[:15], "boot", rows[0], *rows[15:], ""]))
    assert whole(read(path))


def test_a_log_of_several_motors_in_turn_is_refused_with_a_command_that_keeps_one(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t_s,id,u_V,y_rad\n" + log("", row="{t:.2f},7,{u},{y:.4f}\n{t:.2f},8,1,0.5"))
    with pytest.raises(RecordingError, match="'id' says 2 things at each time") as caught:
        read(path, LogFormat())
    subprocess.run(caught.value.cure.partition(": ")[2], shell=True, check=True, cwd=tmp_path)
    assert whole(read(tmp_path / "one.csv", LogFormat()))


def test_labels_may_change_their_order(tmp_path: Path) -> None:
    rows = log("", row="t_s:{t:.2f},u_V:{u},y_rad:{y:.4f}").splitlines()
    rows[5::3] = [",".join(reversed(row.split(","))) for row in rows[5::3]]
    (tmp_path / "log.csv").write_text("\n".join([*rows, ""]))
    assert whole(read(tmp_path / "log.csv"))


LONG: Final = 10 * log("t_s,u_V,y_rad").splitlines()[1:]
LONG[:] = [f"{0.01 * k:.2f}{row[4:]}" for k, row in enumerate(LONG)]


@pytest.mark.parametrize(
    ("content", "rows", "note"),
    [
        (log("Größe,t_s,u_V,y_rad", row="1,{t:.2f},{u},{y:.4f}").encode("latin-1"), 30, "Latin-1"),
        (log("t_s,u_V,y_rad").encode("utf-16"), 30, "UTF-16"),
        ("boot v1.2\nready!\n" + log("t_s,u_V,y_rad") + "done\n", 30, "3 lines are no rows"),
        ("Writer\t2\nX0\t0.0\t0.0\n" + log("t_s\tu_V\ty_rad\tComment", "\t"), 30, "2 lines are no rows"),
        ("\n".join(["t_s,u_V,y_rad", *LONG[:99], "0.9", "setup", "t_s,u_V,y_rad", *LONG[99:], ""]), 300, "3 lines"),
        ("\n".join(["t_s,u_V,y_rad", *LONG[:9], "0.09,,0.1", *LONG[10:99], "0.99,1.5,nan", *LONG[100:], ""]), 298,
         "2 rows lack a number"),
        ("\n".join(["t_s,u_V,y_rad", *LONG[:9], LONG[10], LONG[9], *LONG[11:], ""]), 300, "2 rows stood in another"),
        (log("", row='{{"t_s": {t:.2f}, "u_V": {u}, "y_rad": {y:.4f}}}'), 30, ""),
        (log("", row="10:00:01.5 -> t_s:{t:.2f} u_V:{u} y_rad:{y:.4f}"), 30, ""),
        (log("%t_s,name,u_V,y_rad", row="{t:.2f},joint,{u},{y:.4f}"), 30, ""),
        (log("t_s,u_V,y_rad", row="2026-01-02T23:59:59.{k:02d}Z,{u},{y:.4f}"), 30, ""),
    ],
)  # fmt: skip
def test_what_is_no_row_is_left_out_with_a_note(tmp_path: Path, content: str | bytes, rows: int, note: str) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    recording = read(path)
    assert len(recording) == rows and note in " ".join(recording.notes)
    assert recording.t_s - recording.t_s[0] == pytest.approx(
        0.01 * np.round(100.0 * (recording.t_s - recording.t_s[0]))
    )
    assert recording.y_rad[:9] == pytest.approx(Y_RAD[:9], abs=1e-4)


def test_what_a_column_lacks_is_told_by_the_others(tmp_path: Path) -> None:
    """A drive that is written where it changes stays in between; a row without a position tells the drive."""
    path, rows = tmp_path / "log.csv", [row.split(",") for row in LONG]
    steps = [
        "t_s,u_V,y_rad",
        *(f"{t},{u if k % 5 == 0 else ''},{y if k % 2 else ''}" for k, (t, u, y) in enumerate(rows)),
    ]
    path.write_text("\n".join([*steps, ""]))
    recording = read(path)
    assert recording.drive_steps is not None and recording.drive_steps[1].tolist() == [float(u) for _, u, _ in rows]
    assert recording.y_rad.tolist() == [float(y) for _, _, y in rows[1::2]]
    timeless = ["u_V,y_rad", *(f"{u},{k}" for k, (_, u, _) in enumerate(rows))]
    path.write_text("\n".join([*timeless[:10], "1.5", *timeless[11:], ""]))
    assert 9.0 * 0.01 not in read(path, LogFormat(period_s=0.01)).t_s  # a row that is lost takes its time with it


def test_a_drive_that_was_logged_more_slowly_is_refused_with_a_command_that_holds_it(tmp_path: Path) -> None:
    """When it changed nobody knows: held, tau of a relay's record was 50 % off beside 3 %."""
    path = tmp_path / "my log.csv"
    rows = [row.split(",") for row in LONG]
    path.write_text(
        "\n".join(["t_s,u_V,y_rad", *(f"{t},{'' if k % 3 else u},{y}" for k, (t, u, y) in enumerate(rows)), ""])
    )
    with pytest.raises(
        RecordingError, match=r"csv:3: column u_V is empty in 200 rows of 300.*log it in each"
    ) as caught:
        read(path)
    subprocess.run(["sh", "-c", caught.value.cure.partition("fill it in: ")[2]], cwd=tmp_path, check=True)
    assert read(tmp_path / "plain.csv").u_V.tolist() == [float(rows[k // 3 * 3][1]) for k in range(300)]
    path.write_text("\n".join(["t_s,u_V,y_rad", *(f"{t},,{y}" for t, _, y in rows), ""]))
    with pytest.raises(RecordingError, match="is empty in 300 rows of 300"):
        read(path)


def test_rows_from_which_on_a_log_of_changes_has_no_drive_are_left_out(tmp_path: Path) -> None:
    """The shaft goes on under drives that nobody knows: such a fit took minutes."""
    rows = [row.split(",") for row in LONG]
    path = tmp_path / "log.csv"
    changes = [f"{t},{u if k % 5 == 0 and 5 <= k < 150 else ''},{y}" for k, (t, u, y) in enumerate(rows)]
    path.write_text("\n".join(["t_s,u_V,y_rad", *changes, ""]))
    recording = read(path)
    assert recording.t_s[[0, -1]].tolist() == [0.05, 1.49]
    assert "the drive ends in line 147: the 150 rows that come later were left out" in recording.notes


def whole(recording: Recording) -> bool:
    """Whether all rows of the motion are there, as they were."""
    return bool(np.allclose(recording.t_s, T_S) and np.allclose(recording.y_rad, Y_RAD, atol=1e-4))


def test_units_that_a_name_says() -> None:
    for name, quantity, units in (
        ("Spannung (V)", "drive", {"V"}),
        ("v", "drive", set()),
        ("duty_%", "drive", {"percent"}),
        ("PWM [%]", "drive", {"percent"}),
        ("pwm duty", "drive", {"pwm", "duty"}),
        ("omega (rad/s)", "position", set()),
        ("omega (rad/s)", "time", set()),
        ("counts per second", "position", set()),
        ("Drehzahl (U/min)", "velocity", {"rpm"}),
        ("Winkel [°]", "position", {"deg"}),
        ("angleDeg", "position", {"deg"}),
        ("mV", "drive", {"mV"}),
        ("RPM", "velocity", {"rpm"}),
    ):
        assert units_said(name, quantity) == units, name


def test_a_servos_log_whose_positions_are_rarer_is_refused_for_they_make_its_drive(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,goal,pos\n" + "".join(f"{0.01 * k:.2f},1.0,{'' if k % 2 else 0.01 * k}\n" for k in range(40)))
    options = "--servo xl330-m288 --gain 400 --goal goal:rad --position pos:rad --time t:s --supply-V 5"
    result = CliRunner().invoke(reading, [str(path), *options.split()])
    assert isinstance(result.exception, RecordingError) and ":3: the position is empty" in str(result.exception)
