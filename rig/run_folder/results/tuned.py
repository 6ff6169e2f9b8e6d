"""What `rig tune` says: a loop, its margins, and what it will do; beside it what a bench did."""

from __future__ import annotations

import math
from typing import Any

from pydantic import Field

from rig.run_folder.results.estimates import known
from rig.run_folder.results.part import Count, Flag, Number, Part, Real, Sometimes, Text, key


class TunedPid(Part):
    """The feedback in the words of a PID controller."""

    Kp: Real = Field(description="gain of the error")
    Ki: Real = Field(description="gain of its integral")
    Kd: Real = Field(description="gain of its rate; of a velocity loop 0")
    units: tuple[Text, ...] = Field(description="of Kp, Ki and Kd")


class TunedFeedForward(Part):
    """The plain part of the feed-forward; the law has the motor's other laws, too."""

    kS_V: Real = Field(description="friction and dead band, V")
    kV_V_s_rad: Real = Field(description="drive for each rad/s, V s/rad")
    kA_V_s2_rad: Real = Field(description="drive for each rad/s^2, V s^2/rad")


class TunedMargins(Part):
    """Margins of the loop that is broken at the motor's input."""

    phase_deg: Real = Field(description="phase margin, degrees")
    gain_dB: Number = key("gain margin, for more gain and for less, dB; null: there is none")
    modulus: Real = Field(description="least distance of the loop's response from -1")


class TunedMeasure(Part):
    """A measure of the trial: what is predicted, and what a bench did. null: the step did not come there."""

    meaning: Text = Field(description="in words")
    unit: Text = Field(description="of all numbers")
    median: Number = key("over the drawn motors")
    interval95: tuple[Number, Number] = Field(description="that holds a next motor's value in 95 %")
    bench: Sometimes[Number] = key("of the bench")
    inside: Sometimes[Flag] = key("whether the interval holds the bench's value")

    def words(self) -> tuple[str, str, str]:
        """Median, interval and the bench's value; never: the step did not come there."""
        numbers = map(known, (self.median, *self.interval95, self.bench))
        median, low, high, bench = (f"{one:.3g}" if math.isfinite(one) else "never" for one in numbers)
        return median, f"{low} to {high}", bench


class TunedCurve(Part):
    """A quantity over time, of the drawn motors and of the bench."""

    unit: Text = Field(description="of the quantity")
    t_s: tuple[Real, ...] = Field(description="times, s from the step, or from the trajectory")
    low: tuple[Real, ...] = Field(description="2.5 % of the drawn motors are below")
    median: tuple[Real, ...] = Field(description="median of the drawn motors")
    high: tuple[Real, ...] = Field(description="2.5 % are above")
    reference: Sometimes[tuple[Real, ...]] = key("the set-point")
    bench_t_s: Sometimes[tuple[Real, ...]] = key("times of the bench, s")
    bench: Sometimes[tuple[Real, ...]] = key("the bench's values")


class TunedResponse(Part):
    """The open loop's response from a tenth of the bandwidth on."""

    real: tuple[Real, ...] = Field(description="real parts")
    imaginary: tuple[Real, ...] = Field(description="imaginary parts")


class TunedResult(Part):
    """A loop for the motor of a run, by `rig tune`, and what it did on this bench."""

    run: Text = Field(description="run folder that the motor comes from")
    loop: Text = Field(description="position or velocity")
    bandwidth_rad_s: Real = Field(description="where the response to the set-point is 3 dB down, rad/s")
    largest_bandwidth_rad_s: Real = Field(description="the largest that was possible, rad/s")
    bounded_by: Text = Field(description="what forbids more")
    step: Real = Field(description="the step, rad; of a velocity loop rad/s")
    pid: TunedPid = Field(description="the feedback, of the observed state")
    feedforward: TunedFeedForward = Field(description="the feed-forward")
    margins: dict[str, TunedMargins] = Field(description="nominal: of the identified motor; worst: of its intervals")
    drive_noise_V: Real = Field(description="standard deviation of the drive by the sensor's noise, V")
    draws: Count = Field(description="motors drawn from the intervals")
    prediction: dict[str, TunedMeasure] = Field(description="measures of the trial by name")
    curves: dict[str, TunedCurve] = Field(description="step, drive (during the step) and tracking (error)")
    responses: tuple[TunedResponse, ...] = Field(description="of the identified motor, then of each corner")
    law: dict[str, Any] = Field(description="name and options, for the section `law` of a config")
    beyond: Sometimes[Text] = key("where the trial goes beyond what the motor was measured over")
