"""Exact simulator of plant and relay at 10 ms ticks, against `solve_ivp` with events at equal accuracy, in one run.

PYTHONPATH=tools python -m bench.simulator_speed [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
import time

import numpy as np
from numpy.typing import NDArray

from bench.solver_peer import glide
from rig.control.relay import DualChannelRelay
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.model.sampled_relay import relay_test
from rig.signals import Sample

TAU_S, K_RAD_S_V, FC_V = 0.17, 6.5, 0.5
MOTOR = Motor(TAU_S, K_RAD_S_V, coulomb(FC_V))
H1_V, H2_V, PERIOD_S, START_RAD = 0.8, 1.0, 0.01, 0.3


def exact(ticks: int) -> NDArray[np.float64]:
    """Positions at the ticks, by the exact event-driven motor, compiled."""
    return relay_test(
        MOTOR, H1_V, H2_V, np.arange(ticks, dtype=float) * PERIOD_S, 0.0, start=State(y=START_RAD)
    ).true_y_rad


def interpreted(ticks: int) -> NDArray[np.float64]:
    """The same by the loop's own classes, as the simulated driver uses them."""
    relay, state, y = DualChannelRelay(H1_V, H2_V, 10.0), State(y=START_RAD), []
    for k in range(ticks):
        y.append(state.y)
        state = MOTOR.advance(state, relay.step(Sample(k * PERIOD_S, state.y, 0)), PERIOD_S)
    return np.array(y)


def integrated(ticks: int) -> NDArray[np.float64]:
    """The same by a solver that is restarted at each tick and at each reversal."""
    relay, v, position, y = DualChannelRelay(H1_V, H2_V, 10.0), 0.0, START_RAD, []
    for k in range(ticks):
        y.append(position)
        u = relay.step(Sample(k * PERIOD_S, position, 0))
        v, position, _ = glide(TAU_S, K_RAD_S_V, FC_V, u, v, position, 0.0, PERIOD_S, np.empty(0))
    return np.array(y)


def main() -> int:
    """Print times of a tick, their ratios, and the largest difference of the trajectories."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    as_json = parser.parse_args().json
    ticks = 500
    exact(ticks)
    times: dict[str, list[float]] = {"compiled": [], "interpreted": []}
    for _ in range(9):
        for name, simulate in (("compiled", exact), ("interpreted", interpreted)):
            begin = time.perf_counter()
            simulate(ticks)
            times[name].append(time.perf_counter() - begin)
    begin = time.perf_counter()
    y_integrated = integrated(ticks)
    peer_s = time.perf_counter() - begin
    medians = {name: sorted(values)[len(values) // 2] for name, values in times.items()}
    result = {
        "ticks": ticks,
        "compiled_us_per_tick": 1e6 * medians["compiled"] / ticks,
        "interpreted_us_per_tick": 1e6 * medians["interpreted"] / ticks,
        "solve_ivp_us_per_tick": 1e6 * peer_s / ticks,
        "ratio": peer_s / medians["compiled"],
        "ratio_interpreted": peer_s / medians["interpreted"],
        "largest_difference_rad": float(np.abs(exact(ticks) - y_integrated).max()),
        "largest_difference_interpreted_rad": float(np.abs(interpreted(ticks) - y_integrated).max()),
    }
    print(json.dumps(result) if as_json else "\n".join(f"{k}: {v:.6g}" for k, v in result.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
