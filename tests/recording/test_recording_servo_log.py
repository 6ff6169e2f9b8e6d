"""The log of a servo's own position loop: its drive by duty = gain x error, and BAM's logs."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
import servo_log
from command_line import rig

from rig.identification import identify
from rig.identification.drive_scale import by_own_loop
from rig.output.report.simulated import beyond
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import LogColumn, LogFormat, LogFormatError
from rig.run_folder.recording.reader import read, read_all
from rig.run_folder.recording.servo_law import SCALES, OwnLoop, Scale, ServoLaw, least_known, scale_of
from rig.run_folder.results import Answer

_BAMS = ("xl330", "sts3215")
KNOWN = Scale(1.0, 1.0, "stated")
TAU_S, K, FC_V = 0.0444, 2.354, 0.133  # of the emulated XL330


def log_of(scale: Scale = KNOWN, P: float | None = 0.5, slew_V_s: float = math.inf, **more: Any) -> LogFormat:
    law = ServoLaw(P, scale, slew_V_s)
    return LogFormat(LogColumn("s"), None, LogColumn("rad"), goal=LogColumn("rad"), servo=law, **more)


def written(file: Path, rows: Sequence[tuple[float, ...]], names: str = "time,position,goal,voltage") -> Path:
    file.write_text(names + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows), encoding="utf-8")
    return file


def bam(file: Path, change: Callable[[dict[str, Any]], None] = lambda _: None) -> Path:
    """A log as BAM writes it: 30 entries without torque, 40 with it."""
    entries: list[dict[str, Any]] = [
        {
            "position": 0.1 * k, "speed": 0.0, "load": 0.0, "input_volts": 5.0 if k % 2 else 5.2, "temp": 30,
            "timestamp": 0.01 * k, "goal_position": 0.1 * k + 0.2, "torque_enable": k >= 30,
        }
        for k in range(70)
    ]  # fmt: skip
    data = {"mass": 0.1, "arm-mass": 0.01, "length": 0.1, "kp": 100, "vin": 7.5, "motor": "xl330", "trajectory": "sin"}
    whole = data | {"entries": entries}
    change(whole)
    file.write_text(json.dumps(whole), encoding="utf-8")
    return file


def test_the_drive_is_gain_times_error_within_full_duty_and_each_goal_holds_until_the_next() -> None:
    t_s, y_rad = np.array([0.0, 0.01, 0.02]), np.array([0.0, 0.1, 0.2])
    goal_rad = np.array([1.0, 0.3, -9.0])
    edges_s, u_V, rows_V = ServoLaw(0.5, KNOWN).drive(0.5, t_s, y_rad, goal_rad, 6.0)
    np.testing.assert_allclose(edges_s, np.arange(21) * 0.001, atol=1e-12)
    middles = 0.005 + 0.01 * np.arange(20)  # the position in the middle of each step
    held = np.repeat([1.0, 0.3], 10)
    np.testing.assert_allclose(u_V[:-1], 6.0 * 0.5 * (held - middles), atol=1e-12)
    np.testing.assert_allclose(rows_V, [3.0, 0.6, -6.0])
    first = ServoLaw(0.5, KNOWN, goal_first=True).drive(0.5, t_s, y_rad, goal_rad, 6.0)[1]
    np.testing.assert_allclose(first[:10], 6.0 * 0.5 * (0.3 - middles[:10]), atol=1e-12)


def test_old_positions_are_of_the_time_before_and_goals_change_that_much_after_them(tmp_path: Path) -> None:
    t_s, still = np.array([0.0, 0.01, 0.02, 0.03]), np.zeros(4)
    goal_rad = np.array([0.0, 1.0, 0.5, 0.5])
    _, u_V, _ = ServoLaw(1.0, KNOWN, position_age_s=0.006).drive(1.0, t_s, still, goal_rad, 5.0)
    np.testing.assert_allclose(u_V[:-1], np.repeat([0.0, 5.0, 2.5], [16, 10, 4]))
    file = written(tmp_path / "log.csv", [(0.01 * k, 0.1 * k, 0.1 * k + 0.2, 5.0) for k in range(30)])
    old = log_of()
    assert old.servo is not None
    found = read(file, replace(old, servo=replace(old.servo, position_age_s=0.006)))
    np.testing.assert_allclose(found.t_s, 0.01 * np.arange(30) - 0.006)


def test_parquet_becomes_a_csv_by_the_command_that_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As LeRobot's data sets are; pyarrow, which reads them, need not be here."""
    (tmp_path / "a file.parquet").write_bytes(b"PAR1\x15PAR1")
    with pytest.raises(RecordingError, match="is parquet") as told:
        read(tmp_path / "a file.parquet", log_of(supply_V=5.0))
    words = shlex.split(told.value.cure)
    code, path = words[words.index("-c") + 1 :][:2]
    columns = {"observation.state": [[0.1 * k, 7.0] for k in range(30)], "action": [[0.1 * k + 0.2] for k in range(30)]}
    table = pandas.DataFrame({**columns, "timestamp": 0.01 * np.arange(30)})
    monkeypatch.setattr(pandas, "read_parquet", {str(tmp_path / "a file.parquet"): table}.get)
    monkeypatch.setattr(sys, "argv", ["-c", path.rstrip(";")])
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    log = log_of(supply_V=5.0)
    named = {"time": "timestamp", "position": "observation.state.0", "goal": "action.0"}
    assert all(f"--{name} {column}:" in told.value.cure for name, column in named.items())
    units = {"time": "s", "position": "rad", "goal": "rad"}
    columns_of: dict[str, Any] = {name: LogColumn(units[name], column) for name, column in named.items()}
    found = read(tmp_path / "plain.csv", replace(log, **columns_of))
    np.testing.assert_allclose(found.y_rad, 0.1 * np.arange(30), atol=1e-9)
    np.testing.assert_allclose(found.u_V, 5.0 * 0.5 * 0.2)


def test_a_ramp_bounds_how_quickly_the_drive_changes() -> None:
    t_s, still = np.array([0.0, 0.01, 0.02, 0.03]), np.zeros(4)
    goal_rad = np.array([0.0, 1.0, 1.0, 1.0])
    _, u_V, _ = ServoLaw(1.0, KNOWN, slew_V_s=400.0).drive(1.0, t_s, still, goal_rad, 5.0)
    risen = np.minimum(0.4 * (np.arange(20) + 0.5), 5.0)  # the mean of each step of a ramp of 0.4 V in each
    risen[12] = 0.5 * (4.8 + 5.0)
    np.testing.assert_allclose(u_V[10:-1], risen, atol=1e-12)


def test_a_log_is_read_by_its_columns_and_says_what_it_took(tmp_path: Path) -> None:
    rows = [(0.01 * k, 0.1 * k, 0.1 * k + 0.2, 7.4 + 0.1 * (k % 3)) for k in range(30)]
    found = read(written(tmp_path / "log.csv", rows), log_of())
    np.testing.assert_allclose(found.u_V, 7.5 * 0.5 * 0.2)
    assert found.own_loop == OwnLoop(KNOWN, 0.5 * 7.5) and found.drive_steps is not None
    assert "the supply is the median of column voltage, 7.5 V" in found.notes
    assert found.notes[-1].startswith("the drive is that of the servo's own law, P 0.5, 7.5 V")
    stated = read(tmp_path / "log.csv", log_of(supply_V=5.0))
    np.testing.assert_allclose(stated.u_V, 0.5)


@pytest.mark.parametrize(
    ("names", "P", "words"),
    [
        ("time,position,goal,other", 0.5, "of the supply's voltage"),
        ("time,position,goal,voltage", None, "does not say the servo's gain P"),
    ],
)
def test_what_a_log_does_not_say_is_asked_for(tmp_path: Path, names: str, P: float | None, words: str) -> None:
    rows = [(0.01 * k, 0.1 * k, 0.1 * k + 0.2, 7.4) for k in range(30)]
    with pytest.raises(RecordingError, match=words):
        read(written(tmp_path / "log.csv", rows, names), log_of(P=P))


def test_options_of_another_kind_of_log_are_refused() -> None:
    others: tuple[dict[str, Any], ...] = (
        {"drive": LogColumn("V")},
        {"reversed": True},
        {"time_row": -1},
        {"drive_row": 1},
    )
    for more in others:
        with pytest.raises(LogFormatError):
            LogFormat(goal=LogColumn("rad"), servo=ServoLaw(1.0, KNOWN), **more)
    with pytest.raises(LogFormatError, match="add --servo"):
        LogFormat(goal=LogColumn("rad"))


def test_a_log_of_bams_is_read_as_it_is(tmp_path: Path) -> None:
    # a minute at 200 Hz has as many values
    (found,) = read_all(bam(tmp_path / "log.json", lambda data: data["entries"][0].update(raw=[0] * 100_000)))
    assert len(found) == 40 and found.t_s[0] == 0.3  # the stretch with the torque on
    assert found.own_loop is not None and found.own_loop.scale == SCALES["dynamixel"]
    assert "a factor of 2 only" in beyond(Answer(), found)
    assert found.drive_steps is not None
    # the goal of a row was written before its position was read: it holds in the time before it
    error_rad = 3.1 + 0.2 - (3.0 + 0.1 / 20)
    assert found.drive_steps[1][0] == pytest.approx(5.1 * 100 * SCALES["dynamixel"].middle * error_rad)
    own = read(tmp_path / "log.json", LogFormat(servo=ServoLaw(None, scale_of("dynamixel", 0.004)), supply_V=6.0))
    assert own.drive_steps is not None
    assert own.drive_steps[1][0] == pytest.approx(6.0 * 100 * 0.004 * error_rad)


def test_a_log_of_bams_that_names_another_servo_is_refused(tmp_path: Path) -> None:
    law = ServoLaw(None, SCALES["feetech"], model="sts3215")
    with pytest.raises(RecordingError, match="its motor is xl330, not sts3215"):
        read(bam(tmp_path / "log.json"), LogFormat(servo=law))


def _of(motor: str, data: dict[str, Any]) -> None:
    data.update(motor=motor)


def test_nobody_says_that_the_d_of_an_sts3215_was_0(tmp_path: Path) -> None:
    own, theirs = (read_all(bam(tmp_path / "log.json", partial(_of, motor)))[0] for motor in _BAMS)
    assert own.own_loop is not None and own.own_loop.is_P_alone
    assert theirs.own_loop is not None and not theirs.own_loop.is_P_alone


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.update(motor="mx64"), "whose P rig does not know"),
        (lambda data: data.update(kp="much"), "its kp is no number"),
        (lambda data: [one.update(torque_enable=False) for one in data["entries"]], "with the torque on"),
        (lambda data: data["entries"][40].pop("goal_position"), "entry 40 lacks"),
        (lambda data: data["entries"][40].update(timestamp=0.0), "its time does not rise after entry 9"),
        (lambda data: [one.update(input_volts=-5.0) for one in data["entries"]], "its input_volts are -5"),
        (lambda data: data["entries"][40].update(position=math.nan), "is broken JSON .NaN is no JSON number"),
        (lambda data: data["entries"][40].update(torque_enable="off"), "entry 40 is neither true nor false"),
        (lambda data: data["entries"][69].update(timestamp=1e6), "which goal it had in the 1e\\+06 s before"),
        (lambda data: [one.update(timestamp=10.0 * k) for k, one in enumerate(data["entries"])], "10 s apart"),
    ],
)
def test_a_broken_log_of_bams_is_refused(tmp_path: Path, change: Callable[[dict[str, Any]], None], words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        read_all(bam(tmp_path / "log.json", change))


def test_a_motor_comes_back_from_its_servos_own_loop_and_its_volts_are_as_uncertain_as_the_scale(
    tmp_path: Path,
) -> None:
    rows = [(t, p * servo_log.COUNT_RAD, g * servo_log.COUNT_RAD, u) for t, p, g, u in servo_log.rows(256.0)]
    file = written(tmp_path / "log.csv", rows)

    def by(scale: Scale) -> Answer | None:
        recording = read(file, log_of(scale, servo_log.P, servo_log.SLEW_V_S))
        return identify([recording], ("sampled-data",), choose_law=False).answer

    stated, unsure = by(scale_of("dynamixel", SCALES["dynamixel"].low)), by(SCALES["dynamixel"])
    assert stated is not None and unsure is not None
    assert stated.tau_s == pytest.approx(TAU_S, rel=0.03)
    assert stated.K_rad_s_V == pytest.approx(K, rel=0.03) and stated.fc_V == pytest.approx(FC_V, rel=0.1)
    assert unsure.tau_s == pytest.approx(TAU_S, rel=0.03)  # its ramp alone depends on the scale
    assert unsure.K_rad_s_V == pytest.approx(K / math.sqrt(2.0), rel=0.03)
    interval = unsure.at_95("K_rad_s_V")
    assert interval is not None and interval[0] < K < interval[1]
    assert unsure.verdict == "doubtful" and "a factor of 2 only" in unsure.reasons[0]
    assert "factor" not in " ".join(stated.reasons)


def found(half: float = 0.01, K_rad_s_V: float = 2.0) -> Answer:
    """An answer whose numbers all have this half width, 1."""
    numbers = {"tau_s": 0.05, "K_rad_s_V": K_rad_s_V, "fc_V": 0.2}
    u95 = {name: half * value for name, value in numbers.items()}
    return Answer(**numbers, u95=u95, u95_absolute=u95, verdict="ok")


def test_what_nobody_knows_of_a_servos_loop_is_in_the_answer() -> None:
    """A delay of 1 ms does what gain x 1 ms of viscous friction would do, and no record shows it."""
    late = by_own_loop(found(), OwnLoop(KNOWN, 20.0))
    for name, value in {"tau_s": 0.05, "K_rad_s_V": 2.0}.items():
        low, high = late.at_95(name) or (math.nan, math.nan)
        assert 0.5 * (high - low) / value == pytest.approx(math.hypot(0.01, 2.0 * 20.0 * 1e-3))
    for delay_s, late_s in ((0.0015, 1e-3), (0.009, 8e-3), (-0.004, 3e-3)):  # goals or positions that are late, too
        stamped = by_own_loop(found().model_copy(update={"delay_s": delay_s}), OwnLoop(KNOWN, 20.0))
        low, high = stamped.at_95("tau_s") or (math.nan, math.nan)
        assert 0.5 * (high - low) / 0.05 == pytest.approx(math.hypot(0.01, 2.0 * 20.0 * late_s))
        assert ("which of them is late" in stamped.reasons[0]) == (late_s > 1e-3)
        when = f"moves {1e3 * abs(delay_s):.2g} ms {'after' if delay_s > 0.0 else 'before'} the duty"
        assert (when in stamped.reasons[0]) == (late_s > 1e-3)
        low, high = stamped.at_95("fc_V") or (math.nan, math.nan)
        rubs = 3.0 * 2.0 * 20.0 * late_s if late_s > 1e-3 else 0.0
        assert 0.5 * (high - low) / 0.2 == pytest.approx(math.hypot(0.01, rubs))
    assert late.at_95("fc_V") == pytest.approx((0.198, 0.202))
    assert late.verdict == "doubtful" and "a smaller P" in late.reasons[0]
    assert by_own_loop(found(), OwnLoop(KNOWN, 5.0)).verdict == "ok"
    with_D = by_own_loop(found(), OwnLoop(KNOWN, 5.0, is_P_alone=False))
    assert with_D.verdict == "doubtful" and "--gain P,I,D" in with_D.reasons[0]


def test_of_several_logs_the_least_known_counts() -> None:
    loops = OwnLoop(KNOWN, 9.0), None, OwnLoop(SCALES["feetech"], 3.0, is_P_alone=False)
    assert least_known(loops) == OwnLoop(SCALES["feetech"], 9.0, is_P_alone=False)
    assert least_known([None]) is None


def test_the_options_of_the_command(tmp_path: Path) -> None:
    file = written(tmp_path / "log.csv", [(0.01 * k, 2048, 2048, 5.0) for k in range(30)])
    servo = ("--servo", "xl330-m288", "--gain", "400")
    for options, words in (
        (("--gain", "400"), "add --servo MODEL"),
        (("--servo", "ax12", "--gain", "400"), "rig knows no servo"),
        ((*servo, "--drive", "V"), "--drive and --servo are both given"),
        (("--servo", "sts3215", "--gain", "16,0,32"), "duty = P x error, and I is 0, D 32"),
        (("--servo", "sts3215", "--gain", "nan"), "must be the servo's P"),
        ((*servo, "--p-scale", "inf"), "must be a number"),
        ((*servo, "--position-age", "1s"), "no link makes a position so old"),
        ((*servo, "--position-age", "6"), "--position-age 6 is no time"),
        (("--position-age", "6ms"), "add --servo MODEL"),
        # 4096 counts a turn need not be said
        ((*servo, "--time", "s", "--position", "counts", "--goal", "counts"), "the position never changes"),
    ):
        said = rig("identify", file, *options)
        assert said.exit_code == 2 and words in said.output, said.output
