"""The triple-relay fit against the same equations by `scipy.optimize.least_squares`, from the same starts, in one run.

PYTHONPATH=tools python -m bench.triple_relay_speed [--json]
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from bench.benchmark import median_s, options, tell
from rig.identification.cycles import find_cycle
from rig.identification.mean_cycle import Cycle
from rig.identification.starts import Start, ridge_starts
from rig.identification.triple_relay import Features, fit, solve, solve_cycle
from rig.model.friction import coulomb
from rig.model.limit_cycle import effective_inputs, limit_cycle, stage_states
from rig.model.motor import Motor, State
from rig.model.sampled_relay import Disturbance, relay_test
from rig.run_folder.recording.series import TimeSeries

TAU_S, K_RAD_S_V, FC_V = 0.17, 6.5, 0.5
H1_V, H2_V = 0.8, 1.0
MOTOR = Motor(TAU_S, K_RAD_S_V, coulomb(FC_V))


def features() -> Features:
    """Durations and positions of the exact limit cycle."""
    cycle = limit_cycle(TAU_S, K_RAD_S_V, FC_V, H1_V, H2_V)
    return Features(*cycle.durations_s, float(cycle.states[1, 1]), float(cycle.states[0, 1]))


def by_least_squares(measured: Features, starts: list[Start]) -> NDArray[np.float64]:
    """Best tau, K, fc of the five equations by a general solver with a numerical Jacobian."""
    durations = measured[:3]
    amplitude, omega = -measured.y_extremum_rad, np.pi / sum(durations)

    def residuals(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        tau, K, fc = theta
        states = stage_states(tau, K, durations, effective_inputs(fc, H1_V, H2_V))
        return np.array(
            [
                (states[0, 2] - measured.z_rc_rad_s) * omega,
                states[1, 0] / omega,
                states[2, 1] - measured.y_rb_rad,
                states[1, 1] - measured.y_extremum_rad,
                states[0, 1] - measured.y_rc_rad,
            ]
        ) / amplitude  # fmt: skip

    low, high = [1e-4, 1e-3, -0.1 * H2_V], [10.0, 1e3, H2_V]
    found = [
        least_squares(residuals, start, bounds=(low, high), x_scale=start, xtol=1e-11, ftol=1e-13, gtol=1e-13)
        for start in starts
    ]
    return np.asarray(min(found, key=lambda solution: solution.cost).x)


def record(period_s: float, cycles: int) -> TimeSeries:
    """A sampled relay's log: 3 mrad of noise, its drive acting 0.4 periods after each sample."""
    t = np.arange(0.0, cycles * limit_cycle(TAU_S, K_RAD_S_V, FC_V, H1_V, H2_V).period_s, period_s)
    noise = 0.003 * np.random.default_rng(1).standard_normal(t.size)
    test = relay_test(MOTOR, H1_V, H2_V, t, 0.4 * period_s, disturbance=Disturbance(noise), start=State(y=0.3))
    return TimeSeries(test.t_s, test.y_rad, test.t_u_s, test.u_V)


def ridge(cycle: Cycle) -> list[Start]:
    """The starts that the estimator uses."""
    return ridge_starts(cycle.omega_rad_s, cycle.amplitude_rad, cycle.h1_V, cycle.h2_V)


def main() -> int:
    """Print times and ratios."""
    as_json = options("The triple-relay fit against least_squares.").parse_args().json
    measured = features()
    omega = np.pi / sum(measured[:3])
    starts = ridge_starts(omega, -measured.y_extremum_rad, H1_V, H2_V)
    own_ms = 1e3 * median_s(lambda: solve(measured, H1_V, H2_V, starts), 51)
    peer_ms = 1e3 * median_s(lambda: by_least_squares(measured, starts), 5)
    own, peer = np.array(solve(measured, H1_V, H2_V, starts).theta), by_least_squares(measured, starts)
    coarse, fine = record(0.01, 15), record(0.0002, 40)
    coarse_cycle, fine_cycle = find_cycle(coarse), find_cycle(fine)
    result = {
        "starts": len(starts),
        "five_equations_ms": own_ms,
        "least_squares_ms": peer_ms,
        "ratio": peer_ms / own_ms,
        "largest_relative_difference": float(np.abs(own / peer - 1.0).max()),
        "cycle_at_10_ms_ms": 1e3 * median_s(lambda: solve_cycle(coarse_cycle, ridge(coarse_cycle)), 31),
        "cycle_at_0.2_ms_ms": 1e3 * median_s(lambda: solve_cycle(fine_cycle, ridge(fine_cycle)), 31),
        "cycles_at_10_ms": coarse_cycle.cycles,
        "find_fit_jackknife_at_10_ms_ms": 1e3 * median_s(lambda: fit(find_cycle(coarse)), 15),
        "rows_at_0.2_ms": len(fine),
        "find_fit_jackknife_at_0.2_ms_ms": 1e3 * median_s(lambda: fit(find_cycle(fine)), 5),
    }
    tell(result, as_json=as_json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
