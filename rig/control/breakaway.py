"""The breakaway check: strokes to and fro, slowly stronger, prove sensor, drive and sign before any relay runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import fmean, median
from typing import Literal, NamedTuple

from rig.control.law import BareLaw
from rig.core.faults import Fault
from rig.core.signals import Sample

_QUEUED = 1.5  # periods; a device that acts later keeps drives waiting, and its reports may leave one out
_SEEN_PERIODS = 4  # that a stroke and the report of its end have, at least, before the next one
_LONGEST_WAIT_S = 0.3  # for the report of the first stroke, before it counts as lost
_LEAST_SPARE_S = 0.002  # by which a device's own end of a stroke comes after the check's
_FEWEST_AT_REST = 8  # readings of a rest, and of a pause after the shaft has stopped: a gap may have taken the others
_FEWEST_STILL = 3
_ROUNDING = 1e-9
SURELY = 0.5  # of motion_rad: displacements to which noise adds up once in e^6 strokes
_LEFT_OVER = 0.55  # periods; a stroke lasts whole periods, so one that takes back another is off by up to half of one
_MOST_SHORT = 8  # strokes of one check: more is no single stall, and what repeats them drifts


@dataclass(frozen=True)
class BreakawayFound:
    """What a breakaway check has found.

    plus_V, minus_V  breakaway levels towards rising and falling positions, V (> 0)
    noise_rad        the sensor's standard deviation at rest
    """

    plus_V: float
    minus_V: float
    noise_rad: float


def turns(y_rad: list[float], least_rad: float, noise_rad: float) -> bool:
    """Whether readings at 0 V drift by more than ``least_rad``, and more than their noise explains."""
    half = len(y_rad) // 2
    drift = abs(fmean(y_rad[half:]) - fmean(y_rad[:half]))
    return drift > max(least_rad, 4.0 * noise_rad * math.sqrt(2.0 / half))


class _Stroke(NamedTuple):
    """A stroke that a pair still needs: its direction, +1 or -1; its length, s; whether it takes back another."""

    way: int
    length_s: float
    takes_back: bool


class StrokePlan(NamedTuple):
    """The strokes of a breakaway check.

    strokes_s   lengths, whole periods: that of each pair, the weakest first; further pairs have the last one's
    pause_s     after each, whole periods, at least four; it lasts longer if the shaft still coasts
    top_pause_s the same, of a pair that repeats the largest level
    step_V      by how much the level rises from pair to pair
    watchdog_s  watchdog time of the device in the check; where the device has none, or one that arming does not set,
                the longest delay of a tick that the bound allows. All strokes together may last so much longer than
                planned; less than half a period does not count
    unseen_rad  farthest that the shaft turns in the check if the sensor shows nothing
    further     pairs at the largest level that may follow a motion that was seen: the bound holds for them alone
    in_all      further pairs at most, however often a motion is seen between them
    """

    strokes_s: tuple[float, ...]
    pause_s: float
    top_pause_s: float
    step_V: float
    watchdog_s: float
    unseen_rad: float
    further: int = 0
    in_all: int = 0

    @property
    def pairs(self) -> int:
        """Number of planned pairs: those until the largest level, and those that repeat it."""
        return len(self.strokes_s)

    def levels(self, max_V: float) -> int:
        """Number of different levels up to ``max_V``: the planned pairs without those that repeat the last one."""
        return max(math.ceil(max_V / self.step_V - _ROUNDING), 1)

    def longest_s(self, max_V: float) -> float:
        """How long all pairs take at most, s."""
        first_at_top = self.levels(max_V)
        strokes_s = (*self.strokes_s, *self.strokes_s[-1:] * self.in_all)
        pauses_s = (self.pause_s if k < first_at_top else self.top_pause_s for k in range(len(strokes_s)))
        return 2.0 * (sum(strokes_s) + sum(pauses_s))


class BreakawayCheck(BareLaw):
    """Strokes to and fro, each pair stronger than the last, until the shaft has moved in both directions.

    With a stuck or uncoupled sensor the shaft turns unseen. So an equal stroke in the other direction takes each stroke
    back, and every other pair begins in the other direction. The shaft then moves only as far as friction differs
    between the directions. Strokes go on in both directions until both were seen, so that this holds whenever the
    sensor fails. ``rig.running.preflight.breakaway_strokes`` bounds that travel and chooses the strokes (docs/theory.md
    10.1).

    A late tick makes its stroke longer, by a period at most where the device ends it itself (``pulse_s``), or shorter
    where it begins late. The stroke back lasts as long as that stroke really acted. If the stroke back itself is off,
    one more stroke in each direction makes them equal again. All strokes together may be longer than planned by
    ``plan.watchdog_s``. One that came short turns the shaft no farther than planned; more than a few end the check. A
    gap of the readings makes a pause longer.

    A drive rises within its stroke. Its first ticks may be less than half a step of the device, which then drives 0 V:
    by the device's reports the stroke begins after them. They belong to it all the same.

    The strokes of a slow shaft each move it little. Once both directions together have moved it by ``motion_rad``, the
    sensor shows its motion. After the planned pairs the check then goes on at ``max_V``: by no more than
    ``plan.further`` pairs since such a motion was last seen, where planned pairs count by the lengths of their strokes,
    and by ``plan.in_all`` pairs at most.

    max_V       largest level; Fault NO_MOTION if the pairs up to it have not moved the shaft in both directions
    motion_rad  displacement that counts as motion, added up over the strokes in one direction
    rest_s      rest before and after; the first rest measures the sensor's noise
    plan        the strokes; each rises from the last pair's level to its own
    period_s    period of the loop
    quantised   what the device drives for a drive, V; float: it has no steps

    A device may keep a drive waiting. ``reported_delay_s`` is the time from the sample on which a stroke was decided to
    its begin, by the device's reports; each pause lasts until the device has reported the end of its stroke.

    Results, once finished: ``plus_V`` and ``minus_V`` (> 0), each halfway between the last level without visible motion
    and the next level; ``noise_rad``, the sensor's standard deviation at rest; ``reported_delay_s``. Both levels may
    lie above static friction, since the level rises until the motion exceeds the noise; identification corrects that.
    They may lie below it, too, where noise looks like a first motion. ``surely_V`` is at least the larger of both, and
    so high that noise alone hardly explains the motion below it: what a guard may expect to move the shaft.

    Raises Fault: DRIVE_STUCK_ON (moves at 0 V), SENSOR_NOISY, NO_MOTION, POLARITY (moves against the drive), LOAD_TURNS
    (moves the same way under strokes to either side), LATE (too long), LINK_TIMEOUT (too many came short).
    """

    def __init__(
        self,
        max_V: float,
        motion_rad: float,
        rest_s: float,
        plan: StrokePlan,
        period_s: float,
        quantised: Callable[[float], float] = float,
    ) -> None:
        self.motion_rad = motion_rad
        self.rest_s = rest_s
        self.plus_V = self.minus_V = self.noise_rad = math.nan
        self.reported_delay_s = 0.0
        self.longest_same_s = 0.0
        self._same: tuple[int, float] | None = None  # the last reading, counts, and since when it is the same
        self._rest_y: list[float] = []
        self.max_V = max_V
        self._plan = plan
        self._period_s = period_s
        self._quantised = quantised
        self._phase: Literal["first rest", "stroke", "pause", "last rest"] = "first rest"
        self._since_s = math.nan  # start of the phase
        self._pair = 0
        self._level_V = 0.0
        self._way = 0  # direction of the stroke, +1 or -1
        self._meant_s = 0.0  # its planned length
        self._begun_s = self._ended_s = math.nan  # when it began and ceased to act, by the samples' times
        self._asked_s = (math.nan, math.nan)  # the same, by the samples at which the check asked for it
        self._asked: list[
            tuple[float, float]
        ] = []  # when it asked for a drive in this stroke, and what the device makes
        self._delays_s: list[float] = []  # of each stroke so far, by the device's reports
        self._has_times = False  # whether samples tell when the drive acts
        self._needed: list[_Stroke] = []  # strokes that the pair still needs, in their order
        self._ahead_s = (
            0.0  # how much longer strokes towards rising positions have acted than those that took them back
        )
        self._longer_s = 0.0  # how much longer than planned those strokes were that were too long, added up
        self._short = 0  # strokes that came short
        self._before_rad = 0.0  # where it stood before the stroke
        self._pause_y: list[tuple[float, float]] = []  # s and rad
        self._along = {1: 0.0, -1: 0.0}  # displacement along the strokes of each direction, added up, rad
        self._against = {1: 0.0, -1: 0.0}
        self._further, self._in_all = plan.further, plan.in_all
        self._shown_rad = 0.0  # displacement along the strokes of both directions since the last proof
        self._proven: int | None = None  # pair after which the sensor had shown motion_rad
        self._still_V = {1: 0.0, -1: 0.0}  # last level without displacement beyond the noise
        self._unsure_V = {1: 0.0, -1: 0.0}  # last level with so little displacement that noise may have gathered to it
        self._found_V: dict[int, float] = {}
        self.surely_V = math.nan

    @property
    def moves_V(self) -> float:
        """The drive that moved the shaft both ways."""
        return max(self.plus_V, self.minus_V)

    def _watch_flicker(self, sample: Sample) -> None:
        """Note for how long the reading stays the same."""
        if self._same is None or sample.y_counts != self._same[0]:
            self._same = sample.y_counts, sample.t_s
        self.longest_same_s = max(self.longest_same_s, sample.t_s - self._same[1])

    def _stands(self, sample: Sample, elapsed_s: float, *, first: bool) -> float | None:
        """Take a sample at 0 V. Returns the position at which the shaft stands, rad; None while it still turns.

        Raises Fault SENSOR_NOISY (in the first rest), DRIVE_STUCK_ON.
        """
        self._rest_y.append(sample.y_rad)
        if elapsed_s < self.rest_s or len(self._rest_y) < _FEWEST_AT_REST:
            return None
        # the second half: the shaft has coasted to a stop by then
        still = self._rest_y[len(self._rest_y) // 2 :]
        # from second differences, so that steady turning does not count as noise
        rest = self._rest_y
        bends = [a - 2.0 * b + c for a, b, c in zip(rest, rest[1:], rest[2:], strict=False)]
        self.noise_rad = math.sqrt(fmean(bend * bend for bend in bends) / 6.0)
        if first and self.noise_rad > 0.33 * self.motion_rad:
            raise Fault(
                "SENSOR_NOISY",
                f"standard deviation {self.noise_rad * 1e3:.1f} mrad at rest; "
                f"breakaway.motion_rad is {self.motion_rad * 1e3:.0f} mrad",
            )
        if turns(still, 0.25 * self.motion_rad, self.noise_rad):
            if elapsed_s > 10.0 * self.rest_s:
                raise Fault("DRIVE_STUCK_ON", f"the shaft still turns {elapsed_s:.1f} s after the drive was set to 0 V")
            self._rest_y = self._rest_y[-2 * len(still) :]
            return None
        self._rest_y = []
        return fmean(still)

    def step(self, sample: Sample) -> float:
        """Drive at this sample, V; 0 V while resting."""
        if math.isnan(self._since_s):
            self._since_s = sample.t_s
        elapsed_s = sample.t_s - self._since_s
        self._watch_drive(sample)
        self._watch_flicker(sample)
        if self._phase == "stroke":
            # a tick may come up to half a period early or late
            if elapsed_s < self._meant_s - 0.5 * self._period_s:
                return self._ask(sample, elapsed_s)
            self._begin("pause", sample)
            return 0.0
        if self._phase == "pause":
            return self._pause(sample, elapsed_s)
        stood_rad = self._stands(sample, elapsed_s, first=self._phase == "first rest")
        if stood_rad is None:
            return 0.0
        if self._phase == "last rest":
            self.finished = True
            return 0.0
        return self._next_stroke(sample, stood_rad)

    def _begin(self, phase: Literal["stroke", "pause", "last rest"], sample: Sample) -> None:
        if phase == "pause":
            self._asked_s = (self._since_s, sample.t_s)
        self._phase = phase
        self._since_s = sample.t_s
        self._pause_y = []

    @property
    def pulse_s(self) -> float:
        """From a stroke's last drive until it must have ended, s: a device that can ends it itself. 0.0: no stroke."""
        if self._phase != "stroke":
            return 0.0
        return self._since_s + self._meant_s - self._asked[-1][0] + max(self._period_s, _LEAST_SPARE_S)

    def _watch_drive(self, sample: Sample) -> None:
        """Note when the stroke's drive began and ceased to act: a drive may be lost, or written late."""
        if self._phase not in ("stroke", "pause") or math.isnan(sample.t_u_s):
            return
        self._has_times = True
        if sample.u_V * self._way > 0.0:
            if math.isnan(self._begun_s):
                self._begun_s = sample.t_u_s
                self._note_delay(sample)
            self._ended_s = math.nan
        elif sample.u_V == 0.0 and not math.isnan(self._begun_s) and math.isnan(self._ended_s):
            self._ended_s = sample.t_u_s

    def _note_delay(self, sample: Sample) -> None:
        """Note how late the stroke began: its drive rises tick by tick, so the first one seen tells its tick."""
        asked_s, _ = min(self._asked, key=lambda asked: abs(asked[1] - sample.u_V))
        if sample.t_u_s >= asked_s:
            self._delays_s.append(sample.t_u_s - asked_s)
            self.reported_delay_s = median(self._delays_s)

    def _acted_s(self) -> float:
        """How long the stroke acted, s; without times, and where drives wait: how long the check asked for it."""
        queued = self.reported_delay_s > _QUEUED * self._period_s
        if self._is_lost() and not queued:
            return 0.0
        if queued or math.isnan(self._begun_s) or math.isnan(self._ended_s):
            return self._asked_s[1] - self._asked_s[0]
        # ticks before the first that the device can drive belong to the stroke
        driven_s = next((t_s for t_s, u_V in self._asked if u_V != 0.0), self._asked_s[0])
        return self._ended_s - self._begun_s + driven_s - self._asked_s[0]

    def _is_lost(self) -> bool:
        """Whether the device reports none of the stroke's drive, although it can drive it."""
        return self._has_times and math.isnan(self._begun_s) and any(u_V != 0.0 for _, u_V in self._asked)

    def _next_stroke(self, sample: Sample, from_rad: float) -> float:
        """Begin the next stroke of the pair, or the first one of a stronger pair; its drive, V."""
        if not self._needed:
            if self._level_V >= self.max_V and not self._may_go_on():
                raise Fault("NO_MOTION", self._no_motion_words())
            self._pair += 1
            self._level_V = min(self._pair * self._plan.step_V, self.max_V)
            stroke_s = self._plan.strokes_s[min(self._pair, len(self._plan.strokes_s)) - 1]
            self._needed = [_Stroke(1 if self._pair % 2 else -1, stroke_s, takes_back=False)]
        stroke = self._needed[0]
        self._way = stroke.way
        # in whole periods; once more than half a period is left over, this stroke takes that back, too
        ahead_s = self._ahead_s if stroke.takes_back and abs(self._ahead_s) > _LEFT_OVER * self._period_s else 0.0
        self._meant_s = max(round((stroke.length_s - self._way * ahead_s) / self._period_s), 1) * self._period_s
        self._begun_s = self._ended_s = math.nan
        self._before_rad = from_rad
        self._begin("stroke", sample)
        self._asked = []
        return self._ask(sample, 0.0)

    def _no_motion_words(self) -> str:
        words = {1: "rising", -1: "falling"}
        missing = [word for way, word in words.items() if way not in self._found_V]
        return f"up to {self.max_V:.2f} V towards {' and '.join(missing)} positions" + "".join(
            f"; {level_V:.2f} V moved it towards {words[way]} ones: a load may pull it that way, or one half of the "
            "bridge does not drive"
            for way, level_V in self._found_V.items()
        )

    def _may_go_on(self) -> bool:
        """Whether one more pair at ``max_V`` keeps what could be unseen within the bound."""
        planned, last_s = len(self._plan.strokes_s), self._plan.strokes_s[-1]
        further = self._pair - planned
        if further < 0 or self._proven is None or further >= self._in_all:
            return further < 0
        # a pair at a lower level drifts no faster than one at max_V, but for as long as its stroke lasts
        unseen_s = sum(self._plan.strokes_s[self._proven :]) + (self._pair - max(self._proven, planned)) * last_s
        return unseen_s + last_s <= self._further * last_s * (1.0 + _ROUNDING)

    def _ask(self, sample: Sample, elapsed_s: float) -> float:
        """The stroke's drive at this sample, V; noted."""
        u_V = self._stroke_V(elapsed_s)
        self._asked.append((sample.t_s, self._quantised(u_V)))
        return u_V

    def _stroke_V(self, elapsed_s: float) -> float:
        """Drive within a stroke, V: it rises to the pair's level."""
        stroke_s = self._plan.strokes_s[min(self._pair, len(self._plan.strokes_s)) - 1]
        ticks, tick = round(stroke_s / self._period_s), round(elapsed_s / self._period_s)
        before_V = (self._pair - 1) * self._plan.step_V
        return self._way * min(before_V + self._plan.step_V * min((tick + 1) / ticks, 1.0), self.max_V)

    def _pause(self, sample: Sample, elapsed_s: float) -> float:
        """Wait until the shaft stands, judge the stroke, begin the next one. Returns the drive, V."""
        self._pause_y.append((sample.t_s, sample.y_rad))
        if elapsed_s < self._least_pause_s() - 0.5 * self._period_s:
            return 0.0
        # the last two thirds, of the readings and of the time: the shaft has mostly coasted to a stop by then
        coasted_s = self._since_s + elapsed_s / 3.0 - 0.5 * self._period_s
        still = [y_rad for t_s, y_rad in self._pause_y[len(self._pause_y) // 3 :] if t_s >= coasted_s]
        if len(still) < _FEWEST_STILL:
            return 0.0
        if turns(still, 0.25 * self.motion_rad, self.noise_rad):
            if elapsed_s > 10.0 * self.rest_s:
                raise Fault("DRIVE_STUCK_ON", f"the shaft still turns {elapsed_s:.1f} s after the drive was set to 0 V")
            return 0.0
        stood_rad = fmean(still)
        self._judge(stood_rad, len(still))
        self._balance()
        if not self._needed and len(self._found_V) == 2:
            self.plus_V, self.minus_V = self._found_V[1], self._found_V[-1]
            unsure_V = (level_V + 0.5 * self._plan.step_V for level_V in self._unsure_V.values())
            self.surely_V = max(*self._found_V.values(), *unsure_V)
            self._begin("last rest", sample)
            return 0.0
        return self._next_stroke(sample, stood_rad)

    def _least_pause_s(self) -> float:
        """Length of this pause, s: the plan's, or until the device has reported the stroke."""
        repeats = (self._pair - 1) * self._plan.step_V >= self.max_V
        pause_s = self._plan.top_pause_s if repeats else self._plan.pause_s
        if self._delays_s:
            return max(pause_s, self.reported_delay_s + _SEEN_PERIODS * self._period_s)
        return max(pause_s, _LONGEST_WAIT_S) if self._is_lost() else pause_s

    def _balance(self) -> None:
        """Plan the strokes that the pair still needs, by how long this one really acted.

        Raises Fault LATE, LINK_TIMEOUT.
        """
        acted_s, stroke = self._acted_s(), self._needed.pop(0)
        way, error_s = stroke.way, acted_s - self._meant_s
        as_meant = abs(error_s) <= 0.5 * self._period_s
        if not as_meant:
            self._count_off(way, acted_s, error_s)
        if acted_s < 0.5 * self._period_s:
            self._needed.insert(0, stroke)  # it hardly reached the motor
            self._ahead_s += way * acted_s
        elif not stroke.takes_back:
            self._needed.append(_Stroke(-way, acted_s, takes_back=True))
        elif as_meant:
            self._ahead_s += way * (acted_s - stroke.length_s)
        else:
            # it took back more, or less, than it should: one more stroke in each direction balances both
            self._needed[:0] = [_Stroke(-way, acted_s, takes_back=True), stroke]

    def _count_off(self, way: int, acted_s: float, error_s: float) -> None:
        """Count a stroke that did not last as long as meant. Raises Fault LATE, LINK_TIMEOUT."""
        lasted = (
            f"a stroke of {way * self._level_V:+.2f} V lasted {1e3 * acted_s:.0f} ms instead of "
            f"{1e3 * self._meant_s:.0f} ms"
        )
        if error_s > 0.0:
            self._longer_s += error_s
            if self._longer_s > self._plan.watchdog_s:
                room_ms = 1e3 * self._plan.watchdog_s
                raise Fault("LATE", f"{lasted}; all strokes together may be longer by {room_ms:.0f} ms")
            return
        self._short += 1
        if self._short > _MOST_SHORT:
            raise Fault(
                "LINK_TIMEOUT",
                f"{lasted}, as {_MOST_SHORT} before it: the device takes drives late, not at all, or in coarser "
                "steps than it says",
            )

    def _judge(self, stood_rad: float, samples: int) -> None:
        """Add the stroke's displacement to that of the earlier strokes in its direction.

        Noise adds up, too. So each displacement is reduced by its variance times six over ``motion_rad``. Noise alone
        then adds up to ``motion_rad`` once in about e^12 strokes (a random walk with that drift).
        """
        variance = 2.0 * self.noise_rad**2 / samples
        off_rad = 6.0 * variance / self.motion_rad
        way, along, against = self._way, self._along, self._against
        moved_rad = (stood_rad - self._before_rad) * way
        along[way] = max(along[way] + moved_rad - off_rad, 0.0)
        self._shown_rad = max(self._shown_rad + moved_rad - off_rad, 0.0)
        if self._shown_rad > self.motion_rad:
            self._shown_rad, self._proven = 0.0, self._pair
        against[way] = max(against[way] - moved_rad - off_rad, 0.0)
        if against[way] > self.motion_rad and along[-way] > SURELY * self.motion_rad:
            # swapped wires would turn both ways round
            raise Fault(
                "LOAD_TURNS",
                f"strokes to either side moved the shaft towards {'falling' if way > 0 else 'rising'} positions; "
                f"those of up to {way * self._level_V:+.2f} V by {-way * against[way] * 1e3:+.0f} mrad",
            )
        if against[way] > self.motion_rad:
            raise Fault(
                "POLARITY",
                f"strokes of up to {way * self._level_V:+.2f} V moved the shaft by "
                f"{-way * against[way] * 1e3:+.0f} mrad",
            )
        if along[way] < max(2.5 * math.sqrt(variance), 0.15 * self.motion_rad):
            self._still_V[way] = self._level_V
        if along[way] < SURELY * self.motion_rad:
            self._unsure_V[way] = self._level_V
        if along[way] > self.motion_rad:
            self._found_V.setdefault(way, self._still_V[way] + 0.5 * self._plan.step_V)
