"""Where the shaft of an emulated device really was: no sensor's noise, steps or curvature."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple


class ShaftPath(NamedTuple):
    """Times, s, in the clock of the device's driver, increasing; positions, rad, as the emulated motor counts them."""

    t_s: Sequence[float]
    y_rad: Sequence[float]


def traced(trace: Path) -> ShaftPath:
    """The rows so far of a board's CSV file of the truth (``SerialBoard.run``), without a last line that is torn."""
    lines = trace.read_text(encoding="ascii", errors="replace").split("\n")[:-1]
    if not lines:
        return ShaftPath((), ())
    names = lines[0].split(",")
    t, y = names.index("t_s"), names.index("y_rad")
    rows = [line.split(",") for line in lines[1:]]
    return ShaftPath([float(row[t]) for row in rows], [float(row[y]) for row in rows])
