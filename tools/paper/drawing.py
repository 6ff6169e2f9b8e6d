"""What the report's figures share: the style of the run reports, colours of the two cycles, and one way to render."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from paper.page import BACKEND
from rig.model.limit_cycle import LimitCycle
from rig.model.linear import input_vector, transition
from rig.output.report.style import INK, MUTED, Picture, new_figure, note, render, style

Array = NDArray[np.float64]

FIRST, SECOND = "#0072B2", "#D55E00"  # the paper's two pairs of gains
CYCLES = (FIRST, SECOND)
EXACT, SINE, PEER = INK, "#009E73", "#E69F00"
PARAMETERS = (("τ", "#0072B2", "o"), ("K", "#D55E00", "s"), ("f_c", "#009E73", "D"))
STAGES = ("#eef3f8", "#ffffff", "#f8f1e6")
PAPER = "#7b2a8c"


def finish(figure: Figure, alt: str, caption: str, backend: str = BACKEND) -> Picture:
    """The figure as an image with its caption."""
    return render(figure, f"backend: {backend}", alt, caption)


def course(cycle: LimitCycle, points: int = 400, periods: float = 1.0) -> dict[str, Array]:
    """Time courses over whole half periods from the step up on: t, v, y, z, and which stage (0..5) each point is in."""
    half = 0.5 * cycle.period_s
    t = np.linspace(0.0, periods * cycle.period_s, points)
    halves = np.floor(t / half + 1e-12).astype(int)
    within = np.clip(t - halves * half, 0.0, half)
    ends = np.cumsum(cycle.durations_s)
    stage = np.minimum(np.searchsorted(ends, within, side="right"), 2)
    states = np.empty((t.size, 3))
    for k, (at, s) in enumerate(zip(within, stage, strict=True)):
        h = float(at - (ends[s - 1] if s else 0.0))
        moved = transition(cycle.tau_s, h) @ cycle.states[s]
        states[k] = moved + input_vector(cycle.tau_s, cycle.K_rad_s_V, h) * cycle.inputs_V[s]
    states *= np.where(halves % 2, -1.0, 1.0)[:, None]
    return {"t": t, "v": states[:, 0], "y": states[:, 1], "z": states[:, 2], "stage": stage + 3 * (halves % 2)}


def shade_stages(axes: Axes, cycle: LimitCycle, periods: float) -> None:
    """Shade the stages of each half period."""
    begin = 0.0
    while begin < periods * cycle.period_s - 1e-9:
        for length, ink in zip(cycle.durations_s, STAGES, strict=True):
            axes.axvspan(begin, min(begin + length, periods * cycle.period_s), color=ink, lw=0, zorder=0)
            begin += length


def zero(axes: Axes) -> None:
    """A thin line at zero."""
    axes.axhline(0.0, color=MUTED, lw=0.7)


__all__ = [
    "CYCLES", "EXACT", "FIRST", "INK", "MUTED", "PAPER", "PARAMETERS", "PEER", "SECOND", "SINE", "Array", "course",
    "finish", "new_figure", "note", "shade_stages", "style", "zero",
]  # fmt: skip
