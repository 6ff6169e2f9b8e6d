"""As SysId is tested: every subset of the data either gives the right gains or is not believed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evidence import evidence
from foreign_bench import (
    PAPER,
    QUICK,
    certain_but_for_laws,
    chirp,
    motor,
    plain_csv,
    relay,
    sampled,
    square,
    ticks,
)

from rig.identification import identify
from rig.identification.estimate import Estimate
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.reader import read
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.sample_columns import COLUMNS

pytestmark = pytest.mark.long

PLAIN = ("t_s", "u_V", "y_rad")
WITH_DRIVE_TIMES = (*PLAIN, "t_u_s")
ROWS = 1500
NAMES = ("tau_s", "K_rad_s_V", "fc_V")


def subset(recording: Recording, rows: slice) -> Recording:
    return replace(recording, **{name: getattr(recording, name)[rows] for name in COLUMNS})


def contiguous() -> list[slice]:
    """Lengths from less than a cycle to all, each from several starts."""
    return [
        slice(first, first + length)
        for length in (60, 100, 170, 300, 600, 1000, ROWS)
        for first in range(0, ROWS - length + 1, max(length // 2, 350))
    ]


def outcome(recording: Recording, truth: dict[str, float]) -> tuple[str, Estimate | None]:
    """Verdict, "error" where there is nothing to fit, or "wrong": called ok, and more than it may be off.

    A doubt for nothing but the laws that one size of drive cannot tell counts as ok: these motors are plain.
    """
    try:
        found = identify([recording], ["sampled-data"], choose_law=False).estimates["sampled-data"]
    except IdentifyError as error:
        assert error.cause
        assert error.cure
        return "error", None
    if not certain_but_for_laws(found):
        assert found.reasons
        return found.verdict, found
    values = np.array([getattr(found, name) for name in NAMES])
    half = np.array([0.5 * (found.ci95[name][1] - found.ci95[name][0]) for name in NAMES]) / values
    off = np.abs(values / [truth[name] for name in NAMES] - 1.0)
    right = np.all(off <= np.minimum(0.05, np.maximum(3.0 * half, 0.02)))
    return ("ok" if right else "wrong"), found


def outcomes(path: Path, truth: dict[str, float], choices: list[slice]) -> dict[str, list[slice]]:
    recording = read(path)
    seen: dict[str, list[slice]] = {}
    for rows in choices:
        seen.setdefault(outcome(subset(recording, rows), truth)[0], []).append(rows)
    return seen


FEW = [slice(0, 60), slice(350, 520), slice(300, 900), slice(0, ROWS)]


@pytest.mark.parametrize(
    ("drive", "truth", "names", "choices"),
    [
        ("relay", PAPER, PLAIN, FEW),
        *evidence(
            ("relay", PAPER, PLAIN, contiguous()),
            ("relay", QUICK, PLAIN, contiguous()),
            ("chirp", PAPER, PLAIN, contiguous()),
            ("square", PAPER, PLAIN, contiguous()),
            ("relay", PAPER, WITH_DRIVE_TIMES, contiguous()),
            ("chirp", PAPER, WITH_DRIVE_TIMES, contiguous()),
        ),
    ],
)
def test_every_stretch_of_a_good_record_is_right_or_not_believed(
    tmp_path: Path, drive: str, truth: dict[str, float], names: tuple[str, ...], choices: list[slice]
) -> None:
    law = {"relay": relay(truth["fc_V"]), "chirp": chirp(1.4, 15.0), "square": square(1.2, 1.0)}[drive]
    columns = sampled(motor(**truth), law, ticks(ROWS), 0.004, seed=7)
    seen = outcomes(plain_csv(tmp_path / "a.csv", columns, names), truth, choices)
    assert seen.get("wrong", []) == []
    assert slice(0, ROWS) in seen["ok"]  # refusing all would be easy
    assert slice(0, 60) not in seen["ok"]  # 0.6 s


@pytest.mark.parametrize("numbers", [[1, 12], *evidence([1, 2, 3, 5, 8, 12])])
def test_whole_cycles_of_a_relay_test_are_right_or_not_believed_from_three_to_all(
    tmp_path: Path, numbers: list[int]
) -> None:
    """Cut where the drive steps up to its maximum, as one would by eye."""
    columns = sampled(motor(**PAPER), relay(0.5), ticks(ROWS), 0.004, seed=3)
    up = np.flatnonzero((columns["u_V"][1:] > 1.5) & (columns["u_V"][:-1] < 0.0)) + 1
    assert up.size > 12
    cuts = [slice(int(up[a]), int(up[a + cycles])) for cycles in numbers for a in (0, up.size - 1 - cycles)]
    seen = outcomes(plain_csv(tmp_path / "a.csv", columns), PAPER, cuts)
    assert seen.get("wrong", []) == []
    assert cuts[-1] in seen["ok"]
    assert cuts[0] not in seen.get("ok", [])


@pytest.mark.evidence
@pytest.mark.parametrize(
    ("drive", "names"), [("relay", PLAIN), *evidence(("relay", WITH_DRIVE_TIMES), ("square", PLAIN))]
)
def test_every_few_rows_of_a_record_are_right_or_not_believed(
    tmp_path: Path, drive: str, names: tuple[str, ...]
) -> None:
    """Without the rows between, an edge of the drive is only known to the rows that are left."""
    law = {"relay": relay(0.5), "square": square(1.2, 1.0)}[drive]
    columns = sampled(motor(**PAPER), law, ticks(2 * ROWS, period_s=0.005), 0.002, seed=5)
    strides = [slice(k % 2, None, step) for k, step in enumerate((2, 3, 5, 8, 13))]
    seen = outcomes(plain_csv(tmp_path / "a.csv", columns, names), PAPER, strides)
    assert seen.get("wrong", []) == []
