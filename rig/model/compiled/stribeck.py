"""The functions of ``rig.model.stribeck``, compiled.

They are one file, so that what is kept compiled on disk is current.
"""

from __future__ import annotations

from numba import njit
from numba.extending import register_jitable

from rig.model import stribeck

for function in (
    stribeck.far_speed,
    stribeck.is_exponential,
    stribeck.expand,
    stribeck.speed_at,
    stribeck.path_at,
    stribeck.rest_within,
):
    register_jitable(function)

position = njit(cache=True)(stribeck.position)
