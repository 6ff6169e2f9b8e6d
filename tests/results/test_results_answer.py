"""The one answer: which estimate it is, how older files say it, how it is shown; and that everybody takes it."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig as api
from rig.design.tune.tuning import motor_of
from rig.identification.known_model import known_model
from rig.output.compare.compared_run import read_run as read_compared
from rig.output.export.motor import identified_motor
from rig.output.export.whole_run import ExportedRun
from rig.output.report.source import load
from rig.output.report.words import headline
from rig.panel.past_runs import Runs
from rig.run_folder.catalogue import read_entry
from rig.run_folder.recording.reader import read_result, read_run
from rig.run_folder.results import (
    Answer,
    EstimateResult,
    FoundLawResult,
    GradedNumber,
    HoldsResult,
    PredictsResult,
    RunResult,
    TrueMotor,
    answer_of,
)
from rig.run_folder.results.answer_words import answer_lines, graded_words, of_all, validity

GOLDEN = Path(__file__).resolve().parents[1] / "golden/simulated"
LAW = FoundLawResult(name="sag", value=0.02, unit="1/V", ci95=(0.01, 0.03), bic=30.0, numbers={"sag_per_V": 0.02})


def one(tau_s: float, verdict: str = "ok", half: float = 0.001) -> EstimateResult:
    values = {"tau_s": tau_s, "K_rad_s_V": 38.0 * tau_s, "fc_V": 3.0 * tau_s}
    ci95 = {name: (value - half, value + half) for name, value in values.items()}
    covariance = np.diag([half**2, half**2, half**2]).tolist()
    return EstimateResult(
        **values, ci95=ci95, covariance_of=tuple(values), covariance=covariance, verdict=verdict, reasons=("why",)
    )


# -- which estimate it is ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("leading", "with_laws", "others", "expected"),
    [
        ("ok", None, {}, "plain"),
        ("ok", "ok", {}, "laws"),
        ("ok", "doubtful", {}, "laws"),  # it knows more: its doubts hold of the plain motor, too
        ("doubtful", "refused", {}, "plain"),
        ("refused", "ok", {}, "laws"),
        ("refused", "refused", {}, "laws"),  # it says what is wrong even so
        ("refused", None, {"triple-relay": "ok"}, "plain"),  # a refusal of the leading method is the answer
        (None, None, {"describing-function": "ok", "triple-relay": "doubtful"}, "triple-relay"),
        (None, None, {"describing-function": "ok", "triple-relay": "refused"}, "describing-function"),
        (None, "ok", {"triple-relay": "doubtful"}, "laws"),
        (None, "refused", {"triple-relay": "doubtful"}, "triple-relay"),
        (None, None, {"of a later version": "ok"}, "of a later version"),
    ],
)
def test_one_rule_chooses(leading: str | None, with_laws: str | None, others: dict[str, str], expected: str) -> None:
    names = {"plain": 0.1, "laws": 0.2, "triple-relay": 0.3, "describing-function": 0.4, "of a later version": 0.5}
    estimates = {name: one(names[name], verdict) for name, verdict in others.items()}
    if leading is not None:
        estimates["sampled-data"] = one(0.1, leading)
    laws = None if with_laws is None else one(0.2, with_laws)
    grade = {"tau_s": GradedNumber(value=0.2, u95=0.01, grade="good")}
    answer = answer_of(estimates, laws, (LAW,), None, {"tau_s": 0.01}, grade=grade)
    assert answer is not None and answer.tau_s == names[expected]
    assert answer.method == ("sampled-data" if expected in ("plain", "laws") else expected)
    if laws is not None and expected != "laws":
        assert answer.law == () and answer.u95 is None  # laws and u95 are those of the refused one
        assert answer.grade is not None and {one.grade for one in answer.grade.values()} == {"not known"}
    else:
        assert answer.law == (LAW,) and answer.u95 == {"tau_s": 0.01}


def test_without_an_estimate_there_is_no_answer_and_the_file_says_null() -> None:
    assert answer_of({}) is None
    assert RunResult(answer=None, estimates={}).as_json() == {"answer": None, "estimates": {}}
    assert RunResult().as_json() == {}


# -- older files ------------------------------------------------------------------------------------------------------


def old_keys() -> dict[str, Any]:
    """result.json of an older version whose plain estimate, method by method, is far from its answer."""
    estimates = {"sampled-data": one(0.1, "doubtful"), "triple-relay": one(0.12, "ok")}
    return {
        "schema": 1,
        "estimates": {name: estimate.as_json() for name, estimate in estimates.items()},
        "law": [LAW.as_json()],
        "with_law": one(0.17).as_json(),
        "law_frame": {"centre_rad": 0.0, "half_travel_rad": 1.0, "start_s": 0.0, "duration_s": 9.0},
        "u95": {"tau_s": 0.004, "K_rad_s_V": 0.1, "fc_V": 0.01},
        "u95_absolute": {"tau_s": 0.004, "K_rad_s_V": 0.2, "fc_V": 0.02},
        "budget": [{"source": "scatter", "tau_s": 0.004, "K_rad_s_V": 0.1, "fc_V": 0.01}],
        "friction_law": {"chosen": "stribeck", "rungs": [{"law": "stribeck", "parameters": {"fs_V": 0.6}}]},
        "loop": {"ticks": 100, "period_s": 0.01},
    }


@pytest.fixture
def old_run(tmp_path: Path) -> Path:
    """A run folder with that result."""
    folder = tmp_path / "20260101T000000Z-run-old"
    folder.mkdir()
    for name in ("config.yaml", "meta.json", "samples.csv", "events.jsonl"):
        (folder / name).write_bytes((GOLDEN / name).read_bytes())
    (folder / "result.json").write_text(json.dumps(old_keys()), encoding="utf-8")
    return folder


def test_an_older_file_has_the_answer_once_it_is_read_and_is_written_with_it(old_run: Path) -> None:
    result, notes = read_result(old_run)
    assert result is not None and result.answer is not None and notes == []
    answer = result.answer
    assert (answer.tau_s, answer.verdict, answer.law, answer.method) == (0.17, "ok", (LAW,), "sampled-data")
    assert answer.u95 == old_keys()["u95"] and answer.u95_absolute == old_keys()["u95_absolute"]
    assert answer.law_frame is not None and answer.law_frame.half_travel_rad == 1.0
    assert (answer.grade, answer.predicts, answer.holds) == (None, None, None)
    written = json.loads(json.dumps(result.as_json()))
    assert RunResult.model_validate(written).answer == answer
    assert RunResult.model_validate({"answer": written["answer"], "estimates": written["estimates"]}).answer == answer


def test_the_file_of_a_newer_version_keeps_its_answer_whatever_it_says_beside_it() -> None:
    graded = {"tau_s": {"value": 0.2, "u95": 0.01, "grade": "good", "since": "later"}}
    newer = {"answer": one(0.2).as_json() | {"method": "x", "grade": graded, "later": [1]}}
    read = RunResult.model_validate(newer | old_keys())
    assert read.answer is not None and read.answer.tau_s == 0.2
    assert read.answer.grade is not None and read.answer.grade["tau_s"].grade == "good"
    assert RunResult.model_validate({"answer": None} | {"estimates": old_keys()["estimates"]}).answer is None


# -- everybody takes it -----------------------------------------------------------------------------------------------


def test_list_panel_report_compare_tune_export_and_models_take_the_answer_and_no_other_estimate(old_run: Path) -> None:
    recording, (result, _) = read_run(old_run), read_result(old_run)
    assert result is not None
    listed = read_entry(old_run)
    assert (listed.tau_s, listed.verdict, listed.method, listed.laws) == (0.17, "ok", "sampled-data", "sag")
    assert listed.tau_percent == pytest.approx(100.0 * 0.004 / 0.17)  # of u95, not of the scatter
    (in_panel,) = Runs(old_run.parent).rows()
    assert in_panel["verdict"] == "ok" and in_panel["estimate"] is not None
    assert in_panel["estimate"]["tau_s"] == pytest.approx([0.17, 0.004])
    top = headline(load(old_run))
    assert (top.outcome, top.quantities[0].exact) == ("ok", 0.17)
    assert any("sag" in sentence for sentence in top.sentences)
    run = read_compared(old_run)
    assert (run.numbers[0], run.verdict, run.laws) == (pytest.approx(0.17), "ok", (LAW,))
    tuned = motor_of(result.answer)
    assert (tuned.framed.motor.tau_s, tuned.framed.motor.sag_per_V) == (0.17, 0.02)
    assert tuned.half_95[0] == pytest.approx(0.004)
    exported = identified_motor(old_run, ExportedRun(recording, {}, result, ()))
    assert exported.framed.numbers["tau_s"] == 0.17 and exported.provenance.verdict == "ok"
    assert known_model(old_run, math.inf).numbers["sag_per_V"] == 0.02
    assert api.read(old_run).result == result


def test_the_page_states_no_number_that_is_not_known(old_run: Path) -> None:
    run = load(old_run)
    assert run.result.answer is not None
    grade = {
        "tau_s": GradedNumber(value=0.17, u95=0.01, grade="good"),
        "K_rad_s_V": GradedNumber(grade="not known"),
        "fc_V": GradedNumber(grade="not known"),
        "fc_less_bias_V": GradedNumber(value=0.5, u95=0.01, grade="good"),
    }
    answer = run.result.answer.model_copy(update={"verdict": "doubtful", "grade": grade})
    top = headline(replace(run, result=run.result.model_copy(update={"answer": answer})))
    said = " ".join(top.sentences)
    assert "63 % of its final speed" in said
    assert "Each volt" not in said and "Coulomb friction takes" not in said
    assert top.quantities[2].parameter.symbol == "f_c − a"


# -- how it is shown --------------------------------------------------------------------------------------------------


def test_the_interval_that_people_see_is_u95_and_never_narrower_than_the_scatter() -> None:
    answer = answer_of({"sampled-data": one(0.17, half=0.002)}, u95={"tau_s": 0.01, "fc_V": 0.0001, "K_rad_s_V": None})
    assert answer is not None
    assert answer.at_95("tau_s") == pytest.approx((0.16, 0.18))
    assert answer.at_95("fc_V") == answer.interval("fc_V")
    assert answer.at_95("K_rad_s_V") == answer.interval("K_rad_s_V")
    assert answer.at_95("asym_V") is None


def shown(answer: Answer | None) -> list[str]:
    return list(answer_lines(answer, {"sag": ("sagging supply", "thin wires?")}))


def test_the_answer_is_a_few_lines() -> None:
    u95: dict[str, float | None] = {"tau_s": 0.0006, "K_rad_s_V": 0.021, "fc_V": 0.0042}
    lines = shown(answer_of({"sampled-data": one(0.17, half=1e-4)}, one(0.17, half=1e-4), (LAW,), None, u95))
    assert lines[0].split() == ["tau", "0.17000", "s", "±", "0.35", "%"]
    assert lines[1].split() == ["K", "6.460", "(rad/s)/V", "±", "0.33", "%"]
    assert re.fullmatch(r"f_c  0\.5100 V +± 0\.82 % +ok: rig promises 5 %", lines[2])
    assert lines[3] == "also: sagging supply 0.020 ± 0.010 1/V (thin wires?)"


def test_each_number_has_its_grade_and_the_answer_says_where_it_holds_and_what_it_predicts() -> None:
    grade = {
        "tau_s": GradedNumber(value=0.17, u95=0.01, grade="good"),
        "K_rad_s_V": GradedNumber(u95=3.0, grade="not known"),
        "fc_V": GradedNumber(grade="not known"),
        "fc_less_bias_V": GradedNumber(value=1.21, u95=0.05, grade="good"),
    }
    u95: dict[str, float | None] = {"tau_s": 0.01, "K_rad_s_V": 3.0, "fc_V": 0.05}
    holds = HoldsResult(drive_V=(1.2, 5.0), speed_rad_s=(10.0, 120.0), travel_rad=(0.0, 900.0), ways="forward")
    predicts = PredictsResult(error=0.17, linear_error=0.24, block_s=2.0, blocks=9)
    answer = answer_of({"sampled-data": one(0.17, "doubtful")}, u95=u95, grade=grade, predicts=predicts, holds=holds)
    lines = shown(answer)
    assert re.fullmatch(r"tau  0\.170 s +± 5\.9 % +good", lines[0])
    assert lines[1] == "K    not known: at 95 % it may be 46 % off"
    assert lines[2] == "f_c  not known: the shaft turned one way only; f_c - a = 1.210 V ± 4.1 % good"
    assert lines[3:6] == [
        "holds between 1.2 and 5 V, 10 and 120 rad/s, one way",
        "predicts 83 % of motion that it has not seen (a linear model: 76 %)",
        "doubtful: why",  # on a line of its own
    ]
    assert answer is not None and graded_words(answer) == "tau is good, K is not known, f_c is not known"


def test_where_it_holds_at_one_drive_alone_is_said_so() -> None:
    holds = HoldsResult(drive_V=(5.648, 5.652), speed_rad_s=(10.0, 1544.0), travel_rad=(0.0, 900.0), ways="forward")
    (line,) = validity(Answer(method="sampled-data", holds=holds))
    assert line == "holds at 5.65 V, between 10 and 1540 rad/s, one way"
    chirp = holds.model_copy(update={"drive_V": (1e-15, 5.65)})  # goes through zero, and through what friction takes
    (line,) = validity(Answer(method="sampled-data", fc_V=0.5, holds=chirp))
    assert line == "holds up to 5.65 V, between 10 and 1540 rad/s, one way"


def test_at_which_drive_tau_and_K_hold_is_said_where_the_bridge_lets_the_motor_run_free() -> None:
    law = LAW.model_copy(update={"numbers": {"free_between": 0.9, "full_drive_V": 12.0}})
    (line,) = validity(Answer(method="sampled-data", law=(law,)))
    assert line == "gives tau and K at a drive of 12 V: below it both are larger"


def test_a_number_that_may_be_off_by_more_than_itself_is_unknown() -> None:
    lines = shown(
        answer_of({"sampled-data": one(0.17, "doubtful")}, u95={"tau_s": 0.27, "K_rad_s_V": 1e4, "fc_V": 0.5})
    )
    assert all("unknown" in line and not re.search(r"\d", line.partition("at 95 %")[0]) for line in lines[:2])
    assert "± 98 %" in lines[2] and not any("e+" in line for line in lines)


@pytest.mark.parametrize(("true", "words"), [(0.17, "(0 % off"), (0.1699, "(+0.06 % off"), (0.2, "(-15 % off")])
def test_how_far_off_the_truth_has_two_digits_and_zero_no_sign(true: float, words: str) -> None:
    answer = answer_of({"sampled-data": one(0.17)})
    assert words in next(iter(answer_lines(answer, {}, TrueMotor(tau_s=true, K_rad_s_V=6.5, fc_V=0.5))))


def test_of_many_reasons_the_first_two_are_shown_and_of_a_refused_answer_the_first_and_no_number() -> None:
    many = {"reasons": ("first", "second", "third", "fourth")}
    refused = one(0.17, "refused").model_copy(update=many)
    assert shown(answer_of({"sampled-data": refused})) == ["refused: first", "refused: 3 more reasons"]
    doubtful = shown(answer_of({"sampled-data": one(0.17, "doubtful").model_copy(update=many)}))
    assert doubtful[-3:] == ["doubtful: first", "doubtful: second", "doubtful: 2 more reasons"]
    assert shown(None) == ["no answer: nothing was identified"]


@pytest.mark.parametrize(
    ("percent", "words"),
    [(98.74, "98.7 %"), (5.0, "5.0 %"), (99.94, "99.9 %"), (99.96, "99.96 %"), (99.9972, "99.997 %"), (100.0, "100 %")],
)
def test_a_share_is_all_only_if_nothing_is_missing(percent: float, words: str) -> None:
    """A fit of 100.0 % stood above a residual that everybody sees."""
    assert of_all(percent) == words
