"""Figures of the friction map: the drive over speed and over position, and the law of the identified motor."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from rig.identification.friction_map import FrictionMap, MapSpeed
from rig.output.report.model_curves import answer_motor
from rig.output.report.source import ReportedRun
from rig.output.report.style import INK, MUTED, AbsentError, Picture, new_figure, render
from rig.run_folder.results import FrictionMapResult, known

RISING, FALLING = "#0072B2", "#D55E00"
BARS = 2.0  # standard errors
POINTS = 120  # of a law's curve


def over_speed(run: ReportedRun) -> Picture:
    """The drive that each speed takes, and friction alone. Raises AbsentError without a survey."""
    result, law = _map(run)
    figure = new_figure(3.8)
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    K = known(result.K_rad_s_V)
    top = max((abs(known(one.speed_rad_s)) for one in result.speeds), default=0.0)
    for way, ink, words in ((1.0, RISING, "towards rising positions"), (-1.0, FALLING, "towards falling positions")):
        for one in result.speeds:
            v, u = known(one.speed_rad_s), known(one.drive_V)
            if v * way > 0.0:
                bar, fill = BARS * known(one.error_V), "white" if one.sticks else ink
                left.errorbar(v, u, bar, fmt="o", ms=5, color=ink, mfc=fill, capsize=2, lw=1.0)
                right.errorbar(abs(v), way * (u - v / K), bar, fmt="o", ms=5, color=ink, mfc=fill, capsize=2, lw=1.0)
        if law is not None and top > 0.0:
            speeds = np.geomspace(0.02 * top, 1.05 * top, POINTS)
            drives = np.array([law.law_over_speed(way * v) for v in speeds.tolist()])
            left.plot(way * speeds, drives, "-", color=ink, lw=1.1, zorder=1)
            right.plot(speeds, way * (drives - way * speeds / K), "-", color=ink, lw=1.1, zorder=1, label=words)
    left.axhline(0.0, color=MUTED, lw=0.7)
    left.axvline(0.0, color=MUTED, lw=0.7)
    left.set(xlabel="speed, rad/s", ylabel="drive, V", title="drive over speed")
    right.set(xlabel="speed, rad/s", ylabel="friction, V", title="friction over speed: the drive without v/K")
    right.margins(y=0.25)
    if law is not None:
        right.legend(loc="best")
    stuck = " Hollow: the shaft stuck and slipped." if any(one.sticks for one in result.speeds) else ""
    return render(
        figure, run.foot, "Friction map: drive over speed.",
        f"Mean drive of each slow sweep, less what acceleration took; bars: two standard errors.{stuck} "
        f"Lines: {_law_words(result)}.",
    )  # fmt: skip


def over_position(run: ReportedRun) -> Picture:
    """The drive at each position in both directions; force and friction. Raises AbsentError without a survey."""
    result, law = _map(run)
    if not result.positions:
        raise AbsentError("No sweep of the survey was steady, so there is no map over the position.")
    y = np.array([known(one.y_rad) for one in result.positions])
    figure = new_figure(4.6)
    panels = figure.subplots(2, 2, sharex=True)
    columns: tuple[tuple[Axes, str, str, str, Callable[[float, float], float]], ...] = (
        (panels[0, 0], "plus_V", "plus_error_V", "towards rising positions", lambda plus, minus: plus),
        (panels[1, 0], "minus_V", "minus_error_V", "towards falling positions", lambda plus, minus: minus),
        (panels[0, 1], "force_V", "error_V", "half the sum: force", lambda plus, minus: 0.5 * (plus + minus)),
        (panels[1, 1], "friction_V", "error_V", "half the difference: friction", lambda p, m: 0.5 * (p - m)),
    )
    grid = np.linspace(float(y[0]), float(y[-1]), POINTS)
    plus, minus = ([law.law_over_position(at, way) for at in grid.tolist()] if law else [] for way in (1.0, -1.0))
    widest = 0.0
    for axes, key, error, title, mixed in columns:
        values = np.array([known(getattr(one, key)) for one in result.positions])
        bars = np.array([BARS * known(getattr(one, error)) for one in result.positions])
        axes.errorbar(y, values, bars, fmt="o", ms=3.5, color=INK, lw=0.9, capsize=1.5)
        if law is not None:
            axes.plot(grid, [mixed(a, b) for a, b in zip(plus, minus, strict=True)], "-", color=RISING, lw=1.2)
        axes.set(title=title, ylabel="V")
        widest = max(widest, float(np.ptp(values)), 2.5 * float(np.max(bars)))
    for axes, *_ in columns:  # the same scale in all panels, so that small is seen as small
        low, high = axes.get_ylim()
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.65 * widest, middle + 0.65 * widest)
    for axes in panels[1]:
        axes.set_xlabel("position, rad")
    return render(
        figure, run.foot, "Friction map: drive over position, force and friction.",
        "Drive at each position less v/K and what acceleration took, mean over the sweeps; bars: two standard errors. "
        "What both directions share is a force, as of an unbalanced load; what turns with the motion is friction. All "
        f"panels have one scale. Lines: {_law_words(result)}.",
    )  # fmt: skip


def _law_words(result: FrictionMapResult) -> str:
    laws = ", ".join(name.replace("_", " ") for name in result.laws)
    return (
        f"the identified motor, with {laws}" if laws else "the identified motor, which has no law beyond the plain one"
    )


def _map(run: ReportedRun) -> tuple[FrictionMapResult, FrictionMap | None]:
    """The map of the result, and the identified motor beside it; None if the result has no usable motor."""
    result = run.result.friction_map
    if result is None or not result.speeds or result.travel_rad is None:
        raise AbsentError("There was no survey (`rig survey CONFIG` records one), so there is no friction map.")
    motor = answer_motor(run)
    low, high = map(known, result.travel_rad)
    if motor is None or not (math.isfinite(low) and math.isfinite(high) and low < high):
        return result, None
    speeds = tuple(
        MapSpeed(v, known(one.drive_V), known(one.error_V), one.sticks, known(one.share))
        for one in result.speeds
        if math.isfinite(v := known(one.speed_rad_s))
    )
    usable = all(sum(one.share for one in speeds if one.speed_rad_s * way > 0.0) > 0.0 for way in (1.0, -1.0))
    return result, FrictionMap(motor, (low, high), speeds, ()) if usable else None
