"""How the estimate narrowed while the tests of `relay.until` ran: a figure, and why the tests ended."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes

from rig.output.report.source import ReportedRun
from rig.output.report.style import BANDS, INK, LIMIT, MUTED, AbsentError, Picture, new_figure, note, render, stage_kind
from rig.run_folder.results import LiveResult, StoppedResult, known

SHOWN = (
    ("tau_s", "tau_percent", "τ", "#0072B2", "o-"),
    ("K_rad_s_V", "K_percent", "K", "#D55E00", "s--"),
    ("fc_V", "fc_percent", "$f_c$", "#009E73", "^-."),
)
BESIDE_S = 0.06
WIDEST_PERCENT = 30.0  # an interval that is wider says next to nothing: it is not drawn


def narrowing(run: ReportedRun) -> Picture:
    """The intervals of tau, K and f_c at each live estimate, and the estimates themselves over the last one.

    Raises AbsentError without a live estimate.
    """
    live = [one for one in run.events_of("live", LiveResult) if math.isfinite(known(one.of_s))]
    if not live:
        raise AbsentError("There was no live estimate: the tests ended before the first, or its process did not work.")
    stopped = run.result.stopped or StoppedResult()
    t = np.array([known(one.of_s) for one in live])
    figure = new_figure(3.6)
    widths, values = figure.subplots(1, 2, width_ratios=(1.0, 1.0), sharex=True)
    for axes in (widths, values):
        _shade_stages(run, axes)
    for k, (name, half, symbol, ink, mark) in enumerate(SHOWN):
        percent = np.array([known(getattr(one, half)) for one in live])
        value = np.array([known(getattr(one, name)) for one in live])
        widths.semilogy(t, percent, mark, color=ink, ms=4, lw=1.1, label=symbol)
        off = 100.0 * (value / value[-1] - 1.0)
        drawn = percent <= WIDEST_PERCENT
        beside = t[drawn] + (k - 1) * BESIDE_S  # so that no bar hides another
        values.errorbar(beside, off[drawn], percent[drawn], fmt=mark, ms=4, color=ink, capsize=2, lw=0.9)
        true = run.truth.get(name)
        if true is not None and value[-1] > 0.0:
            values.axhline(100.0 * (true / value[-1] - 1.0), color=ink, lw=0.9, ls=(0, (1, 2)))
    wanted = known(stopped.wanted_percent)
    if math.isfinite(wanted):
        widths.axhline(wanted, color=LIMIT, lw=1.0, ls=(0, (4, 2)))
        note(widths, f"asked for: {wanted:g} %", loc="lower left", colour=LIMIT)
    ended = known(stopped.t_s)
    if math.isfinite(ended):
        for axes in (widths, values):
            axes.axvline(ended, color=INK, lw=1.0)
    widths.set(title="half width of the 95 % interval", ylabel="% of the value")
    values.set(title="estimate over the last one", ylabel="%")
    values.axhline(0.0, color=MUTED, lw=0.7)
    for axes in (widths, values):
        axes.set_xlabel("time since the start, s")
    widths.yaxis.set_major_formatter("{x:g}")
    widths.legend(loc="upper right", ncols=3)
    dotted = " Dotted: the emulated motor's values." if run.truth else ""
    return render(
        figure, run.foot, "How the intervals of tau, K and friction narrowed while the tests ran.",
        f"Live estimates while the tests ran, about one a second: the half width of each 95 % interval, and each value "
        f"over the last one with its interval. Bands: the stages. Upright line: the tests ended.{dotted} The estimate "
        "at the top of the page comes from the same rows, with laws and verdict.",
    )  # fmt: skip


def _shade_stages(run: ReportedRun, axes: Axes) -> None:
    for span in run.spans():
        kind = stage_kind(span.stage)
        if kind in ("search", "relay", "strokes"):
            begin, end = float(run.rows.t_s[span.first]), float(run.rows.t_s[span.last])
            axes.axvspan(begin, end, color=BANDS[kind], lw=0, zorder=0)


def why_it_ended(run: ReportedRun) -> str:
    """Why the tests ended, as a sentence; empty of a run without `relay.until`."""
    stopped = run.result.stopped
    if stopped is None:
        return ""
    seconds, cycles = known(stopped.tests_s), stopped.cycles
    after = f" after {seconds:.1f} s and {cycles} swings to and fro" if math.isfinite(seconds) else ""
    return f"The tests ended{after}: {stopped.why}."
