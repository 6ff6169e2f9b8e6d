"""The drive that a servo's own position loop gave: duty = gain x error, from its goals and positions. Pure.

What a step of its gain P means no manual says well, so the drive is known up to a factor, and K and friction with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:  # every command knows the options of a servo's log: few of them compute
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_COUNTS_RAD: Final = 4096 / (2.0 * math.pi)
_OF_MANUAL: Final = _COUNTS_RAD / (128.0 * 885)
_STEP_S: Final = 1e-3  # of a servo's loop; design assumption


class Scale(NamedTuple):
    """What a gain of 1 makes of 1 rad of error: a share of full duty, lowest and highest, 1/rad; and who says so."""

    low: float
    high: float
    source: str

    @property
    def middle(self) -> float:
        """The geometric mean: as far from both ends."""
        return math.sqrt(self.low * self.high)


class OwnLoop(NamedTuple):
    """What the drive of a log is known by, where a servo's own loop gave it.

    scale       of its P: u_V is that of the middle
    gain_V_rad  volts of a radian of error, by that
    is_P_alone  whether somebody says that its I and D were 0
    """

    scale: Scale
    gain_V_rad: float
    is_P_alone: bool = True


def least_known(loops: Iterable[OwnLoop | None]) -> OwnLoop | None:
    """What several recordings together are known by; None where all volts are volts."""
    some = [one for one in loops if one is not None]
    if not some:
        return None
    widest = max(some, key=lambda one: one.scale.high / one.scale.low)
    return OwnLoop(widest.scale, max(one.gain_V_rad for one in some), is_P_alone=all(one.is_P_alone for one in some))


SCALES: Final = {
    "dynamixel": Scale(
        0.5 * _OF_MANUAL, _OF_MANUAL, "the manual says 1/128 of a step a count, BAM saw 1/256 on an XL330"
    ),
    "feetech": Scale(0.083, 0.332, "BAM saw 0.166 on an STS3215 with an oscilloscope; nobody else, so a factor of 2"),
}
"""By protocol. Sources: ROBOTIS e-Manual; Rhoban/bam."""


def scale_of(protocol: str, stated: float | None = None) -> Scale:
    """The scale of a servo's P; ``stated``, 1/rad: as somebody has measured it. Raises KeyError for no protocol."""
    return SCALES[protocol] if stated is None else Scale(stated, stated, "stated")


@dataclass(frozen=True)
class ServoLaw:
    """A servo's position mode.

    P          of its register, > 0; None: the log says it
    scale      of P
    slew_V_s   of its ramp; inf: it has none
    goal_first whether each row's goal was written before its position was read
    is_P_alone whether its I and D are known to be 0
    model      its name; "": nobody says
    position_age_s   of each row's position at its row's time, at which its goal is written
    """

    P: float | None
    scale: Scale
    slew_V_s: float = math.inf
    goal_first: bool = False
    is_P_alone: bool = True
    model: str = ""
    position_age_s: float = 0.0

    def drive(
        self, P: float, t_s: Floats, y_rad: Floats, goal_rad: Floats, supply_V: float
    ) -> tuple[Floats, Floats, Floats]:
        """Edges, s, and drives, V, from each edge on, (m,), and the drive at each of the n rows, V, (n,).

        P                      of its register, 1
        t_s, y_rad, goal_rad   (n,) of the rows, n >= 2; t_s, rising, are the times of the positions
        supply_V               at full duty
        Between rows the position is interpolated; each step has the mean of its ramp.
        """
        import numpy as np
        from scipy.interpolate import PchipInterpolator

        steps = np.maximum(np.ceil(np.diff(t_s) / _STEP_S - 1e-6), 1.0).astype(int)
        row = np.repeat(np.arange(t_s.size - 1), steps)
        part = np.concatenate([np.arange(n) / n for n in steps])
        period_s = np.diff(t_s)[row]
        edges = t_s[row] + part * period_s
        middles = edges + 0.5 * period_s / steps[row]
        position = PchipInterpolator(t_s, y_rad)(middles)
        written = np.searchsorted(t_s + self.position_age_s, middles, side="right") - 1
        held = goal_rad[np.maximum(written, 0) + self.goal_first]
        gain = self.scale.middle * P
        u_V = supply_V * np.clip(gain * (held - position), -1.0, 1.0)
        if math.isfinite(self.slew_V_s):
            u_V = _ramped(u_V, self.slew_V_s * period_s / steps[row])
        rows_V = supply_V * np.clip(gain * (goal_rad - y_rad), -1.0, 1.0)
        return np.append(edges, t_s[-1]), np.append(u_V, rows_V[-1]), rows_V


def _ramped(u_V: Floats, most_V: Floats) -> Floats:
    """Drives that change by no more than ``most_V`` in a step; of each step its mean."""
    import numpy as np

    ends = [float(u_V[0])]
    for wanted, most in zip(u_V.tolist(), most_V.tolist(), strict=True):
        ends.append(min(max(wanted, ends[-1] - most), ends[-1] + most))
    return np.asarray(0.5 * (np.array(ends[:-1]) + np.array(ends[1:])), dtype=np.float64)
