"""The mean of a limit cycle: half periods, folded by odd symmetry and averaged by point (docs/theory.md 3.1, 6.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rig.core.arrays import Array
from rig.run_folder.recording.errors import IdentifyError


@dataclass(frozen=True)
class Half:
    """One half period, folded by odd symmetry so that the drive starts at +(h1 + h2).

    tau_s, y_rad  its samples: time since the RC edge, s, and position, rad; from before that edge to after the next
    inner_s       time from the RC edge to the RB edge, s (t1 + t2); edges are the equivalent ones of Remark 3.2
    length_s      time to the next RC edge, s
    """

    tau_s: Array
    y_rad: Array
    inner_s: float
    length_s: float


@dataclass(frozen=True)
class Wave:
    """One full period: a half that starts upwards and one that starts downwards."""

    up: Half
    down: Half

    @property
    def period_s(self) -> float:
        """Length of the period, s."""
        return self.up.length_s + self.down.length_s

    @property
    def amplitude_rad(self) -> float:
        """Half of peak to peak, rad."""
        return 0.5 * float(-self.up.y_rad.min() - self.down.y_rad.min())


@dataclass(frozen=True)
class MeanHalf:
    """The mean of the halves that start in one direction, aligned at their RC edges and folded like them.

    at_s, y_rad        n times since the RC edge, s, and positions, rad
    inner_s, length_s  mean times of the RB edge and of the next RC edge, s
    """

    at_s: Array
    y_rad: Array
    inner_s: float
    length_s: float


@dataclass(frozen=True)
class Cycle:
    """The settled limit cycle of a relay test, averaged over its periods.

    h1_V, h2_V       gains, V
    period_s, amplitude_rad   period, s, and half of peak to peak, rad
    t1_s, t2_s, t3_s durations of the three stages, s (docs/theory.md 3.1); t = 0 where the drive steps to +(h1 + h2).
                     They are between edges of the drive: a sampled relay is late by up to a tick plus the delay
    y_rc_rad, y_rb_rad  position at the edges of RC (t = 0) and RB (t = t1 + t2), rad
    y_extremum_rad   position at t1, the minimum
    z_rc_rad_s       integral of position at t = 0, rad s
    phase, curve_rad mean curve over one period: phase 0..1, position, rad
    spread_rad       standard deviation between half periods at these phases, rad
    cycles           periods averaged
    scatter          standard deviation between periods of "period_s", "amplitude_rad", "inner_s" (t1 + t2), "t3_s"
    rows             first and last row of the settled cycles in the file
    waves            the averaged periods
    halves           mean of the halves that start upwards, and mean of those that start downwards
    period_sampling_s, resolution_rad   sampling period, s, and step of the positions, rad
    drive_times_known   whether edges are at the times of the drive (t_u_s); else the drive acted an unknown delay later
    notes            rows used, and how the gains were found
    """

    h1_V: float
    h2_V: float
    period_s: float
    amplitude_rad: float
    t1_s: float
    t2_s: float
    t3_s: float
    y_rc_rad: float
    y_rb_rad: float
    y_extremum_rad: float
    z_rc_rad_s: float
    phase: Array
    curve_rad: Array
    spread_rad: Array
    cycles: int
    scatter: dict[str, float]
    rows: tuple[int, int]
    waves: tuple[Wave, ...]
    halves: tuple[MeanHalf, MeanHalf]
    period_sampling_s: float
    resolution_rad: float
    drive_times_known: bool = True
    notes: tuple[str, ...] = ()

    @property
    def omega_rad_s(self) -> float:
        """Angular frequency, rad/s."""
        return 2.0 * math.pi / self.period_s


def average(
    waves: tuple[Wave, ...],
    h1_V: float,
    h2_V: float,
    sampling_s: float,
    resolution_rad: float,
    rows: tuple[int, int],
    notes: tuple[str, ...] = (),
    drive_times_known: bool = True,
) -> Cycle:
    """Average full periods point by point, aligned at their RC edges, with halves folded by odd symmetry (Remark 3.1).

    A sampled relay switches at its ticks, so the samples of all periods have nearly the same times after the edge.
    An offset of position cancels between the halves.
    Raises IdentifyError if the edges of RB and RC coincide.
    """
    halves = [half for wave in waves for half in (wave.up, wave.down)]
    inner = float(np.mean([half.inner_s for half in halves]))
    length = float(np.mean([half.length_s for half in halves]))
    bins = Bins.of(waves, sampling_s)
    tau, y, spread = bins.folded()
    right = (tau >= 0.0) & (tau < inner)
    if not right.any():
        raise IdentifyError(
            "the relay's RB and RC edges coincide: not a simple oscillation", "raise h2 or lower h1: relay.gains"
        )
    t1, lowest = _extremum(tau, y, inner)
    y_rc = -_at(tau, y, length, length - inner)
    y_rb = _at(tau, y, inner, min(inner - t1, length - inner))
    inside = (tau > 0.0) & (tau < length)
    area = np.trapezoid(np.concatenate(([y_rc], y[inside], [-y_rc])), np.concatenate(([0.0], tau[inside], [length])))
    phase = np.concatenate((tau[inside], tau[inside] + length)) / (2.0 * length)
    scatter = {
        "period_s": _std([wave.period_s for wave in waves]),
        "amplitude_rad": _std([wave.amplitude_rad for wave in waves]),
        "inner_s": _std([0.5 * (wave.up.inner_s + wave.down.inner_s) for wave in waves]),
        "t3_s": _std([0.5 * (wave.period_s - wave.up.inner_s - wave.down.inner_s) for wave in waves]),
    }
    return Cycle(
        h1_V=h1_V,
        h2_V=h2_V,
        period_s=2.0 * length,
        amplitude_rad=-lowest,
        t1_s=t1,
        t2_s=inner - t1,
        t3_s=length - inner,
        y_rc_rad=y_rc,
        y_rb_rad=y_rb,
        y_extremum_rad=lowest,
        z_rc_rad_s=-0.5 * float(area),
        phase=phase,
        curve_rad=np.concatenate((y[inside], -y[inside])),
        spread_rad=np.concatenate((spread[inside], spread[inside])),
        cycles=len(waves),
        scatter=scatter,
        rows=rows,
        waves=waves,
        halves=bins.halves(),
        drive_times_known=drive_times_known,
        period_sampling_s=sampling_s,
        resolution_rad=resolution_rad,
        notes=notes,
    )


@dataclass(frozen=True)
class Bins:
    """Sums over samples with equal times after their RC edges: (2, waves, bins), for halves up and halves down.

    count, time_s, y_rad, square   number of samples; sums of their times, positions and squared positions
    inner_s, length_s              (2, waves), s
    sampling_s                     width of a bin, s
    """

    count: Array
    time_s: Array
    y_rad: Array
    square: Array
    inner_s: Array
    length_s: Array
    sampling_s: float

    @classmethod
    def of(cls, waves: tuple[Wave, ...], sampling_s: float) -> Bins:
        """Sort the samples of the waves into bins."""
        halves = [wave.up for wave in waves] + [wave.down for wave in waves]
        tau = np.concatenate([half.tau_s for half in halves])
        y = np.concatenate([half.y_rad for half in halves])
        # All samples have one phase of the grid; centre the bins on it (circular mean).
        angle = 2.0 * math.pi * tau / sampling_s
        shift = sampling_s / (2.0 * math.pi) * math.atan2(float(np.sin(angle).mean()), float(np.cos(angle).mean()))
        index = np.round((tau - shift) / sampling_s).astype(int)
        index -= index.min()
        width = int(index.max()) + 1
        place = np.repeat(np.arange(len(halves)), [half.tau_s.size for half in halves]) * width + index

        def total(values: Array | None) -> Array:
            sums = np.bincount(place, values, minlength=len(halves) * width)
            return sums.astype(float).reshape(2, len(waves), width)

        def of_halves(values: list[float]) -> Array:
            return np.array(values).reshape(2, len(waves))

        return cls(
            total(None),
            total(tau),
            total(y),
            total(y * y),
            of_halves([half.inner_s for half in halves]),
            of_halves([half.length_s for half in halves]),
            sampling_s,
        )

    def folded(self) -> tuple[Array, Array, Array]:
        """Mean time, mean position and its spread in each bin; up and down halves have equal weight."""
        count, time, y, square = (x.sum(axis=(0, 1)) for x in (self.count, self.time_s, self.y_rad, self.square))
        enough = count >= max(1, self.inner_s.size // 2)
        count, time, y, square = count[enough], time[enough], y[enough], square[enough]
        spread = np.sqrt(np.maximum(square - y * y / count, 0.0) / np.maximum(count - 1.0, 1.0))
        inside = time / count <= float(self.length_s.mean()) + 3.0 * self.sampling_s
        return (time / count)[inside], (y / count)[inside], spread[inside]

    @cached_property
    def _totals(self) -> tuple[Array, Array, Array]:
        return self.count.sum(axis=1), self.time_s.sum(axis=1), self.y_rad.sum(axis=1)

    def halves(self, without: int | None = None) -> tuple[MeanHalf, MeanHalf]:
        """The mean halves of all waves, or of all but one."""
        kept = np.ones(self.inner_s.shape[1], dtype=bool)
        count, time, y = self._totals
        if without is not None:
            kept[without] = False
            count, time = count - self.count[:, without], time - self.time_s[:, without]
            y = y - self.y_rad[:, without]
        means = []
        for k in range(2):
            length = float(self.length_s[k, kept].mean())
            enough = count[k] >= max(1, int(kept.sum()) // 2)
            at = time[k, enough] / count[k, enough]
            inside = (at >= 0.0) & (at <= length)
            mean_y = y[k, enough] / count[k, enough]
            means.append(MeanHalf(at[inside], mean_y[inside], float(self.inner_s[k, kept].mean()), length))
        return means[0], means[1]


def _extremum(tau: Array, y: Array, inner_s: float) -> tuple[float, float]:
    """Time and position of the minimum.

    Acceleration jumps at RA, but after it the curve is smooth. The extremum is the vertex of a cubic through the
    samples between the lowest one and the RB edge.
    """
    near = np.flatnonzero((tau > -0.1 * inner_s) & (tau < inner_s))
    lowest = near[int(np.argmin(y[near]))]
    reach = tau[lowest] + 0.6 * (inner_s - tau[lowest])
    use = np.flatnonzero((np.arange(tau.size) > lowest) & (tau <= reach))
    if use.size < 5:
        use = np.flatnonzero((np.arange(tau.size) > lowest) & (tau <= inner_s))
    if use.size < 4:
        return float(tau[lowest]), float(y[lowest])
    origin = tau[use[0]]
    d, c, b, a = np.polyfit(tau[use] - origin, y[use], 3)
    discriminant = c * c - 3.0 * d * b
    if discriminant > 0.0 and c > 0.0:
        vertex = -b / (c + math.sqrt(discriminant))
        if abs(vertex) < 0.5 * inner_s:
            return float(origin + vertex), float(a + vertex * (b + vertex * (c + vertex * d)))
    return float(tau[lowest]), float(y[lowest])


def _at(tau: Array, y: Array, when_s: float, reach_s: float) -> float:
    """Position at an edge: a cubic through the smooth stretch of at most ``reach_s`` before it."""
    use = np.flatnonzero((tau <= when_s + 1e-12) & (tau >= when_s - reach_s))
    use = use[-12:]
    if use.size < 2:
        return float(np.interp(when_s, tau, y))
    return float(np.polyfit(tau[use] - when_s, y[use], min(3, use.size - 1))[-1])


def _std(values: list[float]) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else math.nan
