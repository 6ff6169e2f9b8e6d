"""Records beside the tests, as far as they show the motor that the tests show (docs/theory.md 12.7).

Somebody touches the shaft in the gain search, a wire slips, a stroke of the breakaway check ends at a stop: a fit to
all records would bend the motor to that. So a record counts up to the first piece that the fit does not describe.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rig.identification.departures.fit import Fit
from rig.run_folder.recording.series import FEWEST_ROWS, TimeSeries

Further = tuple[TimeSeries, int]
"""A record, and the number of the test whose time and travel it is measured in."""

STRANGE = 2.5  # RMS residual of a piece over that of the tests from which on the piece shows another motor
AS_GOOD = 1.2  # RMS residual of the tests over the plain motor's own: above it, the records spoil the fit


def agreeing(
    fit: Fit, tested: int, plain_rms_rad: float, further: Sequence[Further]
) -> tuple[list[Further], tuple[str, ...]]:
    """The records as far as they agree with the tests, and a sentence for each that does not.

    fit            of the tests and these records
    tested         how many of its rows are the tests'
    plain_rms_rad  RMS residual of a plain motor fitted to the tests alone
    """
    cut = fit.problem.cut
    squares = np.add.reduceat(fit.residual_rad**2, cut.begins) / cut.lengths
    rms_rad = np.sqrt(squares)
    of_tests = max(float(np.sqrt(np.mean(fit.residual_rad[:tested] ** 2))), fit.problem.sigma_rad)
    spoilt = of_tests > AS_GOOD * max(plain_rms_rad, fit.problem.sigma_rad)
    worst = max(float(rms_rad[_pieces(fit, further, k)].max()) for k in range(len(further)))
    kept: list[Further] = []
    remarks: list[str] = []
    for k, (series, number) in enumerate(further):
        pieces = _pieces(fit, further, k)
        # where the fit is spoilt, every piece looks strange: then the worst one is the cause
        strange = np.flatnonzero(rms_rad[pieces] >= (worst if spoilt else STRANGE * of_tests))
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


def _pieces(fit: Fit, further: Sequence[Further], k: int) -> slice:
    """The pieces of record ``k``: they stand behind those of the tests, in order."""
    counts = [rows.size for rows in fit.problem.cut.rows]
    first = len(counts) - len(further)
    return slice(sum(counts[: first + k]), sum(counts[: first + k + 1]))
