"""The guard: limits the drive, whatever a law asks for (docs/safety.md)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from rig.control.motion import Standstill
from rig.core.faults import Fault
from rig.core.signals import FLAG_GUARD_BRAKED, FLAG_GUARD_CLIPPED, Limits, Sample


@dataclass(frozen=True)
class GuardSettings:
    """What the guard knows of the bench.

    limits             travel limits, largest drive, watchdog
    rail_counts        raw readings at or beyond these mean a broken wire
    max_speed_rad_s    largest speed to expect; faster is a fault
    coast_tau_s        longest velocity time constant to expect: at 0 V the shaft still travels v * coast_tau_s
    reaction_s         time at full speed to add: a tick, the latency and the watchdog time. So the shaft stays inside
                       even if the host dies at this instant
    noise_rad          sensor noise, standard deviation, at least one LSB
    free_rad_s         speed that the largest drive can give the shaft in the end; 0.0: unknown: max_speed_rad_s counts,
                       and the guard brakes with the largest drive
    delay_s            time beyond its own tick until a drive shows in the reading: it is added to each of these times
    stuck_s, motion_rad  a drive well above static friction must move the shaft by motion_rad within stuck_s; or within
                       twice the longest time that the shaft has needed so far, but at most four times stuck_s
    """

    limits: Limits
    rail_counts: tuple[int, int]
    max_speed_rad_s: float
    coast_tau_s: float
    reaction_s: float
    noise_rad: float
    motion_rad: float
    stuck_s: float = 0.3
    delay_s: float = 0.0
    free_rad_s: float = 0.0


WINDOW_S = 0.04  # shortest window for the velocity, which lags by half of it
_LEAST_SAMPLES = 5
_STALE_SAMPLES = 2  # in a row; one may come if a loop is as quick as its device
_SETTLING_WINDOWS = 1.5  # windows: the velocity lags by half of one, and a drive acts up to two ticks later


def velocity_noise_rad_s(noise_rad: float, period_s: float) -> float:
    """Standard deviation of the guard's velocity, rad/s, by noise of the readings, rad, every ``period_s``."""
    samples = _samples_every(period_s)
    return noise_rad * math.sqrt(12.0 / samples) / ((samples - 1) * period_s)


def _samples_every(period_s: float, window_s: float = WINDOW_S) -> int:
    return max(_LEAST_SAMPLES, 1 + round(window_s / period_s))


class VelocityWindow:
    """Velocity as the slope of the last few positions, by least squares. Without a model, none can mislead it.

    After a gap longer than the window it begins anew: readings from before the gap say little of the velocity after it.

    samples       number of samples in the window
    before_rad_s  the velocity to return until half of them have come; after a gap, its mean over the gap
    """

    def __init__(self, samples: int = _LEAST_SAMPLES, before_rad_s: float = 0.0) -> None:
        self._window: deque[tuple[float, float]] = deque(maxlen=samples)
        self._fewest = samples // 2 + 1
        self._before_rad_s = before_rad_s

    def step(self, t_s: float, y_rad: float) -> float:
        """Slope after this sample, rad/s."""
        window = self._window
        if len(window) == window.maxlen and t_s - window[-1][0] > window[-1][0] - window[0][0]:
            since_s, since_rad = window[-1]
            self._before_rad_s = (y_rad - since_rad) / (t_s - since_s)
            window.clear()
        window.append((t_s, y_rad))
        n = len(window)
        if n < self._fewest:
            return self._before_rad_s
        # plain loops: four generators took half of the guard's time
        t_sum = y_sum = 0.0
        for t, y in window:
            t_sum += t
            y_sum += y
        t_mean, y_mean = t_sum / n, y_sum / n
        moment = spread = 0.0
        for t, y in window:
            moment += (t - t_mean) * (y - y_mean)
            spread += (t - t_mean) ** 2
        return moment / spread


class Gain:
    """The speed that a lasting drive has given the shaft. The shaft keeps it while the drive lasts.

    Under a constant drive u above friction the speed tends to K (u - f), monotonically. If it has risen since the
    drive began, it is still below that value, so it cannot fall again. If friction falls with speed, the value is even
    higher.

    settling_s     time after the drive's begin that counts as before it, for the delay and the lag of the velocity
    """

    FALLEN = 0.9  # a drive below this part of its largest is another drive

    def __init__(self, settling_s: float) -> None:
        self.settling_s = settling_s
        self.restart()

    def restart(self) -> None:
        """Another drive begins at the next sample."""
        self.speed_rad_s = 0.0
        self._since_s = math.nan
        self._largest_V = 0.0
        self._before_rad_s = 0.0

    def step(self, t_s: float, v_rad_s: float, u_V: float) -> float:
        """Speed in the drive's direction that this drive has given so far, rad/s, >= 0."""
        along = math.copysign(v_rad_s, v_rad_s * u_V)
        if abs(u_V) < self.FALLEN * self._largest_V:
            self.restart()
        self._largest_V = max(self._largest_V, abs(u_V))
        if math.isnan(self._since_s):
            self._since_s = t_s
        if t_s - self._since_s <= self.settling_s:
            self._before_rad_s = max(self._before_rad_s, along)
        self.speed_rad_s = max(self.speed_rad_s, along - self._before_rad_s)
        return self.speed_rad_s


class Guard:
    """Passes, reduces, reverses or refuses the drive that a law asks for.

    It raises Fault LAW_FAILED (no finite drive), SAMPLE_STALE, SENSOR_RAIL, SENSOR_JUMP, SENSOR_STUCK, TRAVEL_HARD,
    POLARITY or OVERSPEED, and latches it: from then on ``allow`` always raises it.

    sign_proven    set by the experiment after the breakaway check. Before that the guard never drives by itself, since
                   it does not know which direction is inward
    static_V       breakaway level; nan until it is known
    recovering     lets `rig jog` drive a shaft that stands outside inward
    braked_ticks   ticks in which the guard drove inward by itself
    clipped_ticks  ticks in which it refused outward drive beyond a soft limit
    """

    def __init__(self, settings: GuardSettings) -> None:
        self.settings = settings
        self.sign_proven = False
        self.recovering = False
        self.static_V = math.nan
        self.fault: Fault | None = None
        self.braked_ticks = 0
        self.clipped_ticks = 0
        self.velocity_rad_s = 0.0
        self.predicted_stop_rad = 0.0
        self._samples = _LEAST_SAMPLES
        self._velocity = VelocityWindow()
        self._last: Sample | None = None
        self._fast_since_s = math.nan  # too fast since then; -inf: not by a gap
        self._gap_ended_s = -math.inf  # in which the device held a drive, and nothing could brake
        self._same_instant = 0  # samples in a row that are not later than the one before
        self._push_sign = 0
        self._window_s = WINDOW_S
        self._standstill = Standstill()
        self._gain = Gain(_SETTLING_WINDOWS * WINDOW_S + settings.delay_s)
        self._inward_since: tuple[float, float] | None = None
        self._innermost_rad = math.inf  # smallest distance from the centre under the inward drive of a recovery

    def rearm(self) -> None:
        """Forget the motion before a pause: the guard has seen nothing during the pause."""
        self._velocity = VelocityWindow(self._samples)
        self._last = None
        self._fast_since_s = math.nan
        self._standstill.restart()
        self._gain.restart()
        self._inward_since = None
        self._innermost_rad = math.inf

    def pace(self, sample_s: float, window_s: float = WINDOW_S) -> None:
        """From now on samples come every ``sample_s``; take the velocity from ``window_s`` of them, at least five.

        From a shorter window the velocity would be mostly the sensor's noise.
        """
        self._samples = _samples_every(sample_s, window_s)
        self._velocity = VelocityWindow(self._samples, self.velocity_rad_s)
        self._window_s = (self._samples - 1) * sample_s
        self._gain = Gain(_SETTLING_WINDOWS * self._window_s + self.settings.delay_s)

    def learn(self, settings: GuardSettings) -> None:
        """Know the bench better from now on."""
        self.settings = settings
        self._gain = Gain(_SETTLING_WINDOWS * self._window_s + settings.delay_s)

    def allow(self, sample: Sample, asked_V: float) -> tuple[float, int]:
        """The drive that may go out, V, for the drive ``asked_V`` of a law; and the flags for its row.

        Raises Fault LAW_FAILED, SAMPLE_STALE, SENSOR_RAIL, SENSOR_JUMP, SENSOR_STUCK, TRAVEL_HARD, POLARITY or
        OVERSPEED, and raises it again at every later call.
        """
        if self.fault is not None:
            raise self.fault
        try:
            if not math.isfinite(asked_V):
                raise Fault("LAW_FAILED", f"{asked_V} V")
            self._check_sensor(sample)
            passed_V, flags = self._limit_travel(sample, asked_V)
            self._check_polarity(sample, passed_V)
            self._check_stuck(sample, passed_V)
        except Fault as fault:
            self.fault = fault
            raise
        self._last = sample
        return passed_V, flags

    @property
    def _clear_rad_s(self) -> float:
        """A speed that cannot be noise: ten standard deviations of the velocity, and motion_rad per window."""
        noise_rad_s = self.settings.noise_rad * math.sqrt(12.0 / self._samples) / self._window_s
        return max(10.0 * noise_rad_s, self.settings.motion_rad / self._window_s)

    def _check_sensor(self, sample: Sample) -> None:
        self._same_instant = 0 if self._last is None or sample.t_s > self._last.t_s else self._same_instant + 1
        if self._same_instant >= _STALE_SAMPLES:
            raise Fault(
                "SAMPLE_STALE", f"{1 + self._same_instant} readings in a row, none later than {sample.t_s:.4f} s"
            )
        low, high = self.settings.rail_counts
        if not low < sample.y_counts < high:
            raise Fault("SENSOR_RAIL", f"reading {sample.y_counts} counts; the rails are {low} and {high}")
        if self._last is not None:
            since_s = sample.t_s - self._last.t_s
            step = abs(sample.y_rad - self._last.y_rad)
            fastest_rad_s = 1.5 * self.settings.max_speed_rad_s
            if since_s > self._window_s:
                fastest_rad_s = max(fastest_rad_s, self.settings.free_rad_s)
                self._note_gap(sample)
            allowed = fastest_rad_s * since_s + 12.0 * self.settings.noise_rad
            if step > allowed:
                raise Fault(
                    "SENSOR_JUMP", f"{step:.3f} rad in {since_s * 1e3:.1f} ms; at most {allowed:.3f} rad is possible"
                )
        self.velocity_rad_s = self._velocity.step(sample.t_s, sample.y_rad)
        if self._stays_too_fast(sample.t_s):
            raise Fault(
                "OVERSPEED", f"{abs(self.velocity_rad_s):.1f} rad/s; limit {self.settings.max_speed_rad_s:.1f} rad/s"
            )

    @property
    def _is_too_fast(self) -> bool:
        return abs(self.velocity_rad_s) > 1.2 * self.settings.max_speed_rad_s

    def _stays_too_fast(self, t_s: float) -> bool:
        """Whether the shaft is too fast. One that a gap made so has time to slow down, braked or at 0 V."""
        if not self._is_too_fast:
            self._fast_since_s = math.nan
            return False
        shown_s = _SETTLING_WINDOWS * self._window_s + self.settings.delay_s
        if math.isnan(self._fast_since_s):
            self._fast_since_s = t_s if t_s <= self._gap_ended_s + shown_s else -math.inf
        return t_s > self._fast_since_s + shown_s + self.settings.coast_tau_s

    def _note_gap(self, sample: Sample) -> None:
        """A gap ends: what was decided just before it may have gone out only now."""
        self._gap_ended_s = sample.t_s
        self._inward_since = None
        self._gain.restart()
        if not sample.t_u_s <= self._gap_ended_s - self._window_s:
            self._standstill.restart()

    def _limit_travel(self, sample: Sample, asked_V: float) -> tuple[float, int]:
        s = self.settings
        y, v = sample.y_rad, self.velocity_rad_s
        hard_low, hard_high = s.limits.hard_rad
        soft_low, soft_high = s.limits.soft_rad
        self.predicted_stop_rad = y + v * (s.reaction_s + s.delay_s + s.coast_tau_s)
        u_V, flags = asked_V, 0
        if abs(u_V) > s.limits.max_u_V:
            u_V, flags = math.copysign(s.limits.max_u_V, u_V), FLAG_GUARD_CLIPPED
        inside = hard_low <= y <= hard_high
        if not inside and not self.recovering:
            raise Fault("TRAVEL_HARD", f"y = {y:.3f} rad, hard limits {hard_low:.2f} to {hard_high:.2f} rad")
        if inside and soft_low <= y <= soft_high:
            self.recovering = False
        # between soft and hard, only inward drive passes
        if (y > soft_high and u_V > 0.0) or (y < soft_low and u_V < 0.0):
            u_V, flags = 0.0, flags | FLAG_GUARD_CLIPPED
            self.clipped_ticks += 1
        if self.recovering:
            return u_V, flags
        outward = 1 if self.predicted_stop_rad > hard_high else -1 if self.predicted_stop_rad < hard_low else 0
        if not outward and self._is_too_fast:  # a gap let it: its drive must not go on
            outward = 1 if v > 0.0 else -1
        brake_V = self._brake_V if soft_low <= y <= soft_high else s.limits.max_u_V
        if outward and u_V * outward > -brake_V:
            u_V = -outward * brake_V if self.sign_proven else 0.0
            flags |= FLAG_GUARD_BRAKED
            self.braked_ticks += 1
        return u_V, flags

    @property
    def _brake_V(self) -> float:
        """The drive to brake with, V: one that cannot make the shaft faster the other way, however long it acts.

        The velocity lags by more than a light motor needs to turn round under the largest drive: that would throw it to
        and fro, faster each time; and in a gap the device holds the brake, too.
        """
        s = self.settings
        if s.free_rad_s <= 0.0:
            return s.limits.max_u_V
        return min(abs(self.velocity_rad_s) / s.free_rad_s, 1.0) * s.limits.max_u_V

    def _check_polarity(self, sample: Sample, u_V: float) -> None:
        """Raise POLARITY if the shaft, beyond a soft limit, gets faster outward although the drive is inward."""
        soft_low, soft_high = self.settings.limits.soft_rad
        outward = 1 if sample.y_rad > soft_high else -1 if sample.y_rad < soft_low else 0
        if outward == 0 or u_V * outward >= 0.0:
            self._inward_since = None
            self._innermost_rad = math.inf
            return
        if self.recovering:
            self._check_creep(sample.y_rad * outward, sample.y_rad)
        speed = self.velocity_rad_s * outward
        if self._inward_since is None:
            self._inward_since = (sample.t_s, speed)
            return
        since_s, speed_then = self._inward_since
        # 0.08 s: longer than the velocity window and a tick; a shaft that obeys is slower by then
        gained = speed - max(speed_then, 0.0)
        if sample.t_s - since_s > 0.08 + self.settings.delay_s and gained > 0.05 * self.settings.max_speed_rad_s:
            raise Fault(
                "POLARITY",
                f"at {sample.y_rad:.2f} rad, moving outward at {speed:.1f} rad/s and getting faster, after "
                f"{(sample.t_s - since_s) * 1e3:.0f} ms of inward drive",
            )

    def _check_creep(self, reach_rad: float, y_rad: float) -> None:
        """Raise POLARITY if a shaft creeps outward while it is jogged inward: no hard limit holds then."""
        self._innermost_rad = min(self._innermost_rad, reach_rad)
        crept_rad = reach_rad - self._innermost_rad
        if crept_rad > max(2.0 * self.settings.motion_rad, 12.0 * self.settings.noise_rad):
            raise Fault(
                "POLARITY",
                f"at {y_rad:.2f} rad, the shaft crept outward by {crept_rad * 1e3:.0f} mrad under inward drive",
            )

    def _check_stuck(self, sample: Sample, u_V: float) -> None:
        """Raise SENSOR_STUCK if a drive well above static friction does not move the shaft, or slows it down again."""
        sign = 0
        if not math.isnan(self.static_V) and abs(u_V) > 1.4 * self.static_V:
            sign = 1 if u_V > 0.0 else -1
        if sign == 0 or sign != self._push_sign:
            self._standstill.restart()
            self._gain.restart()
        self._push_sign = sign
        if sign == 0:
            return
        given_rad_s = self._gain.step(sample.t_s, self.velocity_rad_s, u_V)
        if given_rad_s > self._clear_rad_s and self.velocity_rad_s * sign < 0.25 * given_rad_s:
            # a reading that freezes slows down, but does not turn back
            turns_back = self.velocity_rad_s * sign < -0.1 * given_rad_s
            raise Fault(
                "SENSOR_STUCK",
                f"{u_V:+.2f} V had made the shaft {given_rad_s:.1f} rad/s faster, but the reading now moves at "
                f"{self.velocity_rad_s * sign:.1f} rad/s under the same drive"
                + (
                    "; it turns back: check the bridge and the motor's wires, then look for noise" if turns_back else ""
                ),
            )
        still_s = self._standstill.step(sample.t_s, sample.y_rad, self.settings.motion_rad)
        # a slow shaft with coarse counts takes longer, as it has shown
        stuck_s = self.settings.stuck_s + self.settings.delay_s
        if still_s >= min(max(stuck_s, 2.0 * self._standstill.longest_s), 4.0 * stuck_s):
            moved_rad = self._standstill.high_rad - self._standstill.low_rad
            raise Fault(
                "SENSOR_STUCK",
                f"{u_V:+.2f} V for {still_s:.2f} s moved the reading by {moved_rad * 1e3:.1f} mrad; "
                f"the shaft broke away at {self.static_V:.2f} V; {self._standstill.words()}",
            )
