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
def deviances(t_s: Array, starts: Rows, memory_s: float, ratios: Array, residual: Array, out: Array) -> None:
    """Fill ``out`` (k,) with -2 log likelihood of the residual (n,) for each ratio, up to a constant.

    The scale is profiled out; the rest as ``innovations``.
    ratios   variance of the coloured noise over the variance of the white noise, (k,), at most 1e18
    """
    n, m = residual.size, ratios.size
    state, total, logs = np.zeros(m), np.zeros(m), np.zeros(m)
    variance, product = ratios.copy(), np.ones(m)
    piece = 0
    for k in range(n):
        if piece < starts.size and k == starts[piece]:
            keep = 0.0
            piece += 1
        else:
            keep = math.exp(-(t_s[k] - t_s[k - 1]) / memory_s)
        y = residual[k]
        for i in range(m):
            v = ratios[i] + (variance[i] - ratios[i]) * keep * keep
            x = state[i] * keep
            inverse = 1.0 / (v + 1.0)
            surprise = y - x
            total[i] += surprise * surprise * inverse
            product[i] *= v + 1.0
            state[i] = x + v * inverse * surprise
            variance[i] = v * inverse
        if k % 16 == 15:  # one logarithm for many rows
            for i in range(m):
                logs[i] += math.log(product[i])
                product[i] = 1.0
    for i in range(m):
        out[i] = n * math.log(total[i] / n) + logs[i] + math.log(product[i])
