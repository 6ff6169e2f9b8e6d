"""Records beside the tests, as far as they show the motor that the tests show (docs/theory.md 12.7).

Somebody touches the shaft in the gain search, a wire slips, a stroke of the breakaway check ends at a stop: a fit to
all records would bend the motor to that, or lose a law. So a record counts up to the first piece that the fit does not
describe; and where the fit describes the tests worse than their own laws do, up to the worst piece.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.identification.departures.choice import AT_NOISE
from rig.identification.departures.fit import Fit, solve
from rig.identification.departures.fit import start as begin
from rig.identification.noise import WHITE
from rig.run_folder.recording.series import FEWEST_ROWS, TimeSeries

Further = tuple[TimeSeries, int]
"""A record, and the number of the test whose time and travel it is measured in."""

STRANGE = 2.5  # RMS residual of a piece over that of the tests from which on the piece shows another motor
OF_NOISE = 1.7  # the same where the tests leave noise alone: of 12 rows and more noise does not reach it
AS_GOOD = 1.2  # RMS residual of the tests over that of their own laws: above it, the records spoil the fit


def agreeing(
    fit: Fit, tested: int, own: Fit | None, further: Sequence[Further]
) -> tuple[list[Further], tuple[str, ...]]:
    """The records as far as they agree with the tests, and a sentence for each that does not.

    fit      of the tests and these records
    tested   how many of its rows are the tests'
    own      the fit of the tests alone, with their laws; None: ``fit`` leaves nothing of them to explain
    """
    cut = fit.problem.cut
    squares = np.add.reduceat(fit.residual_rad**2, cut.begins) / cut.lengths
    rms_rad = np.sqrt(squares)
    of_tests = max(float(np.sqrt(np.mean(fit.residual_rad[:tested] ** 2))), fit.problem.sigma_rad)
    spoilt = own is not None and _left_rad(fit, own) > AS_GOOD * max(own.rms_rad, fit.problem.sigma_rad)
    strange_rad = (OF_NOISE if of_tests <= AT_NOISE * fit.problem.sigma_rad else STRANGE) * of_tests
    worst = max(float(rms_rad[_pieces(fit, further, k)].max()) for k in range(len(further)))
    kept: list[Further] = []
    remarks: list[str] = []
    for k, (series, number) in enumerate(further):
        pieces = _pieces(fit, further, k)
        # where the fit is spoilt, every piece looks strange: then the worst one is the cause
        strange = np.flatnonzero(rms_rad[pieces] >= (worst if spoilt else strange_rad))
        if strange.size == 0:
            kept.append((series, number))
            continue
        piece = pieces.start + int(strange[0])
        stop = int(np.searchsorted(series.t_s, cut.t_s[cut.begins[piece]]))
        remarks.append(
            f"{series.name}: not in the law's fit from row {series.first_row + stop} on: there the residual is "
            f"{1e3 * float(rms_rad[piece]):.2g} mrad, in the tests {1e3 * of_tests:.2g} mrad"
        )
        if stop >= FEWEST_ROWS:
            kept.append((series.part(0, stop), number))
    return kept, tuple(remarks)


def _left_rad(fit: Fit, own: Fit) -> float:
    """RMS residual of the motor of ``fit`` on the pieces of the tests that their ``own`` one bears, rad."""
    cut = replace(own.problem.cut, frames=fit.problem.cut.frames[: len(own.problem.cut.windows)])
    free_of_numbers = replace(own.problem, cut=cut, free=(), robust_rad=math.inf, noise=WHITE)
    return solve(begin(free_of_numbers, fit.motor)).rms_rad


def _pieces(fit: Fit, further: Sequence[Further], k: int) -> slice:
    """The pieces of record ``k``: they stand behind those of the tests, in order."""
    counts = [rows.size for rows in fit.problem.cut.rows]
    first = len(counts) - len(further)
    return slice(sum(counts[: first + k]), sum(counts[: first + k + 1]))
