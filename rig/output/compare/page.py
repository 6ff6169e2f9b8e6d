"""The report of a comparison: one self-contained page of HTML."""

from __future__ import annotations

from pathlib import Path

from rig.output.compare.comparison import Comparison, degrees_of, hours_of
from rig.output.compare.pictures import LaidOver, chosen, cycles, drawn_as, residuals, tracking, trends, values
from rig.output.report.page import Figure, drawn
from rig.output.report.source import load
from rig.output.report.style import rendered, style
from rig.run_folder.recording.folder import write_whole

SYMBOLS = {"tau_s": "τ", "K_rad_s_V": "K", "fc_V": "f_c"}


def write_page(found: Comparison, path: Path) -> None:
    """Write the page; the runs' samples are read for it. Raises CannotWriteError."""
    laid_over = chosen(found.result)
    page = rendered(
        "rig.output.compare",
        "page.html.j2",
        found=found.result,
        figures=_figures(found, [run.name for run in laid_over]),
        symbols=SYMBOLS,
        few=len(laid_over) < len(found.runs) and len(laid_over),
        backends=_backends(found),
    )
    write_whole(path, page)


def _backends(found: Comparison) -> str:
    return "; ".join(dict.fromkeys(run.meta.backend or "not recorded" for run in found.runs))


def _figures(found: Comparison, names: list[str]) -> dict[str, Figure]:
    backend, result = _backends(found), found.result
    hours, degrees = hours_of(found.runs), degrees_of(found.runs)
    runs = [
        LaidOver(run.name, load(run.folder), *drawn_as(k))
        for k, run in enumerate(one for one in found.runs if one.name in names)
    ]
    with style():
        return {
            "values": drawn(values, result, backend),
            "time": drawn(trends, result, "time", hours, backend),
            "temperature": drawn(trends, result, "temperature", degrees, backend),
            "cycles": drawn(cycles, runs, backend),
            "residuals": drawn(residuals, runs, backend),
            "tracking": drawn(tracking, runs, backend),
        }
