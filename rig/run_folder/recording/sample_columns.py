"""The columns of samples.csv: their order, kind and text.

Text formats are fixed, so that the same rows always give the same bytes:

======== =============================== =========================================
kind     text                            read back
======== =============================== =========================================
integer  decimal                         exactly
time     9 decimals, s                   to 0.5 ns
number   shortest that names the double  exactly
micros   3 decimals, us                  to 0.5 ns
name     as it is                        exactly
======== =============================== =========================================

nan (unknown, or no such sensor) is an empty field.
"""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple

Kind = Literal["integer", "time", "number", "micros", "name"]
Reads = Literal["angle", "counter", "speed", "samples"]
"""What shows the positions: an angle; a counter, of whole counts over more than a turn; a speed, summed up, as it was
between the rows; samples of a speed, whose noise adds up in the sum."""

_COLUMNS: Final[dict[str, tuple[Kind, str]]] = {  # kind and unit
    "tick": ("integer", "1"),  # number of the tick on the loop's grid; a gap is a skipped tick
    "seq": ("integer", "1"),  # sequence number of the exchange with the device
    "t_s": ("time", "s"),  # when y was sampled, since the run's start
    "t_u_s": ("time", "s"),  # when u took effect; empty where it is not known
    "y_rad": ("number", "rad"),  # position
    "y_counts": ("integer", "count"),  # raw reading of y
    "v_rad_per_s": ("number", "rad/s"),  # velocity from a tachometer; empty without one
    "u_V": ("number", "V"),  # drive that acts from t_u_s until t_u_s of the next row
    "z_rad_s": ("number", "rad s"),  # the law's integral of position
    "yd_rad": ("number", "rad"),  # reference position; empty without one
    "stage": ("name", ""),
    "late_us": ("micros", "us"),  # how late the tick woke up
    "io_us": ("micros", "us"),  # time spent talking to the device
    "flags": ("integer", "bits"),  # bits of rig.core.signals.FLAG_*
}
COLUMNS: Final = tuple(_COLUMNS)
KINDS: Final = {name: kind for name, (kind, _) in _COLUMNS.items()}
UNITS: Final = {name: unit for name, (_, unit) in _COLUMNS.items()}
HEADER: Final = ",".join(COLUMNS) + "\n"


def _number(value: float) -> str:
    return "" if value != value else repr(value)


def _time(value_s: float) -> str:
    return "" if value_s != value_s else f"{value_s:.9f}"


def _micros(value_us: float) -> str:
    return "" if value_us != value_us else f"{value_us:.3f}"


class SampleRow(NamedTuple):
    """One row of samples.csv, in the order of ``COLUMNS``."""

    tick: int
    seq: int
    t_s: float
    t_u_s: float
    y_rad: float
    y_counts: int
    v_rad_per_s: float
    u_V: float
    z_rad_s: float
    yd_rad: float
    stage: str
    late_us: float
    io_us: float
    flags: int

    @property
    def in_device(self) -> bool:
        """Whether it is a tick of the relay in the device, which takes no time of the loop."""
        return math.isnan(self.late_us)


def format_row(row: SampleRow) -> str:
    """One line of samples.csv, line end included."""
    tick, seq, t_s, t_u_s, y_rad, y_counts, v_rad_per_s, u_V, z_rad_s, yd_rad, stage, late_us, io_us, flags = row
    return (
        f"{tick},{seq},{_time(t_s)},{_time(t_u_s)},{_number(y_rad)},{y_counts},{_number(v_rad_per_s)},"
        f"{_number(u_V)},{_number(z_rad_s)},{_number(yd_rad)},{stage},{_micros(late_us)},{_micros(io_us)},"
        f"{flags}\n"
    )
