"""The random experiments of a campaign (docs/theory.md 7.10). Experiment k is always the same.

The motor, the noise, the timing and the second test of each experiment have random streams of their own. A stream
depends only on the seed and the number of the experiment. So the order of experiments does not matter, and two
campaigns of one seed have the same motors, even if they differ in noise or quantisation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rig.config.campaign import Campaign
from rig.core.arrays import Array
from rig.core.errors import CauseError
from rig.model.describing_function import predict
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.model.sampled_relay import Disturbance, SimulatedRelayTest, relay_test

Stream = Literal["motor", "noise", "timing", "second noise", "second timing"]

STREAMS: tuple[Stream, ...] = ("motor", "noise", "timing", "second noise", "second timing")
MOST_DRAWS = 10_000
LONGEST_CYCLE = 1.6  # times the describing function's period: delay and sampling make the cycle longer


class CampaignError(CauseError):
    """A campaign cannot be run."""


class BrokenOffError(CampaignError):
    """A campaign ended early, and not by its config: all experiments fail, or a worker process was killed."""

    status = 1


@dataclass(frozen=True)
class Draw:
    """One random experiment: motor, gains, bench. ``period_s`` is the describing function's."""

    number: int
    tau_s: float
    K_rad_s_V: float
    fc_V: float
    asym_V: float
    delay_s: float
    h1_V: float
    h2_V: float
    period_s: float
    offset_rad: float
    start_rad: float
    clock_ratio: float
    static_ratio: float

    def motor(self) -> Motor:
        """The motor. Its asymmetry is a bias: motion cannot show the difference (docs/theory.md 7.3)."""
        return Motor(self.tau_s, self.K_rad_s_V, coulomb(self.fc_V, self.fc_V * self.static_ratio), self.asym_V)

    def second_gains(self, ratio: float) -> tuple[float, float]:
        """h1 and h2, V, of a test with the same period and ``ratio`` times the amplitude."""
        return ratio * self.h1_V, self.fc_V + ratio * (self.h2_V - self.fc_V)


def stream(campaign: Campaign, number: int, name: Stream) -> np.random.Generator:
    """The random stream of one part of one experiment. It is counter-based, and depends on seed and number alone."""
    seeds = np.random.SeedSequence(campaign.seed, spawn_key=(number, STREAMS.index(name)))
    return np.random.Generator(np.random.Philox(seeds))


def draw(campaign: Campaign, number: int) -> Draw:
    """Experiment ``number`` of the campaign. Raises CampaignError if the ranges give no cycle that is slow enough."""
    rng = stream(campaign, number, "motor")
    motor, relay, sampling, sensor = campaign.motor, campaign.relay, campaign.sampling, campaign.sensor
    for _ in range(MOST_DRAWS):
        tau = math.exp(rng.uniform(math.log(motor.tau_s[0]), math.log(motor.tau_s[1])))
        fc = rng.uniform(*motor.fc_V)
        h2 = fc + rng.uniform(*relay.h2_beyond_fc_V)
        h1 = rng.uniform(*relay.h1_over_h2) * h2
        unit = predict(tau, 1.0, fc, h1, h2)
        if unit.period_s >= relay.least_samples * sampling.period_s:
            break
    else:
        raise CampaignError(
            f"none of {MOST_DRAWS} draws has a period of {relay.least_samples:g} samples or more",
            "widen motor.tau_s, lower relay.h1_over_h2 or relay.least_samples, or sample faster",
        )
    return Draw(
        number=number,
        tau_s=tau,
        K_rad_s_V=relay.amplitude_rad / unit.amplitude_rad,
        fc_V=fc,
        h1_V=h1,
        h2_V=h2,
        period_s=unit.period_s,
        asym_V=rng.uniform(*motor.asym_V),
        delay_s=rng.uniform(*sampling.delay_s),
        offset_rad=rng.uniform(*sensor.offset_rad),
        start_rad=rng.uniform(*motor.start_rad),
        clock_ratio=rng.uniform(*sampling.clock_ratio),
        static_ratio=motor.static_ratio,
    )


def simulate(campaign: Campaign, one: Draw, *, second: bool = False) -> tuple[SimulatedRelayTest, slice]:
    """The relay test of an experiment from its start, and the recorded rows of it.

    second  whether to simulate the test at the second amplitude instead
    """
    relay, sampling, sensor = campaign.relay, campaign.sampling, campaign.sensor
    noise = stream(campaign, one.number, "second noise" if second else "noise")
    timing = stream(campaign, one.number, "second timing" if second else "timing")
    wanted = relay.settling_cycles + relay.cycles
    rows = math.ceil((wanted + 1) * LONGEST_CYCLE * one.period_s / sampling.period_s)
    white = noise.standard_normal((3, rows))
    disturbance = one.offset_rad + sensor.noise_rad * white[0]
    if sensor.correlated is not None:
        disturbance += sensor.correlated.std_rad * autoregressive(white[1], sensor.correlated.coefficient)
    torque = campaign.drive_noise
    unit = timing.uniform(-1.0, 1.0, (2, rows))
    h1, h2 = (one.h1_V, one.h2_V)
    if second and relay.second is not None:
        h1, h2 = one.second_gains(relay.second.amplitude_ratio)
    test = relay_test(
        one.motor(),
        h1,
        h2,
        sampling.period_s * np.arange(rows) + sampling.jitter_s * unit[0],
        one.delay_s + sampling.delay_jitter_s * unit[1],
        disturbance=Disturbance(
            reading_rad=disturbance,
            drive_V=None if torque is None else torque.std_V * autoregressive(white[2], torque.coefficient),
            lsb_rad=sensor.lsb_rad,
        ),
        start=State(y=one.start_rad),
    )
    return test, recorded_rows(test, relay.settling_cycles, relay.cycles)


def recorded_rows(test: SimulatedRelayTest, settling_cycles: int, cycles: int) -> slice:
    """Rows of ``cycles`` cycles after ``settling_cycles``. A cycle begins where the integral falls through zero.

    If the test has fewer cycles, the rows go to its end. If it has not even the settling ones, they are all its rows.
    """
    z = test.z_rad_s
    falls = np.flatnonzero((z[1:] < 0.0) & (z[:-1] >= 0.0))
    first = int(falls[settling_cycles]) if falls.size > settling_cycles else 0
    last = settling_cycles + cycles
    stop = int(falls[last]) + 2 if falls.size > last else z.size
    return slice(first, stop)


def autoregressive(white: Array, coefficient: float) -> Array:
    """Stationary x_k = c x_(k-1) + sqrt(1 - c^2) w_k of unit variance, from unit white noise w; x_0 = w_0.

    coefficient  c, correlation from one sample to the next, 0 to 1
    """
    share = math.sqrt(1.0 - coefficient**2)
    values = white.tolist()
    for k in range(1, len(values)):
        values[k] = coefficient * values[k - 1] + share * values[k]
    return np.array(values)
