"""The picture and the page: cells that hold what they say, and something to see whatever there is."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, cast

import matplotlib.image
import numpy as np
import pytest
from evidence import evidence
from small_campaign import small, table

from rig.campaign import report, summary
from rig.campaign.report import HEADINGS, sentences, table_rows, write_report
from rig.config import Campaign
from rig.identification.estimate import PARAMETERS

pytestmark = pytest.mark.drawn

GRID = Campaign(name="grid", experiments=1)


def scattered(rows: int, **columns: Any) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    tau, fc = np.exp(rng.uniform(math.log(0.08), math.log(0.5), rows)), rng.uniform(0.1, 0.5, rows)
    errors = 0.01 * rng.standard_normal((2, rows))
    given = {"true_tau_s": tau, "tau_s": tau + errors[0], "true_fc_V": fc, "fc_V": fc + errors[1]}
    for name, value in (("tau_s", tau + errors[0]), ("fc_V", fc + errors[1])):
        given |= {f"low_{name}": value - 0.0196, f"high_{name}": value + 0.0196}
    return table(rows, **(given | columns))


def test_cells_hold_the_rows_of_their_tau_and_fc() -> None:
    rows = scattered(500)
    tau, fc = report.grid_edges(GRID, 500)
    assert (tau[0], tau[-1], fc[0], fc[-1]) == pytest.approx((0.08, 0.5, 0.1, 0.5))
    values, counts = report.cells(rows, (tau, fc), lambda inside: float(np.sum(inside)))
    assert counts.sum() == 500
    for i in range(fc.size - 1):
        for j in range(tau.size - 1):
            inside = [
                tau[j] <= t < tau[j + 1] and fc[i] <= f < fc[i + 1]
                for t, f in zip(rows["true_tau_s"], rows["true_fc_V"], strict=True)
            ]
            assert counts[i, j] == values[i, j] == sum(inside)


def test_cells_with_few_experiments_say_nothing() -> None:
    values, counts = report.cells(scattered(20), report.grid_edges(GRID, 20), lambda inside: 1.0)
    assert np.array_equal(np.isfinite(values), counts >= report.FEWEST_IN_CELL)


def test_a_motor_that_does_not_vary_still_has_a_cell() -> None:
    fixed = small(motor={"tau_s": (0.17, 0.17), "fc_V": (0.5, 0.5)})
    tau, fc = report.grid_edges(fixed, 100)
    assert tau[0] < 0.17 < tau[-1]
    assert fc[0] < 0.5 < fc[-1]


ALL_VERDICTS = scattered(30, verdict=["ok", "doubtful", "refused"] * 10)


@cache
def drawn_all_verdicts() -> bytes:
    return report.drawn(GRID, ALL_VERDICTS)


@pytest.mark.parametrize(
    "drawn",
    [
        drawn_all_verdicts,
        *evidence(
            lambda: report.drawn(GRID, table(3, verdict="refused", **dict.fromkeys(PARAMETERS, math.nan))),
            lambda: report.drawn(GRID, scattered(40, **{f"bound_{name}": math.nan for name in PARAMETERS})),
            lambda: report.drawn(GRID, table(1)),
        ),
    ],
    ids=["all verdicts", "no estimate", "no bound", "exact"],
)
def test_there_is_a_picture_whatever_came_out(tmp_path: Path, drawn: Callable[[], bytes]) -> None:
    path = tmp_path / "picture.png"
    path.write_bytes(drawn())
    pixels = matplotlib.image.imread(path)
    assert pixels.shape[1] == 1500
    assert np.ptp(pixels) > 0.5


@pytest.mark.evidence
def test_the_same_rows_give_the_same_picture() -> None:
    """Of the case that has most to draw."""
    assert report.drawn(GRID, ALL_VERDICTS) == drawn_all_verdicts()


@pytest.mark.evidence
def test_the_page_stands_alone_and_holds_the_table(tmp_path: Path) -> None:
    rows = scattered(60)
    found = cast(summary.Summary, summary.summarise(rows) | {"session": {"experiments": 0}})
    write_report(tmp_path, GRID, rows, found)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.search(r'(?:src|href)="(?!data:)', page)
    assert "60 random experiments" in page
    for row in table_rows(found["ok"]):
        for cell in row:
            assert f"<td>{cell}</td>" in page
    assert (tmp_path / "campaign.png").stat().st_size > 10_000


def test_the_table_shows_per_cent_where_the_truth_is_no_zero() -> None:
    found = summary.summarise(table(4, tau_s=1.02, asym_V=1.001))
    rows = {row[0]: row for row in table_rows(found["ok"])}
    assert all(len(row) == len(HEADINGS) for row in rows.values())
    assert rows["tau, s"][5] == "2.00 %"
    assert rows["asymmetry, V"][5] == "0.001"
    assert rows["K, (rad/s)/V"][-1] == "100.0 ± 0.0"


def test_outliers_are_named() -> None:
    found = summary.summarise(table(3, tau_s=[1.0, 1.2, 1.0])) | {
        "session": {"experiments": 3, "seconds": 1.5, "experiments_per_s": 2.0, "backend": "joblib", "workers": "2"}
    }
    text = "\n".join(sentences(cast(summary.Summary, found)))
    assert "above 5 % in tau, K or f_c: 1 (1)" in text
    assert "3 done now in 1.5 s: 2.0 a second" in text
