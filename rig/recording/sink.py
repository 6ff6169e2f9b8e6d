"""Where the rows and events of a run go, whatever becomes of them: kept on disk, compared, or thrown away."""

from __future__ import annotations

from typing import Protocol

from rig.signals import Sample

JsonScalar = str | int | float | bool | None

# A row as the loop opens it.
Row = tuple[
    int,  # tick
    Sample,  # what was sampled
    str,  # stage
    float,  # z_rad_s, integral of the position
    float,  # yd_rad, reference; nan without one
    float,  # u_V, drive as commanded
    float,  # late_us, how late the tick began; nan for a tick of the device's own
    float,  # io_us, what the reading took; likewise
    int,  # flags
]


class RowSink(Protocol):
    """What the loop tells of a run."""

    def sample(self, *row: *Row) -> None:
        """Open a row."""

    def complete(self, t_u_s: float, u_V: float, flags: int = 0) -> None:
        """Finish the row opened last: when its drive took effect, and the drive that the device reports, V."""

    def event(self, t_s: float, kind: str, **fields: JsonScalar) -> None:
        """Note an event."""

    def check(self) -> None:
        """Raise Fault RECORDER_DEAD if rows are not being taken."""

    def drain(self, timeout_s: float = 5.0) -> None:
        """Return once every completed row can be read."""


class NullSink:
    """Keeps nothing: for simulations before a run."""

    def sample(self, *row: *Row) -> None:
        """Do nothing."""

    def complete(self, t_u_s: float, u_V: float, flags: int = 0) -> None:
        """Do nothing."""

    def event(self, t_s: float, kind: str, **fields: JsonScalar) -> None:
        """Do nothing."""

    def check(self) -> None:
        """Do nothing."""

    def drain(self, timeout_s: float = 5.0) -> None:
        """Do nothing."""
