"""Logs as people have them, and records of real motors; both lie in a folder beside the project, RIG_SHARED_DATA."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from evidence import evidence

from real_records import __main__ as command
from real_records.bounds import bounds, tellable
from real_records.known import PUBLISHED, Known, known_of
from real_records.scores import FIGURES, Seen, by_table, figures, laws_shared, left_out
from real_records.siblings import next_record, pairs_that_agree
from rig.identification import identify
from rig.identification.identification import Identification
from rig.model.real_motor import Frame, RealMotor
from rig.run_folder.recording.recording import from_columns
from rig.run_folder.results import Answer, GradedNumber
from shared.pieces import Pieces, response

DATA = Path(os.environ.get("RIG_SHARED_DATA") or "nowhere")
WITH_DATA = pytest.mark.skipif(
    not DATA.is_dir(), reason="RIG_SHARED_DATA names no folder: the logs are not part of rig"
)
TRUE = (0.05, 20.0, 0.6)
SLOW = (0.12, 4.2, 0.9)

pytestmark = pytest.mark.long


@WITH_DATA
@pytest.mark.laws
@pytest.mark.parametrize(
    ("name", "verdict", "numbers", "said"),
    [
        ("dead_band_1p3V.csv", "ok", TRUE, "dead band of the drive 1.3"),
        ("closedloop.csv", "ok", SLOW, ""),
        ("one_way_levels.csv", "doubtful", TRUE, "one way only"),
        ("file_fwd.csv file_rev.csv", "ok", TRUE, "dead band"),
        ("demo-refused", "ok", (0.17, 6.5, 0.48), ""),
        *evidence(
            ("vel_lpf5ms.csv", "ok", TRUE, "low-passed by 5"),  # make test has such a filter in tests/identify
            ("steps.csv", "ok", SLOW, ""),
            ("unsigned_drive.csv", "refused", None, "the drive is never negative"),
            ("stamp_of_line_before.csv", "doubtful", None, "--time-row -1"),
            ("velfilt.csv", "ok", SLOW, "low-passed by 4"),
            ("unbalance_2p5V.csv", "doubtful", TRUE, "a load nearly balances the drive"),
            ("lost_counts_fwd2pct.csv", "ok", TRUE, "loses counts one way"),
            ("drift_each_1.csv drift_each_2.csv", "ok", (0.155, 5.32, 0.4097), "in the course of each recording"),
            ("vel_int16.csv", "ok", TRUE, "half a row"),
        ),
    ],
)
def test_a_log_that_went_wrong_is_right(
    name: str, verdict: str, numbers: tuple[float, ...] | None, said: str, tmp_path: Path
) -> None:
    (entry,) = [one for one in command.entries("cases", DATA, tmp_path) if one.name == name]
    found, _, _ = command.identified(entry)
    assert found is not None and found.answer is not None
    words = [*found.answer.reasons, *found.notes]
    assert found.answer.verdict == verdict, words
    assert any(said in word for word in words) or not said
    if numbers is not None:
        for key, true in zip(("tau_s", "K_rad_s_V", "fc_V"), numbers, strict=True):
            value = found.answer.value(key)
            assert value == pytest.approx(true, rel=0.015), key
    if verdict == "ok":
        assert {law.name for law in found.answer.law or ()} <= {
            "dead_band",
            "drift_each",
            "static",
            "viscous_by_direction",
        }


@WITH_DATA
@pytest.mark.laws
def test_a_log_whose_drive_is_beyond_full_or_whose_clock_stands_is_refused(tmp_path: Path) -> None:
    logs = {
        "pwm_above_full.csv": (command.BOARD, "--full says 255"),
        "i5_clock15ms.csv": (command.log_of("t:ms", "pwm", "position", "counts", 1440.0), "15.6"),
    }
    for name, (log, said) in logs.items():
        found, words, _ = command.identified(command.Entry(name, name, (DATA / "cases" / name,), log))
        assert found is None and said in words


@WITH_DATA
@pytest.mark.laws
def test_a_record_of_a_real_motor_has_its_published_numbers(tmp_path: Path) -> None:
    entries = {one.name: one for one in command.entries("real", DATA, tmp_path)}
    found, _, _ = command.identified(entries["nb_prbs"])
    assert found is not None and found.answer is not None and found.answer.grade is not None
    tau, gain = (found.answer.grade[name] for name in ("tau_s", "K_rad_s_V"))
    assert tau.value is not None and gain.value is not None
    assert tau.value == pytest.approx(0.465, abs=tau.u95) and gain.value == pytest.approx(30.1, abs=gain.u95)


@WITH_DATA
@pytest.mark.evidence  # make test has another real motor, above
@pytest.mark.laws
def test_a_law_of_a_real_motor_halves_the_error_of_what_it_predicts(tmp_path: Path) -> None:
    entries = {one.name: one for one in command.entries("emps", DATA, tmp_path)}
    pulses, _, _ = command.identified(entries["DATA_EMPS_PULSES"])
    assert pulses is not None and pulses.answer is not None and pulses.answer.predicts is not None
    assert "viscous_by_direction" in [law.name for law in pulses.answer.law or ()]
    assert (pulses.answer.predicts.error or 1.0) < 0.5 * (pulses.answer.predicts.linear_error or 0.0)


@WITH_DATA
@pytest.mark.evidence  # make test has such a force in a motor that is known, in tests/identify
@pytest.mark.laws
def test_a_servo_with_a_pendulum_of_about_5_V_is_doubtful_and_its_force_is_found(tmp_path: Path) -> None:
    entries = {one.name: one for one in command.entries("real", DATA, tmp_path)}
    loaded, _, _ = command.identified(entries["bam_square100"])
    assert loaded is not None and loaded.answer is not None
    assert loaded.answer.verdict == "doubtful"
    assert "force_over_position" in [law.name for law in loaded.answer.law or ()]


def _record(seed: int, motor: RealMotor) -> Identification:
    random = np.random.default_rng(seed)
    t_s = np.linspace(0.0, 12.0, 1200, endpoint=False)
    u_V = np.repeat(random.choice([-6.0, -4.0, 4.0, 6.0], 40), 30)
    y_rad = response(motor, Frame(duration_s=12.0), (t_s, u_V), t_s, Pieces.one())
    y_rad = y_rad + random.normal(0.0, 0.003, y_rad.size)
    return identify([from_columns(Path(f"{seed}.csv"), t_s, u_V, y_rad)])


@pytest.mark.usefixtures("plain_motor")
def test_the_next_record_is_predicted_to_noise_by_the_motor_that_made_both_and_worse_by_the_linear_ones() -> None:
    motor = RealMotor(0.1, 5.0, 1.5)
    found = next_record(_record(1, motor), _record(2, motor), ("a", "b"))
    assert found is not None and (found.first, found.second) == ("a", "b")
    assert found.rig < 0.02 < min(found.linear, found.arx)
    without = next_record(_record(1, motor._replace(fc_V=0.0)), _record(2, motor._replace(fc_V=0.0)), ("a", "b"))
    assert without is not None and without.linear < 0.02  # no friction: the linear model is the true one
    changed = next_record(_record(1, motor), _record(2, motor._replace(K_rad_s_V=10.0)), ("a", "b"))
    assert changed is not None and changed.rig > 0.3


@pytest.mark.usefixtures("plain_motor")
def test_numbers_of_two_records_agree_within_both_intervals_and_unusable_ones_do_not_count() -> None:
    plain = _record(1, RealMotor(0.1, 5.0, 1.5)).answer
    assert plain is not None

    def answer(tau_s: float | None, u95: float) -> Answer:
        graded = GradedNumber(value=tau_s, u95=u95, grade="good" if tau_s else "not known")
        return plain.model_copy(update={"grade": {"tau_s": graded}})

    records = {"a": answer(0.10, 0.01), "b": answer(0.12, 0.02), "c": answer(0.20, 0.01), "d": answer(None, 0.5)}
    assert pairs_that_agree(records) == (1, 3)


README = """
| record | predicts | tau, s | K, (rad/s)/V | f_c, V |
|---|---|---|---|---|
| one | yes: 0.125, 0.214 | 0.1 ± 88 % (not known) | 5.2 ± 8 % | 1.4 ± 20 % |
| emps | no: 0.4, 0.5 | 0.453 ± 7 % | 29.2 ± 7 % | 0.304 ± 4 % (f_c - a) |
"""


def test_known_numbers_are_read_from_the_readme_beside_the_records(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text(README, encoding="utf-8")
    known = known_of(tmp_path / "README.md")
    assert known["one"].predicts and not known["DATA_EMPS"].predicts
    assert known["one"].share == pytest.approx(0.125 / 0.214)
    assert set(known["one"].numbers) == {"K_rad_s_V", "fc_V"}
    assert known["one"].numbers["K_rad_s_V"] == pytest.approx((5.2, 0.416))
    assert known["one"].numbers["fc_V"] == pytest.approx((1.4, 0.28))
    assert set(known["DATA_EMPS"].numbers) == {"tau_s", "K_rad_s_V", "fc_less_bias_V"}


@pytest.mark.laws
def test_figures_count_what_is_given_what_is_off_and_what_siblings_share(monkeypatch: pytest.MonkeyPatch) -> None:
    motor = RealMotor(0.1, 5.0, 1.5)
    first, second, other = (Seen(name, name[0], _record(k, motor), 3.0) for k, name in enumerate(("a1", "a2", "b1")))
    late = Seen("b2", "b", None, 13.0)
    known = {
        "a1": Known(True, 0.01, {"K_rad_s_V": (5.0, 0.01), "fc_V": (3.0, 0.1)}),
        "b2": Known(True, 0.5, {"tau_s": (0.1, 0.0)}),
    }
    records = [first, second, other, late]
    seen = [(one.is_given, one.holds) for one in by_table(records, known)]
    assert seen == [(True, True), (True, False), (False, False)]
    row = dict(zip(FIGURES, figures(records, known, []), strict=True))
    assert row["known by the table: given (3/4 asked)"] == "2 of 3"
    assert row["by the table: off"] == row["by the table: off without that reason (0 asked)"] == "1 of 2"
    assert row["refused, of those that can be predicted (0 asked)"] == "1 of 2"
    assert row["numbers of siblings that agree (90 % asked)"] == "3 of 3"
    assert row["within 12 s of CPU (90 % asked)"] == "3 of 4"
    assert laws_shared(records) == (0, 0)
    monkeypatch.setitem(PUBLISHED, "a", {"tau_s": (0.1, 0.0), "K_rad_s_V": (4.0, 0.0), "fc_V": (1.5, 0.0)})
    (said,) = tellable([first, late])
    assert first.found is not None
    halves = bounds(first.found, {"tau_s": 0.1, "K_rad_s_V": 4.0, "fc_V": 1.5}).values()
    assert said.startswith(f"a: {sum(left <= 0.25 for _, left in halves)} of 3 numbers can be known to 25 %")
    assert "rig gives 3: tau of a1" in said and "K of a1 (25 %)" in said
    without_b = [cells[3] for cells in left_out(records, known, [])]
    assert without_b == figures([first, second], known, [])
    worse = {**known, "a1": Known(True, 1.0, known["a1"].numbers)}  # no better than a linear model: rig's is nearer
    row = dict(zip(FIGURES, figures(records, worse, []), strict=True))
    assert row["by the table: off"] == "1 of 2"
    assert row["by the table: off without that reason (0 asked)"] == "0 of 2"


@pytest.mark.usefixtures("plain_motor")
def test_the_bound_at_the_true_numbers_is_the_scatter_of_the_fit_and_other_numbers_leave_more() -> None:
    found = _record(1, RealMotor(0.1, 5.0, 1.5))
    assert found.answer is not None
    true = bounds(found, {"tau_s": 0.1, "K_rad_s_V": 5.0, "fc_V": 1.5})
    wrong = bounds(found, {"tau_s": 0.1, "K_rad_s_V": 3.0, "fc_V": 1.5})
    for name, (sensor, left) in true.items():
        low, high = found.answer.interval(name) or (0.0, 0.0)
        own = 0.5 * (high - low) / abs(found.answer.value(name) or 1.0)
        assert 0.5 * own < sensor < 4.0 * own  # blocks have starts of their own, and a force is free
        assert left == pytest.approx(sensor, rel=0.5)
        assert wrong[name][1] > 5.0 * wrong[name][0]


def test_without_the_folder_it_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("RIG_SHARED_DATA", raising=False)
    assert command.main([]) == 2
    assert "RIG_SHARED_DATA" in capsys.readouterr().err
