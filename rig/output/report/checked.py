"""Figures of the checks: tracking by feedback linearisation, and the timing of the loop."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np
from matplotlib.axes import Axes

from rig.core.arrays import Array
from rig.model.error_decay import ErrorDecay
from rig.model.real_motor import FramedMotor
from rig.output.report.source import ReportedRun
from rig.output.report.style import INK, LIMIT, MEASURED, MUTED, AbsentError, Picture, colour, new_figure, note, render
from rig.run_folder.results import DrivenModel, known
from rig.run_folder.results.salvage import DamagedError, parsed

DECAY_S = 1.5  # of a check that is shown; by then k1 and k2 of use have taken the offset away


def tracking(run: ReportedRun) -> Picture:
    """Wanted and measured position, and the error: a column per model, on the same axes.

    Raises AbsentError if no model tracked.
    """
    spans = run.spans_of("track", "No model was driven along the trajectory in this run.")
    last = {s.stage: s for s in spans}  # a stage visited twice counts once, with its last visit
    t, y, yd = run.rows.t_s, run.rows.y_rad, run.rows.yd_rad
    figure = new_figure(4.3)
    panels = figure.subplots(2, len(last), sharex=True, sharey="row", squeeze=False, height_ratios=(1.6, 1.0))
    largest, real_motors = 0.0, _real_motors(run)
    for column, span in enumerate(last.values()):
        method = span.stage.partition(":")[2]
        rows = slice(span.first, span.last + 1)
        time = t[rows] - t[span.first]
        real = real_motors.get(method)
        shown = y[rows] if real is None else real.positions(y[rows])
        error = 1e3 * (yd[rows] - shown)
        top, bottom = panels[0, column], panels[1, column]
        top.plot(time, yd[rows], color=INK, lw=1.0, ls=(0, (4, 2)), label="wanted yd")
        top.plot(time, shown, color=colour(method), lw=1.1, label="measured y")
        top.set_title(method.replace("-", " "))
        bottom.plot(time, error, color=colour(method), lw=0.8)
        bottom.axhline(0.0, color=MUTED, lw=0.7)
        bottom.set_xlabel("time in the stage, s")
        seen = np.abs(error[np.isfinite(error)])
        largest = max(largest, float(seen.max()) if seen.size else 0.0)
        outcome = run.result.tracking.get(method)
        rms = math.nan if outcome is None else 1e3 * known(outcome.rms_rad)
        if math.isfinite(rms):
            true = math.nan if outcome is None else 1e3 * known(outcome.true_rms_rad)
            of_shaft = f", of the shaft {true:.3g}" if math.isfinite(true) else ""
            note(bottom, f"RMS {rms:.3g} mrad{of_shaft}", loc="upper left")
    panels[0, 0].set_ylabel("position, rad")
    panels[1, 0].set_ylabel("error yd − y, mrad")
    if largest > 0.0:
        panels[1, 0].set_ylim(-1.45 * largest, 1.45 * largest)
    low, high = panels[0, 0].get_ylim()
    panels[0, 0].set_ylim(low, high + 0.2 * (high - low))  # room for the legend
    panels[0, 0].legend(loc="upper right", ncols=2, borderaxespad=0.1)
    return render(
        figure, run.foot, "Tracking with each model side by side: wanted and measured position, and the error.",
        "Tracking by feedback linearisation with each model: the same trajectory, gains and axes. The error includes "
        "the sensor's noise, but no curvature of the sensor that the model knows. The table counts it only after the "
        "trajectory has faded in.",
    )  # fmt: skip


def decay(run: ReportedRun) -> Picture:
    """How the error dies away from the offset with which each check begins: measured, and as (35) has it.

    Raises AbsentError if no model tracked, or none from an offset.
    """
    spans = {s.stage: s for s in run.spans_of("track", "No model was driven along the trajectory in this run.")}
    if run.config.decay is None:
        raise AbsentError("No check began with an offset: tracking.offset_rad.")
    designed = ErrorDecay(*run.config.decay)
    real_motors = _real_motors(run)
    figure = new_figure(2.6)
    panels = figure.subplots(1, len(spans), sharex=True, sharey=True, squeeze=False)[0]
    off: dict[str, float] = {}
    for axes, span in zip(panels, spans.values(), strict=True):
        method = span.stage.partition(":")[2]
        time = run.rows.t_s[span.first : span.last + 1] - run.rows.t_s[span.first]
        rows = slice(span.first, span.first + int(np.searchsorted(time, DECAY_S)))
        time, y = time[: rows.stop - rows.start], run.rows.y_rad[rows]
        real = real_motors.get(method)
        error = run.rows.yd_rad[rows] - (y if real is None else real.positions(y))
        wanted = np.array([designed.at(t)[0] for t in time.tolist()])
        off[method] = float(np.nanmax(np.abs(error - wanted), initial=0.0))
        axes.plot(time, 1e3 * wanted, color=INK, lw=1.0, ls=(0, (4, 2)), label="designed (35)")
        axes.plot(time, 1e3 * error, color=colour(method), lw=1.1, label="measured yd − y")
        axes.axhline(0.0, color=MUTED, lw=0.7)
        axes.set(title=method.replace("-", " "), xlabel="time in the stage, s")
    panels[0].set_ylabel("error, mrad")
    panels[0].legend(loc="upper right")
    words = ", ".join(f"{1e3 * value:.2g} mrad with {method.replace('-', ' ')}" for method, value in off.items())
    return render(
        figure, run.foot, "The error from an offset with each model: measured, and as designed.",
        f"Each check begins {run.config.decay[0]:g} rad beside the shaft. With the true model the error dies away as "
        f"e'' + k1 e' + k2 e = 0 has it, (35). Farthest from that: {words}.",
    )  # fmt: skip


def _real_motors(run: ReportedRun) -> dict[str, FramedMotor]:
    """By method, the models that drove; a damaged one is left out: its readings are shown as they are."""
    found = {}
    for event in run.events:
        if event.kind == "model":
            with suppress(DamagedError, ValueError):
                driven = parsed(DrivenModel, event.detail)
                found[driven.method] = FramedMotor.of(driven.numbers)
    return found


def loop_timing(run: ReportedRun) -> Picture:
    """Histograms of lateness and link time, counts on a logarithmic scale, with percentiles.

    Raises AbsentError in virtual time, and if neither was recorded.
    """
    if run.in_virtual_time:
        raise AbsentError(
            "This run was simulated in virtual time: its clock waits for the computation. So there is no lateness "
            "and no link time to show."
        )
    late, io = run.rows.late_us, run.rows.io_us
    if not (np.isfinite(late).any() or np.isfinite(io).any()):
        raise AbsentError("Lateness and link time were not recorded.")
    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2)
    _histogram(left, late, "lateness of the tick")
    _histogram(right, io, "time of the exchange with the device")
    left.set_ylabel("ticks")
    skipped = None if run.result.loop is None else run.result.loop.skipped
    words = "" if skipped is None else f" {skipped} ticks were skipped."
    period = run.period_s
    grid = f" The period is {1e6 * period:.0f} µs." if math.isfinite(period) else ""
    return render(
        figure, run.foot, "Histograms of loop lateness and link time.",
        "Timing of the loop, counts on a logarithmic scale; vertical lines are the median, 99 %, 99.9 % and the "
        f"largest value.{grid}{words}",
    )  # fmt: skip


def _histogram(axes: Axes, values: Array, label: str) -> None:
    seen = values[np.isfinite(values)]
    axes.set_xlabel(f"{label}, µs")
    if seen.size == 0:
        note(axes, "not recorded")
        return
    largest, median = float(seen.max()), float(np.median(seen))
    if largest > 20.0 * max(median, 1.0):  # stragglers would squeeze the rest into one bin
        axes.hist(np.maximum(seen, 1.0), bins=np.geomspace(1.0, 1.05 * largest, 80).tolist(), color=MEASURED, lw=0)
        axes.set(xscale="log", xlabel=f"{label}, µs (first bin: all up to 1 µs)")
    else:
        axes.hist(seen, bins=80, color=MEASURED, lw=0)
    axes.set_yscale("log")
    marks = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
    words = []
    for (name, percent), ink in zip(marks.items(), ("#009E73", "#E69F00", "#D55E00", LIMIT), strict=True):
        value = float(np.percentile(seen, percent))
        axes.axvline(max(value, 1.0) if axes.get_xscale() == "log" else value, color=ink, lw=1.2)
        words.append(f"{name} {value:,.0f}")
    axes.set_title(",  ".join(words) + " µs", fontweight="normal")
