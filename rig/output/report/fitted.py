"""Figures of measured against simulated: averaged cycle and model, residual, estimates side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rig.core.arrays import Array
from rig.core.estimators import MAIN
from rig.output.report.budget import budget_in_words
from rig.output.report.model_curves import average, cycles_of, models, predict_cycles
from rig.output.report.source import ReportedRun, Span
from rig.output.report.style import (
    FAINT,
    INK,
    LIMIT,
    MEASURED,
    MUTED,
    RASTER_FROM,
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
from rig.run_folder.results import EstimateResult, known

LABELS = {"tau_s": "τ, s", "K_rad_s_V": "K, (rad/s)/V", "fc_V": "f_c, V"}
LONGEST_LAG = 60
FEWEST_RESIDUALS = 20
BAND = 1.96  # of the standard deviation of white noise's autocorrelation
MANY_OUTSIDE = 0.1  # of the lags: more than chance puts outside the band
SMALL_RESIDUAL = 0.05  # of the motion
ROOM_BESIDE = 0.6  # of the width of what is ok, on each side
GROUP_GAP = 0.6  # of a bar, between the two sums


def averaged_cycle(run: ReportedRun, span: Span) -> Picture:
    """One relay test: the averaged cycle, each model's prediction over it, the residual below.

    Raises AbsentError without two settled cycles or without a model.
    """
    cycles = cycles_of(run, span)
    if cycles is None:
        raise AbsentError(
            f"{stage_label(span.stage).capitalize()} has no two settled cycles, so there is no average to show."
        )
    methods = models(run)
    if not methods:
        raise AbsentError("There is no estimated model to lay over the averaged cycle.")
    figure = new_figure(4.2)
    panels = figure.subplots(2, len(methods), sharex=True, squeeze=False, height_ratios=(1.7, 1.0))
    bins = round(float(np.median([b - a for a, b in cycles.rows])))
    for column, (method, (estimate, motor)) in enumerate(methods.items()):
        top, bottom = panels[0, column], panels[1, column]
        predicted = predict_cycles(run, estimate, motor, cycles)
        phase = np.concatenate([p.phase[:-1] for p in predicted])
        measured = np.concatenate([p.measured_rad[:-1] for p in predicted])
        model = np.concatenate([p.y_rad[:-1] for p in predicted])
        at, mean, _ = average(phase, measured, bins)
        at_model, mean_model, _ = average(phase, model, bins)
        residual = 1e3 * (measured - model)
        at_residual, mean_residual, _ = average(phase, residual, bins)
        top.plot(at, mean, "o", color=MEASURED, ms=2.6, mew=0, label="measured, averaged")
        top.plot(at_model, mean_model, color=colour(method), ls=line(method), lw=1.4, label=f"{short(method)} model")
        top.set_title(method.replace("-", " ") + (" with its laws" if motor.parts else ""))
        top.legend(loc="lower center", handlelength=2.4)  # below the crest, where the curve is not
        bottom.axhline(0.0, color=MUTED, lw=0.7)
        bottom.plot(phase, residual, ".", color=colour(method), ms=1.6, alpha=0.35, mew=0, rasterized=True)
        bottom.plot(at_residual, mean_residual, color=colour(method), lw=1.2)
        reach = 1.1 * float(np.max(np.abs(residual)))
        bottom.set_ylim(-1.35 * reach, 1.35 * reach)
        note(bottom, f"RMS {math.sqrt(float(np.mean(residual**2))):.3g} mrad")
        bottom.set_xlabel("phase of the cycle")
        if column:
            top.sharey(panels[0, 0])
            top.tick_params(labelleft=False)
    panels[0, 0].set_ylabel("position, rad")
    panels[1, 0].set_ylabel("residual, mrad")
    stage = stage_label(span.stage)
    return render(
        figure, run.foot, f"Averaged cycle of {stage} with each model over it and the residual below.",
        f"{stage.capitalize()}: average of {len(cycles)} cycles, and each model's prediction under the recorded drive; "
        "each cycle begins at the start that fits it best. Below: recorded minus predicted position. A point is a "
        "sample, the line is their average. Each residual has its own scale.",
    )  # fmt: skip


def residuals(run: ReportedRun, curves: Curves | None, spread_rad: float) -> Picture:
    """Residual of the answer, as ``residual_figure`` draws it. Raises AbsentError without a residual.

    spread_rad  standard deviation of the positions that it belongs to, rad
    """
    method = "" if run.result.answer is None else run.result.answer.method
    if curves is None or curves.answer.method != method or curves.residual_rad.size < FEWEST_RESIDUALS:
        raise AbsentError("The residual series could not be computed from this recording.")
    spread = float(np.std(1e3 * curves.residual_rad))
    rms = f"{spread:.3g}" if spread < 100.0 else f"{spread:.0f}"
    return render(
        residual_figure(method, curves.residual_t_s, curves.residual_rad), run.foot,
        f"Residual of the {method} estimate: over time, histogram, autocorrelation.",
        f"Residual of the {method.replace('-', ' ')} estimate (RMS {rms} mrad about its mean, "
        f"{curves.residual_rad.size} samples). If the model explains the data, the residual is white noise: a "
        "bell-shaped histogram, and about 5 % of lags outside the band."
        + _lacking(outside_band(curves.residual_t_s, curves.residual_rad)[2], spread / (1e3 * spread_rad)),
    )  # fmt: skip


def _lacking(outside: float, of_motion: float) -> str:
    """What more lags outside the band mean than white noise has; ``of_motion``: the residual over the motion."""
    if not (outside > MANY_OUTSIDE and math.isfinite(of_motion)):
        return ""
    small = "something small" if of_motion < SMALL_RESIDUAL else "something"
    return (
        f" Here {100 * outside:.0f} %: the model lacks {small}. The residual is {100 * of_motion:.2g} % of the motion "
        "(standard deviations)."
    )


def outside_band(t: Array, residual_rad: Array) -> tuple[Array, Array, float]:
    """Lags, autocorrelation, and the share of lags outside the 95 % band of white noise. t: times, s."""
    lags, values = autocorrelation([residual_rad[piece] for piece in _pieces(t)])
    return lags, values, float(np.mean(np.abs(values) > BAND / math.sqrt(residual_rad.size))) if values.size else 0.0


def residual_figure(method: str, t: Array, residual_rad: Array) -> Figure:
    """The residual over time, its histogram, and its autocorrelation with the band of white noise.

    t   times of ``residual_rad``, s
    Raises AbsentError with fewer than FEWEST_RESIDUALS values.
    """
    if residual_rad.size < FEWEST_RESIDUALS:
        raise AbsentError(f"The {method} estimate has no residual of {FEWEST_RESIDUALS} samples to draw.")
    r = 1e3 * residual_rad
    figure = new_figure(2.9)
    series, histogram, correlation = figure.subplots(1, 3, width_ratios=(1.7, 0.8, 1.2))
    pieces = _pieces(t)
    for piece in pieces:
        series.plot(t[piece], r[piece], color=colour(method), lw=0.6, rasterized=t.size > RASTER_FROM)
    series.axhline(0.0, color=MUTED, lw=0.7)
    series.set(xlabel="time since the start, s", ylabel="residual, mrad", title="over time")
    spread = float(np.std(r))
    histogram.hist(
        r, bins=min(60, max(10, r.size // 30)), density=True, orientation="horizontal", color=colour(method), alpha=0.45
    )
    if spread > 0.0:
        grid = np.linspace(float(r.min()), float(r.max()), 200)
        bell = np.exp(-0.5 * ((grid - r.mean()) / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))
        histogram.plot(bell, grid, color=INK, lw=1.0, ls=(0, (4, 2)))
    histogram.sharey(series)
    histogram.tick_params(labelleft=False)
    histogram.set(xlabel="density, 1/mrad", title="histogram, normal")
    lags, values, outside = outside_band(t, residual_rad)
    band = BAND / math.sqrt(r.size)
    correlation.axhspan(-band, band, color="#e4e7eb", lw=0)
    correlation.axhline(0.0, color=MUTED, lw=0.7)
    correlation.vlines(lags, 0.0, values, color=colour(method), lw=1.4)
    correlation.set(xlabel="lag, samples", title="autocorrelation")
    highest = max(band, float(np.abs(values).max(initial=0.0)))
    correlation.set_ylim(-1.1 * highest, 1.5 * highest)  # above the bars there is room for the note
    note(correlation, f"{100 * outside:.0f} % of lags outside the 95 % band", loc="upper right")
    return figure


def _pieces(t: Array) -> list[slice]:
    """Contiguous stretches of a series of times, cut at steps above ten times the median."""
    steps = np.diff(t)
    cuts = [0, *(np.flatnonzero((steps > 10.0 * np.median(steps)) | (steps <= 0.0)) + 1).tolist(), t.size]
    return [slice(a, b) for a, b in pairwise(cuts)]


def autocorrelation(pieces: list[Array]) -> tuple[Array, Array]:
    """Autocorrelation at lags 1 to ``LONGEST_LAG``, without products across pieces. Returns lags and values."""
    mean = float(np.mean(np.concatenate(pieces)))
    power = sum(float(np.sum((p - mean) ** 2)) for p in pieces)
    longest = min(LONGEST_LAG, max(p.size for p in pieces) - 1)
    lags = np.arange(1, longest + 1)
    if power == 0.0:
        return lags.astype(float), np.zeros(lags.size)
    values = [sum(float((p[k:] - mean) @ (p[: p.size - k] - mean)) for p in pieces if p.size > k) / power for k in lags]
    return lags.astype(float), np.array(values)


def budget(run: ReportedRun) -> Picture:
    """What the uncertainty of tau, K and f_c is made of, as bars. Raises AbsentError without a budget."""
    lines = budget_in_words(run)
    if not lines:
        raise AbsentError("There is no uncertainty budget.")
    figure = new_figure(0.9 + 0.26 * len(lines))
    panels = figure.subplots(1, 3, sharey=True, sharex=True)
    own = sum(not row.absolute for row in lines)
    places = [k + GROUP_GAP * row.absolute for k, row in enumerate(lines)]
    colours = [(LIMIT if row.absolute else INK) if row.is_sum else FAINT for row in lines]
    asked = run.result.ok_asks_u95_percent
    for k, (axes, key) in enumerate(zip(panels, MAIN, strict=True)):
        shares = [row.percent[k] for row in lines]
        axes.barh(places, [share if math.isfinite(share) else 0.0 for share in shares], height=0.7, color=colours)
        for place, share, row in zip(places, shares, lines, strict=True):
            if row.is_sum and math.isfinite(share):
                axes.annotate(f"{share:.2f}", (share, place), (3, 0), textcoords="offset points", va="center")
        if asked is not None:
            axes.plot((asked, asked), (-0.5, own - 0.5), color=MUTED, lw=1.0, ls=":")
        axes.set(title=LABELS[key].split(",")[0], xlabel="% of the estimate")
        axes.margins(x=0.15)
        axes.grid(axis="y", visible=False)
    panels[0].set_yticks(places, [row.source for row in lines])
    panels[0].set_ylim(places[-1] + 0.6, -0.6)
    for row, label in zip(lines, panels[0].get_yticklabels(), strict=True):
        label.set_fontweight("bold" if row.is_sum else "normal")
    return render(
        figure, run.foot, "Uncertainty budget of tau, K and friction.",
        "How far tau, K and friction may be off, with 95 % confidence, and what that comes from. First bar: all that "
        "counts in the bench's own volts and radians (u95). Below it its parts: the noise, and each law that the tests "
        "do not exclude, with as much as it is likely. Second bold line: the same in true volts and radians "
        "(u95_absolute), and what that adds. Parts add up as squares."
        + ("" if asked is None else f" Dotted: {asked:.3g} %, the most for an ok."),
    )  # fmt: skip


def forest(run: ReportedRun) -> Picture:
    """Estimates of tau, K and f_c side by side with their 95 % intervals, and the truth if it is known.

    Raises AbsentError without an estimate.
    """
    truth = " The dotted line is the emulated motor's true value." if run.truth else ""
    truth += " An arrow at the edge: the estimate lies so far beyond." if _scale_is_of_ok(run) else ""
    return render(
        forest_figure(run), run.foot, "Estimates side by side with their 95 % intervals.",
        "Estimates and 95 % intervals side by side. Hollow mark: the verdict is not ok. Mark without a bar: no "
        "interval." + truth,
    )  # fmt: skip


def forest_figure(run: ReportedRun) -> Figure:
    """``forest`` before it is laid out. Raises AbsentError without an estimate."""
    estimates = {m: e for m, e in run.compared.items() if any(math.isfinite(known(e.value(k))) for k in MAIN)}
    if not estimates:
        raise AbsentError("There is no estimate to compare.")
    figure = new_figure(0.9 + 0.34 * len(estimates))
    panels = figure.subplots(1, 3, sharey=True)
    names = list(estimates)
    for axes, key in zip(panels, MAIN, strict=True):
        for row, (name, estimate) in enumerate(estimates.items()):
            method = run.method_of(name)
            value = known(estimate.value(key))
            if not math.isfinite(value):
                continue
            bounds = estimate.at_95(key)
            if bounds is not None:
                axes.plot(bounds, (row, row), "-", color=colour(method), lw=2.2, solid_capstyle="butt")
                axes.plot(bounds, (row, row), "|", color=colour(method), ms=9, mew=1.6)
            hollow = estimate.verdict != "ok"
            axes.plot(value, row, "o", ms=6, color=colour(method), mfc="white" if hollow else colour(method), mew=1.5)
        if key in run.truth:
            axes.axvline(run.truth[key], color=INK, lw=1.0, ls=":", zorder=1)
        axes.set_title(LABELS[key])
        axes.margins(x=0.12)
        _scale_of_ok(axes, run, key, estimates)
        axes.locator_params(axis="x", nbins=4)  # a third of the page has room for five labels of six digits
    panels[0].set_yticks(range(len(names)), [n.replace("-", " ") for n in names])
    panels[0].set_ylim(len(names) - 0.4, -0.6)
    return figure


def _scale_is_of_ok(run: ReportedRun) -> bool:
    """Whether some estimates are ok and others are not: then the scale is of those that are."""
    return {estimate.verdict == "ok" for estimate in run.compared.values()} == {True, False}


def _scale_of_ok(axes: Axes, run: ReportedRun, key: str, estimates: Mapping[str, EstimateResult]) -> None:
    """Scale an axis to the estimates that are ok and the truth; an arrow at the edge, with its value, for each other.

    Else an estimate that is far off would make their intervals a dot.
    """
    if not _scale_is_of_ok(run):
        return
    ends = [run.truth[key]] if key in run.truth else []
    for estimate in estimates.values():
        if estimate.verdict == "ok" and math.isfinite(known(estimate.value(key))):
            ends += [known(estimate.value(key)), *(estimate.at_95(key) or ())]
    low, high = min(ends, default=math.nan), max(ends, default=math.nan)
    if not high > low:
        return
    room = ROOM_BESIDE * (high - low)
    low, high = low - room, high + room
    for row, (name, estimate) in enumerate(estimates.items()):
        value = known(estimate.value(key))
        if math.isfinite(value) and not low <= value <= high:
            right = value > high
            axes.annotate(
                f"{value:.4g} {chr(0x25B8)}" if right else f"{chr(0x25C2)} {value:.4g}",
                (1.0 if right else 0.0, row), xycoords=("axes fraction", "data"), fontsize=8,
                ha="right" if right else "left", va="center", color=colour(run.method_of(name)),
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            )  # fmt: skip
    axes.set_xlim(low, high)
