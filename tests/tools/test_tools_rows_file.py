"""The rows of a campaign on disk: what an interruption, other code and a fresh clone leave of them."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from shared import rows_file
from shared.rows_file import RowsFile
from shared.share import at_most, bounds, counted

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(rows_file, "ROOT", tmp_path)
    (tmp_path / "law.py").write_text("a = 1\n", encoding="utf-8")
    return tmp_path


def test_what_an_interruption_tore_is_lost_alone() -> None:
    RowsFile("c", ["law.py"]).add({"number": 0, "laws": [["sag", 3.0]]})
    with RowsFile("c", ["law.py"]).path.open("a", encoding="utf-8") as file:
        file.write('{"number": 1, "la')
    again = RowsFile("c", ["law.py"])
    again.add({"number": 2})
    assert again.read() == [{"number": 0, "laws": (("sag", 3.0),)}, {"number": 2}]


def test_rows_of_other_code_start_anew_and_come_back_with_it(root: Path) -> None:
    RowsFile("c", ["law.py"]).add({"number": 0})
    (root / "law.py").write_text("a = 2\n", encoding="utf-8")
    assert RowsFile("c", ["law.py"]).read() == []
    (root / "law.py").write_text("a = 1\n", encoding="utf-8")
    assert RowsFile("c", ["law.py"]).read() == [{"number": 0}]


def test_a_fresh_clone_goes_on_from_the_rows_that_were_kept(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = RowsFile("c", ["law.py"])
    file.add({"number": 0})
    file.keep()
    file.path.unlink()
    assert RowsFile("c", ["law.py"]).read() == [{"number": 0}]
    (root / "law.py").write_text("a = 2\n", encoding="utf-8")
    assert RowsFile("c", ["law.py"]).read() == []
    assert "c.jsonl.gz holds rows of other code" in capsys.readouterr().err


def test_the_same_rows_are_kept_as_the_same_bytes() -> None:
    file = RowsFile("c", ["law.py"])
    file.add({"number": 0})
    file.keep()
    once = file.kept.read_bytes()
    file.keep()
    assert file.kept.read_bytes() == once


def test_a_share_has_the_exact_bounds() -> None:
    # Clopper and Pearson: quantiles of beta(3, 98) and beta(2, 99), beta(3, 98)
    assert at_most(2, 100) == pytest.approx(0.0616, abs=5e-5)
    assert bounds(2, 100) == pytest.approx((0.00243, 0.07038), abs=5e-5)
    assert bounds(0, 10)[0] == 0.0
    assert counted([True] * 3 + [False]) == ("3 of 4: 75.0 %", "19.4 to 99.4 %")
    assert counted([]) == ("–", "")


@pytest.mark.parametrize("campaign", ["campaign_real", "comparing", "stalls", "stopping", "tune"])
def test_the_code_that_makes_the_rows_of_a_campaign_is_there(campaign: str) -> None:
    told = vars(import_module(f"{campaign}.__main__"))
    made_by = [part for name, parts in told.items() if name.startswith(("MADE_BY", "GAINS_BY")) for part in parts]
    assert made_by
    assert [part for part in made_by if not (PROJECT / part).exists()] == []
