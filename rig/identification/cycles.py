"""Limit cycles in a recording: the relay's gains, its edges, and the settled cycles (docs/theory.md 3.1, 4.3, 6.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.core.arrays import Array
from rig.identification.mean_cycle import Cycle, Half, Wave, average
from rig.model.cycle_detector import GAP_PERIODS, GAP_SHARE
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries

SETTLED = 0.05  # the oscillation has settled once three periods in a row lie within this,
ARRIVED = 0.005  # and their mean is this near the period at the end of the recording
KEPT = 0.15  # later cycles belong to it while they are within this of the median
STEADY = 0.002  # of period and amplitude: first cycles that are farther off than this and the scatter are left out
SPARSE = 0.01  # of the rows: a rarer value of the drive is not a level of the relay
CHATTER = 0.25  # of the median half period: shorter half periods are chatter
FEWEST_CYCLES = 3
SHORTEST_PERIODS = 30  # a cycle lasts at least this many sampling periods,
SMALLEST_LSB = 20  # and is at least this many steps of the sensor in amplitude; else it is delay hunting


@dataclass(frozen=True)
class MeasuredGains:
    """Gains of the dual-channel relay, found from the levels of the recorded drive, V.

    h1_V, h2_V   gains, V
    side   per row: +1 at +(h1 + h2), -1 at -(h1 + h2), 0 at +-(h2 - h1), nan elsewhere
    note   how they were found, as a sentence
    """

    h1_V: float
    h2_V: float
    side: Array
    note: str


class NoRelayError(IdentifyError):
    """The drive is none of a dual-channel relay, so there is no limit cycle to look for."""


def relay_gains(series: TimeSeries) -> MeasuredGains:
    """Gains h1, h2 from the levels of u = -h1 sgn(y) - h2 sgn(z).

    Levels are clusters, so they need not be exact, and a quantised or saturated drive is accepted. (A saturated drive
    gives the levels that the motor has got.) Raises NoRelayError if the drive does not come from a dual-channel relay,
    and IdentifyError if it never takes one of the levels.
    """
    u = series.u_V
    largest = float(np.abs(u).max())
    cure = "give a relay test, or use the method sampled-data, which takes any drive"
    if largest == 0.0:
        raise NoRelayError(f"{series.name}: the drive is zero throughout", "record a relay test: `rig relay CONFIG`")
    order = np.sort(u)
    # An averaged relay signal has steps between its levels (Remark 3.2); they are rare.
    near = np.searchsorted(order, order + 0.03 * largest, "right") - np.searchsorted(order, order - 0.03 * largest)
    order = order[near >= max(3, SPARSE * u.size)]
    cuts = np.flatnonzero(np.diff(order) > 0.06 * largest)
    groups = [group for group in np.split(order, cuts + 1) if group.size]
    covered = sum(g.size for g in groups) / u.size
    levels = [float(np.median(g)) for g in groups]
    listed = ", ".join(f"{level:.3g}" for level in levels)
    if not 3 <= len(groups) <= 4 or covered < 0.9 or any(np.ptp(g) > 0.12 * largest for g in groups):
        raise NoRelayError(
            f"{series.name}: the drive is not a dual-channel relay's (levels: {listed or 'none'} V)", cure
        )
    top, bottom = levels[-1], levels[0]
    if (
        not (bottom < 0.0 < top)
        or abs(top + bottom) > 0.25 * largest
        or any(abs(x) > 0.94 * largest for x in levels[1:-1])
    ):
        raise NoRelayError(f"{series.name}: the drive's levels are not symmetric ({listed} V)", cure)
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
        raise IdentifyError(f"{series.name}: the drive never takes the level +-(h2 - h1)", cure)
    outer = 0.5 * (top - bottom)
    inner = 0.5 * float(np.median(after_top) - np.median(after_bottom))
    h1, h2 = 0.5 * (outer - inner), 0.5 * (outer + inner)
    note = f"h1 = {h1:.4g} V, h2 = {h2:.4g} V from the drive's levels {listed} V"
    if abs(top + bottom) > 0.02 * largest:
        note += " (unequal in the two directions: their mean is used)"
    return MeasuredGains(h1, h2, side, note)


def _held(side: Array) -> Array:
    """For each row the last outer level (+1 or -1), nan before the first. This is the state of RC; RB may chatter."""
    outer = np.flatnonzero(np.abs(side) == 1.0)
    if outer.size == 0:
        return np.full(side.size, np.nan)
    last = np.searchsorted(outer, np.arange(side.size), side="right") - 1
    return np.where(last >= 0, side[outer[np.maximum(last, 0)]], np.nan)


def find_cycle(series: TimeSeries) -> Cycle:
    """The settled cycle of a relay test, averaged.

    Raises IdentifyError if the drive does not come from a dual-channel relay, or if there are no three cycles that are
    settled and acceptable (docs/theory.md 4.3: period at least 30 samples, amplitude at least 20 steps of the sensor,
    edges in the order RA, RB, RC).
    """
    gains = relay_gains(series)
    halves = _halves(series, gains)
    waves = [Wave(a, b) for (a, sa), (b, _) in zip(halves.found[:-1], halves.found[1:], strict=True) if sa > 0]
    starts = [row for row, (_, s) in zip(halves.rows[:-2], halves.found[:-1], strict=True) if s > 0]
    stops = [row for row, (_, s) in zip(halves.rows[2:], halves.found[:-1], strict=True) if s > 0]
    if len(waves) < FEWEST_CYCLES:
        raise IdentifyError(
            f"{series.name}: {len(waves)} full cycles are too few",
            "record at least ten settled cycles of the relay test: relay.cycles in the config",
        )
    resolution = series.resolution_rad()
    first, stop = _settled(series, waves, resolution)
    whole = _whole(series, waves, starts, stops)
    after_whole = [True, *whole[:-1]]
    used = tuple(waves[k] for k in range(first, stop) if whole[k] and after_whole[k])
    if len(used) < FEWEST_CYCLES:
        used = tuple(waves[k] for k in range(first, stop) if whole[k])
    if len(used) < FEWEST_CYCLES:
        raise IdentifyError(
            f"{series.name}: only {len(used)} of {stop - first} settled cycles have no gap between their rows",
            "record longer (relay.cycles); `rig doctor` tells why this machine stands still",
        )
    rows = (series.first_row + starts[first], series.first_row + stops[stop - 1] - 1)
    notes = (gains.note, f"{len(used)} settled cycles of {len(waves)}, rows {rows[0]} to {rows[1]}")
    cycle = average(used, gains.h1_V, gains.h2_V, series.period_s, resolution, rows, notes, series.t_u_s is not None)
    _accept(series, cycle)
    return cycle


@dataclass(frozen=True)
class _Halves:
    found: list[tuple[Half, float]]
    rows: list[int]


def equivalent_edge(begin_s: Array, lasting_s: Array, done: Array) -> float:
    """Time of the single step that has the area of a staircase (Remark 3.2), s.

    begin_s, lasting_s   n rows: time from which the row's drive acts, and for how long
    done                 n shares of the step: 0 before it, 1 after it, between 0 and 1 during chatter
    """
    return float(begin_s[0] + lasting_s @ (1.0 - done))


def _halves(series: TimeSeries, gains: MeasuredGains) -> _Halves:
    """Complete half periods between RC edges. Chatter of a relay becomes one equivalent edge.

    Take the middle of the time that the drive spends at its outer level. Lower levels before it are chatter of RC;
    outer levels after it are chatter of RB.
    """
    acts = series.edge_s
    side, u = gains.side, series.u_V
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
    margin = 3.0 * series.period_s
    found = []
    for k in range(len(flips) - 1):
        length = rc[k + 1] - rc[k]
        lo, hi = np.searchsorted(series.t_s, [rc[k] - margin, rc[k] + length + margin])
        half = Half(series.t_s[lo:hi] - rc[k], signs[k] * series.y_rad[lo:hi], rb[k] - rc[k], length)
        found.append((half, signs[k]))
    return _Halves(found, flips)


def _flips(side: Array, acts_s: Array) -> list[int]:
    """Rows at which the drive's outer level changes its sign, without changes that are taken back at once."""
    state = _held(side)
    rows = np.flatnonzero(state[1:] * state[:-1] == -1.0) + 1
    while rows.size > 3:
        lasting = np.diff(acts_s[rows])
        shortest = int(np.argmin(lasting))
        if lasting[shortest] >= CHATTER * float(np.median(lasting)):
            break
        rows = np.delete(rows, [shortest, shortest + 1])
    return [int(row) for row in rows]


def _whole(series: TimeSeries, waves: list[Wave], starts: list[int], stops: list[int]) -> list[bool]:
    """Of each cycle, whether it has no gap between its rows: in a gap the relay switches late."""
    steps = np.diff(series.t_s)
    return [
        float(steps[max(a - 1, 0) : b + 1].max()) <= max(GAP_PERIODS * series.period_s, GAP_SHARE * wave.period_s)
        for wave, a, b in zip(waves, starts, stops, strict=True)
    ]


def _settled(series: TimeSeries, waves: list[Wave], resolution_rad: float) -> tuple[int, int]:
    """Longest sequence of cycles with steady period and amplitude: (first, stop).

    A relay that decides once a tick makes cycles jitter by more than a tick. So three cycles in a row must agree
    closely, and the others roughly.
    """
    periods = np.array([wave.period_s for wave in waves])
    amplitudes = np.array([wave.amplitude_rad for wave in waves])
    late = slice(len(waves) // 2, None)
    period, amplitude = float(np.median(periods[late])), float(np.median(amplitudes[late]))
    tick, noise = 1.5 * series.period_s, 4.0 * resolution_rad
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
    first, stop = (_steady(periods, amplitudes, begins[0], stop, series.period_s), stop) if begins else (0, 0)
    if stop - first < FEWEST_CYCLES:
        raise IdentifyError(
            f"{series.name}: no {FEWEST_CYCLES} cycles in a row are settled (periods {periods.min():.3g} to "
            f"{periods.max():.3g} s, amplitudes {amplitudes.min():.3g} to {amplitudes.max():.3g} rad)",
            "record longer (relay.cycles), or use only the steady part: --rows FIRST:LAST",
        )
    centre = np.array([float(w.up.y_rad.mean() - w.down.y_rad.mean()) / 2 for w in waves[first:stop]])
    drift = float(np.polyfit(np.arange(centre.size), centre, 1)[0]) * centre.size
    if abs(drift) > 0.2 * amplitude:
        raise IdentifyError(
            f"{series.name}: the cycle drifts by {drift:.3g} rad at an amplitude of {amplitude:.3g} rad",
            "record until it is steady (relay.cycles); check the coupling of the sensor",
        )
    return first, stop


def _steady(periods: Array, amplitudes: Array, first: int, stop: int, tick_s: float) -> int:
    """The first of three settled cycles whose period and amplitude differ from the late ones only by scatter.

    The triple-relay and describing-function estimators take the cycle for periodic. They magnify a cycle that is still
    settling tenfold. At most half of the settled cycles are left out.
    """
    latest = first + (stop - first) // 2
    late = slice(latest, stop)
    # edges at ticks make periods scatter by a few ticks for ever, and amplitudes by twice this share
    share = max(STEADY, 4.0 * tick_s / float(np.median(periods[late])))
    still = np.zeros(stop, dtype=bool)
    for values, tolerance in ((periods, share), (amplitudes, 2.0 * share)):
        centre = float(np.median(values[late]))
        allowed = max(tolerance * centre, 3.0 * float(np.std(values[late])))
        still |= np.abs(values[:stop] - centre) > allowed
    begin = next((k for k in range(first, latest) if not still[k : k + 3].any()), latest)
    return begin if stop - begin >= FEWEST_CYCLES else first


def _accept(series: TimeSeries, cycle: Cycle) -> None:
    """Accept a limit cycle, refuse delay hunting of the loop (docs/theory.md 4.3)."""
    cure = "raise h2 or lower h1 (relay.gains): a slower and larger cycle; or sample faster (period_s)"
    if cycle.period_s < SHORTEST_PERIODS * series.period_s:
        raise IdentifyError(
            f"{series.name}: the period {cycle.period_s:.3g} s is below {SHORTEST_PERIODS} samples: delay hunting", cure
        )
    if not cycle.amplitude_rad > 0.0:
        raise IdentifyError(
            f"{series.name}: the position does not follow the drive: the mean cycle has no amplitude",
            "check that the motor turns and that the sensor is coupled to it, then record again",
        )
    if cycle.amplitude_rad < SMALLEST_LSB * cycle.resolution_rad:
        raise IdentifyError(
            f"{series.name}: the amplitude {cycle.amplitude_rad:.3g} rad is below {SMALLEST_LSB} steps of the sensor",
            cure,
        )
    # If stage 3 does not drive it back, the motor may stop before the late RC edge of a sampled relay.
    earliest = -3.0 * series.period_s if cycle.h1_V <= cycle.h2_V else 0.0
    if not (earliest < cycle.t1_s < cycle.t1_s + cycle.t2_s < 0.5 * cycle.period_s):
        raise IdentifyError(f"{series.name}: extremum, RB and RC are not in this order: not a simple oscillation", cure)
