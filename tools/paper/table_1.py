"""Example 4.2's methods in one table: what each needs, what it gives, how far it is off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from paper import example_4_2a, example_4_2b, example_4_2c, surviving
from paper.drawing import Array
from paper.gauss_newton import features_of, iterate
from paper.page import Claim, Paragraph, Remark, Section
from rig.model.limit_cycle import limit_cycle
from shared.table import Cell, Table, number, share, significant

EXACT = 1e-6  # relative error that counts as none


@dataclass(frozen=True)
class Row:
    """One method: recordings needed; tau, K, fc (nan: not given); iterations to an error of ``EXACT``, if any."""

    name: str
    needs: str
    theta: Array
    iterations: int | None


@dataclass(frozen=True)
class Result:
    """All methods on data without noise, and the truth."""

    rows: tuple[Row, ...]
    truth: Array

    def error(self, row: Row) -> float:
        """Largest relative error of what the method gives."""
        return float(np.nanmax(np.abs(row.theta / self.truth - 1.0)))


def compute() -> Result:
    """Least squares, describing function, triple relay from a guess, and two-stage."""
    truth = np.array(surviving.MOTOR)
    least = example_4_2a.compute()
    fc = {p: float(trace[-1]) for p, trace in least.by_covariance.items()}
    df = example_4_2b.compute(3).theta
    seen = features_of(limit_cycle(*surviving.MOTOR, *surviving.GAINS[0]))
    guess = example_4_2c.STARTS[0]
    alone = iterate(seen, surviving.GAINS[0], guess)
    two_stage = iterate(seen, surviving.GAINS[0], (float(df[0]), float(df[1]), float(df[2])))
    none = float("nan")
    runs, tests = "two runs from rest at zero, hysteretic relay", "two relay tests"
    rows = (
        Row(f"(a) least squares, P = {example_4_2a.ASSUMED:g}", runs,
            np.array([none, none, fc[example_4_2a.ASSUMED]]), None),
        Row("(a) least squares, nothing assumed", runs, np.array([none, none, fc[np.inf]]), None),
        Row("(b) describing function", tests, df, None),
        Row(f"(c) triple relay, from ({', '.join(f'{v:g}' for v in guess)})", "one relay test, a guess", alone.theta,
            alone.steps_until(truth, EXACT)),
        Row("(d) two-stage", tests, two_stage.theta, two_stage.steps_until(truth, EXACT)),
    )  # fmt: skip
    return Result(rows, truth)


def exact_and_biased(result: Result) -> Claim:
    """Triple relay and two-stage are exact on data without noise, the describing function is not."""
    df, alone, two_stage = result.rows[2:]
    return Claim(result.error(df) > EXACT > max(result.error(alone), result.error(two_stage)))


def section(result: Result) -> Section:
    """Its part of the page."""
    claim = exact_and_biased(result)
    df, alone, two_stage = result.rows[2:]
    rows = []
    for row in result.rows:
        cells = []
        for value, truth in zip(row.theta.tolist(), result.truth.tolist(), strict=True):
            cells += [number(value, 5), share(value / truth - 1.0) if np.isfinite(value) else Cell("–")]
        count = Cell("–") if row.iterations is None else Cell(f"{row.iterations}", float(row.iterations))
        rows.append((Cell(row.name), Cell(row.needs), *cells, count))
    low, high = surviving.LEAST_SQUARES_FC_V
    theirs = Cell(f"{low} … {high}", None, "paper")
    rows.append(
        (Cell("paper: (a), after the last sample", None, "paper"), *([Cell("")] * 5), theirs, Cell(""), Cell(""))
    )
    counts = Cell(f"{surviving.TWO_STAGE_ITERATIONS} instead of {surviving.ONE_STAGE_ITERATIONS}", None, "paper")
    rows.append((Cell("paper: (d)", None, "paper"), *([Cell("")] * 7), counts))
    rows.append((Cell("true"), Cell(""), *(c for v in result.truth for c in (number(float(v), 5), Cell(""))), Cell("")))
    blocks = (
        Paragraph(
            "The four methods of Example 4.2 beside each other, on data without noise and without sampling (least "
            "squares: sampled). What the paper's own table had in these places did not survive but for the purple."
        ),
        Table(
            ("method", "needs", "τ, s", "error", "K, (rad/s)/V", "error", "f<sub>c</sub>, V", "error", "iterations"),
            tuple(rows),
            f"Iterations: until all parameters stay within {significant(EXACT, 1)} of the truth.",
        ),
        Remark(
            claim.agreement,
            f"The triple relay's equations are {claim.says('exact', 'not exact')} here: "
            f"{significant(result.error(alone), 1)} from the guess, {significant(result.error(two_stage), 1)} in two "
            "stages; "
            f"the describing function is {significant(100.0 * result.error(df), 2)} % off in the worst parameter, "
            "least "
            "squares gives friction alone.",
        ),
    )
    return Section("table-1", "Table I", "Table I: the methods of Example 4.2 in one place", blocks, ())
