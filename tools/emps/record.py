"""The record of the benchmark EMPS, its pieces, and what its authors published of it.

The record is not part of rig. A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS, 2019.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from rig.model.real_motor import RealMotor
from rig.run_folder.recording.series import TimeSeries

Array = NDArray[np.float64]

PUBLISHED_AT = "A. Janot, M. Gautier, M. Brunot: Data Set and Reference Models of EMPS, 2019; nonlinearbenchmark.org"
FORCE_N_V = 35.15  # of the motor
LARGEST_V = 10.0  # of the drive
PIECE_S = 2.0


@dataclass(frozen=True)
class Drive:
    """A linear drive as its authors describe it.

    mass_kg                  M, kg
    viscous_N_s_m            viscous friction, mean of both directions, N s/m
    viscous_half_N_s_m       half the difference of the directions, as its size, N s/m
    friction_N               Coulomb friction, mean of both directions, N
    """

    mass_kg: float
    viscous_N_s_m: float
    viscous_half_N_s_m: float
    friction_N: float


# Viscous friction is 166.7 N s/m one way and 240.4 the other, Coulomb friction 20.14 and 20.63 N.
PUBLISHED = Drive(95.15, 203.55, 36.85, 20.385)
PUBLISHED_MOTOR = RealMotor(
    PUBLISHED.mass_kg / PUBLISHED.viscous_N_s_m,
    FORCE_N_V / PUBLISHED.viscous_N_s_m,
    PUBLISHED.friction_N / FORCE_N_V,
    0.5 * (20.63 - 20.14) / FORCE_N_V,
    viscous_by_direction_V_s_rad=-PUBLISHED.viscous_half_N_s_m / FORCE_N_V,
)
# The same authors' simulation of the closed loop: relative errors of force and position, %.
PUBLISHED_FORCE_ERROR, PUBLISHED_POSITION_ERROR = 5.85, 0.0138


@dataclass(frozen=True, eq=False)
class Record:
    """The record: 24.84 s at 1 kHz.

    series          drive, V, and position, in m where rig says rad
    reference_m     what the position controller was asked for, m, (n,)
    kp_1_s, kv_V_s_m   its gains: it drives kp kv (reference - y) - kv v, V
    """

    series: TimeSeries
    reference_m: Array
    kp_1_s: float
    kv_V_s_m: float

    @property
    def starts(self) -> list[int]:
        """First rows of its pieces of 2 s; what is left over at the end belongs to the last."""
        rows = round(PIECE_S / self.series.period_s)
        return [k * rows for k in range(len(self.series) // rows)]

    @property
    def pieces(self) -> list[TimeSeries]:
        """Its pieces of 2 s."""
        return [self.series.part(first, stop) for first, stop in self.spans]

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First row of each piece, and the row after its last."""
        return list(zip(self.starts, [*self.starts[1:], len(self.series)], strict=True))


def read(path: Path) -> Record:
    """The record in the file DATA_EMPS.mat. Raises ValueError where it is another file."""
    try:
        columns = loadmat(str(path))
        t_s, y, u_V, reference = (np.asarray(columns[k], dtype=np.float64).ravel() for k in ("t", "qm", "vir", "qg"))
        gains = [float(np.asarray(columns[name]).item()) for name in ("kp", "kv")]
    except (KeyError, MatReadError, ValueError) as error:
        raise ValueError(f"{path} is not DATA_EMPS.mat: {error}") from error
    return Record(TimeSeries(t_s, y, None, u_V, name="EMPS"), reference, *gains)
