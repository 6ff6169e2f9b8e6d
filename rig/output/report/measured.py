"""Figures of what was measured: the whole run, breakaway, gain search, the relay tests and their portraits."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from rig.core.arrays import Array
from rig.core.estimators import ESTIMATORS
from rig.output.report.model_curves import central_difference, cycles_of, models, predict_cycles
from rig.output.report.source import ReportedRun, Span
from rig.output.report.style import (
    BANDS,
    DRIVE,
    FAINT,
    INK,
    LIMIT,
    MEASURED,
    MUTED,
    RASTER_FROM,
    RELAY_STAGES,
    WIDTH_IN,
    AbsentError,
    Picture,
    new_figure,
    note,
    plain,
    render,
    stage_kind,
    stage_label,
)
from rig.run_folder.results import BreakawayResult, SearchStepResult, known

PORTRAIT_ROWS = 3  # before and after: over one, a coarse sensor makes stripes of the velocity


def whole_run(run: ReportedRun) -> Picture:
    """Position and drive over time: stages, limits, cycles, faults."""
    figure, count = whole_run_figure(run)
    words = f" Triangles mark the starts of the {count} relay cycles used." if count else ""
    tracked = {span.stage.partition(":")[2] for span in run.spans("track")}
    models = [f"{entry.short} {entry.name.replace('-', ' ')}" for entry in ESTIMATORS if entry.name in tracked]
    words += f" Tracking with the model{'s' * (len(models) > 1)} of {', '.join(models)}." if models else ""
    return render(
        figure, run.foot, "Position and drive over the whole run, stages shaded.",
        f"Position and drive over the whole run ({len(run.rows)} samples). Stages are shaded and named." + words,
    )  # fmt: skip


def whole_run_figure(run: ReportedRun) -> tuple[Figure, int]:
    """``whole_run`` before it is laid out; and how many relay cycles it marks."""
    t, y, u = run.rows.t_s, run.rows.y_rad, run.rows.u_V
    figure = new_figure(4.9)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.1, 1.0))
    raster = t.size > RASTER_FROM
    top.plot(t, y, color=MEASURED, lw=0.7, label="measured position", rasterized=raster)
    if np.isfinite(run.rows.yd_rad).any():
        top.plot(t, run.rows.yd_rad, color="#f0b64a", lw=2.2, zorder=1.5, label="wanted position", rasterized=raster)
    _limits(top, run)
    top.set_ylabel("position y, rad")
    bottom.step(t, u, where="post", color=MEASURED, lw=0.6, rasterized=raster)
    bottom.set(ylabel="drive u, V", xlabel="time since the start, s")
    bottom.set_xlim(float(t[0]), float(t[-1]) + 0.005 * float(t[-1] - t[0]))
    _stage_bands((top, bottom), t, run.spans())
    count = 0
    for span in run.spans("relay"):
        cycles = cycles_of(run, span)
        if cycles is not None:
            count += len(cycles)
            foot = blended_transform_factory(top.transData, top.transAxes)
            starts = t[[first for first, _ in cycles.rows]]
            top.plot(starts, np.full(starts.size, 0.025), "^", ms=3.0, color=INK, transform=foot, zorder=4)
    for fault in run.faults:
        when = known(fault.t_s)
        if math.isfinite(when):
            for axes in (top, bottom):
                axes.axvline(when, color=LIMIT, lw=1.2)
            note(top, plain(f"fault {fault.code} at {when:.2f} s"), loc="upper left", colour=LIMIT)
    low, high = top.get_ylim()
    top.set_ylim(low, high + 0.13 * (high - low))  # room for the legend above the limits
    top.legend(loc="upper right", ncols=4, borderaxespad=0.1)
    return figure, count


def _limits(axes: Axes, run: ReportedRun) -> None:
    soft, hard = run.config.soft_rad, run.config.hard_rad
    for limits, style, words in ((soft, (0, (5, 3)), "soft limit"), (hard, "-", "hard limit")):
        for k, value in enumerate(limits or ()):
            axes.axhline(value, color=LIMIT, lw=0.9, ls=style, label=words if k == 0 else None)


def _stage_bands(panels: tuple[Axes, ...], t: Array, spans: list[Span]) -> None:
    """Shade each stage, and name it above the first panel; a name that would overlap goes to another line."""
    inches_per_s = 0.88 * WIDTH_IN / max(float(t[-1] - t[0]), 1e-9)
    free_from = [-math.inf, -math.inf, -math.inf]
    head = blended_transform_factory(panels[0].transData, panels[0].transAxes)
    for k, span in enumerate(spans):
        begin = float(t[span.first])
        end = float(t[min(span.last + 1, t.size - 1)])
        for axes in panels:
            axes.axvspan(begin, end, color=BANDS.get(stage_kind(span.stage), "#f3f0f5"), lw=0, zorder=0)
            if k:
                axes.axvline(begin, color=FAINT, lw=0.6, zorder=0.5)
        label = stage_label(span.stage)
        at = begin * inches_per_s
        lane = next((n for n, free in enumerate(free_from) if at >= free), 0)
        free_from[lane] = at + 0.075 * len(label) + 0.08
        panels[0].text(
            begin, 1.015 + 0.055 * lane, label, transform=head, fontsize=8, color=INK, weight="bold", clip_on=False
        )


def relay_tests(run: ReportedRun) -> Picture:
    """The last periods of each relay test: position, its integral, the drive, and the order of the edges.

    Raises AbsentError without a relay test.
    """
    spans = run.spans_of("relay", "There was no relay test, so there is no limit cycle to show.")
    t, y, z, u = run.rows.t_s, run.rows.y_rad, run.rows.z_rad_s, run.rows.u_V
    v = velocity(run)
    figure = new_figure(5.0)
    panels = figure.subplots(3, len(spans), sharex="col", sharey="row", squeeze=False, height_ratios=(2, 1.2, 1.2))
    for column, span in enumerate(spans):
        rows = _last_periods(run, span, 4)
        time = t[rows] - t[rows.start]
        acts = run.rows.t_u_s[rows] - t[rows.start]
        acts = np.where(np.isfinite(acts), acts, time)
        panels[0, column].plot(time, y[rows], ".-", color=MEASURED, ms=2.5, lw=0.6)
        panels[1, column].plot(time, z[rows], ".-", color=MEASURED, ms=2.5, lw=0.6)
        panels[2, column].step(acts, u[rows], where="post", color=MEASURED)
        for axes, signal, mark, words in (
            (panels[0, column], y[rows], "#0072B2", "RB: y = 0"),
            (panels[1, column], z[rows], "#D55E00", "RC: z = 0"),
        ):
            axes.axhline(0.0, color=MUTED, lw=0.7)
            crossing = _crossings(time, signal)
            axes.plot(crossing, np.zeros(crossing.size), "o", ms=4.5, mfc="white", mec=mark, mew=1.3, label=words)
        turns = _extrema(time, y[rows], v[rows])
        panels[0, column].plot(
            turns, np.interp(turns, time, y[rows]), "D", ms=4.5, mfc="white", mec="#009E73", mew=1.3, label="RA: v = 0"
        )
        test = next((test for test in run.result.relays if test.stage == span.stage), None)
        title = stage_label(span.stage)
        if test is not None:
            title += f":  h1 = {test.h1_V:.3g} V,  h2 = {test.h2_V:.3g} V"
        panels[0, column].set_title(title)
        panels[2, column].set_xlabel("time, s")
    for axes, words in zip(panels[:, 0], ("y, rad", "z, rad s", "u, V"), strict=True):
        axes.set_ylabel(words)
    for axes in panels[:2, -1]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderaxespad=0.0, handletextpad=0.2)
    return render(
        figure, run.foot, "The last four periods of each relay test: position, its integral and drive.",
        "The last four periods of each relay test: position y, its integral z, and the drive that the device reported. "
        "In theory, the edges of the limit cycle come in the order RA (velocity), RB (position), RC (integral).",
    )  # fmt: skip


def _last_periods(run: ReportedRun, span: Span, count: int) -> slice:
    """Rows of the last ``count`` whole cycles of a relay test; if none is settled, of its last 3 s."""
    cycles = cycles_of(run, span)
    if cycles is not None:
        return slice(cycles.rows[-min(count, len(cycles))][0], cycles.rows[-1][1] + 1)
    t = run.rows.t_s
    first = int(np.searchsorted(t, t[span.last] - 3.0))
    return slice(max(first, span.first), span.last + 1)


def _crossings(t: Array, signal: Array) -> Array:
    """Times at which ``signal`` changes sign, by linear interpolation."""
    k = np.flatnonzero(np.signbit(signal[1:]) != np.signbit(signal[:-1]))
    return np.asarray(t[k] - signal[k] * (t[k + 1] - t[k]) / (signal[k + 1] - signal[k]))


def _extrema(t: Array, y: Array, v: Array) -> Array:
    """Times of the largest and the smallest position between crossings of the mean, so that noise adds none."""
    level = y - 0.5 * (np.max(y) + np.min(y))
    edges = np.flatnonzero(np.signbit(level[1:]) != np.signbit(level[:-1])) + 1
    return np.array([t[a + int(np.argmax(np.abs(level[a:b])))] for a, b in pairwise(edges.tolist())])


def velocity(run: ReportedRun, rows: int = 1) -> Array:
    """Velocity of the shaft, rad/s: the tachometer's, or without one the central difference over so many ``rows``."""
    if has_tachometer(run):
        return run.rows.v_rad_per_s
    return central_difference(run.rows.t_s, run.rows.y_rad, rows)


def has_tachometer(run: ReportedRun) -> bool:
    """Whether nearly every row has a measured velocity."""
    return bool(np.isfinite(run.rows.v_rad_per_s).mean() > 0.9)


def portraits(run: ReportedRun) -> Picture:
    """Phase portraits y-v and y-z of the relay tests, with the switching planes.

    Raises AbsentError without a relay test.
    """
    spans = run.spans_of("relay", "There was no relay test, so there is no phase portrait.")
    y, z, v = run.rows.y_rad, run.rows.z_rad_s, velocity(run, PORTRAIT_ROWS)
    figure = new_figure(4.5)
    left, right = figure.subplots(1, 2, sharex=True)
    best = next(iter(models(run).values()), None)
    for k, span in enumerate(spans):
        rows = _last_periods(run, span, 12)
        ink = RELAY_STAGES[k % len(RELAY_STAGES)]
        mark = "osD^"[k % 4]
        label = stage_label(span.stage)
        left.plot(y[rows], v[rows], mark, ms=1.8, color=ink, alpha=0.45, mew=0, label=label, rasterized=True)
        right.plot(y[rows], z[rows], mark, ms=1.8, color=ink, alpha=0.45, mew=0, label=label, rasterized=True)
        cycles = cycles_of(run, span)
        for predicted in predict_cycles(run, *best, cycles.last()) if cycles and best else ():
            left.plot(predicted.y_rad, predicted.v_rad_per_s, "-", color=INK, lw=1.0,
                      label="model" if k == 0 else None)  # fmt: skip
        at = np.flatnonzero(np.signbit(z[rows][1:]) != np.signbit(z[rows][:-1]))
        left.plot(y[rows][at], v[rows][at], "x", color=INK, ms=4.5, mew=1.0, label="z = 0 (RC)" if k == 0 else None)
        turn = np.flatnonzero(np.signbit(v[rows][1:]) != np.signbit(v[rows][:-1]))
        far = turn[np.abs(y[rows][turn]) > 0.5 * np.max(np.abs(y[rows]))]
        right.plot(y[rows][far], z[rows][far], "D", color=INK, ms=3.2, mfc="none", mew=0.9,
                   label="v = 0 (RA)" if k == 0 else None)  # fmt: skip
    left.axhline(0, color="#009E73", lw=1.0)
    right.axhline(0, color="#D55E00", lw=1.0)
    for axes in (left, right):
        axes.axvline(0, color="#0072B2", lw=1.0)
        axes.set_xlabel("position y, rad")
    left.set_ylabel("velocity v, rad/s")
    right.set_ylabel("integral of position z, rad s")
    left.set_title("velocity over position")
    right.set_title("integral over position")
    _name_planes(left, "RA: v = 0", "#009E73")
    _name_planes(right, "RC: z = 0", "#D55E00")
    for axes in (left, right):  # the middle of a cycle is empty
        handles, labels = axes.get_legend_handles_labels()
        order = sorted(range(len(labels)), key=lambda k: not labels[k].startswith("relay"))
        axes.legend(
            [handles[k] for k in order],
            [labels[k] for k in order],
            loc="center",
            markerscale=2.0,
            frameon=True,
            facecolor="white",
            edgecolor="none",
            framealpha=0.9,
        )
    source = "the tachometer's" if has_tachometer(run) else f"the difference over {PORTRAIT_ROWS} rows before and after"
    return render(
        figure, run.foot, "Phase portraits of the relay tests with the switching planes.",
        f"Phase portraits of the settled cycles with the three switching planes. Each point is a sample; velocity is "
        f"{source}.",
    )  # fmt: skip


def _name_planes(axes: Axes, horizontal: str, ink: str) -> None:
    """Name the horizontal plane at its right end, and y = 0 at its foot."""
    axes.margins(0.12, 0.1)
    axes.annotate(horizontal, (1.0, 0.0), xycoords=("axes fraction", "data"), xytext=(3, 0),
                  textcoords="offset points", va="center", fontsize=7.5, color=ink)  # fmt: skip
    axes.annotate("RB: y = 0", (0.0, 0.0), xycoords=("data", "axes fraction"), xytext=(4, 3),
                  textcoords="offset points", fontsize=7.5, color="#0072B2")  # fmt: skip


def breakaway(run: ReportedRun) -> Picture:
    """The breakaway strokes: drive and position over time, static friction marked.

    Raises AbsentError without a breakaway check.
    """
    spans = run.spans_of("breakaway", "There was no breakaway check in this run.")
    rows = slice(spans[0].first, spans[-1].last + 1)
    t, y, u = run.rows.t_s[rows], run.rows.y_rad[rows], run.rows.u_V[rows]
    figure = new_figure(4.2)
    panels = figure.subplot_mosaic([["position", "over"], ["drive", "over"]], width_ratios=(1.25, 1.0))
    position, drive, right = panels["position"], panels["drive"], panels["over"]
    position.plot(t, 1e3 * y, ".", color=FAINT, ms=1.6, rasterized=True, label="a reading")
    position.set(ylabel="position, mrad", title="slowly stronger strokes, until the shaft moves each way")
    position.sharex(drive)
    position.tick_params(labelbottom=False)
    drive.fill_between(t, u, step="post", color=DRIVE, lw=0)
    drive.set(ylabel="drive, V", xlabel="time since the start, s")
    found = run.result.breakaway or BreakawayResult()
    plus = ("plus", 1.0, "#0072B2", found.static_plus_V, found.static_plus_range_V)
    minus = ("minus", -1.0, "#D55E00", found.static_minus_V, found.static_minus_range_V)
    for name, sign, ink, static, reach in (plus, minus):
        level, moved, stood_s, stood_rad = _strokes(t, y, u, sign)
        if level.size:
            position.plot(stood_s, 1e3 * stood_rad, "o", ms=2.6, color=ink, mew=0, label=f"mean after a {name} stroke")
            right.plot(level, 1e3 * np.cumsum(moved), ".-", ms=3.0, lw=0.6, color=ink,
                       label=f"{name}: towards {'rising' if sign > 0 else 'falling'} positions")  # fmt: skip
        static_V = known(static)
        if math.isfinite(static_V):
            low_V, high_V = map(known, reach or (None, None))
            if math.isfinite(low_V) and math.isfinite(high_V):
                right.axvspan(low_V, high_V, color=ink, alpha=0.12, lw=0)
            right.axvline(static_V, color=ink, lw=1.2, ls=(0, (4, 2)), label=f"breaks away at {static_V:.3f} V")
    right.set(xlabel="|drive| of a stroke, V", ylabel="moved so far in this direction, mrad")
    right.set_title("displacement over drive")
    if right.get_legend_handles_labels()[0]:
        # below, since bands and dashed lines fill the axes
        right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
        position.legend(loc="lower left", ncols=3, markerscale=2.0, handletextpad=0.1, columnspacing=1.0)
        low, high = position.get_ylim()
        position.set_ylim(low - 0.2 * (high - low), high)  # room for the legend
    else:
        note(right, "the run ended before a stroke")
    noise = 1e3 * known(found.noise_rad)
    words = f" At rest the sensor's noise is {noise:.2g} mrad (standard deviation)." if math.isfinite(noise) else ""
    if any(math.isfinite(known(level)) for level in (found.static_plus_V, found.static_minus_V)):
        words += (
            " Dashed, with its interval: the drive at which the identified model must break away to reproduce the "
            "motion best. Towards rising positions it is static friction minus bias; towards falling ones, static "
            "friction plus bias."
        )
    return render(
        figure, run.foot, "Breakaway strokes: drive and position, with static friction.",
        "Breakaway check: short strokes, slowly stronger. They prove sensor, drive and sign before any test, and "
        "show static friction." + words,
    )  # fmt: skip


def _strokes(t_s: Array, y_rad: Array, u_V: Array, sign: float) -> tuple[Array, Array, Array, Array]:
    """The strokes in one direction: the largest |drive| of each, V, and how far it moved the shaft along, rad.

    Then when the shaft stood after it, s, and where, rad: means over the second half of its pause.
    """
    way = np.concatenate(([0.0], np.sign(u_V), [0.0]))
    begins = np.flatnonzero((way[1:-1] != 0.0) & (way[1:-1] != way[:-2]))
    found = []
    for begin, until in zip(begins, np.append(begins, y_rad.size)[1:], strict=True):
        if sign * u_V[begin] > 0.0:
            pause = begin + int(np.count_nonzero(u_V[begin:until]))
            stands = slice((pause + until) // 2, until) if until > pause else slice(until - 1, until)
            stood, count = float(y_rad[stands].mean()), stands.stop - stands.start
            before = float(y_rad[max(begin - count + 1, 0) : begin + 1].mean())
            level = float(np.abs(u_V[begin:until]).max())
            found.append((level, sign * (stood - before), float(t_s[stands].mean()), stood))
    level_V, moved_rad, stood_s, stood_rad = np.array(found).reshape(-1, 4).T
    return level_V, moved_rad, stood_s, stood_rad


def gain_search(run: ReportedRun) -> Picture:
    """The path of the gain search: h1 and h2 over time, and the amplitude and period that settled.

    Raises AbsentError if no step was noted.
    """
    steps = _search_steps(run)
    if not steps:
        raise AbsentError("The config gave the gains, or the run ended before the search noted a step.")
    t, amplitude, period = (
        np.array([known(value) for value in values])
        for values in zip(*((s.t_s, s.amplitude_rad, s.period_s) for s in steps), strict=True)
    )
    if run.result.stopped is not None and not np.isfinite(amplitude).any():
        return _rising_gains(run, steps)
    figure = new_figure(4.3)
    gains, size, length = figure.subplots(3, 1, sharex=True, height_ratios=(1.3, 1, 1))
    begin = _draw_gains(run, steps, gains)
    tolerance, ratio = known(run.config.tolerance), known(run.config.second_ratio)
    for axes, values, aim, words in (
        (size, amplitude, run.config.wanted_amplitude_rad, "amplitude A, rad"),
        (length, period, run.config.wanted_period_s, "period T, s"),
    ):
        axes.plot(t, values, "o", color=MEASURED, ms=5)
        wanted = known(aim)
        if math.isfinite(wanted):
            axes.axhline(wanted, color="#009E73", lw=1.0, ls=(0, (4, 2)))
            if math.isfinite(tolerance):
                axes.axhspan(wanted * (1 - tolerance), wanted * (1 + tolerance), color="#e2f1ea", lw=0)
            note(axes, f"wanted {wanted:g}", loc="lower left", colour="#00684b")
            if axes is size and math.isfinite(ratio):
                axes.axhline(ratio * wanted, color="#009E73", lw=1.0, ls=":")
        if not np.isfinite(values).any():
            note(axes, "no cycle settled")
            axes.set_yticks([])
        axes.set_ylabel(words)
    length.set_xlabel("time since the start, s")
    gains.set_xlim(begin, t[-1] + 0.02 * (t[-1] - begin))
    settled = int(np.isfinite(amplitude).sum())
    why = Counter(_in_words(s.outcome) for s, a in zip(steps, amplitude, strict=True) if not math.isfinite(a))
    others = "; ".join(f"{words} ({count})" for words, count in sorted(why.items()) if words)
    others = f" Why the others did not, and how many: {others}." if others else ""
    second = " Dotted: the amplitude that the second test is to have." if math.isfinite(ratio) else ""
    return render(
        figure, run.foot, "Path of the gain search: gains, amplitude and period over time.",
        f"Gain search: it raises h2 until a cycle settles, then trims both gains towards the wanted amplitude and "
        f"period (green).{second} It tried {len(steps)} pairs of gains; a dot marks each of the {settled} that settled."
        + others,
    )  # fmt: skip


def _in_words(outcome: str) -> str:
    """Why a pair of gains gave no cycle, for people."""
    if outcome.endswith("delay hunting"):
        return "too small or too quick: the shaft only hunts about zero, since each switch acts late"
    return outcome


def _rising_gains(run: ReportedRun, steps: list[SearchStepResult]) -> Picture:
    """The path of a start without a target: its gains alone."""
    figure = new_figure(2.6)
    gains = figure.subplots()
    _draw_gains(run, steps, gains)
    gains.set_xlabel("time since the start, s")
    return render(
        figure, run.foot, "Path of the start without a target: gains over time.",
        "The search needs no model and no target: a relay's gains grow from the breakaway level until the shaft swings "
        f"widely, in {len(steps)} steps. What it drove is identified, too.",
    )  # fmt: skip


def _draw_gains(run: ReportedRun, steps: list[SearchStepResult], axes: Axes) -> float:
    """Draw h1 and h2 over time; returns when the search began, s."""
    t, h1, h2 = (
        np.array([known(value) for value in values])
        for values in zip(*((s.t_s, s.h1_V, s.h2_V) for s in steps), strict=True)
    )
    # the run notes a step when it is over: its gains held since the step before
    begin = min((float(run.rows.t_s[s.first]) for s in run.spans("search")), default=float(t[0]))
    edges = np.concatenate(([begin], t))
    axes.stairs(h1, edges, baseline=None, color="#0072B2", lw=1.6, label="h1 (position)")
    axes.stairs(h2, edges, baseline=None, color="#D55E00", lw=1.6, ls="--", label="h2 (integral)")
    axes.set_ylabel("gain, V")
    axes.margins(y=0.25)  # room for the legend above the steps
    axes.legend(loc="upper left", ncols=2)
    return begin


def _search_steps(run: ReportedRun) -> list[SearchStepResult]:
    """Steps of the search from the events; without any, from the result."""
    seen = run.events_of("search", SearchStepResult) or run.result.search or ()
    return [s for s in seen if all(math.isfinite(known(value)) for value in (s.t_s, s.h1_V, s.h2_V))]
