"""Prediction of noise that is partly white and partly coloured (see ``rig.identification.noise``), sample by sample."""

from __future__ import annotations

from ctypes import byref

import numpy as np

from rig.core.arrays import Array, Rows
from rig.model.library import LIBRARY, NoiseRows, address, given, require_size


def innovations(t_s: Array, starts: Rows, memory_s: float, ratio: float, columns: Array) -> tuple[Array, float]:
    """The innovations (n, p) of ``columns`` in units of the white part, and the sum of log F.

    t_s       n times, s
    starts    first rows of the windows, each with coloured noise of its own
    memory_s  correlation time of the coloured noise, s
    ratio     variance of the coloured noise over the variance of the white noise
    columns   (n, p), in any unit
    F is the variance of each innovation over the variance of the white noise. All innovations have the same variance.
    """
    t, first, table = given(t_s), _rows(starts), given(columns)
    n, p = table.shape
    require_size(t, n, "t_s")
    rows, work, out = NoiseRows(address(t), address(first), n, first.size, memory_s), np.empty(p), np.empty((n, p))
    logs: float = LIBRARY.noise_innovations(byref(rows), ratio, address(table), p, address(work), address(out))
    return out, logs


def deviances(t_s: Array, starts: Rows, memory_s: float, ratios: Array, residual: Array) -> Array:
    """(k,) -2 log likelihood of the residual (n,) for each ratio, up to a constant.

    The scale is profiled out; the rest as ``innovations``.
    ratios   variance of the coloured noise over the variance of the white noise, (k,), at most 1e18
    """
    t, first, ratio, rest = given(t_s), _rows(starts), given(ratios), given(residual)
    require_size(t, rest.size, "t_s")
    rows = NoiseRows(address(t), address(first), t.size, first.size, memory_s)
    work, out = np.empty(5 * ratio.size), np.empty(ratio.size)
    LIBRARY.noise_deviances(byref(rows), address(ratio), ratio.size, address(rest), address(work), address(out))
    return out


def _rows(starts: Rows) -> Rows:
    rows: Rows = np.ascontiguousarray(starts, dtype=np.int64)
    if rows.size == 0 or rows[0] != 0:
        raise ValueError("the first window begins with the first row")
    return rows
