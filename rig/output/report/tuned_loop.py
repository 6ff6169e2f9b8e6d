"""The picture of a tuned loop: the step and the tracking on drawn motors, a bench's beside them, and the open loop."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rig.output.report import style
from rig.output.report.source import ReportedRun
from rig.output.report.style import INK, LIMIT, MUTED, AbsentError, Picture, new_figure, render
from rig.run_folder.results import known
from rig.run_folder.results.tuned import TunedCurve, TunedMargins, TunedResult

HEIGHT_IN = 6.4
SMOOTH_S = 0.2
BAND = "#0072B2"
BENCH = "#D55E00"


def save(found: TunedResult, title: str, file: Path) -> None:
    """Write the picture, as ``style.save``."""
    style.save(file, title, HEIGHT_IN, lambda figure: _draw(figure, found))


def loop(run: ReportedRun) -> Picture:
    """The picture for the report of the bench's run. Raises AbsentError without a tuned loop."""
    found = run.result.tuned
    if found is None:
        raise AbsentError("No tuned loop ran.")
    figure = new_figure(HEIGHT_IN)
    _draw(figure, found)
    return render(
        figure, run.foot, "A tuned loop: step, drive and tracking error, predicted and on the bench.",
        f"The {found.loop} loop that `rig tune` made for the motor of {found.run}. Blue: 95 % of {found.draws} motors "
        "that the tests of that run allow, simulated. Orange: this bench.",
    )  # fmt: skip


def _draw(figure: Figure, found: TunedResult) -> None:
    axes = figure.subplot_mosaic(
        [["step", "nyquist"], ["drive", "nyquist"], ["tracking", "tracking"]],
        width_ratios=[1.7, 1.0],
        height_ratios=[1.3, 0.8, 1.0],
    )
    _curve(axes["step"], found.curves["step"], f"predicted: 95 % of {found.draws} motors")
    axes["step"].set(title="the step", ylabel=f"{'position' if found.loop == 'position' else 'speed'}, {_unit(found)}")
    axes["step"].legend(loc="lower right" if found.loop == "position" else "best")
    _curve(axes["drive"], found.curves["drive"])
    axes["drive"].set(ylabel="drive, V", xlabel="time from the step, s")
    if "tracking" in found.curves:
        _curve(axes["tracking"], _smooth(found.curves["tracking"]))
    axes["tracking"].set(
        title=f"tracking: reference less measured, means over {SMOOTH_S:g} s", ylabel=_unit(found), xlabel="time, s"
    )
    _nyquist(axes["nyquist"], found)


def _smooth(curve: TunedCurve) -> TunedCurve:
    """A curve's running means over ``SMOOTH_S``: the sensor's noise of single readings would hide it."""
    bench = None
    if curve.bench is not None and curve.bench_t_s is not None:
        bench = _means(curve.bench_t_s, curve.bench)
    low, median, high = (_means(curve.t_s, values) for values in (curve.low, curve.median, curve.high))
    return curve.model_copy(update={"low": low, "median": median, "high": high, "bench": bench})


def _means(t_s: Sequence[float], values: Sequence[float]) -> tuple[float, ...]:
    """Means of ``values`` over ``SMOOTH_S`` about each time, s; at the ends over what is there."""
    t, sums = np.asarray(t_s), np.concatenate(([0.0], np.cumsum(values)))
    first, end = (np.searchsorted(t, t + shift) for shift in (-0.5 * SMOOTH_S, 0.5 * SMOOTH_S))
    end = np.maximum(end, first + 1)
    return tuple(((sums[end] - sums[first]) / (end - first)).tolist())


def _curve(axes: Axes, curve: TunedCurve, words: str | None = None) -> None:
    """The band of the drawn motors, their median, the reference and the bench."""
    is_drive = curve.unit == "V"
    held: Literal["post"] | None = "post" if is_drive else None
    shape: Literal["steps-post", "default"] = "steps-post" if is_drive else "default"
    axes.fill_between(curve.t_s, curve.low, curve.high, color=BAND, alpha=0.25, linewidth=0, step=held, label=words)
    axes.plot(curve.t_s, curve.median, color=BAND, drawstyle=shape, label=words and "predicted: their median")
    if curve.reference is not None:
        axes.plot(curve.t_s, curve.reference, "--", color=INK, linewidth=0.9, label="reference")
    if curve.bench is not None and curve.bench_t_s is not None:
        axes.plot(curve.bench_t_s, curve.bench, color=BENCH, linewidth=0.9, label="bench", drawstyle=shape)


def _nyquist(axes: Axes, found: TunedResult) -> None:
    """The open loop of every corner near -1."""
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    axes.plot(np.cos(turn), np.sin(turn), ":", color=MUTED, linewidth=0.9)
    for one in found.responses[::-1]:
        axes.plot(one.real, one.imaginary, color=BAND, linewidth=0.8, alpha=0.6)
    axes.plot(-1.0, 0.0, "+", color=LIMIT, markersize=9)
    axes.set(xlim=(-2.2, 1.1), ylim=(-2.2, 1.1), aspect="equal", xlabel="real", ylabel="imaginary")
    axes.set_title(f"open loop: the motor, its corners\n{_words(found.margins['worst'])} at the worst")


def _words(margins: TunedMargins) -> str:
    return f"{margins.phase_deg:.0f} degrees, {known(margins.gain_dB):.1f} dB"


def _unit(found: TunedResult) -> str:
    return found.curves["step"].unit
