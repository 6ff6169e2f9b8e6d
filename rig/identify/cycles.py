"""Limit cycles in a recording: the relay's gains, its edges, the settled cycles, and their average (theory 3, 5, 7)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.identify.record import IdentifyError, Record

Array = NDArray[np.float64]

SETTLED = 0.05  # three periods in a row within this show that the oscillation has settled;
ARRIVED = 0.005  # their mean lies this near the period at which the recording ends
KEPT = 0.15  # cycles after them belong to it while within this of the median
STEADY = 0.002  # of period and amplitude: what is still settling beyond the late cycles' scatter is not averaged
SPARSE = 0.01  # of the rows: values of the drive that are rarer are no level of the relay
CHATTER = 0.25  # of the median half period: shorter ones are chatter
FEWEST_CYCLES = 3
SHORTEST_PERIODS = 30  # a cycle lasts at least this many sampling periods,
SMALLEST_LSB = 20  # and is at least this many steps of the sensor in amplitude; else it is delay hunting


@dataclass(frozen=True)
class Gains:
    """Gains of the dual-channel relay as found from the levels of the recorded drive, V.

    side   per row: +1 at +(h1 + h2), -1 at -(h1 + h2), 0 at +-(h2 - h1), nan elsewhere
    note   how they were found, in words
    """

    h1_V: float
    h2_V: float
    side: Array
    note: str


@dataclass(frozen=True)
class Half:
    """One half period, folded by odd symmetry so that the drive starts at +(h1 + h2).

    tau_s, y_rad  its samples: time since the RC edge (from before it, to after the next), and position
    inner_s       time of the RB edge after the RC edge, s (t1 + t2). Edges are the equivalent ones of Remark 3.2
    length_s      to the next RC edge, s
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
    """The average of the halves that start one way, aligned at their RC edges, folded like them.

    at_s, y_rad        n times since the RC edge, s, and positions, rad
    inner_s, length_s  mean times of the RB edge and of the next RC edge
    """

    at_s: Array
    y_rad: Array
    inner_s: float
    length_s: float


@dataclass(frozen=True)
class Cycle:
    """The settled limit cycle of a relay test, averaged over its periods.

    h1_V, h2_V       gains
    period_s, amplitude_rad
    t1_s, t2_s, t3_s durations of the three stages (theory section 3), t = 0 where the drive steps to +(h1 + h2). The
                     switchings are the drive's: a sampled relay is late by up to a tick plus the delay
    y_rc_rad, y_rb_rad  position at the edges of RC (t = 0) and RB (t = t1 + t2), rad
    y_extremum_rad   position at t1, the minimum
    z_rc_rad_s       integral of position at t = 0, rad s
    phase, curve_rad averaged curve over one period: phase 0..1, position
    spread_rad       standard deviation between half periods at these phases, rad
    cycles           periods averaged
    scatter          standard deviation between periods of "period_s", "amplitude_rad", "inner_s" (t1 + t2), "t3_s"
    rows             first and last row of the settled cycles in the file
    waves            what was averaged
    halves           the halves that start upwards and those that start downwards, averaged apart
    period_sampling_s, resolution_rad   of the record
    drive_times_known   whether edges are where the drive acted (t_u_s); else it acted an unknown delay later
    notes            which rows, and how the gains were found
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


def relay_gains(record: Record) -> Gains:
    """Gains h1, h2 from the levels of u = -h1 sgn(y) - h2 sgn(z).

    Levels need not be exact: they are clusters, so quantised and saturated drives pass. (Under saturation the levels
    found are those of the relay that the motor has effectively seen.) Raises IdentifyError if the drive is not a
    dual-channel relay's.
    """
    u = record.u_V
    largest = float(np.abs(u).max())
    cure = "give a relay test, or use the method sampled-data, which takes any drive"
    if largest == 0.0:
        raise IdentifyError(f"{record.name}: the drive is zero throughout", "record a relay test")
    order = np.sort(u)
    # An averaged relay signal has steps between its levels (Remark 3.2); they are rare.
    near = np.searchsorted(order, order + 0.03 * largest, "right") - np.searchsorted(order, order - 0.03 * largest)
    order = order[near >= max(3, SPARSE * u.size)]
    cuts = np.flatnonzero(np.diff(order) > 0.06 * largest)
    groups = [group for group in np.split(order, cuts + 1) if group.size]
    covered = sum(g.size for g in groups) / u.size
    levels = [float(np.median(g)) for g in groups]
    shown = ", ".join(f"{level:.3g}" for level in levels)
    if not 3 <= len(groups) <= 4 or covered < 0.9 or any(np.ptp(g) > 0.12 * largest for g in groups):
        raise IdentifyError(
            f"{record.name}: the drive is not a dual-channel relay's (levels: {shown or 'none'} V)", cure
        )
    top, bottom = levels[-1], levels[0]
    if (
        not (bottom < 0.0 < top)
        or abs(top + bottom) > 0.25 * largest
        or any(abs(x) > 0.94 * largest for x in levels[1:-1])
    ):
        raise IdentifyError(f"{record.name}: the drive's levels are not symmetric ({shown} V)", cure)
    width = 0.06 * largest
    side = np.full(u.size, np.nan)
    side[u >= groups[-1].min() - 0.1 * width] = 1.0
    side[u <= groups[0].max() + 0.1 * width] = -1.0
    for group in groups[1:-1]:
        side[(u >= group.min()) & (u <= group.max())] = 0.0
    # A middle level belongs to the outer level before it: after +(h1 + h2) comes h2 - h1.
    before = _held(side)
    middle = side == 0.0
    after_top, after_bottom = u[middle & (before > 0)], u[middle & (before < 0)]
    if after_top.size < 3 or after_bottom.size < 3:
        raise IdentifyError(f"{record.name}: the drive never passes through +-(h2 - h1)", cure)
    outer = 0.5 * (top - bottom)
    inner = 0.5 * float(np.median(after_top) - np.median(after_bottom))
    h1, h2 = 0.5 * (outer - inner), 0.5 * (outer + inner)
    note = f"h1 = {h1:.4g} V, h2 = {h2:.4g} V from the drive's levels {shown} V"
    if abs(top + bottom) > 0.02 * largest:
        note += " (unequal both ways: mean taken)"
    return Gains(h1, h2, side, note)


def _held(side: Array) -> Array:
    """Per row the last outer level (+1 or -1) seen, nan before the first: the state of RC, whatever RB chatters."""
    outer = np.flatnonzero(np.abs(side) == 1.0)
    if outer.size == 0:
        return np.full(side.size, np.nan)
    last = np.searchsorted(outer, np.arange(side.size), side="right") - 1
    return np.where(last >= 0, side[outer[np.maximum(last, 0)]], np.nan)


def find_cycle(record: Record) -> Cycle:
    """The settled cycle of a relay test, averaged.

    Raises IdentifyError with the reason if the drive is no dual-channel relay's, or no three cycles are settled and
    acceptable (theory section 5: period at least 30 samples, amplitude at least 20 steps of the sensor, edges in the
    order RA, RB, RC).
    """
    gains = relay_gains(record)
    halves = _halves(record, gains)
    waves = [Wave(a, b) for (a, sa), (b, _) in zip(halves.found[:-1], halves.found[1:], strict=True) if sa > 0]
    starts = [row for row, (_, s) in zip(halves.rows[:-2], halves.found[:-1], strict=True) if s > 0]
    stops = [row for row, (_, s) in zip(halves.rows[2:], halves.found[:-1], strict=True) if s > 0]
    if len(waves) < FEWEST_CYCLES:
        raise IdentifyError(
            f"{record.name}: {len(waves)} full cycles are too few",
            "record at least ten settled cycles of the relay test",
        )
    resolution = record.resolution_rad()
    first, stop = _settled(record, waves, resolution)
    used = tuple(waves[first:stop])
    rows = (record.first_row + starts[first], record.first_row + stops[stop - 1] - 1)
    notes = (gains.note, f"{len(used)} settled cycles of {len(waves)}, rows {rows[0]} to {rows[1]}")
    cycle = average(used, gains.h1_V, gains.h2_V, record.period_s, resolution, rows, notes, record.t_u_s is not None)
    _accept(record, cycle)
    return cycle


@dataclass(frozen=True)
class _Halves:
    found: list[tuple[Half, float]]
    rows: list[int]


def equivalent_edge(begin_s: Array, lasting_s: Array, done: Array) -> float:
    """When a single step has the area of a staircase (Remark 3.2), s.

    begin_s, lasting_s   n rows: since when each one's drive acts, and for how long
    done                 n shares of the step that it has taken: 0 before, 1 after, anything between in the chatter
    """
    return float(begin_s[0] + lasting_s @ (1.0 - done))


def _halves(record: Record, gains: Gains) -> _Halves:
    """Complete half periods between RC edges; chatter of either relay is merged into an equivalent edge.

    Before the middle of the time that the drive spends at its outer level, lower levels are chatter of RC; after it,
    outer ones are chatter of RB.
    """
    acts = record.edge_s
    side, u = gains.side, record.u_V
    lasting = np.diff(acts, append=acts[-1])
    flips = _flips(gains.side, acts)
    odd = np.isnan(side)
    begins = []
    for row in flips:  # steps on the way to the outer level belong to the edge
        while row > 0 and odd[row - 1]:
            row -= 1
        begins.append(row)
    rc: list[float] = []
    rb: list[float] = []
    signs: list[float] = []
    for flip, begin, stop in zip(flips, begins, [*begins[1:], acts.size], strict=True):
        sign = float(side[flip])
        rows = slice(begin, stop)
        outer = side[rows] == sign
        spent = np.cumsum(lasting[rows] * outer)
        centre = begin + int(np.searchsorted(spent, 0.5 * spent[-1]))
        rising, falling = slice(begin, max(centre, begin + 1)), slice(max(centre, begin + 1), stop)
        up = np.where(side[rising] == sign, 1.0, (sign * u[rising] + gains.h2_V - gains.h1_V) / (2.0 * gains.h2_V))
        down = np.where(side[falling] == sign, 1.0, (sign * u[falling] + gains.h1_V - gains.h2_V) / (2.0 * gains.h1_V))
        up[side[rising] == 0.0] = down[side[falling] == 0.0] = 0.0
        rc.append(equivalent_edge(acts[rising], lasting[rising], np.clip(up, 0.0, 1.0)))
        last = acts[falling] if stop > falling.start else acts[-1:]
        rb.append(equivalent_edge(last, lasting[falling], 1.0 - np.clip(down, 0.0, 1.0)))
        signs.append(sign)
    margin = 3.0 * record.period_s
    found = []
    for k in range(len(flips) - 1):
        length = rc[k + 1] - rc[k]
        lo, hi = np.searchsorted(record.t_s, [rc[k] - margin, rc[k] + length + margin])
        half = Half(record.t_s[lo:hi] - rc[k], signs[k] * record.y_rad[lo:hi], rb[k] - rc[k], length)
        found.append((half, signs[k]))
    return _Halves(found, flips)


def _flips(side: Array, acts_s: Array) -> list[int]:
    """Rows at which the drive's outer level changes its sign, without those that it takes back at once."""
    state = _held(side)
    rows = np.flatnonzero(state[1:] * state[:-1] == -1.0) + 1
    while rows.size > 3:
        lasting = np.diff(acts_s[rows])
        shortest = int(np.argmin(lasting))
        if lasting[shortest] >= CHATTER * float(np.median(lasting)):
            break
        rows = np.delete(rows, [shortest, shortest + 1])
    return [int(row) for row in rows]


def _settled(record: Record, waves: list[Wave], resolution_rad: float) -> tuple[int, int]:
    """Longest run of cycles whose period and amplitude stay: (first, stop).

    A relay that decides once a tick makes cycles jitter by more than a tick, so three in a row have to agree closely,
    and the others roughly.
    """
    periods = np.array([wave.period_s for wave in waves])
    amplitudes = np.array([wave.amplitude_rad for wave in waves])
    late = slice(len(waves) // 2, None)
    period, amplitude = float(np.median(periods[late])), float(np.median(amplitudes[late]))
    tick, noise = 1.5 * record.period_s, 4.0 * resolution_rad
    near = np.abs(periods - period) <= KEPT * period + tick
    near &= np.abs(amplitudes - amplitude) <= 1.5 * KEPT * amplitude + noise
    runs = np.flatnonzero(np.diff(np.concatenate(([0], near.astype(int), [0]))))
    spans = [(int(a), int(b)) for a, b in zip(runs[::2], runs[1::2], strict=True)]
    first, stop = max(spans, key=lambda span: span[1] - span[0], default=(0, 0))
    begins = [
        k
        for k in range(first, stop - 2)
        if np.ptp(periods[k : k + 3]) <= SETTLED * period + tick
        and np.abs(periods[k : k + 3].mean() - period) <= ARRIVED * period + tick
    ]
    first, stop = (_steady(periods, amplitudes, begins[0], stop, record.period_s), stop) if begins else (0, 0)
    if stop - first < FEWEST_CYCLES:
        raise IdentifyError(
            f"{record.name}: no {FEWEST_CYCLES} cycles in a row are settled (periods {periods.min():.3g} to "
            f"{periods.max():.3g} s, amplitudes {amplitudes.min():.3g} to {amplitudes.max():.3g} rad)",
            "record longer, and start when the oscillation has become steady",
        )
    centre = np.array([float(w.up.y_rad.mean() - w.down.y_rad.mean()) / 2 for w in waves[first:stop]])
    drift = float(np.polyfit(np.arange(centre.size), centre, 1)[0]) * centre.size
    if abs(drift) > 0.2 * amplitude:
        raise IdentifyError(
            f"{record.name}: the cycle drifts by {drift:.3g} rad at an amplitude of {amplitude:.3g} rad",
            "record longer until it is steady; check the coupling of the sensor",
        )
    return first, stop


def _steady(periods: Array, amplitudes: Array, first: int, stop: int, tick_s: float) -> int:
    """First of three settled cycles whose period and amplitude differ from the late ones' by scatter alone.

    The estimators of section 7 take the cycle for periodic, and magnify what is still settling tenfold. At most half of
    the settled cycles are left out.
    """
    latest = first + (stop - first) // 2
    late = slice(latest, stop)
    # edges at the ticks make periods scatter by a few of these for ever, and amplitudes by twice their share
    share = max(STEADY, 4.0 * tick_s / float(np.median(periods[late])))
    still = np.zeros(stop, dtype=bool)
    for values, tolerance in ((periods, share), (amplitudes, 2.0 * share)):
        centre = float(np.median(values[late]))
        allowed = max(tolerance * centre, 3.0 * float(np.std(values[late])))
        still |= np.abs(values[:stop] - centre) > allowed
    begin = next((k for k in range(first, latest) if not still[k : k + 3].any()), latest)
    return begin if stop - begin >= FEWEST_CYCLES else first


def _accept(record: Record, cycle: Cycle) -> None:
    """Theory section 5: what is the limit cycle and what is the loop's delay hunting by itself."""
    cure = "raise h2 (or lower h1): a slower and larger cycle; or sample faster"
    if cycle.period_s < SHORTEST_PERIODS * record.period_s:
        raise IdentifyError(
            f"{record.name}: the period {cycle.period_s:.3g} s is below {SHORTEST_PERIODS} samples: delay hunting", cure
        )
    if cycle.amplitude_rad < SMALLEST_LSB * cycle.resolution_rad:
        raise IdentifyError(
            f"{record.name}: the amplitude {cycle.amplitude_rad:.3g} rad is below {SMALLEST_LSB} steps of the sensor",
            cure,
        )
    # Where stage 3 does not drive it back, the motor may stop before a sampled relay's late RC edge.
    earliest = -3.0 * record.period_s if cycle.h1_V <= cycle.h2_V else 0.0
    if not (earliest < cycle.t1_s < cycle.t1_s + cycle.t2_s < 0.5 * cycle.period_s):
        raise IdentifyError(
            f"{record.name}: extremum, RB and RC do not follow in this order: not a simple oscillation", cure
        )


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
    """Average full periods point by point, aligned at their RC edges, halves folded by odd symmetry (Remark 3.1).

    A sampled relay switches at its ticks, so samples of all periods fall on nearly the same times after the edge.
    An offset of position cancels between the halves.
    """
    halves = [half for wave in waves for half in (wave.up, wave.down)]
    inner = float(np.mean([half.inner_s for half in halves]))
    length = float(np.mean([half.length_s for half in halves]))
    bins = Bins.of(waves, sampling_s)
    tau, y, spread = bins.folded()
    right = (tau >= 0.0) & (tau < inner)
    if not right.any():
        raise IdentifyError("the relay's RB and RC edges coincide: not a simple oscillation", "raise h2 or lower h1")
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
    """Sums over samples that lie equally far behind their RC edges: (2, waves, bins), of halves up and halves down.

    count, time_s, y_rad, square   how many samples, sums of their times, positions and squared positions
    inner_s, length_s              (2, waves)
    sampling_s                     width of a bin
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
        # Samples lie at one phase of the grid; centre the bins on it (circular mean).
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
        """Mean time, mean position and its spread in each bin, up and down halves weighing the same."""
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

    Acceleration jumps at RA, but right of it the curve is smooth: the vertex of a cubic through the samples between
    the lowest and the RB edge is the extremum.
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
