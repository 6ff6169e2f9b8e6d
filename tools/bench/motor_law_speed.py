"""One identification with all laws of real motors, against one prediction of the same tests by `solve_ivp`.

The peer predicts the plain motor's positions in both tests once, with a solver that is restarted at every event. An
identification predicts hundreds of motors with laws, and their derivatives.

    PYTHONPATH=tools python -m bench.motor_law_speed [--motors 41] [--peers 3] [--json]
"""

from __future__ import annotations

import sys
import time

import numpy as np

from bench.benchmark import options, tell
from bench.solver_peer import positions
from campaign_real.kinds import Case, case
from campaign_real.rows import kinds_of
from rig.config.campaign import Campaign
from rig.core.estimators import LEADING
from rig.identification import identify

SEED = 3  # not that of the campaign


def predicted_once_s(one: Case) -> float:
    """Time that the solver takes for the positions of both tests, s."""
    begin = time.perf_counter()
    for record in one.records:
        keep = np.concatenate(([True], np.diff(record.u_V) != 0.0))
        theta = np.array([one.motor.tau_s, one.motor.K_rad_s_V, one.motor.fc_V, 0.0, one.bench.delay_s, 0.0, 0.0])
        positions(theta, record.t_s[keep], record.u_V[keep], record.t_s)
    return time.perf_counter() - begin


def main() -> int:
    """Print the median time of an identification over many motors, and its ratio to the peer's prediction."""
    parser = options("One identification with all laws against one prediction by solve_ivp.")
    parser.add_argument("--motors", type=int, default=41)
    parser.add_argument("--peers", type=int, default=3, help="motors that the peer predicts, too")
    arguments = parser.parse_args()
    campaign = Campaign(name="speed", experiments=arguments.motors, seed=SEED)
    cases = [case(campaign, number, kinds_of(number, False, SEED)) for number in range(arguments.motors)]
    identify(cases[0].recordings(), (LEADING,))  # compiles
    times = []
    for one in cases:
        begin = time.perf_counter()
        identify(one.recordings(), (LEADING,))
        times.append(time.perf_counter() - begin)
    ratios = [taken / predicted_once_s(one) for one, taken in zip(cases[: arguments.peers], times, strict=False)]
    result = {
        "motors": arguments.motors,
        "rows_median": float(np.median([sum(record.t_s.size for record in one.records) for one in cases])),
        "identify_median_s": float(np.median(times)),
        "identify_p95_s": float(np.percentile(times, 95)),
        "over_one_prediction_by_solve_ivp": float(np.median(ratios)),
    }
    tell(result, as_json=arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
