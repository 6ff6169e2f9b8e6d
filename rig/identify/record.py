"""What estimators read: times, positions and drives of one stretch of recording, cut loose from run folders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class IdentifyError(Exception):
    """A recording that cannot be identified: one line of cause, one of cure."""

    def __init__(self, cause: str, cure: str) -> None:
        self.cause = cause
        self.cure = cure
        super().__init__(f"{cause}\n{cure}")


@dataclass(frozen=True)
class Record:
    """Rows of a recording. Row k: y sampled at t_s; u acts from t_u_s until the next row's t_u_s.

    t_s        n times, s, increasing
    y_rad      n positions, rad
    t_u_s      n times at which each row's drive took effect, s; None if unknown (then u acts from t_s plus a constant
               delay between 0 and 2 periods)
    u_V        n drives, V, after saturation and quantisation
    first_row  index of row 0 in the file it comes from
    name       what to call it in a message
    Raises IdentifyError on columns of unequal length, fewer than 2 rows, values that are not finite, or times
    that do not increase.
    """

    t_s: Array
    y_rad: Array
    t_u_s: Array | None
    u_V: Array
    first_row: int = 0
    name: str = "recording"

    def __post_init__(self) -> None:
        columns = {"t_s": self.t_s, "y_rad": self.y_rad, "u_V": self.u_V}
        if self.t_u_s is not None:
            columns["t_u_s"] = self.t_u_s
        for key, column in columns.items():
            if column.ndim != 1 or column.size != self.t_s.size:
                raise IdentifyError(
                    f"{self.name}: column {key} has {column.size} values where t_s has {self.t_s.size}",
                    "every column needs one value a row",
                )
            bad = np.flatnonzero(~np.isfinite(column))
            if bad.size:
                raise IdentifyError(
                    f"{self.name}: {key} is not a number in row {self.first_row + int(bad[0])}"
                    + (f" and {bad.size - 1} more" if bad.size > 1 else ""),
                    "remove these rows, or record again",
                )
        if self.t_s.size < 2:
            raise IdentifyError(f"{self.name}: {self.t_s.size} rows are too few", "record at least ten cycles")
        back = np.flatnonzero(np.diff(self.t_s) <= 0.0)
        if back.size:
            raise IdentifyError(
                f"{self.name}: t_s does not increase at row {self.first_row + int(back[0]) + 1}",
                "t_s must be the time of each sample in seconds; sort the rows and drop doubled ones",
            )
        if self.t_u_s is not None:
            back = np.flatnonzero(np.diff(self.t_u_s) < 0.0)
            if back.size:
                raise IdentifyError(
                    f"{self.name}: t_u_s decreases at row {self.first_row + int(back[0]) + 1}",
                    "t_u_s must be the time at which each row's drive took effect; leave the column out if unknown",
                )

    def __len__(self) -> int:
        return int(self.t_s.size)

    @property
    def period_s(self) -> float:
        """Sampling period: the median step of t_s, s."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def edge_s(self) -> Array:
        """Times from which each row's drive acts, as far as they are known: t_u_s, else t_s."""
        return self.t_s if self.t_u_s is None else self.t_u_s

    def part(self, first: int, stop: int) -> Record:
        """Rows ``first`` to ``stop`` (exclusive)."""
        cut = slice(first, stop)
        times = None if self.t_u_s is None else self.t_u_s[cut]
        return Record(self.t_s[cut], self.y_rad[cut], times, self.u_V[cut], self.first_row + first, self.name)

    def resolution_rad(self) -> float:
        """Step between neighbouring distinct positions, rad; 0 if they do not look quantised.

        Positions are taken for quantised if most differences between sorted distinct values are near multiples of
        the smallest common one.
        """
        steps = np.diff(np.unique(np.round(self.y_rad, 12)))
        steps = steps[steps > 1e-9]
        if steps.size < 3:
            return float(steps.min()) if steps.size else 0.0
        lsb = float(np.median(steps[steps < 1.5 * steps.min()]))
        ratio = steps / lsb
        return lsb if float(np.mean(np.abs(ratio - np.round(ratio)) < 0.1)) > 0.9 else 0.0
