"""One sampled-data fit of ten cycles, all starts included, against the same fit by `solve_ivp` and `least_squares`.

The peer has the same recording, starts and unknowns; it predicts with a solver that is restarted at every
event, and has its Jacobian by differences. Both must come to the same motor.

    PYTHONPATH=tools python -m bench.sampled_data_speed [--motors 40] [--peers 1] [--json]
"""

from __future__ import annotations

import sys
import time

import numpy as np
from scipy.optimize import least_squares

from bench.benchmark import options, tell
from bench.solver_peer import Array, positions
from rig.campaign.random_motors import draw, simulate
from rig.config.campaign import Campaign
from rig.identification import sampled_data
from rig.identification.cycles import find_cycle
from rig.identification.mean_cycle import Cycle
from rig.identification.starts import Start, ridge_starts
from rig.run_folder.recording.series import TimeSeries

STARTS = 3  # that are iterated, as our own fit does


def record_of(campaign: Campaign, number: int) -> tuple[TimeSeries, Cycle, list[Start]]:
    """One experiment of the grid as a plain CSV would hold it, its cycle, and the starts from it."""
    test, rows = simulate(campaign, draw(campaign, number))
    record = TimeSeries(test.t_s[rows], test.y_rad[rows], None, test.u_V[rows], name=f"experiment {number}")
    cycle = find_cycle(record)
    return record, cycle, ridge_starts(cycle.omega_rad_s, cycle.amplitude_rad, cycle.h1_V, cycle.h2_V)


def peer(record: TimeSeries, starts: list[Start]) -> Array:
    """tau, K, fc of the best of the starts, by the solver."""
    longest = 2.0 * record.period_s
    first = int(np.searchsorted(record.t_s, record.t_s[0] + longest))
    t_s, y_rad = record.t_s[first:], record.y_rad[first:]
    keep = np.concatenate(([True], np.diff(record.u_V) != 0.0))
    edge_s, u_V = record.t_s[keep], record.u_V[keep]

    def residual(x: Array) -> Array:
        return positions(np.array([np.exp(x[0]), np.exp(x[1]), *x[2:]]), edge_s, u_V, t_s) - y_rad

    slope, offset = np.polyfit(t_s[:4] - t_s[0], y_rad[:4], 1)
    guesses = [
        np.array([np.log(s.tau_s), np.log(s.K_rad_s_V), s.fc_V, 0.0, 0.5 * longest, slope, offset]) for s in starts
    ]
    guesses.sort(key=lambda x: float(np.sum((residual(x) - residual(x).mean()) ** 2)))
    largest = float(np.abs(u_V).max())
    bounds = (
        [np.log(1e-3), -40.0, 0.0, -largest, 0.0, -np.inf, -np.inf],
        [np.log(1e2), 40.0, largest, largest, longest, np.inf, np.inf],
    )
    found = [least_squares(residual, x, bounds=bounds, x_scale="jac", max_nfev=100) for x in guesses[:STARTS]]
    best = min(found, key=lambda f: f.cost).x
    return np.array([np.exp(best[0]), np.exp(best[1]), best[2]])


def main() -> int:
    """Print the median time of a fit over many motors, and its ratio to the peer's on the first."""
    parser = options("One sampled-data fit against solve_ivp and least_squares.")
    parser.add_argument("--motors", type=int, default=40)
    parser.add_argument("--peers", type=int, default=1, help="motors that the peer fits too (about a minute each)")
    arguments = parser.parse_args()
    campaign = Campaign(name="speed", experiments=arguments.motors)
    cases = [record_of(campaign, number) for number in range(arguments.motors)]

    def own(record: TimeSeries, cycle: Cycle, starts: list[Start]) -> tuple[float, Array]:
        begin = time.perf_counter()
        found = sampled_data.fit([record], starts, periods_s=[cycle.period_s])
        return time.perf_counter() - begin, np.array([found.tau_s, found.K_rad_s_V, found.fc_V])

    own(*cases[0])  # compiles
    times = [own(*case)[0] for case in cases]
    ratios, differences = [], []
    for record, cycle, starts in cases[: arguments.peers]:
        begin = time.perf_counter()
        theirs = peer(record, starts)
        peer_s = time.perf_counter() - begin
        again = [own(record, cycle, starts) for _ in range(7)]
        ratios.append(peer_s / float(np.median([seconds for seconds, _ in again])))
        differences.append(float(np.abs(again[0][1] / theirs - 1.0).max()))
    result = {
        "motors": arguments.motors,
        "rows_median": float(np.median([len(record) for record, _, _ in cases])),
        "fit_median_ms": 1e3 * float(np.median(times)),
        "fit_p95_ms": 1e3 * float(np.percentile(times, 95)),
        "ratio": min(ratios),
        "largest_relative_difference": max(differences),
    }
    tell(result, as_json=arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
