"""One run in a list of runs: the JSON of `rig list`, and a line of its index."""

from __future__ import annotations

from pydantic import Field

from rig.run_folder.results.part import Flag, Number, Part, Sometimes, Text


class ListedRun(Part):
    """A run in one line. A number is null if the run does not know it."""

    name: Text = Field(description="the run's folder")
    started_utc: Text | None = Field(None, description="when it started: ISO 8601, UTC")
    command: Text | None = Field(None, description="what ran: run, relay, survey, track, jog, law, breakaway")
    config: Text | None = Field(None, description="the config's name")
    backend: Text | None = Field(None, description="the bench in words")
    emulated: Flag = Field(False, description="whether nothing real moved")
    rehearsal: Sometimes[Flag] = Field(None, description="true: `rig rehearse` ran it; nothing was measured")
    state: Text = Field(description="done, fault, no result (it was killed, or runs still) or damaged")
    fault: Text | None = Field(None, description="code of the fault that ended it")
    problem: Text | None = Field(None, description="what is wrong with its files")
    method: Text | None = Field(None, description="method of the answer")
    verdict: Text | None = Field(None, description="of the answer: ok, doubtful or refused")
    tau_s: Number = Field(None, description="time constant, s")
    K_rad_s_V: Number = Field(None, description="gain, (rad/s)/V")
    fc_V: Number = Field(None, description="friction, V")
    tau_percent: Number = Field(None, description="half width of its 95 % interval, %")
    K_percent: Number = Field(None, description="half width of its 95 % interval, %")
    fc_percent: Number = Field(None, description="half width of its 95 % interval, %")
    laws: Text = Field("", description="laws that it shows, with commas between")
    tracking_rms_rad: Number = Field(None, description="RMS error of tracking with the leading model, rad")
    duration_s: Number = Field(None, description="how long its loop ran, s")
