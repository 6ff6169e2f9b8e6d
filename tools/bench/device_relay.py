"""What a relay that decides every 1 ms in the device brings, against 10 ms in the host: same motors, same time.

PYTHONPATH=tools python -m bench.device_relay [--json] [--motors N]

Motors, gains, offset and noise are those of config/campaign.yaml (10-bit counts, 3 mrad); both recordings are
equally long. The host's drive acts 0.5 to 9.5 ms after its sample, the device's 0.1 ms; both are recorded.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.benchmark import options, tell
from rig.campaign.random_motors import LONGEST_CYCLE, Draw, draw
from rig.config import load_campaign
from rig.config.campaign import Campaign
from rig.identification import sampled_data, triple_relay
from rig.identification.cycles import find_cycle
from rig.identification.mean_cycle import Cycle
from rig.identification.starts import ridge_starts
from rig.model.motor import State
from rig.model.sampled_relay import Disturbance, relay_test
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries
from shared.table import markdown

CONFIG = Path(__file__).resolve().parents[2] / "config" / "campaign.yaml"
HOST_S, DEVICE_S = 0.010, 0.001
DEVICE_DELAY_S = 0.0001
SETTLING_CYCLES, CYCLES = 6, 10
PARAMETERS = ("tau_s", "K_rad_s_V", "fc_V")


class Found(NamedTuple):
    """Of one recording: largest relative error of tau, K, fc by method; widest relative half of the 95 % intervals."""

    five_equations: float
    triple_relay: float
    sampled_data: float
    interval: float


def relay_record(campaign: Campaign, one: Draw, period_s: float, delay_s: float) -> TimeSeries:
    """The settled part of a relay test: the same seconds of it whatever the period."""
    start_s = SETTLING_CYCLES * LONGEST_CYCLE * one.period_s
    t_s = np.arange(0.0, start_s + CYCLES * one.period_s, period_s)
    noise = np.random.default_rng([one.number, round(1e6 * period_s)]).standard_normal(t_s.size)
    test = relay_test(
        one.motor(),
        one.h1_V,
        one.h2_V,
        t_s,
        delay_s,
        disturbance=Disturbance(one.offset_rad + campaign.sensor.noise_rad * noise, lsb_rad=campaign.sensor.lsb_rad),
        start=State(y=one.start_rad),
    )
    kept = t_s >= start_s
    return TimeSeries(test.t_s[kept], test.y_rad[kept], test.t_u_s[kept], test.u_V[kept])


def features_of(cycle: Cycle) -> triple_relay.Features:
    """Of an averaged cycle, with position and integral measured at the edges."""
    return triple_relay.Features(
        *(cycle.t1_s, cycle.t2_s, cycle.t3_s),
        *(cycle.y_extremum_rad, cycle.y_rc_rad, cycle.y_rb_rad, cycle.z_rc_rad_s),
    )


def identify(one: Draw, record: TimeSeries) -> Found:
    """Every method on one record, against the truth."""

    def error(tau_s: float, K_rad_s_V: float, fc_V: float) -> float:
        return max(abs(tau_s / one.tau_s - 1.0), abs(K_rad_s_V / one.K_rad_s_V - 1.0), abs(fc_V / one.fc_V - 1.0))

    cycle = find_cycle(record)
    starts = ridge_starts(cycle.omega_rad_s, cycle.amplitude_rad, cycle.h1_V, cycle.h2_V)
    try:
        five = error(*triple_relay.solve(features_of(cycle), cycle.h1_V, cycle.h2_V, starts).theta)
    except IdentifyError:  # the noise has put the edges out of order
        five = math.inf
    curve = triple_relay.fit(cycle)
    best = sampled_data.fit([record], starts, periods_s=[cycle.period_s])
    widths = [(best.ci95[name][1] - best.ci95[name][0]) / 2.0 / getattr(one, name) for name in PARAMETERS]
    return Found(
        five,
        error(curve.tau_s, curve.K_rad_s_V, curve.fc_V),
        error(best.tau_s, best.K_rad_s_V, best.fc_V),
        max(widths),
    )


def compare(motors: int) -> dict[str, list[Found]]:
    """Both periods on motors 0, 1, 2, ..."""
    campaign = load_campaign(CONFIG)
    found: dict[str, list[Found]] = {"host": [], "device": []}
    for number in range(motors):
        one = draw(campaign, number)
        found["host"].append(identify(one, relay_record(campaign, one, HOST_S, one.delay_s)))
        found["device"].append(identify(one, relay_record(campaign, one, DEVICE_S, DEVICE_DELAY_S)))
    return found


def medians(found: list[Found]) -> Found:
    """Median of each column."""
    return Found(*(statistics.median(column) for column in zip(*found, strict=True)))


def main() -> int:
    """Print the table, or JSON."""
    parser = options("A relay in the device against one in the host.")
    parser.add_argument("--motors", type=int, default=50)
    arguments = parser.parse_args()
    began = time.perf_counter()
    found = compare(arguments.motors)
    host, device = medians(found["host"]), medians(found["device"])
    narrower = sum(d.interval < h.interval for h, d in zip(found["host"], found["device"], strict=True))
    rows = []
    for name, words in (
        ("five_equations", "error of the triple relay by the paper's five equations"),
        ("triple_relay", "error of `triple-relay`"),
        ("sampled_data", "error of `sampled-data`"),
        ("interval", "half of the 95 % interval of `sampled-data`"),
    ):
        a, b = getattr(host, name), getattr(device, name)
        rows.append((words, f"{a:.3%}", f"{b:.3%}", f"{b / a:.2f}"))
    table = markdown(("median over the motors, worst of tau, K, f_c", "host, 10 ms", "device, 1 ms", "ratio"), rows)
    took_s = time.perf_counter() - began
    tell(
        {"motors": arguments.motors, "host": host._asdict(), "device": device._asdict(), "narrower": narrower},
        as_json=arguments.json,
        text=f"{table}\n\nThe interval is narrower for {narrower} of {arguments.motors} motors. {took_s:.0f} s",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
