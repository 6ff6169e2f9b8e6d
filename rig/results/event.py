"""events.jsonl: one event per line, each with the keys of its kind."""

from __future__ import annotations

from pydantic import Field

from rig.results.part import JsonObject, Number, Part, Real, Text
from rig.signals import BenchDelay


class RunEvent(Part):
    """An event: its time, its kind, and in ``detail`` the keys of that kind."""

    t_s: Number = Field(None, description="when, s since the run's start")
    kind: Text = Field("", description="stage, gains, cycle, search, model, fault, stop, end, ...")

    @property
    def detail(self) -> JsonObject:
        """The keys of this kind."""
        return dict(self.model_extra or {})


class MeasuredDelay(Part):
    """The keys of an event ``delay``: how late the bench acts, by the strokes of the breakaway check."""

    reported_s: Real
    low_s: Number = None
    further_s: Number = None
    high_s: Number = None

    @property
    def delay(self) -> BenchDelay:
        """As the loop and the guard take it."""
        if self.low_s is None or self.further_s is None or self.high_s is None:
            return BenchDelay(self.reported_s)
        return BenchDelay(self.reported_s, (self.low_s, self.further_s, self.high_s))


class DrivenModel(Part):
    """The keys of an event ``model``: a model that tracked."""

    method: Text
    tau_s: Real
    K_rad_s_V: Real
    fc_V: Real
    bias_V: Real
    further_delay_s: Real = 0.0
