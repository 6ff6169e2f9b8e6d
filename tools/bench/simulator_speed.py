"""Exact simulator of plant and relay at 10 ms ticks, against `solve_ivp` with events at equal accuracy, in one run.

PYTHONPATH=tools python -m bench.simulator_speed [--json]
"""

from __future__ import annotations

import sys
import time

import numpy as np
from numpy.typing import NDArray

from bench.benchmark import median_s, options, tell
from bench.solver_peer import glide
from rig.control.relay import DualChannelRelay
from rig.core.signals import Sample
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.model.sampled_relay import relay_test

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
    as_json = options("The exact simulator against solve_ivp.").parse_args().json
    ticks = 500
    compiled_s, interpreted_s = median_s(lambda: exact(ticks), 9), median_s(lambda: interpreted(ticks), 9)
    begin = time.perf_counter()
    y_integrated = integrated(ticks)
    peer_s = time.perf_counter() - begin
    result = {
        "ticks": ticks,
        "compiled_us_per_tick": 1e6 * compiled_s / ticks,
        "interpreted_us_per_tick": 1e6 * interpreted_s / ticks,
        "solve_ivp_us_per_tick": 1e6 * peer_s / ticks,
        "ratio": peer_s / compiled_s,
        "ratio_interpreted": peer_s / interpreted_s,
        "largest_difference_rad": float(np.abs(exact(ticks) - y_integrated).max()),
        "largest_difference_interpreted_rad": float(np.abs(interpreted(ticks) - y_integrated).max()),
    }
    tell(result, as_json=as_json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
