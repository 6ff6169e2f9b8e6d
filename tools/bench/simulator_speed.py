"""Exact simulator of plant and relay at 10 ms ticks, against `solve_ivp` with events at equal accuracy, in one run.

python tools/bench/simulator_speed.py [--json]
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time

import numpy as np
from scipy.integrate import solve_ivp

from rig.control.relay import DualChannelRelay
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.signals import Sample

MOTOR = Motor(0.17, 6.5, coulomb(0.5))
H1_V, H2_V, PERIOD_S = 0.8, 1.0, 0.01


def exact(seconds: float) -> np.ndarray:
    """Positions at the ticks, by the event-driven motor."""
    relay, state, y = DualChannelRelay(H1_V, H2_V, 10.0), State(y=0.3), []
    for k in range(round(seconds / PERIOD_S)):
        y.append(state.y)
        u = relay.step(Sample(k * PERIOD_S, state.y, 0))
        state = MOTOR.advance(state, u, PERIOD_S)
    return np.array(y)


def integrated(seconds: float) -> np.ndarray:
    """The same by a solver that is restarted at each tick and at each reversal."""
    relay, v, position, y = DualChannelRelay(H1_V, H2_V, 10.0), 0.0, 0.3, []

    def reversal(t: float, x: np.ndarray, *_: float) -> float:
        return float(x[0])

    reversal.terminal = True  # type: ignore[attr-defined]
    for k in range(round(seconds / PERIOD_S)):
        y.append(position)
        u = relay.step(Sample(k * PERIOD_S, position, 0))
        t, end = 0.0, PERIOD_S
        while t < end:
            direction = math.copysign(1.0, v) if v else (math.copysign(1.0, u) if abs(u) > 0.5 else 0.0)
            if direction == 0.0:
                break
            target = MOTOR.K_rad_s_V * (u - 0.5 * direction)
            solution = solve_ivp(
                lambda _, x, goal: [(goal - x[0]) / MOTOR.tau_s, x[0]],
                (t, end), [v, position], args=(target,), rtol=1e-11, atol=1e-13, events=reversal if v else None,
            )  # fmt: skip
            t, v, position = float(solution.t[-1]), float(solution.y[0, -1]), float(solution.y[1, -1])
            if solution.status == 1:
                v = 0.0
    return np.array(y)


def main() -> int:
    """Print times, their ratio, and the largest difference of the two trajectories."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    as_json = parser.parse_args().json
    seconds = 5.0
    exact(seconds)
    times = []
    for _ in range(7):
        begin = time.perf_counter()
        y_exact = exact(seconds)
        times.append(time.perf_counter() - begin)
    begin = time.perf_counter()
    y_integrated = integrated(seconds)
    peer_s = time.perf_counter() - begin
    own_s = sorted(times)[len(times) // 2]
    result = {
        "simulated_s": seconds,
        "exact_s": own_s,
        "solve_ivp_s": peer_s,
        "ratio": peer_s / own_s,
        "largest_difference_rad": float(np.abs(y_exact - y_integrated).max()),
    }
    print(json.dumps(result) if as_json else "\n".join(f"{k}: {v:.6g}" for k, v in result.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
