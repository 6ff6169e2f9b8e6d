"""A real machine: the record EMPS, which RIG_EMPS names; it is not part of the project."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from emps import __main__ as emps
from emps import record as published
from emps.found import Found, every_other, prediction, whole
from emps.found import published as published_law

pytestmark = [pytest.mark.long, pytest.mark.drawn]
FILE = os.environ.get("RIG_EMPS", "")
PUBLISHED = published.PUBLISHED


WITH_RECORD = pytest.mark.skipif(not FILE, reason="RIG_EMPS names no file: the record is not part of the project")


def published_numbers(one: Found) -> None:
    assert "viscous_by_direction" in one.names
    assert one.drive.viscous_half_N_s_m == pytest.approx(37.0, abs=4.0)
    assert one.drive.mass_kg == pytest.approx(PUBLISHED.mass_kg, rel=0.03)
    assert one.drive.friction_N == pytest.approx(PUBLISHED.friction_N, rel=0.08)
    length_s, fitted_m = one.law.growth[0]
    assert 1.2 < length_s < 2.5  # of the first pieces: about 2 s
    assert fitted_m < 0.25e-3


@WITH_RECORD
@pytest.mark.evidence  # make test has another real motor: test_a_record_of_a_real_motor_has_its_published_numbers
def test_a_real_drive_has_its_published_numbers_and_the_law_predicts_what_it_has_not_seen() -> None:
    record = published.read(Path(FILE))
    half = every_other(record)
    published_numbers(half)
    theirs = prediction(published_law(record), record)
    assert half.prediction.odd < theirs.odd  # held out from ours, seen by theirs
    assert not half.prediction.fails
    assert half.prediction.free < theirs.free


@WITH_RECORD
@pytest.mark.evidence
def test_the_whole_record_has_them_too_and_its_page_is_written(tmp_path: Path) -> None:
    published_numbers(whole(published.read(Path(FILE))))
    assert emps.main(tmp_path) == 0
    assert "held out in the last column" in (tmp_path / "emps.md").read_text(encoding="utf-8")
    assert (tmp_path / "figures" / "emps.svg").read_bytes().startswith(b"<?xml")


def test_without_the_file_it_says_where_it_is_published(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("RIG_EMPS", raising=False)
    assert emps.main() == 2
    assert "nonlinearbenchmark.org" in capsys.readouterr().err


def test_another_file_is_refused_with_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other.mat").write_text("t,u,y\n", encoding="utf-8")
    monkeypatch.setenv("RIG_EMPS", str(tmp_path / "other.mat"))
    assert emps.main() == 2
    assert "other.mat is not DATA_EMPS.mat" in capsys.readouterr().err
