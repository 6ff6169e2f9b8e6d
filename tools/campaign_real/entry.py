"""What a law must bring to enter: how often a plain motor would get one, by the bar.

Every plain motor goes through the whole choice of laws without a bar. The law that is left with the largest gain beyond
Schwarz's criterion says at which bar that motor would have none.

    PYTHONPATH=tools python -m campaign_real.entry [--motors 1000] [--seed 5]
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace

import numpy as np
from rich.progress import track
from scipy.stats import beta

from campaign_real.kinds import KINDS, case
from rig.config.campaign import Campaign
from rig.core.estimators import LEADING
from rig.identification import identify
from rig.identification.departures.choice import Asked, loss
from rig.identification.departures.fit import Normal, unit
from rig.identification.measurements import measurements
from rig.identification.motor_law import Beginning
from shared.cases import spread

BARS = (0.0, 4.0, 7.0, 10.0, 14.0, 20.0)


def largest_gain(campaign: Campaign, number: int) -> float:
    """Of the laws left in a plain motor, beyond Schwarz's criterion; -inf if none is."""
    recordings = case(campaign, number, (KINDS[0],)).recordings()
    data = measurements(recordings, with_cycles=True, plain_is_hysteretic=False)
    plain = identify(recordings, (LEADING,), choose_law=False).estimates[LEADING]
    begun = Beginning.of(data.tests, plain, data.periods_s)
    chooser = replace(begun.chooser, asked=Asked(0.0, 0.0, -math.inf))
    choice = chooser.choose(begun.whole, begun.motor, begun.cycle_s)
    fit = choice.fit.with_own_noise
    normal = Normal.of(fit.rows, fit.problem.cut)
    gains = [loss(normal, fit, law) / unit(fit) - chooser.price(law, fit, 0.0) for law in choice.laws]
    return max(gains, default=-math.inf)


def main() -> int:
    """Print the share of plain motors with a law, by the bar."""
    parser = argparse.ArgumentParser(description="How often a plain motor would get a law.")
    parser.add_argument("--motors", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=5)
    given = parser.parse_args()
    campaign = Campaign(name="entry", experiments=given.motors, seed=given.seed)
    jobs = [(campaign, number) for number in range(given.motors)]
    results = spread(largest_gain, jobs, batch=10)
    gains = np.array([gain for _, gain in track(results, total=len(jobs), disable=not sys.stderr.isatty())])
    print(f"{gains.size} plain motors, seed {given.seed}: share with a law, if a law must bring this much to enter")
    for bar in BARS:
        false = int(np.sum(gains > bar))
        bound = float(beta.ppf(0.95, false + 1, max(gains.size - false, 1)))
        print(f"{bar:5.1f}  {100.0 * false / gains.size:6.2f} %  (at most {100.0 * bound:.2f} %, 95 % confidence)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
