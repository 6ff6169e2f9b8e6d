"""The schema of a campaign: from which ranges random experiments are drawn, and how they are recorded.

The defaults are the grid of docs/theory.md 7.10. Strict, as ``rig.config.schema``.
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from rig.core.section import NonNegative, Positive
from rig.core.section import Section as _Section


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    low, high = interval
    if not low <= high:
        raise ValueError(f"must be [low, high] with low <= high, not [{low:g}, {high:g}]")
    return interval


Range = Annotated[tuple[float, float], AfterValidator(_ordered)]
PositiveRange = Annotated[tuple[Positive, Positive], AfterValidator(_ordered)]
NonNegativeRange = Annotated[tuple[NonNegative, NonNegative], AfterValidator(_ordered)]


class CampaignMotor(_Section):
    """The random motor; its gain follows from relay.amplitude_rad."""

    tau_s: PositiveRange = Field((0.08, 0.5), description="velocity time constant, log-uniform in [low, high]")
    fc_V: NonNegativeRange = Field((0.1, 0.5), description="Coulomb friction, uniform in [low, high]")
    asym_V: Range = Field((-0.05, 0.05), description="asymmetry of the effective drive, uniform in [low, high]")
    static_ratio: Annotated[float, Field(ge=1)] = Field(1.0, description="static over moving friction")
    start_rad: Range = Field((0.0, 0.0), description="position at the start, uniform in [low, high]")


class SecondTest(_Section):
    """A second relay test of the same period, never used in the fit: its cycle is predicted."""

    amplitude_ratio: Annotated[float, Field(gt=0.3, lt=3.0)] = Field(
        0.75, description="h1 and h2 - f_c of the second test over those of the first"
    )


class CampaignRelay(_Section):
    """The random gains, and how much is recorded."""

    h2_beyond_fc_V: PositiveRange = Field((0.3, 1.0), description="h2 - f_c, uniform in [low, high]")
    h1_over_h2: PositiveRange = Field((0.4, 1.0), description="h1 / h2, uniform in [low, high]")
    amplitude_rad: Positive = Field(0.8, description="amplitude by describing function, which sets the motor's gain")
    least_samples: Annotated[float, Field(ge=4)] = Field(
        30.0, description="a draw is kept if its period by describing function has at least so many samples"
    )
    settling_cycles: Annotated[int, Field(ge=0, le=1000)] = Field(6, description="cycles before the recording begins")
    cycles: Annotated[int, Field(ge=1, le=1000)] = Field(10, description="cycles recorded")
    second: SecondTest | None = Field(None, description="predict a second test that the fit has not seen")


class CampaignSampling(_Section):
    """When samples are taken, when the drive acts, and which of these times are recorded."""

    period_s: Annotated[float, Field(ge=0.0001, le=0.1)] = Field(0.01, description="sampling period")
    jitter_s: NonNegative = Field(0.0, description="each sample's time, uniform half width; recorded in t_s")
    delay_s: NonNegativeRange = Field((0.0005, 0.0095), description="from sample to drive, uniform in [low, high]")
    delay_jitter_s: NonNegative = Field(0.0, description="each drive's delay around that, uniform half width")
    times_known: bool = Field(False, description="whether t_u_s is recorded; else the delay is fitted")
    clock_ratio: PositiveRange = Field(
        (1.0, 1.0), description="recorded over true time, uniform in [low, high]; [1, 1]: a plain CSV without ticks"
    )

    @model_validator(mode="after")
    def _effects_in_order(self) -> Self:
        if self.jitter_s >= 0.5 * self.period_s:
            raise ValueError("`jitter_s` must be less than half of `period_s`: samples must stay in order")
        if self.delay_jitter_s > self.delay_s[0]:
            raise ValueError("`delay_jitter_s` must be at most the smallest `delay_s`: no drive acts before its sample")
        if 2.0 * (self.jitter_s + self.delay_jitter_s) >= self.period_s:
            raise ValueError(
                "`jitter_s` + `delay_jitter_s` must be less than half of `period_s`: drives must act in order"
            )
        if self.delay_s[1] + self.delay_jitter_s > 2.0 * self.period_s:
            raise ValueError("`delay_s` must be at most 2 * `period_s`: no longer delay is looked for")
        return self


class CorrelatedNoise(_Section):
    """Coloured noise on the position (first-order autoregressive), added to the white noise."""

    coefficient: Annotated[float, Field(ge=0, lt=1)] = Field(description="correlation from one sample to the next")
    std_rad: NonNegative = Field(description="its standard deviation")


class DriveNoise(_Section):
    """First-order autoregressive disturbance of the drive at the motor; it is not recorded."""

    coefficient: Annotated[float, Field(ge=0, lt=1)] = Field(description="correlation from one sample to the next")
    std_V: NonNegative = Field(description="its standard deviation")


class CampaignSensor(_Section):
    """The potentiometer."""

    offset_rad: Range = Field((-0.05, 0.05), description="reading at the centre of travel, uniform in [low, high]")
    noise_rad: NonNegative = Field(0.003, description="standard deviation of white noise before quantisation")
    lsb_rad: NonNegative = Field(4.2 / 1024, description="step of the reading; 0 for none")
    correlated: CorrelatedNoise | None = Field(None, description="noise that lasts from sample to sample")


class Campaign(_Section):
    """Random experiments, simulated and identified."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=40)] = Field(
        description="lower case; becomes part of the campaign folder's name"
    )
    experiments: Annotated[int, Field(ge=1, le=10_000_000)] = Field(description="how many; numbered from 0")
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = Field(1, description="experiment k is the same for the same seed")
    motor: CampaignMotor = Field(CampaignMotor(), description="the random motor")
    relay: CampaignRelay = Field(CampaignRelay(), description="the random gains, and how much is recorded")
    sampling: CampaignSampling = Field(CampaignSampling(), description="when samples are taken and the drive acts")
    sensor: CampaignSensor = Field(CampaignSensor(), description="the potentiometer")
    drive_noise: DriveNoise | None = Field(None, description="what disturbs the motor besides the drive")


def campaign_lines(campaign: Campaign) -> tuple[str, ...]:
    """What a campaign will do, in words, a line each."""
    motor, relay, sampling = campaign.motor, campaign.relay, campaign.sampling
    times = "all times recorded" if sampling.times_known else "without t_u_s"
    return (
        f"campaign {campaign.name}: {campaign.experiments} random experiments, seed {campaign.seed}",
        f"motors: tau {motor.tau_s[0]:g} to {motor.tau_s[1]:g} s, f_c {motor.fc_V[0]:g} to {motor.fc_V[1]:g} V",
        f"records: {relay.cycles} cycles after {relay.settling_cycles}, every {1e3 * sampling.period_s:g} ms, {times}",
        "run it with `rig campaign`",
    )
