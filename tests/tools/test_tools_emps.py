"""A real machine: the record EMPS, which RIG_EMPS names; it is not part of the project."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import emps

FILE = os.environ.get("RIG_EMPS", "")


@pytest.mark.skipif(not FILE, reason="RIG_EMPS names no file: the record is not part of the project")
def test_a_real_drive_has_viscous_friction_that_differs_by_direction_and_its_published_numbers() -> None:
    one = emps.found(Path(FILE))
    assert "viscous_by_direction" in [law.law.name for law in one.law.found]
    assert one.viscous_by_direction_N_s_m == pytest.approx(37.0, abs=4.0)
    assert one.mass_kg == pytest.approx(emps.MASS_KG, rel=0.03)
    assert one.friction_N == pytest.approx(emps.FRICTION_N, rel=0.08)
    length_s, rms_m = one.pieces_m[0]
    assert 1.5 < length_s < 2.5
    assert rms_m < 0.25e-3
    assert one.plain.rms_rad > 10.0 * rms_m
    assert "published 95.15" in emps.page(one)


def test_without_the_file_it_says_where_it_is_published(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("RIG_EMPS", raising=False)
    assert emps.main() == 2
    assert "nonlinearbenchmark.org" in capsys.readouterr().err
