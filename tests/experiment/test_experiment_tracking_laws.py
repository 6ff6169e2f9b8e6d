"""Tracking with the laws that rig identify finds: in virtual time, at fixed seeds, each bench identified once."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import rig
from evidence import evidence

from rig import config
from rig.core.estimators import LEADING
from rig.identification import Identification, identify
from rig.identification.departures import DEPARTURES
from rig.identification.motor_law import FoundLaw
from rig.model.real_motor import FramedMotor
from rig.run_folder.recording.recording import Recording
from rig.run_folder.results import HoldsResult, known
from rig.running.experiment import script as experiment
from rig.running.replay import replay
from tracking_table import BENCHES, SEEDS, bench, compare

pytestmark = [pytest.mark.long, pytest.mark.laws]

STRIBECK, UNBALANCED, SAG = [name for name in BENCHES if name.startswith(("Stribeck", "an unbalanced", "a supply"))]
PLAIN = next(name for name in BENCHES if name.startswith("none"))


@pytest.fixture(autouse=True)
def _no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each run's page takes longer than the run, and is tested elsewhere."""
    monkeypatch.setattr("rig.running.session.write_report", lambda *_: None)


@pytest.fixture(scope="module")
def sagging(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Identification]:
    """A config, a run of it, and what is identified from the run: a bench with sag."""
    folder = tmp_path_factory.mktemp("sagging")
    path = folder / "sagging.yaml"
    sag = bench(*BENCHES[SAG])
    relay = sag.relay.model_copy(update={"cycles": 5})  # enough to find it
    path.write_text(config.dump(sag.model_copy(update={"relay": relay})), encoding="utf-8")
    found: list[Identification] = []

    def kept(recordings: Sequence[Recording]) -> Identification:
        found.append(identify(recordings))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rig.running.session.write_report", lambda *_: None)
        patch.setattr("rig.running.experiment.stages.identify", kept)
        run = experiment.run(config.load(path), folder).folder
    (models,) = found
    return path, run, models


@pytest.mark.parametrize(
    ("name", "law", "seeds"),
    [
        # of one seed: test_track_drives_with_the_laws_of_another_run_and_without_them_if_told
        *evidence((SAG, "sag", SEEDS), (STRIBECK, "stribeck", SEEDS), (UNBALANCED, "force_over_position", SEEDS))
    ],
)
def test_with_the_laws_the_error_is_at_most_half_at_each_seed(
    name: str, law: str, seeds: tuple[int, ...], sagging: tuple[Path, Path, Identification], tmp_path: Path
) -> None:
    found = compare(bench(*BENCHES[name]), tmp_path, seeds, sagging[1:] if name == SAG else None)
    assert law in found.laws
    for with_laws, without in zip(found.with_laws, found.without, strict=True):
        assert without.law is None
        assert known(with_laws.rms_rad) < known(without.rms_rad)  # with the sensor's noise, 3.3 mrad, in both
        assert known(with_laws.true_rms_rad) <= 0.5 * known(without.true_rms_rad)


@pytest.mark.evidence
def test_a_motor_without_laws_is_tracked_as_before_and_most_of_its_error_is_the_sensors(tmp_path: Path) -> None:
    found = compare(bench(*BENCHES[PLAIN]), tmp_path, seeds=(1,))
    assert found.laws == ()
    for one in (*found.with_laws, *found.without):  # the answer's numbers, and those of the method alone
        assert known(one.rms_rad) < 0.0045
        assert known(one.true_rms_rad) < 0.5 * known(one.rms_rad)
        assert known(one.true_max_rad) >= known(one.true_rms_rad)


def test_a_run_with_laws_is_replayed_and_says_what_it_drove_with(sagging: tuple[Path, Path, Identification]) -> None:
    _, run, models = sagging
    assert replay(run).is_same
    real = models.real_motor
    assert real is not None
    events = [json.loads(line) for line in (run / "events.jsonl").read_text(encoding="utf-8").splitlines()]
    driven = next(event for event in events if event["kind"] == "model")
    assert FramedMotor.of({k: v for k, v in driven.items() if isinstance(v, float)}) == real
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    assert result["tracking"][LEADING]["law"] == ["sag"]
    assert result["answer"]["law_frame"]["half_travel_rad"] == real.frame.half_travel_rad


@pytest.mark.evidence
def test_track_drives_with_the_laws_of_another_run_and_without_them_if_told(
    sagging: tuple[Path, Path, Identification], tmp_path: Path
) -> None:
    path, run, models = sagging
    shown = rig("track", path, "--model", run, "--out", tmp_path / "with").stdout
    (folder,) = (tmp_path / "with").iterdir()
    with_laws = json.loads((folder / "result.json").read_text(encoding="utf-8"))["tracking"][LEADING]
    assert with_laws["law"] == ["sag"]
    assert f"(true {with_laws['true_rms_rad']:.4f})" in shown
    assert f"tracking with {LEADING}: the drive makes up for sag" in shown
    told = tmp_path / "plain.yaml"
    text = path.read_text(encoding="utf-8").replace("with_law: true", "with_law: false")
    told.write_text(text, encoding="utf-8")
    without = experiment.run_tracking(config.load(told), models.as_result(), run, tmp_path).result.tracking[LEADING]
    assert without.law is None
    assert with_laws["true_rms_rad"] < 0.5 * known(without.true_rms_rad)


def test_a_law_that_no_drive_makes_up_for_and_a_drive_beyond_the_answers_are_named(
    sagging: tuple[Path, Path, Identification], tmp_path: Path
) -> None:
    path, run, models = sagging
    assert models.motor_law is not None
    law = next(law for law in DEPARTURES if law.name == "drift")
    drift = FoundLaw(law, 0.02, (0.01, 0.03), 30.0, {"drift": 0.02})
    holds = HoldsResult(drive_V=(0.1, 0.3))
    changed = replace(models, motor_law=replace(models.motor_law, found=(*models.motor_law.found, drift), holds=holds))
    outcome = experiment.run_tracking(config.load(path), changed.as_result(), run, tmp_path)
    tracked = outcome.result.tracking[LEADING]
    assert tracked.law == ("sag",) and tracked.law_left_out == ("drift",)
    assert any("no drive makes up for drift" in note for note in outcome.result.notes)
    assert any(f"{LEADING} had a drive of" in note and "holds up to 0.3 V" in note for note in outcome.result.notes)
    assert replay(outcome.folder).is_same


def test_where_only_the_motor_with_laws_is_good_enough_it_drives_alone(
    sagging: tuple[Path, Path, Identification], tmp_path: Path
) -> None:
    path, run, models = sagging
    refused = models.estimates[LEADING].judged("refused", "for this test")
    changed = replace(models, estimates={**models.estimates, LEADING: refused})
    e = config.load(path)
    assert e.tracking is not None
    both = e.model_copy(update={"tracking": e.tracking.model_copy(update={"methods": (LEADING, "triple-relay")})})
    tracked = experiment.run_tracking(both, changed.as_result(), run, tmp_path).result.tracking
    assert tracked[LEADING].law == ("sag",) and known(tracked[LEADING].true_rms_rad) < 0.005
    assert "good enough" in (tracked["triple-relay"].not_run or "")
