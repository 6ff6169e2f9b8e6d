"""The picture of `rig design`: the map over both gains, the best strokes, and the time that each interval takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from rig.output.report import style
from rig.output.report.style import DRIVE, INK, LIMIT, MEASURED, MUTED, note
from rig.run_folder.results.design import DesignResult

LONGEST_S = 1000.0  # beyond it the map has one colour
COLOURS = {"strokes": "#0072B2", "two pairs of gains in turn": "#D55E00", "one pair of gains": "#E69F00"}


def save(found: DesignResult, title: str, file: Path) -> None:
    """Write the picture, as ``style.save``."""
    style.save(file, title, 6.6, lambda figure: _draw(figure, found))


def _draw(figure: Figure, found: DesignResult) -> None:
    axes = figure.subplot_mosaic([["map", "times"], ["motion", "motion"]], height_ratios=[1.5, 1.0])
    _map(figure, axes["map"], found)
    _times(axes["times"], found)
    _motion(axes["motion"], found)


def _map(figure: Figure, axes: Axes, found: DesignResult) -> None:
    axes.set_title(f"one relay test: seconds until all intervals are within {found.wanted_percent:g} %")
    h1_V, h2_V = np.array(found.map.h1_V), np.array(found.map.h2_V)
    least_V = h2_V[0] - h1_V[0]  # both axes have the same steps from there
    shown = np.array(found.map.seconds, dtype=float)
    axes.set(xscale="log", yscale="log", xlabel="h1, V", ylabel=f"h2 - {least_V:.3g} V, V")
    if np.isfinite(shown).any():
        shown = np.minimum(shown, LONGEST_S)
        norm = LogNorm(max(float(np.nanmin(shown)), 0.1), float(np.nanmax(shown)) * 1.001)
        mesh = axes.pcolormesh(h1_V, h2_V - least_V, shown.T, norm=norm, cmap="viridis_r", shading="nearest")
        bar = figure.colorbar(mesh, ax=axes, label="s")
        bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_locator(NullLocator())
    axes.set_facecolor("#eceef1")
    axes.grid(False)
    note(axes, "grey: sticks, or leaves the room", loc="lower right", colour=MUTED)
    marked = [("one pair", "o", found.single), *zip(("hard", "soft"), "^v", found.gains, strict=False)]
    for name, marker, gains in marked:
        if gains is not None:
            axes.plot(
                gains.h1_V, gains.h2_V - least_V, marker, color=LIMIT, markerfacecolor="white", markersize=8,
                label=f"{name}: h1 {gains.h1_V:.3g} V, h2 {gains.h2_V:.3g} V", linestyle="none",
            )  # fmt: skip
    if found.single is None:
        note(axes, "no pair of gains stays inside the room")
    else:
        axes.legend(loc="upper left", frameon=True, framealpha=0.85)


def _times(axes: Axes, found: DesignResult) -> None:
    axes.set_title("how long for what interval")
    series = {
        "strokes": [one.strokes_s for one in found.until],
        "two pairs of gains in turn": [one.pair_s for one in found.until],
        "one pair of gains": [one.single_s for one in found.until],
    }
    percents = [one.interval_percent for one in found.until]
    for name, seconds in series.items():
        kept = [(p, s) for p, s in zip(percents, seconds, strict=True) if s is not None]
        if kept:
            axes.plot(*zip(*kept, strict=True), "o-", color=COLOURS[name], label=name, markersize=4)
    axes.set(xscale="log", yscale="log", xlabel="half width of the 95 % intervals, %", ylabel="test, s")
    axes.set_xticks(percents, [f"{p:g}" for p in percents])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.invert_xaxis()
    if axes.lines:
        axes.legend(loc="upper left")


def _motion(axes: Axes, found: DesignResult) -> None:
    axes.set_title("the best strokes, as the believed motor moves")
    if found.motion is None:
        note(axes, "no strokes stay inside the room")
        return
    motion, room = found.motion, found.room
    axes.plot(motion.t_s, motion.y_rad, color=MEASURED)
    for limit in (room.low_rad, room.high_rad):
        axes.axhline(limit, color=LIMIT, linewidth=0.8, linestyle="--")
    axes.set(xlabel="t, s", ylabel="y, rad", xlim=(0.0, motion.t_s[-1]))
    drive = axes.twinx()
    drive.step(motion.t_s, motion.u_V, where="post", color=DRIVE, linewidth=0.8)
    drive.set_ylabel("u, V", color=DRIVE)
    drive.set_ylim(*(1.4 * np.array(drive.get_ylim())))  # so that its levels lie on no limit
    drive.spines["right"].set_visible(True)
    drive.grid(False)
    for one in found.until:
        if one.interval_percent == found.wanted_percent and one.strokes_s is not None:
            axes.axvline(one.strokes_s, color=INK, linewidth=0.8, linestyle=":")
            axes.text(one.strokes_s, room.high_rad, f" {one.interval_percent:g} %", va="top", fontsize=8)
