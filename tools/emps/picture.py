"""The picture of the page: the record, its free run, and what each prediction leaves."""

from __future__ import annotations

import base64

import numpy as np
from numpy.typing import NDArray

from emps.found import Found
from emps.prediction import free_run, in_pieces
from emps.record import PUBLISHED_AT
from rig.output.report.style import COLOURS, INK, MUTED, new_figure, render, style

EVERY = 20  # samples of the drawn curves: 20 ms
HELD_OUT = "#f8efd6"


def picture(one: Found) -> bytes:
    """The SVG, of the law that was found in every other piece."""
    record, law = one.record, one.motor
    series, spans = record.series, record.spans
    free, pieces = free_run(law, record), in_pieces(law, record, record.starts)
    some = slice(None, None, EVERY)
    t_s = series.t_s[some]
    with style():
        figure = new_figure(5.6)
        rows = figure.subplots(3, 1, sharex=True)
        rows[0].plot(t_s, 1e3 * series.y_rad[some], color=INK, label="recorded")
        rows[0].plot(t_s, 1e3 * (series.y_rad + free)[some], "--", color=COLOURS[1], label="free run")
        rows[0].set_ylabel("position, mm")
        rows[0].legend(loc="upper center", ncols=2, bbox_to_anchor=(0.5, 1.25))
        rows[1].plot(t_s, 1e3 * free[some], color=COLOURS[1])
        rows[1].set_ylabel("free run less\nrecorded, mm")
        for k, (first, stop) in enumerate(spans):
            part = slice(first, stop, EVERY)
            rows[2].plot(series.t_s[part], 1e3 * pieces[part], color=COLOURS[k % 2])
        _shade(rows, [(series.t_s[a], series.t_s[b - 1]) for a, b in spans[1::2]])
        rows[2].set(ylabel="pieces of 2 s less\nrecorded, mm", xlabel="time, s (shaded: held out from the fit)")
        for row in rows[1:]:
            row.axhline(0.0, color=MUTED, lw=0.7)
        rows[0].set_xlim(float(series.t_s[0]), float(series.t_s[-1]))
        made = render(figure, f"no device; the record EMPS ({PUBLISHED_AT})", "EMPS and what the law predicts.", "")
    return base64.b64decode(made.uri.partition(",")[2])


def _shade(rows: NDArray[np.object_], spans: list[tuple[float, float]]) -> None:
    for row in rows:
        for begin, end in spans:
            row.axvspan(begin, end, color=HELD_OUT, lw=0, zorder=0)
