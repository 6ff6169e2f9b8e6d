"""Signs that a recording is not in seconds, rad and V, or has a hole: what no fit can notice by itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rig.identify.record import Record

LONGEST_PERIOD_S = 0.5
LARGEST_SPAN_RAD = 40.0  # six turns
LARGEST_DRIVE_V = 100.0
GAP_PERIODS = 5.0


def wrong_units(records: Sequence[Record]) -> list[str]:
    """Why the numbers cannot be what the columns' names say, a sentence for each column and record."""
    said = []
    for record in records:
        span = float(np.ptp(record.y_rad))
        largest = float(np.abs(record.u_V).max())
        if record.period_s > LONGEST_PERIOD_S:
            said.append(f"{record.name}: samples are {record.period_s:g} s apart: is t_s in milliseconds?")
        if span > 10.0 and bool(np.all(record.y_rad == np.round(record.y_rad))):
            said.append(f"{record.name}: all positions are whole numbers over {span:g}: is y_rad in raw counts?")
        elif span > LARGEST_SPAN_RAD:
            said.append(f"{record.name}: positions span {span:.3g} rad: is y_rad in degrees?")
        if largest > LARGEST_DRIVE_V:
            said.append(f"{record.name}: the drive reaches {largest:.3g} V: is u_V in mV or in duty counts?")
    return said


def gaps(records: Sequence[Record]) -> list[str]:
    """Holes in the samples, a sentence for the longest of each record."""
    said = []
    for record in records:
        steps = np.diff(record.t_s)
        k = int(np.argmax(steps))
        if steps[k] > GAP_PERIODS * record.period_s:
            said.append(
                f"{record.name}: gap of {steps[k]:.3g} s after row {record.first_row + k}: what the drive did in it is "
                "unknown; identify the part before or after it"
            )
    return said
