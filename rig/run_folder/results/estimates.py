"""Results of an identification: relay tests, estimates, static friction, the laws of the motor."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from rig.run_folder.results.part import NOT_IN_EACH_FILE, Count, Flag, Number, Part, Real, Text, key

Interval = tuple[Number, Number]
Rows = tuple[Count, Count]
Matrix = tuple[tuple[Number, ...], ...]
_IfIdentified = NOT_IN_EACH_FILE


class RelayTestResult(Part):
    """A relay test that was used: its gains and its settled limit cycle."""

    stage: Text = Field(description="stage of the run; of a CSV file: the file's name")
    h1_V: Real = Field(description="gain of the relay on position, V")
    h2_V: Real = Field(description="gain of the relay on the integral, V")
    period_s: Real = Field(description="period of the settled cycle, s")
    amplitude_rad: Real = Field(description="amplitude of the settled cycle, rad")
    cycles: Count = Field(description="settled cycles that were averaged")


class HystereticResult(Part):
    """A run of a hysteretic relay from rest, up to its first switching."""

    stage: Text = Field(description="stage of the run; of a CSV file: the file's name")
    d_V: Real = Field(description="drive, V")
    start_rad: Number = Field(description="position at the start, rad")
    switched_s: Number = key("first switching after the drive took effect, s; null: none")
    switched_rad: Number = key("position at the first switching, rad; null: none")
    rows: Rows | None = key("first and last row, counted from 0")
    eps_rad: Annotated[Number, NOT_IN_EACH_FILE] = key("hysteresis by the config, rad")


class ResidualResult(Part):
    """The residual: recorded minus modelled position."""

    repeated: Number = key("share of its power that repeats in each cycle, 0 to 1")
    wander_memory_s: Number = key("memory of its coloured noise, s; null: it is white")
    wander_over_white: Number = key("standard deviation of its coloured noise over that of its white noise")


class EstimateResult(Part):
    """One estimator's result. A parameter is null if the method does not estimate it."""

    tau_s: Number = key("velocity time constant, s")
    K_rad_s_V: Number = key("velocity gain of the measured shaft, (rad/s)/V")
    fc_V: Number = key("Coulomb friction, V")
    asym_V: Number = key("asymmetry of the effective drive, V")
    delay_s: Number = key("from a sample to the effect of its drive, s")
    fc_plus_V: Number = key("Coulomb friction towards rising positions, V")
    fc_minus_V: Number = key("Coulomb friction towards falling positions, V")
    bias_V: Number = key("drive that acts in addition to the commanded one, V")
    ci95: dict[str, Interval] | None = key("95 % intervals by parameter: low, high")
    covariance_of: tuple[Text, ...] = key("parameters in the order of the matrices", ())
    covariance: Matrix | None = key("covariance of the parameters")
    correlation: Matrix | None = key("correlation of the parameters")
    rms_rad: Number = key("RMS of the residual of the position, rad")
    residual: ResidualResult | None = key("properties of the residual")
    iterations: Count | None = key("iterations from the start that fitted best")
    verdict: Text = key("ok, doubtful or refused", "not judged")
    reasons: tuple[Text, ...] = key("what is wrong, and what to record instead", ())
    rows: Rows | None = key("first and last row used; null: the model comes from another run")

    def value(self, name: str) -> float | None:
        """One parameter by its name; None if it is not known."""
        found = getattr(self, name) if name in type(self).model_fields else None
        return found if isinstance(found, float) else None

    def interval(self, name: str) -> tuple[float, float] | None:
        """The 95 % interval of one parameter; None if it has none."""
        return whole((self.ci95 or {}).get(name))

    def at_95(self, name: str) -> tuple[float, float] | None:
        """The interval of one parameter that people are told, at 95 %; None if it has none."""
        return self.interval(name)

    def correlation_of(self, one: str, other: str) -> float | None:
        """The correlation of two parameters, -1 to 1; None if it is not known."""
        names = self.covariance_of
        try:
            found = (self.correlation or ())[names.index(one)][names.index(other)]
        except (ValueError, IndexError):
            return None
        return None if found is None or math.isnan(found) else min(max(found, -1.0), 1.0)

    @property
    def is_refused(self) -> bool:
        """Whether its numbers must not be used."""
        return self.verdict == "refused"


class StaticFrictionResult(Part):
    """The drives at which the shaft breaks away, from the breakaway strokes and the identified motor."""

    static_plus_V: Number = key("towards rising positions, V; null: the recording does not show it")
    static_minus_V: Number = key("towards falling positions, V; null: the recording does not show it")
    static_plus_range_V: Interval | None = key("its interval, V")
    static_minus_range_V: Interval | None = key("its interval, V")
    reason: Text = key("why something is null, or what was assumed", "")


class BreakawayResult(Part):
    """What the breakaway check saw, and the static friction identified from it."""

    seen_plus_V: Annotated[Number, NOT_IN_EACH_FILE] = key("drive at the first motion, rising, V")
    seen_minus_V: Annotated[Number, NOT_IN_EACH_FILE] = key("drive at the first motion, falling, V")
    noise_rad: Annotated[Number, NOT_IN_EACH_FILE] = key("noise of the sensor at rest, rad")
    static_plus_V: Annotated[Number, _IfIdentified] = key("static friction, rising, V")
    static_minus_V: Annotated[Number, _IfIdentified] = key("static friction, falling, V")
    static_plus_range_V: Annotated[Interval | None, _IfIdentified] = key("its interval, V")
    static_minus_range_V: Annotated[Interval | None, _IfIdentified] = key("its interval, V")
    reason: Annotated[Text, _IfIdentified] = key("why something is null, or what was assumed", "")


class FoundLawResult(Part):
    """A law that the tests show beyond tau, K and Coulomb friction."""

    name: Text = Field(description="dead_band, gain_by_sign, sag, lag, ... (docs/theory.md 12.1)")
    value: Number = key("its size: its number, or the root sum of squares of its numbers")
    unit: Text = key("of the value; 1: none", "")
    ci95: Interval | None = key("its 95 % interval: low, high")
    bic: Number = key("by how much BIC would rise without it")
    numbers: dict[str, Number] = key("all its numbers, with the unit in the name", {})


class LawFrameResult(Part):
    """What the laws refer to."""

    centre_rad: Number = key("middle of the driven travel, rad")
    half_travel_rad: Number = key("half its width, rad")
    start_s: Number = key("half of duration_s before the mean time of all fitted records, s since the run's start")
    duration_s: Number = key("from their start to their end, s")


class BudgetEntry(Part):
    """One line of the uncertainty budget: half widths at 95 %."""

    source: Text = Field(
        description="`scatter`: of the fit; `supply`, `calibration`, `clock`; else a law that the tests neither show "
        "nor exclude"
    )
    tau_s: Number = key("what it adds to the uncertainty of tau, s")
    K_rad_s_V: Number = key("of K, (rad/s)/V")
    fc_V: Number = key("of the friction, V")
    absolute: Annotated[Flag, NOT_IN_EACH_FILE] = key("whether it counts in u95_absolute alone", False)


class PieceResult(Part):
    """The residual of one length of pieces."""

    length_s: Number = key("length of the longest piece, s; each piece has a start of its own")
    rms_rad: Number = key("RMS of the residual, rad: it grows with the length if the motor is random")


class FittedRecord(Part):
    """A record that the law of the motor was fitted to."""

    name: Text = Field(description="its stage; of a CSV file: the file's name")
    rows: Rows | None = key("first and last row, counted from 0")
    duration_s: Number = key("how long it is, s")


class MapSpeedResult(Part):
    """A sweep of the survey: the drive that its speed took."""

    speed_rad_s: Number = key("mean speed, rad/s; negative towards falling positions")
    drive_V: Number = key("mean drive, less what acceleration took, V")
    error_V: Number = key("its standard error, V")
    sticks: Flag = key("whether the shaft stuck and slipped: then this is no steady speed", False)
    share: Number = key("its share in the means over the speeds; 0: it stuck")
    law_V: Number = key("the drive that the identified motor takes there, V")


class MapPositionResult(Part):
    """A position of the survey: the drive there less v/K and what acceleration took, mean over the speeds."""

    y_rad: Number = key("position, rad")
    plus_V: Number = key("drive towards rising positions, V")
    minus_V: Number = key("drive towards falling positions, V")
    plus_error_V: Number = key("standard error of plus_V, V")
    minus_error_V: Number = key("standard error of minus_V, V")
    force_V: Number = key("half their sum: force over position, less the bias, V")
    friction_V: Number = key("half their difference: friction over position, V")
    error_V: Number = key("standard error of force_V and of friction_V, V")
    law_plus_V: Number = key("plus_V by the identified motor, V")
    law_minus_V: Number = key("minus_V by the identified motor, V")


class FrictionMapResult(Part):
    """The friction map: the drive over speed and over position, from the sweeps of a survey."""

    tau_s: Number = key("time constant by which acceleration was corrected, s")
    K_rad_s_V: Number = key("gain by which speed and acceleration were corrected, (rad/s)/V")
    laws: tuple[Text, ...] = key("laws of the motor beside the map; empty: the plain motor", ())
    travel_rad: Interval | None = key("the positions that every sweep passed steadily, rad")
    speeds: tuple[MapSpeedResult, ...] = key("the sweeps, by speed", ())
    positions: tuple[MapPositionResult, ...] = key("by position; empty: no sweep was steady", ())


def whole(interval: Interval | None) -> tuple[float, float] | None:
    """An interval with both its ends; None without one of them."""
    low, high = map(known, interval or (None, None))
    return (low, high) if math.isfinite(low) and math.isfinite(high) else None


def known(value: float | None) -> float:
    """A number of a result; nan if ``value`` is None, or too large to be a measurement; in the unit of ``value``."""
    return math.nan if value is None or not abs(value) < LARGEST else value


LARGEST = 1e100  # no axis is drawn to numbers whose square overflows
