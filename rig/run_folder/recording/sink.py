"""Where the loop sends its rows and events: to disk, to a comparison, or nowhere."""

from __future__ import annotations

from typing import Protocol

from rig.core.signals import Sample

JsonScalar = str | int | float | bool | None

# The fields of a row when the loop opens it.
Row = tuple[
    int,  # tick
    Sample,  # what was sampled
    str,  # stage
    float,  # z_rad_s, integral of the position
    float,  # yd_rad, reference; nan without one
    float,  # u_V, commanded drive
    float,  # late_us, how late the tick began; nan for a tick of the relay in the device
    float,  # io_us, time for the reading; nan likewise
    int,  # flags
]


class RowSink(Protocol):
    """Takes the rows and events of a run."""

    def sample(self, *row: *Row) -> None:
        """Open a row."""

    def complete(self, t_u_s: float, u_V: float, flags: int = 0) -> None:
        """Finish the open row: the time at which its drive took effect, and the drive that the device reports."""

    def event(self, t_s: float, kind: str, **fields: JsonScalar) -> None:
        """Take an event."""

    def check(self) -> None:
        """Raise Fault RECORDER_DEAD if rows are not taken."""

    def drain(self) -> None:
        """Wait until every completed row can be read."""


class NullSink:
    """Drops all rows and events: for the simulation before a run."""

    def sample(self, *row: *Row) -> None:
        """Do nothing."""

    def complete(self, t_u_s: float, u_V: float, flags: int = 0) -> None:
        """Do nothing."""

    def event(self, t_s: float, kind: str, **fields: JsonScalar) -> None:
        """Do nothing."""

    def check(self) -> None:
        """Do nothing."""

    def drain(self) -> None:
        """Do nothing."""
