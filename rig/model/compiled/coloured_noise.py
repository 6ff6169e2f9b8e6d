"""Prediction of noise that is partly white and partly coloured (see ``rig.identify.noise``), sample by sample."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model.compiled.kernel import kernel

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@kernel
def innovations(t_s: Array, starts: Rows, memory_s: float, ratio: float, columns: Array, out: Array) -> float:
    """Fill ``out`` (n, p) with the innovations of ``columns`` in units of the white part; returns sum of log F.

    t_s       n times, s
    starts    first rows of the windows, each with coloured noise of its own
    memory_s  correlation time of the coloured noise, s
    ratio     variance of the coloured noise over the variance of the white noise
    columns   (n, p), in any unit
    F is the variance of each innovation over the variance of the white noise. All of ``out`` has the same variance.
    """
    n, p = columns.shape
    state = np.zeros(p)
    variance = ratio
    logs = 0.0
    piece = 0
    for k in range(n):
        if piece < starts.size and k == starts[piece]:
            state[:] = 0.0
            variance = ratio
            piece += 1
        else:
            keep = math.exp(-(t_s[k] - t_s[k - 1]) / memory_s)
            for c in range(p):
                state[c] *= keep
            variance = ratio + (variance - ratio) * keep * keep
        spread = variance + 1.0
        gain = variance / spread
        scale = 1.0 / math.sqrt(spread)
        logs += math.log(spread)
        for c in range(p):
            surprise = columns[k, c] - state[c]
            out[k, c] = surprise * scale
            state[c] += gain * surprise
        variance *= 1.0 - gain
    return logs


@kernel
def deviance(t_s: Array, starts: Rows, memory_s: float, ratio: float, residual: Array) -> float:
    """-2 log likelihood of the residual (n,), its scale profiled out, up to a constant; the rest as ``innovations``.

    ratio   variance of the coloured noise over the variance of the white noise
    """
    n = residual.size
    total = logs = state = 0.0
    variance = ratio
    piece = 0
    for k in range(n):
        if piece < starts.size and k == starts[piece]:
            state = 0.0
            variance = ratio
            piece += 1
        else:
            keep = math.exp(-(t_s[k] - t_s[k - 1]) / memory_s)
            state *= keep
            variance = ratio + (variance - ratio) * keep * keep
        spread = variance + 1.0
        surprise = residual[k] - state
        total += surprise * surprise / spread
        logs += math.log(spread)
        gain = variance / spread
        state += gain * surprise
        variance *= 1.0 - gain
    return n * math.log(total / n) + logs
