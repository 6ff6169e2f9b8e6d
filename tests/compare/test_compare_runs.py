"""`rig compare` and `rig.compare` on run folders: both answers, benches, what is left out, the report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import rig
from compared_runs import Told, write_run, write_samples

import rig as api
from rig.output.text import comparison_words
from rig.run_folder.results.comparison import ComparisonResult, Difference, ScatterResult, TrendResult

DRIFTED = Told(fc_V=0.48 * 1.02)
LAW = {"name": "dead_band", "value": 0.05, "unit": "V", "ci95": [0.04, 0.06], "bic": 30.0, "numbers": {}}


def compared(*arguments: object) -> dict[str, Any]:
    done = rig("compare", *arguments, "--json")
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_a_drift_within_one_bench_is_measurable_and_within_the_scatter_of_a_motor(tmp_path: Path) -> None:
    first, second = write_run(tmp_path / "a", Told()), write_run(tmp_path / "b", DRIFTED, hour=1)
    found = compared(second, first)
    assert [run["name"] for run in found["runs"]] == ["a", "b"]  # by their start
    assert [run["bench"] for run in found["runs"]] == [1, 1]
    assert found["measurably"]["differs"]
    assert found["measurably"]["odd"] is None
    assert found["runs"][1]["off_percent"]["fc_V"] == pytest.approx(2.0, rel=0.02)
    assert not found["beyond_scatter"]["differs"]
    assert found["scatter"]["source"] == "default"
    assert compared(first, second, "--scatter", "0.1,0.1,0.1")["beyond_scatter"]["differs"]
    shown = rig("compare", first, second).stdout
    assert "differs measurably: Yes" in shown
    assert "differs beyond the scatter from run to run: No" in shown


def test_supply_and_calibration_do_not_cancel_between_benches(tmp_path: Path) -> None:
    runs = [
        write_run(tmp_path / "a", Told(supply=0.02)),
        write_run(tmp_path / "b", replace(DRIFTED, supply=0.02), supply_V=9.0),
    ]
    found = compared(*runs)
    assert [run["bench"] for run in found["runs"]] == [1, 2]
    assert not found["measurably"]["differs"]
    assert any("differ in motor supply" in note for note in found["notes"])


def test_what_tests_of_another_kind_could_explain_is_said(tmp_path: Path) -> None:
    told = Told(dead_band_V=0.02), replace(DRIFTED, dead_band_V=0.02)
    runs = [write_run(tmp_path / name, one) for name, one in zip("ab", told, strict=True)]
    assert "may come from dead band, which they do not exclude" in compared(*runs)["measurably"]["words"]


def test_what_one_run_excludes_and_another_does_not_is_no_difference_of_the_motor(tmp_path: Path) -> None:
    """Of pairs of one motor with laws 10 % differed measurably. What is more than that still differs."""
    told = Told(), replace(DRIFTED, dead_band_V=0.02), Told(fc_V=0.48 * 1.1, dead_band_V=0.02), Told(fc_V=0.481)
    runs = [write_run(tmp_path / name, one, hour=k) for k, (name, one) in enumerate(zip("abcd", told, strict=True))]
    within, beyond = compared(*runs[:2]), compared(runs[0], runs[2])
    assert not within["measurably"]["differs"] and "only some of their tests exclude" in within["measurably"]["words"]
    low, high = within["runs"][1]["off_ci95_percent"]["fc_V"]
    line_V = 1.96 * 0.01  # of the budget's half width, whose coverage is 2; supply, which both have, cancels
    assert 0.5 * (high - low) == pytest.approx(100.0 * line_V / 0.48, rel=0.05)
    assert beyond["measurably"]["differs"]
    several = compared(runs[0], runs[2], runs[3])
    assert several["measurably"]["odd"] == ["c"]


def test_friction_that_changes_over_the_travel_is_compared_over_one_travel(tmp_path: Path) -> None:
    """Each run's f_c is the mean over its own travel: three runs of one motor differed, by 1.5 % of f_c."""
    law = {"name": "friction_over_position", "value": 0.08, "ci95": [0.079, 0.081]}
    law |= {"numbers": {"friction_sin_V": 0.08, "friction_cos_V": 0.0}}
    for k, (middle, half) in enumerate(((-0.05, 0.2), (0.0, 0.25), (0.04, 0.15))):
        told = Told(fc_V=0.48 + 0.08 * middle, laws=(law,), travel_rad=(middle, half))
        write_run(tmp_path / str(k), told, hour=k)
    found = compared(*(tmp_path / str(k) for k in range(3)))
    assert not found["measurably"]["differs"] and found["measurably"]["chance"] > 0.9
    assert [run["fc_V"] for run in found["runs"]] == pytest.approx([0.48 - 0.08 * 0.01 / 3.0] * 3, abs=2e-4)
    assert any("f_c is the mean from -0.203 to 0.197 rad" in note for note in found["notes"])


def test_the_odd_one_of_several_is_named_and_judged_by_the_scatter_of_the_others(tmp_path: Path) -> None:
    scattered = [0.4795, 0.4803, 0.4812, 0.4788, 0.4801]
    runs = [write_run(tmp_path / f"r{k}", Told(fc_V=fc), hour=k) for k, fc in enumerate(scattered)]
    runs.append(write_run(tmp_path / "worn", Told(fc_V=0.53), hour=6))
    found = compared(*runs)
    assert found["measurably"]["odd"] == ["worn"]
    assert found["beyond_scatter"]["odd"] == ["worn"]
    assert found["scatter"]["source"] == "runs"
    assert found["runs"][-1]["off_percent"]["fc_V"] == pytest.approx(10.4, abs=0.3)
    same = compared(*runs[:-1])
    assert not same["measurably"]["differs"] or same["measurably"]["odd"] is None
    assert not same["beyond_scatter"]["differs"]


def test_a_trend_over_temperature_has_its_interval(tmp_path: Path) -> None:
    degrees = [20.0, 25.0, 31.0, 36.0]
    runs = [
        write_run(tmp_path / f"r{k}", Told(fc_V=0.48 * (1.0 - 0.01 * (t - 20.0))), hour=k)
        for k, t in enumerate(degrees)
    ]
    table = tmp_path / "degrees.csv"
    table.write_text("run, temperature_C\n" + "".join(f"r{k},{t}\n" for k, t in enumerate(degrees)) + "other,3\n")
    found = compared(*runs, "--temperature", table)
    by = {(one["over"], one["parameter"]): one for one in found["trends"]}
    friction = by["temperature", "fc_V"]
    assert friction["shows"]
    assert friction["ci95"][0] < -1.0 / 0.93 < friction["ci95"][1] or friction["slope"] == pytest.approx(
        -1.09, abs=0.05
    )
    assert not by["temperature", "tau_s"]["shows"]
    assert by["time", "fc_V"]["unit"] == "%/h"
    assert any("other" in note for note in found["notes"])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,T\na,3\n", "columns run and temperature_C"),
        ("run,temperature_C\na,warm\n", "degrees.csv:2: 'warm' is no temperature"),
        ("run,temperature_C\na,3\nruns/a,4\n", "degrees.csv:3: names a twice"),
    ],
)
def test_a_bad_table_of_temperatures_is_refused(text: str, said: str, tmp_path: Path) -> None:
    runs = [write_run(tmp_path / name, Told()) for name in "ab"]
    (tmp_path / "degrees.csv").write_text(text)
    done = rig("compare", *runs, "--temperature", tmp_path / "degrees.csv")
    assert done.exit_code == 2
    assert said in done.output


def test_what_cannot_be_compared_is_left_out_and_said(tmp_path: Path) -> None:
    good = [write_run(tmp_path / "a", Told()), write_run(tmp_path / "b", Told(laws=(LAW,), verdict="doubtful"))]
    killed, refused = write_run(tmp_path / "killed"), write_run(tmp_path / "refused", Told(verdict="refused"))
    tracked, old = write_run(tmp_path / "tracked", Told()), write_run(tmp_path / "old", Told())
    unknown = write_run(tmp_path / "unknown", Told())
    for folder, change in (
        (tracked, {"models_from": "runs/x"}),
        (old, {"budget": None, "u95": None}),
        (unknown, {"estimates": {}}),
    ):
        result = json.loads((folder / "result.json").read_text())
        (folder / "result.json").write_text(json.dumps(result | change))
    # as a run whose laws give no number: its plain fit has tau, K and f_c with a small scatter, 5 % off
    unbounded = write_run(tmp_path / "unbounded", Told(verdict="doubtful"))
    result = json.loads((unbounded / "result.json").read_text())
    answer = result["estimates"]["sampled-data"] | {"grade": {"tau_s": {}, "K_rad_s_V": {}, "fc_V": {}}, "law": []}
    (unbounded / "result.json").write_text(json.dumps(result | {"answer": answer}))
    damaged = write_run(tmp_path / "damaged", Told())
    result = json.loads((damaged / "result.json").read_text())
    for estimate in result["estimates"].values():
        estimate["covariance"][0].pop()
    (damaged / "result.json").write_text(json.dumps(result))
    found = compared(*good, killed, refused, tracked, old, unknown, unbounded, damaged)
    assert sorted(run["name"] for run in found["runs"]) == ["a", "b", "old"]
    why = {Path(one["folder"]).name: one["reason"] for one in found["left_out"]}
    assert "no result.json" in why["killed"]
    assert "refused: too few cycles" in why["refused"]
    assert "runs/x" in why["tracked"]
    assert "identified no motor" in why["unknown"]
    assert "does not know its motor: too few cycles" in why["unbounded"]
    assert "is damaged" in why["damaged"]
    notes = "\n".join(found["notes"])
    assert "old: no budget" in notes
    assert "not ok: b" in notes
    assert "dead band shows in b only" in notes
    alone = rig("compare", good[0], killed)
    assert alone.exit_code == 1
    assert "no result.json" in alone.output
    assert rig("compare", good[0], good[0]).exit_code == 2
    assert rig("compare", good[0], tmp_path).exit_code == 2
    assert rig("compare", *good, "--scatter", "1,2").exit_code == 2


@pytest.mark.usefixtures("undrawn")
def test_the_report_lays_the_runs_over_each_other(tmp_path: Path) -> None:
    runs = [write_run(tmp_path / name, Told(), hour=k) for k, name in enumerate(("a", "b", "c"))]
    for seed, run in enumerate(runs):
        write_samples(run, seed)
    found = api.compare([*runs[:2], str(runs[2])], temperatures_C={"a": 20.0, "b": 21.0, "c": 23.0})
    assert (found.differs_measurably, found.differs_beyond_scatter, found.odd) == (False, False, ())
    assert "differs measurably: No" in found.summary()
    page = found.report(tmp_path / "page.html").read_text(encoding="utf-8")
    for figure in ("values", "time", "temperature", "cycles", "residuals", "tracking"):
        assert f'<figure id="{figure}">' in page
    assert page.count("<td>100 %</td>") == 3
    assert "http" not in page.replace("http://www.w3.org", "")  # nothing is loaded from elsewhere
    again = rig("compare", *runs, "--to", tmp_path / "page.html")
    assert again.exit_code == 2
    assert "is there already" in again.output
    assert rig("compare", *runs, "--to", tmp_path / "page.pdf").exit_code == 2
    with pytest.raises(api.CompareError, match="two runs"):
        api.compare(runs[:1])
    with pytest.raises(ValueError, match="0 to 100"):
        api.compare(runs, scatter_percent=(1.0, -1.0, 0.0))


def test_a_large_difference_is_in_per_cent_of_the_other(tmp_path: Path) -> None:
    first, second = (
        write_run(tmp_path / "a", Told()),
        write_run(tmp_path / "b", Told(tau_s=0.34, K_rad_s_V=1.3), hour=1),
    )
    off = [run["off_percent"] for run in compared(first, second)["runs"]]
    assert (off[0]["tau_s"], off[1]["tau_s"]) == (pytest.approx(-50.0), pytest.approx(100.0))
    assert (off[0]["K_rad_s_V"], off[1]["K_rad_s_V"]) == (pytest.approx(400.0), pytest.approx(-80.0))


@pytest.mark.parametrize(
    ("half", "said"),
    [(99.0, "tau +3 ±99 %/h (none shows)"), (699.0, "tau not known to 100 %/h: give runs farther apart")],
)
def test_a_slope_that_may_be_anything_is_unknown(half: float, said: str) -> None:
    trend = TrendResult(
        over="time", parameter="tau_s", unit="%/h", slope=3.0, ci95=(3.0 - half, 3.0 + half), chance=0.9, shows=False
    )
    same = Difference(differs=False, chance=1.0, odd=(), words="No.")
    found = ComparisonResult(
        runs=(), level=0.05, measurably=same, beyond_scatter=same, trends=(trend,),
        scatter=ScatterResult(source="stated", percent=dict.fromkeys(("tau_s", "K_rad_s_V", "fc_V"), 1.0), why=""),
    )  # fmt: skip
    assert f"trend over time: {said}" in comparison_words(found)
