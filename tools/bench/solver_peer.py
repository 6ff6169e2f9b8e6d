"""The peer of the benchmarks: the motor with Coulomb friction by scipy's `solve_ivp`, restarted at every event."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

RTOL, ATOL = 1e-11, 1e-13


def glide(
    tau_s: float,
    K: float,
    fc_V: float,
    u_V: float,
    v: float,
    y: float,
    begin_s: float,
    end_s: float,
    at_s: Array,
) -> tuple[float, float, Array]:
    """Velocity and position at ``end_s`` under constant drive, and the positions at the times ``at_s`` between."""
    found: list[Array] = []
    now = begin_s
    while True:
        direction = math.copysign(1.0, v) if v else (math.copysign(1.0, u_V) if abs(u_V) > fc_V else 0.0)
        wanted = at_s[(at_s >= now) & (at_s < end_s)]
        if direction == 0.0:
            return 0.0, y, np.concatenate([*found, np.full(wanted.size, y)])

        def motion(_: float, x: Array, goal: float = K * (u_V - fc_V * direction)) -> list[float]:
            return [(goal - x[0]) / tau_s, x[0]]

        def reversal(_: float, x: Array) -> float:
            return float(x[0])

        reversal.terminal = True  # type: ignore[attr-defined]
        solution = solve_ivp(
            motion,
            (now, end_s),
            [v, y],
            rtol=RTOL,
            atol=ATOL,
            events=reversal if v else None,
            dense_output=wanted.size > 0,
        )
        now, v, y = float(solution.t[-1]), float(solution.y[0, -1]), float(solution.y[1, -1])
        wanted = wanted[wanted < now] if solution.status == 1 else wanted
        if wanted.size and solution.sol is not None:
            found.append(solution.sol(wanted)[1])
        if solution.status != 1:
            return v, y, np.concatenate(found) if found else np.empty(0)
        v = 0.0


def positions(theta: Array, edge_s: Array, u_V: Array, t_s: Array) -> Array:
    """Positions at ``t_s`` under a recorded drive; theta = tau, K, fc, asym, delay, v0, y0."""
    tau, K, fc, asym, delay, v, y = theta
    edges = edge_s + delay
    first = max(int(np.searchsorted(edges, t_s[0], side="right")) - 1, 0)
    parts = []
    begins = np.concatenate(([t_s[0]], edges[first + 1 :]))
    for begin, end, u in zip(begins, np.concatenate((begins[1:], [math.inf])), u_V[first:], strict=True):
        last = end >= t_s[-1]
        end_s = float(t_s[-1]) + 1e-6 if last else float(end)
        v, y, at = glide(tau, K, fc, float(u + asym), v, y, float(begin), end_s, t_s[(t_s >= begin) & (t_s < end_s)])
        parts.append(at)
        if last:
            break
    return np.concatenate(parts)
