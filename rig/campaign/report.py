"""The report of a campaign: the figure as PNG, and one self-contained page with figure and table.

The figure shows error and coverage over the grid, standardised errors, and error against bound.
"""

from __future__ import annotations

import base64
import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, ScalarFormatter
from numpy.typing import NDArray

from rig.campaign.results import Table
from rig.campaign.summary import (
    MAIN,
    VERDICTS,
    ParameterSums,
    Summary,
    Sums,
    covered,
    error,
    over_bound,
    relative_error,
    rms,
)
from rig.config import Campaign, dump
from rig.core.arrays import Array
from rig.output.report.style import INK, LIMIT, MUTED, WIDTH_IN, note, rendered, style
from rig.run_folder.recording.folder import write_whole

SYMBOLS = {"tau_s": r"$\tau$", "K_rad_s_V": "$K$", "fc_V": "f_c"}
COLOURS = {"ok": "#0072B2", "doubtful": "#E69F00", "refused": "#D55E00"}
GOOD, HIGH, LOW = "#f4f5f7", "#D55E00", "#0072B2"
FEWEST_IN_CELL = 8  # experiments; a cell with fewer stays white
PER_CELL = 40  # experiments in a cell on average, so that its number means something
MOST_CELLS = 6


def drawn(campaign: Campaign, table: Table) -> bytes:
    """The figure as PNG: a column for each of tau, K and f_c, from the experiments that have an estimate."""
    estimated = np.isfinite(table["tau_s"])
    ok = estimated & (table["verdict"] == "ok")
    called_ok = {name: column[ok] for name, column in table.items()}
    every = {name: column[estimated] for name, column in table.items()}
    with style():
        figure = Figure(figsize=(WIDTH_IN, 12.4), layout="constrained")
        FigureCanvasAgg(figure)
        rows = figure.subplots(4, len(MAIN))
        edges = grid_edges(campaign, int(ok.sum()))
        for column, name in enumerate(MAIN):
            _error_map(rows[0, column], called_ok, name, edges)
            _coverage_map(rows[1, column], called_ok, name, edges)
            _standardised(rows[2, column], called_ok, name)
            _against_bound(rows[3, column], every, name)
        figure.suptitle(
            f"campaign {campaign.name}: {table['number'].size} experiments, {int(ok.sum())} called ok",
            x=0.01, ha="left", fontsize=11, fontweight="bold", color=INK,
        )  # fmt: skip
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    return buffer.getvalue()


def grid_edges(campaign: Campaign, experiments: int) -> tuple[Array, Array]:
    """Edges of the cells: log tau, s, and fc, V; as many cells as the experiments fill."""
    count = int(np.clip(math.isqrt(max(1, experiments // PER_CELL)), 2, MOST_CELLS))
    low, high = _widened(*(math.log(end) for end in campaign.motor.tau_s))
    return np.exp(np.linspace(low, high, count + 1)), np.linspace(*_widened(*campaign.motor.fc_V), count + 1)


def cells(table: Table, edges: tuple[Array, Array], value: Any) -> tuple[Array, NDArray[np.int_]]:
    """``value`` of each cell, nan in a cell with few experiments; and the number of experiments in each cell.

    edges  of the cells, as from ``grid_edges``
    value  takes a boolean mask of the table's rows and returns a number
    Both arrays are (fc, tau), from low to high.
    """
    tau, fc = edges
    column = np.clip(np.searchsorted(tau, table["true_tau_s"], side="right") - 1, 0, tau.size - 2)
    row = np.clip(np.searchsorted(fc, table["true_fc_V"], side="right") - 1, 0, fc.size - 2)
    values = np.full((fc.size - 1, tau.size - 1), math.nan)
    counts = np.zeros(values.shape, dtype=int)
    for i, j in np.ndindex(values.shape):
        inside = (row == i) & (column == j)
        counts[i, j] = int(inside.sum())
        if counts[i, j] >= FEWEST_IN_CELL:
            values[i, j] = value(inside)
    return values, counts


def _error_map(axes: Axes, table: Table, name: str, edges: tuple[Array, Array]) -> None:
    ratio = over_bound(table, name)
    kind = "RMS error / bound"
    if np.isfinite(ratio).any():
        values, _ = cells(table, edges, lambda inside: rms(ratio[inside]))
        _map(axes, edges, values, _Shades(1.0, 0.5, "{:.2f}"))
    else:  # there is no bound without noise
        share = 100.0 * relative_error(table, name)
        kind = "RMS error, %"
        values, _ = cells(table, edges, lambda inside: rms(share[inside]))
        finite = values[np.isfinite(values)]
        reach = float(finite.max()) if finite.size and finite.max() > 0.0 else 1.0
        _map(axes, edges, values, _Shades(0.0, reach, "{:.2g}"))
    axes.set_title(f"{SYMBOLS[name]}: {kind}")


def _coverage_map(axes: Axes, table: Table, name: str, edges: tuple[Array, Array]) -> None:
    held = covered(table, name)
    values, counts = cells(table, edges, lambda inside: 100.0 * float(held[inside].mean()))
    enough = counts[counts >= FEWEST_IN_CELL]
    scatter = 100.0 * math.sqrt(0.95 * 0.05 / float(np.median(enough))) if enough.size else math.nan
    _map(axes, edges, values, _Shades(95.0, 10.0, "{:.0f}", upside_down=True))
    chance = f" (chance: 95 ± {scatter:.1f})" if math.isfinite(scatter) else ""
    axes.set_title(f"{SYMBOLS[name]}: coverage, %{chance}")


@dataclass(frozen=True)
class _Shades:
    """The colours of a map: by the distance of a cell's value from ``centre``, up to ``reach``.

    text         format of the values in the cells
    upside_down  whether low values are the bad ones
    """

    centre: float
    reach: float
    text: str
    upside_down: bool = False


def _map(axes: Axes, edges: tuple[Array, Array], values: Array, shades: _Shades) -> None:
    """Draw the cells, with their values in them."""
    tau, fc = edges
    colours, centre, reach = _diverging(shades.upside_down), shades.centre, shades.reach
    axes.pcolormesh(
        tau, fc, values, cmap=colours, norm=Normalize(centre - reach, centre + reach), edgecolors="white", linewidth=1.0
    )
    for i, j in np.ndindex(values.shape):
        if math.isfinite(values[i, j]):
            far = abs(values[i, j] - centre) > 0.6 * reach
            axes.text(
                math.sqrt(tau[j] * tau[j + 1]), 0.5 * (fc[i] + fc[i + 1]), shades.text.format(values[i, j]),
                ha="center", va="center", fontsize=7.5, color="white" if far else INK,
            )  # fmt: skip
    axes.set_xscale("log")
    axes.grid(visible=False)
    axes.set(xlim=(tau[0], tau[-1]), ylim=(fc[0], fc[-1]))
    axes.set_xticks([t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if tau[0] <= t <= tau[-1]])
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel=r"$\tau$, s", ylabel="f_c, V")


def _standardised(axes: Axes, table: Table, name: str) -> None:
    with np.errstate(divide="ignore", invalid="ignore"):
        z = error(table, name) / table[f"se_{name}"]
    z = z[np.isfinite(z)]
    beyond = int(np.count_nonzero(np.abs(z) > 4.0))
    bins = np.linspace(-4.0, 4.0, int(np.clip(math.isqrt(max(1, z.size)), 8, 40)) + 1)
    x = np.linspace(-4.0, 4.0, 200)
    if z.size:
        weights = np.full(z.size, 1.0 / (z.size * (bins[1] - bins[0])))
        axes.hist(z, bins=bins.tolist(), weights=weights, color="#b9d4e8", edgecolor="white", linewidth=0.4)
        note(axes, f"mean {z.mean():+.2f}\nstd {z.std():.2f}\nbeyond ±4: {beyond}")
    axes.plot(x, np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi), color=INK, linewidth=1.2)
    axes.set_xlim(-4.0, 4.0)
    axes.set_ylim(bottom=0.0)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)
    axes.set(xlabel="error / its standard error", title=f"{SYMBOLS[name]}: standardised errors, normal as line")


def _against_bound(axes: Axes, table: Table, name: str) -> None:
    sizes = 100.0 * relative_error(table, name)
    with np.errstate(divide="ignore"):
        bounds = 100.0 * table[f"bound_{name}"] / table[f"true_{name}"]
    usable = np.isfinite(bounds) & (bounds > 0.0) & np.isfinite(sizes) & (sizes > 0.0)
    axes.set(title=f"{SYMBOLS[name]}: error against bound, %", xlabel="Cramér-Rao bound, %", ylabel="error, %")
    if not usable.any():
        note(axes, "no bound: there is no noise")
        return
    ends = np.array([0.8 * bounds[usable].min(), 1.25 * bounds[usable].max()])
    for times, words, dash in ((1.0, "bound", "-"), (1.96, "1.96 × bound", "--")):
        axes.plot(ends, times * ends, color=MUTED, linewidth=0.9, linestyle=dash, label=words, zorder=3)
    for verdict in VERDICTS:
        some = usable & (table["verdict"] == verdict)
        if some.any():
            axes.plot(
                bounds[some], sizes[some], ".", color=COLOURS[verdict], markersize=3.0 if verdict == "ok" else 5.0,
                alpha=0.35 if verdict == "ok" else 0.9, markeredgewidth=0.0, rasterized=True,
                label=f"{verdict} ({int(some.sum())})", zorder=2 if verdict == "ok" else 2.5,
            )  # fmt: skip
    axes.axhline(5.0, color=LIMIT, linewidth=0.8, linestyle=":", label="5 %")
    axes.set(xscale="log", yscale="log", xlim=(ends[0], ends[1]))
    axes.set_ylim(bottom=0.02 * float(np.median(sizes[usable])))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if axis is axes.xaxis else (1.0,), numticks=12))
        axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    if name == MAIN[0]:
        axes.legend(
            loc="lower left", fontsize=6.5, handlelength=1.6, labelspacing=0.25, markerscale=1.6,
            frameon=True, facecolor="white", edgecolor="none", framealpha=0.85,
        )  # fmt: skip


def _diverging(upside_down: bool) -> Colormap:
    """Colours from too good to too bad: blue, white, red; the other way round if small is bad."""
    colours = [LOW, GOOD, HIGH]
    return LinearSegmentedColormap.from_list("off", colours[::-1] if upside_down else colours)


def _widened(low: float, high: float) -> tuple[float, float]:
    """The range, or one around a single value."""
    return (low, high) if high > low else (low - 0.05, high + 0.05)


PICTURE = "campaign.png"
REPORT = "report.html"

NAMES = {
    "tau_s": ("tau", "s"),
    "K_rad_s_V": ("K", "(rad/s)/V"),
    "fc_V": ("f_c", "V"),
    "asym_V": ("asymmetry", "V"),
    "delay_s": ("delay", "s"),
}
HEADINGS = ("", "RMS error", "bound", "RMS/bound", "RMS ratio", "median", "95 %", "largest", "coverage, %")


def write_report(folder: Path, campaign: Campaign, table: Table, found: Summary) -> None:
    """Write campaign.png and report.html into the campaign's folder. Raises CannotWriteError."""
    image = drawn(campaign, table)
    write_whole(folder / PICTURE, image)
    page = rendered(
        "rig.campaign",
        "report.html.j2",
        campaign=campaign,
        found=found,
        headings=HEADINGS,
        tables=[
            (f"{found['ok']['number']} experiments called ok", table_rows(found["ok"])),
            (f"all {found['estimated']['number']} that have an estimate", table_rows(found["estimated"])),
        ],
        sentences=sentences(found),
        fewest_in_cell=FEWEST_IN_CELL,
        picture=base64.b64encode(image).decode("ascii"),
        config=dump(campaign),
    )
    write_whole(folder / REPORT, page)


def table_rows(sums: Sums) -> list[tuple[str, ...]]:
    """A row of text for each parameter, under ``HEADINGS``. Errors are in per cent of the truth, or in the unit."""
    rows = []
    for name, values in sums["parameters"].items():
        symbol, unit = NAMES[name]
        sizes = _sizes(values, name)
        share, scatter = 100.0 * values["coverage"], 100.0 * values["coverage_error"]
        rows.append(
            (
                f"{symbol}, {unit}",
                *(_number(values[key], "{:.3g}") for key in ("rms_error", "rms_bound")),
                *(_number(values[key], "{:.3f}") for key in ("rms_over_bound", "rms_ratio")),
                *(_number(100.0 * s, "{:.2f} %") if name in MAIN else _number(s, "{:.2g}") for s in sizes),
                f"{share:.1f} ± {scatter:.1f}" if math.isfinite(share) else "–",
            )
        )
    return rows


def sentences(found: Summary) -> list[str]:
    """Sentences beside the table: verdicts, reasons, outliers, the second test, speed."""
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in found["verdicts"].items())
    off = found["ok_but_off"]
    lines = [
        f"{found['number']} experiments: {verdicts}",
        f"called ok with an error above 5 % in tau, K or f_c: {len(off)}{_named(off)}",
    ]
    failed = found["failed"]
    if failed:
        lines.append(
            f"failed, by a defect of the program: {len(failed)}{_named(failed)}; repeat the first: {found['repeat']}"
        )
    if found["far"]:
        far = found["far"]
        lines.append(f"an error above 5 times its bound, whatever the verdict: {len(far)}{_named(far)}")
    if "second" in found:
        second = found["second"]
        lines.append(
            "second test, predicted but never fitted: residual "
            f"{second['median']:.3f} times the true motor's (median; 95 %: {second['p95']:.3f}, "
            f"largest {second['max']:.2f})"
        )
    session = found["session"]
    if session["experiments"]:
        each_ms = 1e3 * found["seconds"]["median"]
        lines.append(
            f"{session['experiments']} done now in {session['seconds']:.1f} s: {session['experiments_per_s']:.1f} "
            f"a second ({session['backend']}, {session['workers']}; median {each_ms:.0f} ms each in its worker)"
        )
    return lines


def _sizes(values: ParameterSums, name: str) -> tuple[float, float, float]:
    """Median, 95 % and largest error."""
    if name in MAIN:
        return values["relative_median"], values["relative_p95"], values["relative_max"]
    return values["absolute_median"], values["absolute_p95"], values["absolute_max"]


def _named(numbers: list[int], most: int = 12) -> str:
    if not numbers:
        return ""
    return " (" + ", ".join(map(str, numbers[:most])) + (", ..." if len(numbers) > most else "") + ")"


def _number(value: float, text: str) -> str:
    return text.format(value) if math.isfinite(value) else "–"
