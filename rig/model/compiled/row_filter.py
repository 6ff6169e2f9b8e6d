"""A linear filter of at most second order along rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.model.library import LIBRARY, address, numbers


def filtered(
    forward: Sequence[float], back: Sequence[float], columns: Array, first: NDArray[np.int64] | None = None
) -> Array:
    """(n, k) y of (n, k) ``columns`` x, any unit: y_i = f0 x_i + f1 x_(i-1) + f2 x_(i-2) - b0 y_(i-1) - b1 y_(i-2).

    forward, back   up to three and up to two numbers
    first           first rows of pieces, increasing from 0 on: each is filtered from nothing on; default: one piece
    Raises ValueError on more numbers, and on rows that are not there.
    """
    if len(forward) > 3 or len(back) > 2:
        raise ValueError("a filter has three numbers forward at most, and two back")
    begins = np.zeros(1, dtype=np.int64) if first is None else np.ascontiguousarray(first, dtype=np.int64)
    if np.any(np.diff(np.append(begins, columns.shape[0])) < 0) or begins.min(initial=0) < 0:
        raise ValueError("pieces must begin in increasing rows")
    out = np.array(columns, dtype=np.float64, order="C")
    LIBRARY.windows_filter(
        numbers(*forward, *[0.0] * (3 - len(forward))), numbers(*back, *[0.0] * (2 - len(back))),
        address(begins), begins.size, *out.shape, address(out),
    )  # fmt: skip
    return out
