"""Pictures of a comparison: the values, the trends, and cycles, residuals and tracking laid over each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from rig.core.arrays import Array
from rig.core.estimators import LEADING, MAIN
from rig.output.report.fitted import LABELS, autocorrelation
from rig.output.report.model_curves import average, cycles_of, kept_or_fitted
from rig.output.report.source import ReportedRun
from rig.output.report.style import COLOURS, INK, LINES, MUTED, AbsentError, Picture, new_figure, plain, render
from rig.run_folder.recording.errors import IdentifyError, RecordingError
from rig.run_folder.results import known
from rig.run_folder.results.comparison import ComparedRunResult, ComparisonResult, TrendResult

FEWEST = 20  # residuals to draw
MOST_LAID_OVER = 7  # runs: so many colours can be told apart
SMOOTH = 9  # samples, of the tracking errors


@dataclass(frozen=True)
class LaidOver:
    """A run that is laid over others: its folder as read, and how it is drawn."""

    name: str
    run: ReportedRun
    colour: str
    line: str


def chosen(found: ComparisonResult) -> list[ComparedRunResult]:
    """The runs that are laid over each other: all; of more than seven the odd ones, and others from first to last."""
    runs = list(found.runs)
    if len(runs) <= MOST_LAID_OVER:
        return runs
    odd = {*(found.measurably.odd or ()), *(found.beyond_scatter.odd or ())}
    kept = [k for k, run in enumerate(runs) if run.name in odd][:MOST_LAID_OVER]
    others = [k for k in range(len(runs)) if k not in kept]
    places = np.linspace(0, len(others) - 1, MOST_LAID_OVER - len(kept)).round().astype(int)
    return [runs[k] for k in sorted({*kept, *(others[place] for place in places)})]


def drawn_as(k: int) -> tuple[str, str]:
    """Colour and line of the k-th run that is laid over others."""
    return COLOURS[k % len(COLOURS)], LINES[k % len(LINES)]


def values(found: ComparisonResult, backend: str) -> Picture:
    """tau, K and f_c of each run with its interval; the odd ones hollow."""
    runs = found.runs
    figure = new_figure(0.9 + 0.26 * len(runs))
    panels = figure.subplots(1, 3, sharey=True)
    odd = {*(found.measurably.odd or ())}
    for axes, key in zip(panels, MAIN, strict=True):
        scatter = 0.01 * known(found.scatter.percent[key])
        numbers = np.array([getattr(run, key) for run in runs])
        middle = float(np.median([n for n, run in zip(numbers, runs, strict=True) if run.name not in odd] or numbers))
        axes.axvspan(middle * (1.0 - 1.96 * scatter), middle * (1.0 + 1.96 * scatter), color="#eceef1", lw=0)
        for row, (run, number) in enumerate(zip(runs, numbers, strict=True)):
            low, high = (known(end) for end in run.ci95[key])
            colour = COLOURS[1] if run.name in odd else COLOURS[0]
            axes.plot((low, high), (row, row), color=colour, lw=2.2, solid_capstyle="butt")
            axes.plot(number, row, "o", ms=5, color=colour, mfc="white" if run.name in odd else colour, mew=1.4)
        axes.set_title(LABELS[key])
        axes.locator_params(axis="x", nbins=4)
        axes.margins(x=0.1)
    panels[0].set_yticks(range(len(runs)), [plain(run.name) for run in runs])
    panels[0].set_ylim(len(runs) - 0.4, -0.6)
    return render(
        figure, backend, "tau, K and friction of each run with 95 % intervals.",
        "The runs by their start. Bars: 95 % intervals by Type A alone. Hollow: differs measurably from the others. "
        "Grey: where 95 % of one motor's runs are by the scatter from run to run.",
    )  # fmt: skip


def trends(found: ComparisonResult, over: str, at: Sequence[float], backend: str) -> Picture:
    """tau, K and f_c over time or temperature, % of their mean, with the fitted slope. Raises AbsentError without."""
    lines = [one for one in found.trends if one.over == over]
    if not lines:
        raise AbsentError(f"There is no trend over {over}: it takes three runs that say it.")
    figure = new_figure(2.6)
    x = np.array(at)
    for axes, line in zip(figure.subplots(1, 3), lines, strict=True):
        numbers = np.array([getattr(run, line.parameter) for run in found.runs])
        half = np.array(
            [0.5 * (known(r.ci95[line.parameter][1]) - known(r.ci95[line.parameter][0])) for r in found.runs]
        )
        mean = float(numbers.mean())
        percent, bars = 100.0 * (numbers / mean - 1.0), 100.0 * half / mean
        axes.errorbar(x, percent, bars, fmt="o", ms=4, color=COLOURS[0], lw=1.2)
        seen = np.isfinite(x)
        span = np.linspace(x[seen].min(), x[seen].max(), 40)
        away, low, high = span - x[seen].mean(), known(line.ci95[0]), known(line.ci95[1])
        centre = float(percent[seen].mean())
        axes.plot(span, centre + line.slope * away, color=INK, lw=1.0, ls="-" if line.shows else (0, (4, 2)))
        axes.fill_between(span, centre + low * away, centre + high * away, color="#eceef1", lw=0)
        reach = 1.6 * float(np.max(np.abs(percent) + bars))
        axes.set(ylim=(-reach, reach), title=LABELS[line.parameter].split(",")[0])
        axes.locator_params(axis="x", nbins=5)
        axes.set_xlabel("time since the first run, h" if over == "time" else "temperature, °C")
    figure.axes[0].set_ylabel("off the mean, %")
    told = "; ".join(f"{LABELS[one.parameter].split(',')[0]} {_slope(one)}" for one in lines)
    return render(
        figure, backend, f"tau, K and friction over {over}.",
        f"Slope over {over} with its 95 % interval: {told}. Grey: the slopes in that interval. Dashed: no trend shows.",
    )  # fmt: skip


def _slope(one: TrendResult) -> str:
    low, high = (known(end) for end in one.ci95)
    if not one.is_known:
        return "unknown"
    return f"{one.slope:+.3g} ({low:+.3g} to {high:+.3g}) {one.unit}"


def cycles(runs: Sequence[LaidOver], backend: str) -> Picture:
    """One averaged cycle of each run over its phase: position, and velocity over position. Raises AbsentError."""
    figure = new_figure(3.4)
    left, right = figure.subplots(1, 2)
    drawn = 0
    for one in runs:
        for span in one.run.spans("relay")[:1]:
            found = cycles_of(one.run, span)
            if found is None:
                continue
            phase, shown = _phases(found.series.t_s, found.series.y_rad, found.rows, found.series.first_row)
            bins = round(float(np.median([b - a for a, b in found.rows])))
            at, mean, _ = average(phase, shown, bins)
            period_s = float(np.median([b - a for a, b in found.rows])) * found.series.period_s
            label = f"{plain(one.name)}: {period_s:.3f} s"
            left.plot(at, mean, color=one.colour, ls=one.line, label=label)
            right.plot(mean, np.gradient(mean, at * period_s), color=one.colour, ls=one.line)
            drawn += 1
    if not drawn:
        raise AbsentError(
            "No run has two settled cycles of a relay test, so there are no cycles to lay over each other."
        )
    left.set(xlabel="phase of the cycle", ylabel="position, rad")
    right.set(xlabel="position, rad", ylabel="velocity, rad/s")
    figure.legend(loc="outside upper left", ncols=2)
    return render(
        figure, backend, "Averaged limit cycles of the runs laid over each other.",
        f"The averaged cycle of the first relay test of {drawn} runs, with its period; on the right velocity over "
        "position. Other gains make another cycle: look at the table of each run's report.",
    )  # fmt: skip


def _phases(t: Array, y: Array, rows: Sequence[tuple[int, int]], first_row: int) -> tuple[Array, Array]:
    """Phases, 0 to 1, and positions about each cycle's mean, of all cycles."""
    phases, shown = [], []
    for first, last in rows:
        part = slice(first - first_row, last - first_row)
        end = t[last - first_row]
        phases.append((t[part] - t[part.start]) / (end - t[part.start]))
        shown.append(y[part] - y[part].mean())
    return np.concatenate(phases), np.concatenate(shown)


def residuals(runs: Sequence[LaidOver], backend: str) -> Picture:
    """The residuals of the runs: their distribution, and their autocorrelation. Raises AbsentError without any."""
    figure = new_figure(3.2)
    left, right = figure.subplots(1, 2)
    drawn, fewest, anew = 0, math.inf, []
    for one in runs:
        try:
            found, why = kept_or_fitted(one.run)
        except (AbsentError, IdentifyError, RecordingError):
            continue
        if found is None or found.residual_rad.size < FEWEST:
            continue
        anew += [f"{plain(one.name)} ({why})"] if why else []
        r = 1e3 * found.residual_rad
        label = f"{plain(one.name)}: RMS {float(np.sqrt(np.mean(r**2))):.3g} mrad"
        left.plot(np.sort(r), (np.arange(r.size) + 0.5) / r.size, color=one.colour, ls=one.line, label=label)
        lags, shares = autocorrelation([r])
        right.plot(lags, shares, color=one.colour, ls=one.line, lw=0.9)
        drawn, fewest = drawn + 1, min(fewest, r.size)
    if not drawn:
        raise AbsentError("No run has a residual to show.")
    right.axhspan(-1.96 / math.sqrt(fewest), 1.96 / math.sqrt(fewest), color="#e4e7eb", lw=0)
    left.set(xlabel="residual, mrad", ylabel="share of samples below")
    right.set(xlabel="lag, samples", ylabel="autocorrelation")
    figure.legend(loc="outside upper left", ncols=2)
    return render(
        figure, backend, "Residuals of the runs laid over each other: distribution and autocorrelation.",
        "Recorded less modelled position in each run. Curves that lie on each other: the same noise. A wider one: more "
        "noise, or a motor that the model fits less well. Grey: where 95 % of white noise is."
        + (f" Identified anew for this picture: {'; '.join(anew)}." if anew else ""),
    )  # fmt: skip


def tracking(runs: Sequence[LaidOver], backend: str) -> Picture:
    """Tracking errors of the runs over the time in the stage. Raises AbsentError without any."""
    figure = new_figure(3.2)
    axes = figure.subplots()
    drawn = sum(_tracked(axes, one) for one in runs)
    if not drawn:
        raise AbsentError(f"No run tracked with its {LEADING} model.")
    axes.axhline(0.0, color=MUTED, lw=0.7)
    axes.set(xlabel="time in the stage, s", ylabel="error yd − y, mrad")
    figure.legend(loc="outside upper left", ncols=2)
    return render(
        figure, backend, "Tracking errors of the runs laid over each other.",
        "Wanted less measured position while each run's own model drove its motor along the trajectory, as a mean over "
        f"{SMOOTH} samples; the RMS is of the samples after the trajectory has faded in. What repeats from run to run "
        "is a law that the model lacks.",
    )  # fmt: skip


def _tracked(axes: Axes, one: LaidOver) -> bool:
    spans = [span for span in one.run.spans("track") if span.stage.partition(":")[2] == LEADING]
    if not spans:
        return False
    rows = slice(spans[-1].first, spans[-1].last + 1)
    recording = one.run.rows
    time = recording.t_s[rows] - recording.t_s[spans[-1].first]
    outcome = one.run.result.tracking.get(LEADING)
    rms = math.nan if outcome is None else 1e3 * known(outcome.rms_rad)
    error = 1e3 * (recording.yd_rad[rows] - recording.y_rad[rows])
    smooth = np.convolve(error, np.full(SMOOTH, 1.0 / SMOOTH), "same")
    axes.plot(time, smooth, color=one.colour, ls=one.line, lw=0.9, label=f"{plain(one.name)}: RMS {rms:.3g} mrad")
    return True
