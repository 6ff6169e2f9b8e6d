"""Figures of the hysteretic runs: the motion up to the first switching, and the recursion of least squares."""

from __future__ import annotations

import math

import numpy as np

from rig.core.estimators import LEADING
from rig.identification import least_squares
from rig.identification.least_squares import Transient
from rig.identification.preprocessing import from_recording
from rig.output.report.source import ReportedRun
from rig.output.report.style import (
    INK,
    MUTED,
    RELAY_STAGES,
    AbsentError,
    Picture,
    colour,
    line,
    new_figure,
    note,
    render,
    short,
    stage_label,
)
from rig.run_folder.recording.curves import Curves
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.results import EstimateResult, known

BEFORE_S = 0.1  # of the rest that is drawn
MARKS = "osD^v<>P"
NO_RUNS = "There was no hysteretic run."


def transients(run: ReportedRun) -> list[Transient]:
    """The hysteretic runs as the estimator reads them, without those that it cannot read."""
    found = []
    for span in run.spans("hysteretic"):
        try:
            series, _ = from_recording(run.rows, slice(span.first, span.last + 1), span.stage)
            found.append(Transient.of(series))
        except IdentifyError:
            continue
    return found


def first_transients(run: ReportedRun) -> Picture:
    """Position of each run around its transient; and all of them divided by d - f, which gives one curve.

    Raises AbsentError without a hysteretic run.
    """
    found = transients(run)
    if not found:
        raise AbsentError(NO_RUNS)
    estimate = run.estimates.get(least_squares.METHOD, EstimateResult())
    fc, asym = known(estimate.fc_V), known(estimate.asym_V)
    asym = asym if math.isfinite(asym) else 0.0
    bands = {entry.stage: known(entry.eps_rad) for entry in run.result.hysteretic or ()}
    figure = new_figure(3.9)
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
    for k, transient in enumerate(found):
        ink, mark = RELAY_STAGES[k % len(RELAY_STAGES)], MARKS[k % len(MARKS)]
        label = f"{stage_label(transient.name)}: d = {transient.d_V:+.3g} V"
        rows = run.rows.stage_rows(transient.name)
        since = run.rows.t_s[rows] - (run.rows.t_s[transient.rows[0]] - transient.t_s[0])
        end = float(transient.t_s[-1])
        shown = (since > -BEFORE_S) & (since < 1.25 * end)
        left.plot(since[shown], run.rows.y_rad[rows][shown], "-", color=ink, lw=0.7)
        read = transient.t_s <= min(float(t.t_s[-1]) for t in found if t.d_V * transient.d_V > 0.0)
        left.plot(transient.t_s[read], transient.y_rad[read], mark, color=ink, ms=3.2, mew=0, label=label)
        eps = bands.get(transient.name, math.nan)
        if math.isfinite(eps):
            level = math.copysign(eps, transient.d_V)
            left.plot((0.75 * end, 1.25 * end), (level, level), color=ink, lw=1.0, ls=(0, (4, 2)))
        way = math.copysign(1.0, transient.d_V)
        push = abs(transient.d_V) - (fc - way * asym)
        if math.isfinite(push) and push > 0.0:
            right.plot(transient.t_s, way * transient.y_rad / push, mark, color=ink, ms=3.2, mew=0)
    left.axvline(0.0, color=MUTED, lw=0.7)
    left.set(xlabel="time since the drive took effect, s", ylabel="position, rad")
    left.set_title("from rest to just after the first switching")
    left.legend(loc="best", markerscale=1.4)
    right.set(xlabel="time since the drive took effect, s", ylabel="position / (d − f), rad/V")
    right.set_title("divided by drive minus friction: one curve g(t)")
    if not math.isfinite(fc):
        note(right, "no friction was estimated")
    return render(
        figure, run.foot, "Hysteretic runs up to the first switching, and divided by drive minus friction.",
        "Runs of the hysteretic relay from rest at zero. Least squares reads the marked samples: up to the first "
        "switching of the shorter run in each direction (dashed: the edge of the hysteresis). Until then the motion is "
        "linear. So divided by drive minus estimated friction, all runs must fall on one curve.",
    )  # fmt: skip


def recursion(run: ReportedRun, curves: Curves | None) -> Picture:
    """The friction after each sample of the recursion, its final interval, and the truth.

    Raises AbsentError without a recursion.
    """
    fit = run.estimates.get(least_squares.METHOD)
    if fit is None or curves is None or curves.friction_V.size < 2:
        raise AbsentError("Least squares gave no value here, so there is no recursion to show.")
    trace, fc_V, method = curves.friction_V, known(fit.fc_V), least_squares.METHOD
    figure = new_figure(3.0)
    axes = figure.subplots()
    samples = np.arange(1, trace.size + 1)
    axes.plot(samples, trace, marker="o", ms=3.2, color=colour(method), ls=line(method), label="recursion")
    bounds = fit.interval("fc_V")
    half = 0.5 * (bounds[1] - bounds[0]) if bounds else 0.0
    if bounds:
        axes.axhspan(*bounds, color=colour(method), alpha=0.15, lw=0, label="95 % interval, all samples")
    other = run.estimates.get(LEADING, EstimateResult())
    if math.isfinite(known(other.fc_V)):
        axes.axhline(known(other.fc_V), color=colour(LEADING), lw=1.2, label=short(LEADING))
        extent = other.interval("fc_V")
        if extent is not None:
            axes.axhspan(*extent, color=colour(LEADING), alpha=0.15, lw=0)
    if "fc_V" in run.truth:
        axes.axhline(run.truth["fc_V"], color=INK, lw=0.9, ls=":", label="truth")
    reach = max(4.0 * half, 0.25 * abs(fc_V))
    axes.set_ylim(fc_V - reach, fc_V + reach)
    outside = int(np.sum(~(np.abs(trace - fc_V) <= reach)))
    if outside:
        note(axes, f"{outside} of the first values lie outside", loc="lower right")
    axes.set(xlabel="samples of each run", ylabel="friction, V")
    axes.legend(loc="upper right", ncols=4)
    return render(
        figure, run.foot, "Recursive least squares: estimated friction after each sample.",
        "Recursive least squares: the friction after each sample of the runs. The band is the 95 % interval. It allows "
        "for noise on both sides of the equation and in the measured starts; the recursion does not. If the last value "
        "lies outside the band, this noise has biased it.",
    )  # fmt: skip
