"""The result file: whatever ends the program, whole rows stay, and rows of two campaigns never mix."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from small_campaign import small

from rig.campaign import results
from rig.campaign.random_motors import CampaignError
from rig.campaign.trial import COLUMNS, Row, run_trial
from rig.config import load_campaign


@cache
def rows() -> list[Row]:
    return [run_trial(small(), k) for k in (4, 0, 2)]


def filled(folder: Path) -> Path:
    with results.opened(folder, small()) as file:
        file.append(rows()[:2])
        file.append(rows()[2:])
    return folder / results.RESULTS


def test_rows_come_back_exactly_by_number(tmp_path: Path) -> None:
    path = filled(tmp_path / "one")
    table = results.read(tmp_path / "one")
    ordered = sorted(rows(), key=lambda row: row["number"])
    for name in COLUMNS:
        np.testing.assert_array_equal(table[name], [row[name] for row in ordered])
    with path.open(newline="", encoding="utf-8") as file:
        assert next(csv.reader(file)) == list(COLUMNS)
    assert results.read(tmp_path / "one", 3)["number"].tolist() == [0, 2]


def test_texts_with_commas_quotes_and_line_ends_stay_in_one_row(tmp_path: Path) -> None:
    row = rows()[0] | {"verdict": "refused", "reasons": 'a "word", and\nanother line', "tau_s": math.nan}
    with results.opened(tmp_path, small()) as file:
        file.append([row])
    table = results.read(tmp_path)
    assert table["reasons"].tolist() == ['a "word", and another line']
    assert np.isnan(table["tau_s"][0])
    assert (tmp_path / results.RESULTS).read_bytes().count(b"\n") == 2


@pytest.mark.parametrize("torn", [1, 40, 200])
def test_a_torn_last_line_is_cut_off_and_its_experiment_is_missing(tmp_path: Path, torn: int) -> None:
    path = filled(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-torn])
    assert results.read(tmp_path)["number"].tolist() == [0, 4]
    with results.opened(tmp_path, small()) as file:
        assert file.done == {0, 4}
        file.append(rows()[2:])
    assert path.read_bytes() == whole


def test_a_header_that_was_torn_is_written_again(tmp_path: Path) -> None:
    path = filled(tmp_path)
    path.write_bytes(path.read_bytes()[:30])
    with results.opened(tmp_path, small()) as file:
        assert file.done == set()
    assert path.read_text(encoding="utf-8") == results.HEADER


def test_another_campaign_is_refused_and_says_which_key_differs(tmp_path: Path) -> None:
    filled(tmp_path)
    with (
        pytest.raises(CampaignError, match=r"sensor\.noise_rad is 0\.003 there and 0\.004 here"),
        results.opened(tmp_path, small(sensor={"noise_rad": 0.004})),
    ):
        pass


def test_rows_of_another_version_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled(tmp_path)
    monkeypatch.setattr(results, "program_hash", lambda: "0" * 64)
    with pytest.raises(CampaignError, match="another version"), results.opened(tmp_path, small()):
        pass


def test_more_experiments_and_another_name_are_the_same_campaign(tmp_path: Path) -> None:
    filled(tmp_path)
    more = small(1000).model_copy(update={"name": "renamed"})
    with results.opened(tmp_path, more) as file:
        assert file.done == {0, 2, 4}
    assert results.folder_for(tmp_path, small(24)) == results.folder_for(tmp_path, small(1000))
    assert results.folder_for(tmp_path, small()) != results.folder_for(tmp_path, small(seed=2))


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with (
        results.opened(tmp_path, small()),
        pytest.raises(CampaignError, match="another process"),
        results.opened(tmp_path, small()),
    ):
        pass


def test_the_folder_says_what_it_is(tmp_path: Path) -> None:
    filled(tmp_path)
    meta = json.loads((tmp_path / "meta.json").read_text(encoding="utf-8"))
    assert meta["config_sha256"] == results.config_hash(small())
    assert meta["campaign"]["relay"]["cycles"] == 6
    assert load_campaign(tmp_path / "config.yaml") == small()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace(",ok,", ",", 1), ":2: is broken"),
        (lambda text: text.replace("\n4,", "\nfour,", 1), ":2: is broken"),
        (lambda text: text.replace("number,", "nr,", 1), ":1: these are not the columns"),
        (lambda text: text + text.splitlines()[1] + "\n", "experiment 4 twice"),
    ],
)
def test_a_broken_file_is_said_with_its_line(tmp_path: Path, change: Callable[[str], str], words: str) -> None:
    path = filled(tmp_path)
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(CampaignError, match=words), results.opened(tmp_path, small()):
        pass


def test_foreign_folders_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "results.csv").write_text("somebody's\n", encoding="utf-8")
    with pytest.raises(CampaignError, match="not a campaign's folder"), results.opened(tmp_path, small()):
        pass
    assert (tmp_path / "results.csv").read_text(encoding="utf-8") == "somebody's\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results.csv"]
    (tmp_path / "meta.json").write_text("[]", encoding="utf-8")
    with pytest.raises(CampaignError, match="does not say"), results.opened(tmp_path, small()):
        pass
