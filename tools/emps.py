"""`make emps`: a real friction-impeded DC drive, the field's benchmark EMPS, identified beside its published numbers.

The record is not part of rig. RIG_EMPS names the file DATA_EMPS.mat.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from rig.identify import sampled_data
from rig.identify.estimate import Estimate
from rig.identify.motor_law import MotorLaw, motor_law
from rig.recording.series import TimeSeries

PUBLISHED_AT = "A. Janot, M. Gautier, M. Brunot: Data Set and Reference Models of EMPS, 2019; nonlinearbenchmark.org"
FORCE_N_V = 35.15  # of the motor, N/V (Janot and others, 2019)
MASS_KG, FRICTION_N = 95.15, 20.385  # with friction that differs by direction: M, and the mean of Fc both ways
VISCOUS_N_S_M = 36.85  # half of 240.4 - 166.7


@dataclass(frozen=True)
class Found:
    """The drive in the units of its paper, and what was found.

    mass_kg, friction_N         M = tau gtau / K, and Coulomb friction
    viscous_by_direction_N_s_m  half the difference of the viscous friction of both directions
    pieces_m                    length of the pieces, s, and their RMS residual, m
    plain, law                  the plain estimate, and the law of the motor
    """

    mass_kg: float
    friction_N: float
    viscous_by_direction_N_s_m: float
    pieces_m: tuple[tuple[float, float], ...]
    plain: Estimate
    law: MotorLaw


def series(path: Path) -> TimeSeries:
    """The record: position in m where rig says rad, drive in V."""
    columns = loadmat(str(path))
    t_s, y, u_V = (np.asarray(columns[name], dtype=np.float64).ravel() for name in ("t", "qm", "vir"))
    return TimeSeries(t_s, y, None, u_V, name="EMPS")


def found(path: Path) -> Found:
    """Identify the record. Raises IdentifyError if it is too short."""
    test = series(path)
    plain = sampled_data.fit([test])
    law = motor_law([test], plain, [None])
    best = law.estimate or plain
    sizes = {one.law.name: abs(one.size) for one in law.found}
    return Found(
        best.tau_s * FORCE_N_V / best.K_rad_s_V,
        best.fc_V * FORCE_N_V,
        sizes.get("viscous_by_direction", 0.0) * FORCE_N_V,
        law.growth,
        plain,
        law,
    )


def page(one: Found) -> str:
    """What was found, beside the published numbers."""
    lines = [
        f"EMPS ({PUBLISHED_AT})",
        f"plain motor, one piece: residual {1e3 * one.plain.rms_rad:.2f} mm",
        *(f"pieces of {length_s:.1f} s: residual {1e3 * rms:.3f} mm" for length_s, rms in one.pieces_m),
        f"mass: {one.mass_kg:.1f} kg (published {MASS_KG})",
        f"Coulomb friction: {one.friction_N:.2f} N (published {FRICTION_N})",
        f"viscous friction, half difference of the directions: {one.viscous_by_direction_N_s_m:.1f} N s/m "
        f"(published {VISCOUS_N_S_M})",
        "laws over position are in turns of 2 pi m here: read them as a slow change over the travel",
        *one.law.notes(),
    ]
    return "\n".join(lines)


def main() -> int:
    """Print the page; exit status 2 without the file."""
    path = os.environ.get("RIG_EMPS", "")
    if not path or not Path(path).is_file():
        print(f"RIG_EMPS must name DATA_EMPS.mat. It is published: {PUBLISHED_AT}", file=sys.stderr)
        return 2
    print(page(found(Path(path))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
