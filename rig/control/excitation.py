"""The relay experiment's laws: the search for both tests' gains, and the test at fixed gains (docs/theory.md 4.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from rig.control.guard import VelocityWindow
from rig.control.law import BareLaw
from rig.control.motion import CycleWatch
from rig.control.relay import DualChannelRelay, RelayOnCounts
from rig.control.unshown import UnshownMotion
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.cycle_detector import CycleDetector
from rig.model.describing_function import Oscillation, gains_for, linear_part


@dataclass(frozen=True)
class CycleTarget:
    """The wanted limit cycle: amplitude, rad; period, s; tolerance: the relative error that is good enough."""

    amplitude_rad: float
    period_s: float
    tolerance: float


@dataclass(frozen=True)
class SearchRange:
    """Range of the gain search: first gains and step, V; time per step, s; largest gains, V; time-out, s."""

    h1_start_V: float
    h2_start_V: float
    h2_step_V: float
    step_s: float
    h_max_V: float
    sum_max_V: float
    timeout_s: float


class SettledCycle(NamedTuple):
    """A settled limit cycle, and the gains that gave it."""

    h1_V: float
    h2_V: float
    period_s: float
    amplitude_rad: float


class SearchStep(NamedTuple):
    """One pair of gains that the search tried, and its outcome; period and amplitude are nan if no cycle settled."""

    t_s: float
    h1_V: float
    h2_V: float
    period_s: float
    amplitude_rad: float
    outcome: str


Relay = DualChannelRelay | RelayOnCounts
"""The relay, or as it runs in a device."""
R = TypeVar("R", bound=Relay)


class RelayLaw(BareLaw, Generic[R]):
    """A law that runs the shared relay and watches its cycle.

    ahead_s   how far ahead the relay takes the position, s: by the velocity, where drives act that much too late. Its
              integral then is ahead, too; the detector gets position and integral as they are
    """

    ahead_s = 0.0

    def __init__(self, relay: R, detector: CycleDetector) -> None:
        self.relay = relay
        self.detector = detector
        self.z_rad_s = 0.0
        self._start_s = math.nan
        self._velocity = VelocityWindow()

    def _run_relay(self, sample: Sample) -> tuple[float, bool]:
        """Returns the drive, V, and whether this sample completed a period."""
        if math.isnan(self._start_s):
            self._start_s = sample.t_s
        self.speed_rad_s = self._velocity.step(sample.t_s, sample.y_rad)
        u_V = self.relay.step(sample._replace(y_rad=sample.y_rad + self.ahead_s * self.speed_rad_s))
        self.z_rad_s = self.relay.z_rad_s
        cycle = self.detector.step(sample.t_s, sample.y_rad, self.z_rad_s - self.ahead_s * sample.y_rad)
        return u_V, cycle is not None


class GainSearch(RelayLaw[DualChannelRelay]):
    """Raise h2 until a cycle is accepted, then trim h1 and h2 to an amplitude and a period (docs/theory.md 4.2).

    After ``seek_second`` it goes on, run once more, to a cycle of another amplitude and the same period.

    relay, detector  shared with the relay tests that follow, so that the cycle goes on
    target           the wanted cycle
    search           where to start, and how far to go
    friction_V       first guess of f_c: the breakaway level, V
    reach_rad        largest |y| that the search may use: a little inside the soft limit
    top_speed_rad_s  largest speed that the search may use

    The trim inverts the describing function. With x = h2 - f_c:  w = h1/(tau x),  A = 4 K tau x^2/(pi h1). So a
    settled (A, w) at known gains gives tau and K for the assumed f_c, and then the wanted (A, w) gives x and h1.
    From two settled pairs, if they differ enough, the search also estimates f_c. The second cycle needs that: f_c is a
    large part of h2, so with the breakaway level in its place x would hardly change, and A could grow where h1 falls.
    No step changes x or h1 by more than a factor ``_STRIDE``. Where it gives up, as at the time-out, it raises Fault
    NO_CYCLE; of the second cycle it ends with ``no_second`` instead, and has the gains of the first again.

    no_second  why there is no second cycle; empty: it gave none up
    unshown  raises SENSOR_STUCK where the reading stands still under the drives; None: nothing does
    """

    _STRIDE = 1.5
    _PATIENCE_CYCLES = 12
    _HUNTS = 4  # periods in a row that are no cycle
    _OF_THE_GUESS = 0.85  # f_c, of a guess from strokes: these have to move the shaft visibly in their short time
    _CYCLES_OF_SECOND = 5  # from the larger cycle it shrinks by a few per cent a period, which counts as settled
    unshown: UnshownMotion | None = None
    first: SettledCycle | None = None  # once the second is searched
    no_second = ""

    def __init__(
        self,
        relay: DualChannelRelay,
        detector: CycleDetector,
        target: CycleTarget,
        search: SearchRange,
        friction_V: float,
        reach_rad: float,
        top_speed_rad_s: float = math.inf,
    ) -> None:
        super().__init__(relay, detector)
        self.top_speed_rad_s = top_speed_rad_s
        self.target = target
        self.search = search
        self.friction_V = self._guess_V = friction_V
        self.reach_rad = reach_rad
        self.steps: list[SearchStep] = []
        self._settled: list[tuple[float, float, float, float]] = []  # h1, h2, w, A
        self._before = 0  # steps of the first cycle's search, once the second is searched
        self._step_start_s = math.nan
        self._was_within = False
        self._y_range = (math.inf, -math.inf)  # since the last change of gains
        self._set_gains(search.h1_start_V, search.h2_start_V)

    def step(self, sample: Sample) -> float:
        """Drive of the relay at this sample, V; changes its gains between cycles."""
        u_V, completed = self._run_relay(sample)
        stood = "" if self.unshown is None else self.unshown.step(sample, u_V)
        if stood:
            raise Fault("SENSOR_STUCK", stood)
        if math.isnan(self._step_start_s):
            self._step_start_s = sample.t_s
        self._y_range = (min(self._y_range[0], sample.y_rad), max(self._y_range[1], sample.y_rad))
        if sample.t_s - self._start_s > self.search.timeout_s:
            self._give_up(self._story())
            return u_V
        # only when it leaves the reach: if it starts beyond, that is not due to the gains
        leaves, self._was_within = (
            self._was_within and abs(sample.y_rad) > self.reach_rad,
            (abs(sample.y_rad) <= self.reach_rad),
        )
        speed = abs(self.speed_rad_s)
        if leaves:
            self._retreat(sample.t_s, f"|y| above {self.reach_rad:.2f} rad")
        elif speed > self.top_speed_rad_s:
            self._retreat(sample.t_s, f"speed above {self.top_speed_rad_s:.1f} rad/s")
        elif completed and self.detector.settled and len(self.detector.cycles) >= self._cycles:
            self._trim(sample.t_s)
        elif self._step_is_over(sample.t_s):
            self._raise_h2(sample.t_s)
        return u_V

    def _step_is_over(self, t_s: float) -> bool:
        cycles = self.detector.cycles
        # give a cycle that grows or settles time; not one that hunts
        promising = sum(c.accepted for c in cycles)
        if self._hunts_unshown:
            return t_s - self._step_start_s > self.search.step_s
        if promising > 0 and len(cycles) < self._PATIENCE_CYCLES:
            last = cycles[-1]
            return t_s > last.start_s + 3.5 * last.period_s  # the shaft sticks meanwhile
        if self._sticks and self.first is None:
            wait_s = self.search.step_s  # there is nothing to wait for
        else:
            # a first whole period after a change of gains may take two
            period_s = max(self.target.period_s, *(2.0 * math.pi / s[2] for s in self._settled[-1:]), 0.0)
            wait_s = max(self.search.step_s, 2.5 * period_s)
        return t_s - self._step_start_s > wait_s

    @property
    def _cycles(self) -> int:
        """Periods at one pair of gains, at least, until it is judged by them."""
        return 3 if self.first is None else self._CYCLES_OF_SECOND

    @property
    def _hunts_unshown(self) -> bool:
        """Whether it hunts by so little that the wait would end in SENSOR_STUCK: h1 is above friction, h2 not yet."""
        last = self.detector.cycles[-self._HUNTS :]
        if self.first is not None or self.unshown is None or any(cycle.accepted for cycle in last):
            return False
        return self.unshown.standstill.still_s > self.search.step_s

    @property
    def _sticks(self) -> bool:
        """Whether the shaft has hardly moved since the last change of gains."""
        return self._y_range[1] - self._y_range[0] < self.detector.min_amplitude_rad

    def _raise_h2(self, t_s: float) -> None:
        self._note(t_s, math.nan, math.nan, self._last_reason())
        h1, h2 = self.relay.h1_V, self.relay.h2_V + self.search.h2_step_V
        if self.first is not None:  # half the way back to gains that are known to give a cycle
            h1, h2 = 0.5 * (h1 + self.first.h1_V), 0.5 * (self.relay.h2_V + self.first.h2_V)
        if h2 > self.search.h_max_V or h2 + h1 > self.search.sum_max_V:
            self._give_up(f"h2 reached {self.relay.h2_V:.2f} V; {self._story()}")
            return
        if self._sticks:
            self.relay.restart()  # the shaft sticks: the integral meanwhile means nothing
        self._set_gains(h1, h2)
        self._step_start_s = t_s

    def _give_up(self, story: str) -> None:
        """End without a cycle; without the second alone, the tests go on with the first's gains."""
        if self.first is None:
            raise Fault("NO_CYCLE", story)
        self.no_second, self.finished = story, True
        self.relay.restart()  # its integral is of a motion that was no cycle
        self._set_gains(self.first.h1_V, self.first.h2_V)

    def _retreat(self, t_s: float, why: str) -> None:
        """Reduce h2 at once: the cycle exceeds its room, or the largest speed of the bench."""
        excess = self.relay.h2_V - self.friction_V
        h2 = self.friction_V + 0.6 * excess if excess > 0.05 else self.relay.h2_V * 0.8
        if t_s - self._step_start_s < self.target.period_s:
            return  # the last change needs a period to take effect
        self._note(t_s, math.nan, math.nan, why)
        h1 = min(self.relay.h1_V * 1.2, self.search.h_max_V, self.search.sum_max_V - h2)
        self._set_gains(h1, h2)
        self._step_start_s = t_s

    def _trim(self, t_s: float) -> None:
        period, amplitude = self.detector.mean()
        h1, h2 = self.relay.h1_V, self.relay.h2_V
        self._note(t_s, period, amplitude, "settled")
        error = max(abs(amplitude / self.target.amplitude_rad - 1.0), abs(period / self.target.period_s - 1.0))
        if error <= self.target.tolerance:
            self.finished = True
            return
        self._settled.append((h1, h2, 2.0 * math.pi / period, amplitude))
        self._refine_friction()
        x = max(h2 - self.friction_V, 0.05)
        omega = 2.0 * math.pi / period
        motor = linear_part(Oscillation(omega, amplitude), h2 - x, h1, h2)
        wish = Oscillation(2.0 * math.pi / self.target.period_s, self.target.amplitude_rad)
        _, wished_h2 = gains_for(wish, motor.tau_s, motor.K_rad_s_V, h2 - x)
        wanted_x = _within(wished_h2 - (h2 - x), x, self._STRIDE)
        wanted_h1 = _within(wish.omega_rad_s * motor.tau_s * wanted_x, h1, self._STRIDE)
        wanted_h2 = self.friction_V + wanted_x
        self._set_gains(*self._drivable(wanted_h1, wanted_h2))
        self._step_start_s = t_s

    def _refine_friction(self) -> None:
        """f_c from two settled pairs: pi A w / 4 = K h2 - K f_c is a line in h2 (docs/theory.md 4.2).

        The second cycle has the first's shape, and there the line is exact: the first pair stands for one of the two,
        and the motion alone has to differ.
        """
        if len(self._settled) < 2:
            return
        (_, h2a, wa, Aa), (_, h2b, wb, Ab) = self._settled[0 if self.first is not None else -2], self._settled[-1]
        if self.first is None and abs(h2a - h2b) < 0.08 * max(h2a, h2b):
            return
        if h2a == h2b or abs(Aa * wa - Ab * wb) < 0.05 * Aa * wa:
            return
        slope = (Aa * wa - Ab * wb) / (h2a - h2b)
        if slope <= 0.0:
            return
        fc = h2b - Ab * wb / slope
        # the describing function is approximate: it may change the breakaway level by half at most
        self.friction_V = max(0.5 * self.friction_V, min(1.5 * self.friction_V, fc, h2b - 0.05))

    def _drivable(self, h1_V: float, h2_V: float) -> tuple[float, float]:
        """Both scaled down together where the search's drive is too small for them."""
        most_V, sum_V = self.search.h_max_V, self.search.sum_max_V
        scale = min(1.0, most_V / h1_V, most_V / h2_V, sum_V / (h1_V + h2_V))
        return h1_V * scale, h2_V * scale

    def _set_gains(self, h1_V: float, h2_V: float) -> None:
        self.relay.h1_V = h1_V
        self.relay.h2_V = h2_V
        self.detector.forget()
        self._y_range = (math.inf, -math.inf)

    def _note(self, t_s: float, period_s: float, amplitude_rad: float, outcome: str) -> None:
        self.steps.append(SearchStep(t_s, self.relay.h1_V, self.relay.h2_V, period_s, amplitude_rad, outcome))

    def _last_reason(self) -> str:
        cycles = self.detector.cycles
        if not cycles:
            return "no oscillation"
        return cycles[-1].reason or "not settled"

    def _story(self) -> str:
        tried = self.steps[self._before :]
        found = [s for s in tried if s.outcome == "settled"]
        which = "" if self.first is None else "of the second test "
        if not found:
            return f"{len(tried)} pairs of gains {which}tried, none gave a settled cycle; last: {self._last_reason()}"
        best = min(found, key=lambda s: abs(math.log(s.amplitude_rad / self.target.amplitude_rad)))
        return (
            f"nearest{which and ', of the second test'}: h1 {best.h1_V:.2f} V, h2 {best.h2_V:.2f} V gave "
            f"{best.amplitude_rad:.2f} rad, "
            f"{best.period_s:.2f} s; wanted {self.target.amplitude_rad:.2f} rad, {self.target.period_s:.2f} s"
        )

    def seek_second(self, ratio: float) -> None:
        """Go on from the cycle found to one of the same period whose amplitude is larger by the factor ``ratio``.

        It is nearer to that than to the first. Where there is no room for more, it is smaller by that factor instead.
        """
        period, amplitude = self.detector.mean()
        self.first = SettledCycle(self.relay.h1_V, self.relay.h2_V, period, amplitude)
        self._settled = [(self.first.h1_V, self.first.h2_V, 2.0 * math.pi / period, amplitude)]
        if self.friction_V == self._guess_V:
            self.friction_V *= self._OF_THE_GUESS
        ratio = self._with_room(ratio)
        tolerance = min(self.target.tolerance, max(0.5 * abs(1.0 - ratio), 0.05))
        self.target = CycleTarget(amplitude * ratio, period, tolerance)
        self._set_gains(*self._drivable(*self._scaled(self.first, ratio)))
        self.finished, self._before = False, len(self.steps)
        self._start_s = self._step_start_s = math.nan

    def further_gains(self, ratio: float) -> tuple[float, float]:
        """Gains (h1, h2), V, for the first cycle's period and ``ratio`` times its amplitude; as ``seek_second``.

        Raises ValueError before that.
        """
        if self.first is None:
            raise ValueError("the second cycle has not been searched")
        return self._drivable(*self._scaled(self.first, self._with_room(ratio)))

    def _scaled(self, first: SettledCycle, ratio: float) -> tuple[float, float]:
        """If h1 and x = h2 - f_c are both scaled, w = h1/(tau x) stays and A = 4 K tau x^2/(pi h1) is scaled, too."""
        x = max(first.h2_V - self.friction_V, 0.05)
        return first.h1_V * ratio, self.friction_V + x * ratio

    def _with_room(self, ratio: float) -> float:
        """The ratio, or if the larger amplitude would exceed the reach or the drive, its inverse."""
        if self.first is None or ratio <= 1.0:
            return ratio
        h1, h2 = self._scaled(self.first, ratio)
        too_much = max(h1, h2) > self.search.h_max_V or h1 + h2 > self.search.sum_max_V
        return 1.0 / ratio if too_much or 1.1 * self.first.amplitude_rad * ratio > self.reach_rad else ratio


class RelayTest(RelayLaw[Relay]):
    """Run the relay at fixed gains until ``cycles`` settled periods have passed.

    Once finished, settled_start_s and settled_end_s are the times between which they lie. Raises Fault NO_CYCLE if
    ``timeout_s`` passes first; SENSOR_STUCK if the reading stands still for longer than a cycle can (``CycleWatch``).

    unshown  raises SENSOR_STUCK where the reading stands still before the first period is over; None: nothing does
    """

    unshown: UnshownMotion | None = None

    def __init__(
        self, relay: Relay, detector: CycleDetector, gains_V: tuple[float, float], cycles: int, timeout_s: float
    ) -> None:
        super().__init__(relay, detector)
        self.cycles = cycles
        self.timeout_s = timeout_s
        self.settled_start_s = math.nan
        self.settled_end_s = math.nan
        self.watch = CycleWatch(detector.min_amplitude_rad)
        relay.h1_V, relay.h2_V = gains_V
        detector.forget()

    def step(self, sample: Sample) -> float:
        """Drive of the relay at this sample, V."""
        u_V, completed = self._run_relay(sample)
        self.watch.step(sample, u_V)
        if self.unshown is not None and not self.detector.cycles:
            stood = self.unshown.step(sample, u_V)
            if stood:
                raise Fault("SENSOR_STUCK", stood)
        if sample.t_s - self._start_s > self.timeout_s:
            seen = self.detector.cycles
            last = f"; last: {seen[-1].reason}" if seen and seen[-1].reason else ""
            if self.detector.left_out:
                last += (
                    f"; {self.detector.left_out} more had a gap in the readings: see that the machine is not so busy"
                )
            raise Fault(
                "NO_CYCLE",
                f"{len(seen)} periods in {self.timeout_s:.0f} s at h1 {self.relay.h1_V:.2f} V, "
                f"h2 {self.relay.h2_V:.2f} V, not settled{last}",
            )
        if completed:
            self.watch.end_period(self.detector.cycles[-1])
            if not self.detector.settled:
                self.settled_start_s = math.nan
            elif math.isnan(self.settled_start_s):
                self.settled_start_s = self.detector.cycles[-3].start_s
            if not math.isnan(self.settled_start_s):
                settled = [c for c in self.detector.cycles if c.start_s >= self.settled_start_s]
                if len(settled) >= self.cycles:
                    self.settled_end_s = settled[-1].start_s + settled[-1].period_s
                    self.finished = True
        return u_V


def _within(value: float, around: float, factor: float) -> float:
    return max(around / factor, min(around * factor, value))
