"""Which records of a run enter the fit, up to which row, and which are left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evidence import evidence

from campaign_real.departing_motor import Bench, Departures, PlainMotor, relay_test
from rig.identification import IdentifyError, identify, sampled_data
from rig.identification.identification import Identification
from rig.identification.measurements import Measurements
from rig.identification.motor_law import motor_law
from rig.identification.records import sound_rows
from rig.run_folder.recording.reader import read
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.results import RunEvent, RunMeta

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "simulated"
LED_BY = ("sampled-data",)


@pytest.fixture(scope="module")
def run() -> Recording:
    """A whole run: breakaway, search, two relay tests, tracking."""
    return read(GOLDEN)


@pytest.fixture(scope="module")
def found(run: Recording) -> Identification:
    return identify([run], LED_BY)


def told(found: Identification) -> dict[str, Any]:
    return found.as_result().as_json()


def names(found: Identification) -> list[str]:
    assert found.motor_law is not None
    return [record.name for record in found.motor_law.records]


def half_width(found: Identification, name: str = "fc_V") -> float:
    estimate = found.motor_law.estimate if found.motor_law is not None else None
    low, high = (estimate or found.estimates["sampled-data"]).ci95[name]
    return high - low


def ended(run: Recording, code: str, stage: str, rows: int) -> Recording:
    """The run as if a fault had ended it ``rows`` rows after the start of ``stage``."""
    cut = run.select(0, run.stage_rows(stage).start + rows - 1)
    return replace(cut, events=(*run.events, RunEvent(t_s=float(cut.t_s[-1]), kind="fault", code=code)))


def test_gain_search_and_breakaway_enter_the_fit_and_make_it_narrower(run: Recording, found: Identification) -> None:
    tests_alone = identify([run], LED_BY, without=("search", "breakaway"))
    assert sorted(names(found)) == ["breakaway", "relay-1", "relay-2", "search"]
    assert sorted(names(tests_alone)) == ["relay-1", "relay-2"]
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert half_width(found, name) < 0.97 * half_width(tests_alone, name)
    answer = told(found)["answer"]
    assert answer["tau_s"] == pytest.approx(0.17, rel=0.01)
    assert answer["reasons"] == []  # how few cycles may be is for the intervals and the budget to say
    plain, alone = found.estimates["sampled-data"], tests_alone.estimates["sampled-data"]
    for name, true in (("tau_s", 0.17), ("K_rad_s_V", 6.5), ("fc_V", 0.48)):
        widths = [one.ci95[name][1] - one.ci95[name][0] for one in (plain, alone)]
        assert widths[0] < 0.6 * widths[1]  # the plain estimate is of everything driven
        assert plain.ci95[name][0] < true < plain.ci95[name][1]
    assert plain.verdict == "ok"  # although its tests have three and four settled cycles: the intervals say enough
    assert tests_alone.breakaway is None


def test_tracking_changes_neither_estimates_nor_law_nor_verdict(run: Recording, found: Identification) -> None:
    tracking = np.char.startswith(run.stage, "track:")
    assert tracking.sum() > 100
    spoilt = replace(run, y_rad=np.where(tracking, 0.5 - run.y_rad, run.y_rad), u_V=np.where(tracking, 1.0, run.u_V))
    assert told(identify([spoilt], LED_BY)) == told(found)


@pytest.mark.evidence
def test_a_strange_stretch_of_the_search_is_left_out_and_the_verdict_stays(
    run: Recording, found: Identification
) -> None:
    rows = run.stage_rows("search")
    hand = np.zeros(len(run))
    middle = (rows.start + rows.stop) // 2
    hand[middle : middle + 40] = 0.25 * np.sin(np.linspace(0.0, np.pi, 40))
    touched = identify([replace(run, y_rad=run.y_rad + hand)], LED_BY)
    assert touched.motor_law is not None
    assert found.motor_law is not None
    assert touched.estimates["sampled-data"].verdict == found.estimates["sampled-data"].verdict
    assert told(touched)["answer"]["verdict"] == told(found)["answer"]["verdict"]
    assert touched.motor_law.found == found.motor_law.found == ()
    assert any("search: not in the law's fit from row" in note for note in touched.notes)
    search = next(record for record in touched.motor_law.records if record.name == "search")
    assert search.rows is not None
    assert rows.start <= search.rows[0] < search.rows[1] < middle


@pytest.mark.parametrize("rows", [150, *evidence(60)])
def test_a_stretch_that_is_left_out_is_told_where_laws_are_chosen_again_from_all_rows(rows: int) -> None:
    """With the strange stretch the laws leave more than noise; without it little else, so all rows count then.

    With the longer one a fit to all records has no law at all, and tells the tests worse than their own law does.
    """
    motor, law = PlainMotor(0.3, 3.0, 0.3), Departures(force_V=0.3, force_phase_rad=1.0)
    bench = Bench(noise_rad=0.0005, lsb_rad=4.2 / 16384)
    records = []
    for k, gains_V in enumerate(((0.8, 1.1), (0.6, 0.9), (0.7, 1.0))):
        seen = relay_test(motor, law, bench, gains_V, 800, (10.0 * k, 40.0), np.random.SeedSequence(k))
        records.append(TimeSeries(seen.t_s, seen.y_rad, seen.t_s + bench.delay_s, seen.u_V, name=f"record-{k}"))
    *tests, third = records
    third.y_rad[500 : 500 + rows] += 0.25 * np.sin(np.linspace(0.0, np.pi, rows))
    found = motor_law(tests, sampled_data.fit(tests), [None, None], further=[(third, 0)])
    assert [one.law.name for one in found.found] == ["force_over_position"]
    assert [record.rows for record in found.records] == [(0, 799), (0, 799), (0, 493)]
    assert [words.partition(":")[0] for words in found.remarks] == ["record-2"]


def test_a_name_that_no_record_has_is_refused_with_those_there_are(run: Recording) -> None:
    with pytest.raises(IdentifyError, match="no record 'tracking'") as error:
        identify([run], without=("tracking",))
    assert error.value.cure == "the records are breakaway, search, relay-1, relay-2"
    with pytest.raises(IdentifyError, match="every relay test is left out"):
        identify([run], without=("relay-1", "relay-2"))


def test_what_the_runs_config_leaves_out_stays_out(run: Recording) -> None:
    meta = RunMeta.model_validate({**run.meta.model_dump(by_alias=True), "identify_without": ("relay-2", "survey")})
    found = identify([replace(run, meta=meta)], LED_BY, choose_law=False)
    assert [relay.stage for relay in found.relays] == ["relay-1"]


@pytest.mark.parametrize(("code", "periods"), [("NO_CYCLE", 0), ("SENSOR_STUCK", 1)])
def test_after_a_fault_of_sensor_or_drive_the_last_period_is_left_out(run: Recording, code: str, periods: int) -> None:
    broken = ended(run, code, "relay-2", 400)
    rows, remark = sound_rows(broken, "relay-2")
    lost = broken.stage_rows("relay-2").stop - rows.stop
    period = max(float(str(event.detail["period_s"])) for event in run.events if event.kind == "cycle") / 0.01
    assert 0.9 * period * periods <= lost <= 1.15 * period * periods  # and two ticks
    assert (remark is None) == (periods == 0)
    assert sound_rows(broken, "relay-1") == (broken.stage_rows("relay-1"), None)


def test_a_run_that_ended_in_its_second_test_gives_its_first(run: Recording) -> None:
    found = identify([ended(run, "INTERRUPTED", "relay-2", 15)], LED_BY, choose_law=False)
    assert found.estimates["sampled-data"].verdict != "refused"
    assert "relay-2: left out, because fewer than 20 of its rows can be used" in found.notes


def test_a_test_that_ended_in_its_first_stroke_is_left_out(run: Recording) -> None:
    """Of a law in the device these are many rows."""
    u_V = run.u_V.copy()
    u_V[run.stage_rows("relay-2")] = 1.0
    found = identify([replace(run, u_V=u_V)], LED_BY, choose_law=False)
    assert "relay-2: left out, because its drive never changed" in found.notes
    assert [relay.stage for relay in found.relays] == ["relay-1"]


def test_a_run_that_ended_in_the_gain_search_gives_the_search(run: Recording) -> None:
    rows = run.stage_rows("search")
    found = identify([ended(run, "NO_CYCLE", "search", rows.stop - rows.start)], LED_BY, choose_law=False)
    estimate = found.estimates["sampled-data"]
    assert estimate.tau_s == pytest.approx(0.17, rel=0.05)
    assert estimate.verdict != "refused", estimate.reasons
    with pytest.raises(IdentifyError, match="no relay test"):
        identify([run.select(0, run.stage_rows("breakaway").stop - 1)])


@pytest.mark.parametrize(("share", "beside"), [(1.0, 4), (1.3, 0)])
def test_of_runs_that_do_not_agree_the_tests_alone_are_searched_for_laws(
    run: Recording, share: float, beside: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside searches no level of friction in each is looked for: K was 38 % off beside 16 %, of two days."""
    given: list[int] = []

    def law(*asked: Any, **_: Any) -> None:
        given.append(len(asked[4]))
        raise IdentifyError("enough", "none")

    monkeypatch.setattr("rig.identification.identification.motor_law", law)
    identify([run, replace(run, u_V=share * run.u_V)], LED_BY)
    assert given == [beside]


def test_an_unknown_delay_is_that_of_every_record() -> None:
    """Records that kept the reported times would bend the fit, or be left out as another motor's."""
    t_s = 0.01 * np.arange(30.0)
    test, beside = (TimeSeries(t_s, np.zeros(30), t_s + 0.001, np.ones(30)) for _ in range(2))
    data = Measurements(tests=[test], further=[(beside, 0)], sources=[("run", [test])])
    data.take_unknown_delay((0.0, 0.05))
    assert [series.delay_s for series in (data.tests[0], data.further[0][0])] == [(0.0, 0.05)] * 2
    assert data.sources[0][1][0] is data.tests[0] and data.further[0][1] == 0
