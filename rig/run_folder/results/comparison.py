"""What `rig compare` says: the JSON of the command."""

from __future__ import annotations

from pydantic import Field

from rig.run_folder.results.estimates import FoundLawResult, Interval, known
from rig.run_folder.results.part import Count, Flag, Number, Part, Real, Text, key


class ComparedRunResult(Part):
    """One run, and how far it is off the others: off their weighted mean; of two runs, off the other."""

    name: Text = Field(description="the run in messages and pictures")
    folder: Text = Field(description="its folder")
    started_utc: Text | None = key("when it started: ISO 8601, UTC")
    temperature_C: Number = key("given by `--temperature`")
    bench: Count = Field(description="runs with one number are of one bench: what is common to them cancels")
    verdict: Text = Field(description="of its answer")
    tau_s: Real = Field(description="time constant, s")
    K_rad_s_V: Real = Field(description="gain, (rad/s)/V")
    fc_V: Real = Field(description="friction, V")
    ci95: dict[str, Interval] = Field(description="their 95 % intervals by Type A alone: low, high")
    laws: tuple[FoundLawResult, ...] = key("laws of the motor that it shows", ())
    off_percent: dict[str, Real] = Field(description="how far each parameter is off the others, % of their mean")
    off_ci95_percent: dict[str, Interval] = Field(
        description="its 95 % interval by Type A, and by what the runs do not share"
    )
    chance: Real = Field(description="of being off so much by Type A alone, for one of the same motor; for all three")
    beyond_ci95_percent: dict[str, Interval] = Field(
        description="the 95 % interval of `off_percent` that counts the scatter from run to run, too"
    )
    beyond_chance: dict[str, Real] = Field(description="of being off so much, counting that scatter")


class LeftOutResult(Part):
    """A folder that was not compared."""

    folder: Text = Field(description="the folder")
    reason: Text = Field(description="why")


class Difference(Part):
    """An answer to: is it one motor?"""

    differs: Flag = Field(description="yes or no")
    chance: Real = Field(description="of so large a difference, or a larger one, if it is one motor")
    odd: tuple[Text, ...] | None = Field(
        description="the runs without which the others agree; null: of two runs, and of more where no majority agrees"
    )
    words: Text = Field(description="the answer as a sentence")


class ScatterResult(Part):
    """The scatter from run to run of one motor, as a standard deviation."""

    source: Text = Field(description="`runs`: from the other runs; `stated`: by --scatter; `default`")
    percent: dict[str, Real] = Field(description="by parameter, % of the value; of `runs`: from all of them")
    why: Text = Field(description="where the numbers come from")


class TrendResult(Part):
    """How one parameter changes over time or temperature."""

    over: Text = Field(description="`time` or `temperature`")
    parameter: Text = Field(description="tau_s, K_rad_s_V or fc_V")
    unit: Text = Field(description="of the slope: % for an hour, or % for a kelvin")
    slope: Real = Field(description="slope, in that unit")
    ci95: Interval = Field(description="its 95 % interval")
    chance: Real = Field(description="of so steep a slope if there is none")
    shows: Flag = Field(description="whether there is a trend, at 5 % for the three parameters together")

    @property
    def is_known(self) -> bool:
        """Whether its interval is at most 100 of its unit to each side."""
        low, high = (known(end) for end in self.ci95)
        return high - low <= 200.0


class ComparisonResult(Part):
    """The JSON of `rig compare`."""

    runs: tuple[ComparedRunResult, ...] = Field(description="the runs, by their start")
    left_out: tuple[LeftOutResult, ...] = key("folders that could not be compared, and why", ())
    level: Real = Field(description="probability of a false alarm of each answer")
    measurably: Difference = Field(description="whether they differ by more than the noise explains (Type A)")
    beyond_scatter: Difference = Field(description="whether they differ by more than one motor does from run to run")
    scatter: ScatterResult
    trends: tuple[TrendResult, ...] = key("empty with fewer than three runs", ())
    notes: tuple[Text, ...] = key("what else there is to know, in words", ())
