"""events.jsonl: one event per line, each with the keys of its kind; and why the tests of `relay.until` ended."""

from __future__ import annotations

from pydantic import Field

from rig.core.signals import BenchDelay
from rig.run_folder.results.part import Count, Flag, JsonObject, Number, Part, Real, Sometimes, Text, key


class RunEvent(Part):
    """An event: its time, its kind, and in ``detail`` the keys of that kind."""

    t_s: Number = key("when, s since the run's start")
    kind: Text = key("stage, gains, cycle, search, model, fault, stop, end, ...", "")

    @property
    def detail(self) -> JsonObject:
        """The keys of this kind."""
        return dict(self.model_extra or {})


class DrivenSurvey(Part):
    """The keys of an event ``survey``: the crude motor, and the plan. Each speed is an event ``sweep``."""

    tau_s: Real
    K_rad_s_V: Real
    plus_V: Real
    minus_V: Real
    low_rad: Real
    high_rad: Real
    bandwidth_1_s: Real
    latency_s: Real
    lost_rad: Real


class DrivenSweep(Part):
    """The keys of an event ``sweep``: the speed of a sweep to and fro."""

    speed_rad_s: Real


class FurtherTest(Part):
    """The keys of an event ``further_test``: gains of a relay test that a thorough run added."""

    h1_V: Real
    h2_V: Real


class Decided(Part):
    """The keys of an event ``decided``: what the tests of `relay.until` go over to after a row, and who said so."""

    row: Count
    by: Text = Field(
        description="advice: by the live estimate; loop: by the guard or a bound, which a replay finds anew"
    )
    what: Text = Field(description="relay, strokes, rest or stop")
    why: Text = ""
    h1_V: Number = None
    h2_V: Number = None
    longest_stroke_s: Number = None
    rest_s: Number = None


class JoggedLease(Part):
    """The keys of an event ``lease``: the drive of a jog by leases from this row on, V; None: it ended there."""

    row: Count
    u_V: Number


class DrivenStroke(Part):
    """The keys of an event ``stroke``: one stroke of the stroke test that is decided next."""

    u_V: Real
    turn_rad: Real


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


class KnownModel(Part):
    """The keys of an event ``known``: the model of an earlier run, with which the tests of `relay.until` began."""

    tau_s: Real
    K_rad_s_V: Real
    fc_V: Real
    bias_V: Real
    half_travel_rad: Sometimes[Real] = key("half the travel that its laws refer to; without it the motor is plain")

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers by name, those of its laws with them. Raises ValueError if one of these is no number."""
        found: dict[str, float] = {}
        for name, value in (self.__dict__ | (self.model_extra or {})).items():
            if name in ("method", "t_s", "kind", "further_delay_s") or value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError(f"{name} is {value!r}, which is no number")
            found[name] = float(value)
        return found


class DrivenModel(KnownModel):
    """The keys of an event ``model``: a model that tracked."""

    method: Text
    further_delay_s: Real = 0.0


class LiveResult(Part):
    """An estimate while the tests ran: an event ``live``, and an entry of `stopped.live`."""

    row: Count = key("the last row that it counts, from 0", 0)
    of_s: Number = key("when that was sampled, s since the run's start")
    tau_s: Number = key("time constant, s")
    K_rad_s_V: Number = key("gain, (rad/s)/V")
    fc_V: Number = key("friction, V")
    tau_percent: Number = key("half width of the 95 % interval of tau, % of it")
    K_percent: Number = key("half width of the 95 % interval of K, % of it")
    fc_percent: Number = key("half width of the 95 % interval of f_c, % of it")
    residual_over_noise: Number = key("RMS residual over the noise at rest")
    laws: Text = key("names of the laws that are fitted with them, with commas between", "")
    drives_differ: Flag = key("whether clearly different drives were seen", False)


class StoppedResult(Part):
    """Why the tests of a run with `relay.until` ended, and how the estimate narrowed until then."""

    why: Text = key("in words", "")
    known: Flag = key("whether they ended because the motor was known as well as asked for", False)
    t_s: Number = key("when, s since the run's start")
    tests_s: Number = key("since the first sample of the tests, s")
    cycles: Count = key("swings to and fro in the tests", 0)
    wanted_percent: Number = key("half width of the 95 % intervals that was asked for, %")
    interval_percent: Number = key("the largest of tau, K and f_c at the last live estimate, %")
    live: tuple[LiveResult, ...] = key("the live estimates, in their order", ())
