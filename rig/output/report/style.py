"""How figures look: palette, names, sizes; and from a matplotlib figure to an inline image.

The palette is Okabe and Ito's, which colour-blind readers can tell apart. Line styles differ too, for black and white
print. No pyplot: no global state, no display.
"""

from __future__ import annotations

import base64
import io
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import jinja2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from rig.core.estimators import ESTIMATORS
from rig.core.package import VERSION
from rig.run_folder.recording.folder import write_whole
from rig.run_folder.recording.stage import kind_of

FORMATS: Final = {".png": "Software", ".svg": "Date", ".pdf": "CreationDate"}  # with what each says of its making
WIDTH_IN = 10.0
INK = "#1f2328"
MUTED = "#6a737d"
FAINT = "#c9ced6"
LIMIT = "#9a1b1b"
MEASURED = "#4a4f57"
DRIVE = "#b35900"
# With this many points or more, a curve becomes pixels inside the vector figure: all points, in a smaller file.
RASTER_FROM = 20_000

# of the estimators, in the order of their list
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C510A")
LINES = ("-", "--", "-.", ":")
RELAY_STAGES = ("#0072B2", "#E69F00", "#CC79A7", "#56B4E9")
BANDS = {
    "breakaway": "#eceef1",
    "search": "#f8efd6",
    "relay": "#dfecf6",
    "strokes": "#e9e3f4",
    "homing": "#f4f1ec",
    "hysteretic": "#f6e6f0",
    "survey": "#e6f0df",
    "track": "#e2f1ea",
}

RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 5),
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "text.color": INK,
    "lines.linewidth": 1.1,
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.constrained_layout.h_pad": 0.06,
    "figure.constrained_layout.w_pad": 0.06,
    "path.simplify": False,  # every sample is drawn
    "agg.path.chunksize": 20_000,
    "svg.fonttype": "path",
    "svg.hashsalt": "rig",
    "mathtext.fontset": "dejavusans",
}


@dataclass(frozen=True)
class Picture:
    """One finished figure: ``uri`` is a data URI, ``alt`` says what it shows, ``caption`` how to read it."""

    uri: str
    alt: str
    caption: str


class AbsentError(Exception):
    """A part of the run is missing. The message is a sentence for the page: which part, and why."""


class Drawing(Figure):
    """A figure that a notebook can show; it belongs to no window, and needs no display."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with style():
            self.savefig(buffer, format="png", dpi=110)
        return buffer.getvalue()


def colour(method: str) -> str:
    """Colour of an estimator; ink if it is unknown."""
    at = _place(method)
    return INK if at is None else COLOURS[at % len(COLOURS)]


def line(method: str) -> str:
    """Line style of an estimator; solid if it is unknown."""
    at = _place(method)
    return LINES[0] if at is None else LINES[at % len(LINES)]


def short(method: str) -> str:
    """Short name of an estimator; its name if it is unknown."""
    at = _place(method)
    return method if at is None else ESTIMATORS[at].short


def _place(method: str) -> int | None:
    """Place of an estimator in the list; None if it is unknown."""
    return next((k for k, entry in enumerate(ESTIMATORS) if entry.name == method), None)


def plain(text: str) -> str:
    """``text`` from a file, so that matplotlib does not read $ as mathematics."""
    return text.replace("$", r"\$")


def stage_kind(stage: str) -> str:
    """``relay-1`` -> ``relay``, ``track:sampled-data`` -> ``track``."""
    return str(kind_of(stage))


def stage_label(stage: str) -> str:
    """Stage name for figures: ``track:sampled-data`` -> ``track SD``."""
    kind, _, method = stage.partition(":")
    return plain(f"{kind} {short(method)}" if method else stage.replace("-", " "))


def new_figure(height_in: float) -> Figure:
    """An empty figure of the page's width, ``height_in`` inches high."""
    return Drawing(figsize=(WIDTH_IN, height_in))


def laid_out(figure: Figure) -> Figure:
    """A figure to be looked at by itself, outside of a page."""
    figure.set_layout_engine("constrained")
    return figure


def save(file: Path, title: str, height_in: float, draw: Callable[[Figure], None]) -> None:
    """Write what ``draw`` puts into an empty figure, ``height_in`` inches high.

    The file's suffix, one of ``FORMATS``, names the format. Raises CannotWriteError.
    """
    suffix = file.suffix.lower()
    with style():
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold", color=INK)
        buffer = io.BytesIO()
        figure.savefig(buffer, format=suffix.removeprefix("."), dpi=150, metadata={FORMATS[suffix]: None})
    write_whole(file, buffer.getvalue())


@cache
def _templates(package: str) -> jinja2.Environment:
    """The templates of a package's pages. Compiled once a process: that takes longer than to fill them in."""
    found = jinja2.Environment(
        loader=jinja2.PackageLoader(package, package_path="."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.globals["swatches"] = {entry.short: colour(entry.name).lower() for entry in ESTIMATORS}
    found.globals["version"] = VERSION
    return found


def rendered(package: str, template: str, **values: Any) -> str:
    """A page of a package, by its template."""
    return _templates(package).get_template(template).render(values)


def style() -> Any:
    """The matplotlib settings for every figure, as a context."""
    return mpl.rc_context(RC)


def note(axes: Axes, text: str, *, loc: str = "upper left", colour: str = INK) -> None:
    """A few words in a corner of ``axes``: ``upper left``, ``lower right``, ..."""
    x = 0.015 if "left" in loc else 0.985
    y = 0.97 if "upper" in loc else 0.03
    axes.text(
        x, y, text, transform=axes.transAxes, fontsize=8, color=colour,
        ha="left" if "left" in loc else "right", va="top" if "upper" in loc else "bottom",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
    )  # fmt: skip


def render(figure: Figure, foot: str, alt: str, caption: str) -> Picture:
    """The figure as a data URI, with what it was recorded from at its foot, as ``ReportedRun.foot``."""
    words = textwrap.wrap(foot, 150)
    foot_in = 0.13 * len(words) + 0.05
    height = figure.get_figheight()
    figure.text(
        1.0 - 0.06 / WIDTH_IN, 0.03 / height, plain("\n".join(words)),
        ha="right", va="bottom", fontsize=6.5, color=MUTED,
    )  # fmt: skip
    FigureCanvasSVG(figure)
    # lay out once, here: a layout engine would draw everything a second time as it saves
    engine = ConstrainedLayoutEngine(rect=(0.0, foot_in / height, 1.0, 1.0 - foot_in / height))
    engine.execute(figure)
    for axes in figure.axes:  # the solver's last digits vary, and the same run must give the same file
        axes.set_position(np.round(axes.get_position().bounds, 6).tolist())
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=160, metadata={"Date": None, "Creator": None})
    encoded = base64.b64encode(buffer.getvalue()).decode("ascii")
    return Picture(f"data:image/svg+xml;base64,{encoded}", f"{alt} {foot[:1].upper()}{foot[1:]}.", caption)
