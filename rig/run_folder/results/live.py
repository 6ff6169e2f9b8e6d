"""What a run with `relay.until` says of its tests: each live estimate, and why they ended."""

from __future__ import annotations

from pydantic import Field

from rig.run_folder.results.part import Count, Flag, Number, Part, Text


class LiveResult(Part):
    """An estimate while the tests ran: an event ``live``, and an entry of `stopped.live`."""

    row: Count = Field(0, description="the last row that it counts, from 0")
    of_s: Number = Field(None, description="when that was sampled, s since the run's start")
    tau_s: Number = Field(None, description="time constant, s")
    K_rad_s_V: Number = Field(None, description="gain, (rad/s)/V")
    fc_V: Number = Field(None, description="friction, V")
    tau_percent: Number = Field(None, description="half width of the 95 % interval of tau, % of it")
    K_percent: Number = Field(None, description="half width of the 95 % interval of K, % of it")
    fc_percent: Number = Field(None, description="half width of the 95 % interval of f_c, % of it")
    residual_over_noise: Number = Field(None, description="RMS residual over the noise at rest")
    laws: Text = Field("", description="names of the laws that are fitted with them, with commas between")
    drives_differ: Flag = Field(False, description="whether clearly different drives were seen")


class StoppedResult(Part):
    """Why the tests of a run with `relay.until` ended, and how the estimate narrowed until then."""

    why: Text = Field("", description="in words")
    known: Flag = Field(False, description="whether they ended because the motor was known as well as asked for")
    t_s: Number = Field(None, description="when, s since the run's start")
    tests_s: Number = Field(None, description="since the first sample of the tests, s")
    cycles: Count = Field(0, description="swings to and fro in the tests")
    wanted_percent: Number = Field(None, description="half width of the 95 % intervals that was asked for, %")
    interval_percent: Number = Field(None, description="the largest of tau, K and f_c at the last live estimate, %")
    live: tuple[LiveResult, ...] = Field((), description="the live estimates, in their order")
