"""What logs of one's own have that no motor shows, and how it is undone: clocks and numbers that wrap, signs that were
lost on the way, velocities in the place of positions, several runs in one file.

Each function takes columns of numbers as they stand in the file. It adds a sentence to ``notes`` for what it changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from rig.run_folder.recording.log_format import LARGEST
from rig.run_folder.recording.recording import FIT_ROWS, Columns, Floats, Integers

_UNEVEN = 0.05  # scatter of the time between rows, over that: by chance no sample is whole steps then
_FEW_STEPS, _FEWEST_MOVES = 10.5, 10  # of a counter, between two rows, for a velocity to show them
# Of steps of a counter behind rounded velocities: the largest, over the most that they are rounded by; how exactly one
# is tried, how many, and on how many ways from row to row, for all took longer than the fit; log of the probability
# that chance alone puts as many near whole steps
_COARSE, _NEAR_STEP, _MOST_STEPS, _MOST_TRIED, _BY_CHANCE = 20.0, 0.02, 200_000, 500, -30.0
_LEAST_SHARE, _FEW, _LIKELY = 1e-3, 40, 0.8
_FEWEST_KINDS = 30  # of changes from row to row: fewer are those of a ramp, which is near any grid
_OF_BITS: Final = {8: 2.0**8, 16: 2.0**16, 32: 2.0**32}  # numbers that a whole number of so many bits can be
_COUNTERS: Final = (8, 10, 12, 14, 16, 32)  # bits of a position
_CLOCKS: Final = (8, 16, 24, 32)  # of a time
# Of its range: what a position that wraps covers at least, and the most that it then moves in nearly each row. A number
# of 16 bits or more wraps wherever it jumps by more than half of its range.
_COVERS, _MOVES, _NEARLY, _WIDE = 0.8, 0.35, 0.99, 16
# Seconds after which clocks begin anew: those of 16 and 32 bits, and those that show a part of a longer time.
_SHOWN_S: Final = (1.0, 10.0, 60.0, 100.0, 1000.0, 3600.0, 43200.0, 86400.0)
_WRAP_PERIODS = 3.0  # longest step over the end of a clock
_TURNS_ON = 0.2  # of the largest step of a position: by so much a shaft turns over the end of a clock
_COUNTS, _JUMPS = 0.9, 1.3  # share of rows in which a counter of rows rises; of the largest other bend, a jump back
_FAR_ROWS = 5  # that rows out of order may be from their place
# Share of rows in which the time since the row before is shorter than that of the row before; or share that are alike,
# and no longer than so, s
_FALLS, _MOSTLY, _LONGEST_S = 0.2, 0.5, 0.5
_BEGINS_PERIODS = 3.0  # from the first run's time: where another run begins
_FEWEST_HELD, _HELD = 20, 0.97  # changes of a velocity, and the share at whole multiples of rows, for it to be held
# Of a velocity that is cut off: rows in a row, and in all, at the end of its range; the least jump to it, in steps of
# its numbers; share of such stays elsewhere, at most
_STAYS, _CUT_ROWS, _JUMPS_TO, _ELSEWHERE = 3, 10, 20.5, 0.1
# Of a velocity that is one count over the time that it took: of its largest sizes so many, at least so many, which are
# one over at most this many ticks and more, so exactly. How many stands, how unlike, which are slow, of the largest
# speed; by how many digits they differ, how they go with the speed, and how many last as long as the next count took
_SIZES, _FEWEST_SIZES, _MOST_TICKS, _NEAR_TICK = 12, 4, 25, 0.1
_FEWEST_STANDS, _UNLIKE, _SLOW, _FAR_DIGITS, _INVERSE, _AS_LONG = 10, 0.15, 0.3, 3.5, -0.5, 0.9
_ARX_ROUNDS, _SURE = 20, 0.4  # rounds of a wrapped velocity; of its range, the largest error of what is expected
# Bits of a velocity that wraps; of its range, what it covers then; what a motor leaves of it as it goes on, of what one
# leaves of it as it stands, at most
_VELOCITIES: Final = (16, 8, 10, 12, 14, 24)
_FILLS, _FAR_LESS = 0.95, 0.3


def unwrapped_clock(t: Floats, y: Floats, second: float, notes: list[str]) -> Floats:
    """Times of a clock that begins anew, as they go on; as they are where that is no sign of such a clock.

    second  units of t in a second
    y       positions or velocities of the same rows: at the end of a clock they go on, at the start of a run not
    """
    back = np.flatnonzero(t[1:] < t[:-1])
    if back.size == 0 or float(np.abs(t).max()) > LARGEST:
        return t
    forth = np.diff(t)[np.diff(t) > 0.0]
    period = float(np.median(forth)) if forth.size else 0.0
    bits = [2.0**size for size in _CLOCKS if second > 1.0]
    for length in sorted({*bits, *(second * s for s in _SHOWN_S)}):
        over = np.diff(t)[back] + length
        close = bool(np.all((over > 0.0) & (over <= _WRAP_PERIODS * period)))
        if float(np.ptp(t)) < length and close and (length in bits or _is_sure(y, back)):
            turns = np.zeros(t.size)
            turns[back + 1] = length
            notes.append(f"the clock begins anew after {length / second:.6g} s: the times go on")
            return np.asarray(t + np.cumsum(turns))
    # of any other length: of one clock all rows end and begin alike, and a shaft that turns does not jump
    far = _WRAP_PERIODS * period
    alike = bool(np.all(t[back] >= t.max() - far) and np.all(t[back + 1] <= t.min() + far))
    # where it never comes near 0, and falls every few rows, each time is that since the row before
    steps = float(t[1:].min()) > far and _since_row_before(t, second)
    if steps or not (alike and period > 0.0 and _is_sure(y, back) and _turns_on(y, back)):
        return t
    turns = np.zeros(t.size)
    turns[back + 1] = t[back] - t[back + 1] + period
    notes.append(f"the clock begins anew after {np.median(turns[back + 1]) / second:.4g} s: the times go on")
    return np.asarray(t + np.cumsum(turns))


def _turns_on(y: Floats, at: Integers) -> bool:
    """Whether a position goes on by as much behind these rows as before and after them, and at one of them by much."""
    steps = np.diff(y)
    inside = at[(at > 0) & (at < steps.size - 1)]
    near = np.stack([steps[inside - 1], steps[inside], steps[inside + 1]])
    bends, most = np.abs(np.diff(steps)), float(np.abs(steps).max(initial=0.0))
    goes_on = np.abs(near[1] - 0.5 * (near[0] + near[2])) <= np.quantile(bends, _NEARLY)
    # noise turns, too, but not one way
    least = max(_TURNS_ON * most, float(np.median(bends)))
    turns = (np.abs(near).min(axis=0) > least) & (np.abs(np.sign(near).sum(axis=0)) == len(near))
    return bool(goes_on.all() and turns.any())


def _is_sure(y: Floats, at: Integers) -> bool:
    """Whether there are rows enough, and a column changes after these rows by no more than it does elsewhere."""
    steps = np.abs(np.diff(y))
    usual = float(np.max(np.delete(steps, at), initial=0.0))
    return y.size >= FIT_ROWS and (usual == 0.0 or bool(np.all(steps[at] <= 1.5 * usual)))


def in_order(columns: Columns, lines: Sequence[int], notes: list[str]) -> tuple[Columns, Sequence[int]]:
    """The rows, and their lines, by their times, where neighbours changed places on the way; else as they are.

    Then the motion is smoother so. Where it is not, the stamps are wrong, and not the order.
    """
    t, y = columns["t_s"], columns["y_rad" if "y_rad" in columns else "v_rad_per_s"]
    order = np.argsort(t, kind="stable")
    far = np.abs(order - np.arange(t.size))
    if not far.any() or far.max() > _FAR_ROWS:
        return columns, lines
    seen = np.isfinite(y)
    if np.sum(np.abs(np.diff(y[order][seen[order]], 2))) >= np.sum(np.abs(np.diff(y[seen], 2))):
        return columns, lines
    notes.append(f"{np.count_nonzero(far)} rows stood in another order than their times, and were put in order")
    return {name: values[order] for name, values in columns.items()}, [lines[k] for k in order]


def once(raw: Columns, notes: list[str]) -> Columns:
    """The rows without those that say the one before again, if their times rise then; with a note."""
    again = np.all([values[1:] == values[:-1] for name, values in raw.items() if name != "line"], axis=0)
    kept = np.append(True, ~again)
    t = raw["t_s"][kept]
    if not again.any() or np.any(t[1:] <= t[:-1]):
        return raw
    notes.append(f"{np.count_nonzero(again)} rows say the one before again, time included, and were left out")
    return {name: values[kept] for name, values in raw.items()}


def added_up(t: Floats, notes: list[str]) -> Floats:
    """Times that each say how long after the row before a row came, as times; with a note. Else as they are."""
    if not _since_row_before(t, 1.0):
        return t
    notes.append("each time is that since the row before: they were added up")
    return np.asarray(np.cumsum(t))


def _since_row_before(t: Floats, second: float) -> bool:
    """Whether each time says how long after the row before its row came; ``second``: units of t in a second.

    No clock of rows in order goes back so often, nor says one time in most of its rows.
    """
    if t.size < FIT_ROWS or t[1:].min() <= 0.0:
        return False
    usual = float(np.median(t))
    is_even = usual <= _LONGEST_S * second and float(np.mean(t == usual)) > _MOSTLY
    return is_even or float(np.mean(np.diff(t) < 0.0)) >= _FALLS


def runs_of(t: Floats) -> list[slice]:
    """The rows of each run in a file whose time begins again; all rows as one where it does not.

    A run has at least 22 rows, and begins near the time at which the first one begins, or near 0. Fewer before the only
    one are what the link still held of another: they are in none.
    """
    back = np.flatnonzero(t[1:] < t[:-1]) + 1
    if back.size == 0 or float(np.abs(t).max()) > LARGEST:
        return [slice(0, t.size)]
    edges = [0, *back.tolist(), t.size]
    near = _BEGINS_PERIODS * float(np.median(np.abs(np.diff(t))))
    begins = t[back]
    begin_again = bool(np.all((np.abs(begins - t[0]) <= near) | (np.abs(begins) <= near)))
    if edges[1] < FIT_ROWS < t.size - edges[1] and back.size == 1 and abs(begins[0]) <= near:
        return [slice(edges[1], t.size)]
    if not begin_again or min(np.diff(edges)) < FIT_ROWS:
        return [slice(0, t.size)]
    return [slice(first, stop) for first, stop in pairwise(edges)]


def runs_without_time(y: Floats, begins: Sequence[int], others: Iterable[Floats]) -> list[slice]:
    """The rows of each run in a file without a time: behind a greeting, where a counter begins again, or the position.

    y       positions; not finite: there are none
    begins  rows before which the file says something else
    others  columns not read; one that rises in most rows, and then falls to where it began, counts the rows of a run
    """
    edges = [0, *begins, y.size]
    if not begins or min(np.diff(edges)) < FIT_ROWS:
        counters = [runs_of(one) for one in others if np.mean(np.diff(one) > 0.0) > _COUNTS]
        edges = [0, *(run.stop for run in max(counters, key=len, default=[slice(0, y.size)]))]
    if len(edges) == 2 and y.size > FIT_ROWS and np.isfinite(y).all():
        bends = np.abs(np.diff(y, 2, prepend=y[0], append=y[-1]))
        off = np.maximum(bends[:-1], bends[1:])  # of the steps into row 1, 2, ... from those beside it
        again = np.flatnonzero((y[1:] == y[0]) & (off > 0.0))
        beside = np.clip([again - 1, again, again + 1], 0, off.size - 1)
        usual = float(np.delete(off, beside).max(initial=0.0))
        edges = [0, *(again[off[again] > _JUMPS * usual] + 1).tolist(), y.size]
        edges = edges if min(np.diff(edges)) >= FIT_ROWS else [0, y.size]
    return [slice(first, stop) for first, stop in pairwise(edges)]


def signed(u: Floats, full: float | None, what: str, notes: list[str]) -> Floats:
    """Drives, or velocities, whose negative numbers were kept as unsigned ones, with their signs.

    full  the largest number that can be; None: unknown, then only numbers of 16 and 32 bits are seen
    what  these are, in the plural
    """
    if u.min() < 0.0 or not np.all(u == np.round(u)):
        return u
    for bits, size in _OF_BITS.items():
        most = full if full is not None else 0.25 * size
        if (full is None and bits == 8) or most >= 0.5 * size:
            continue
        negative = u >= size - most
        if u.max() < size and negative.any() and np.all(negative | (u <= most)):
            notes.append(
                f"negative {what} stand as unsigned numbers of {bits} bits, such as {u[negative].min():.0f} for "
                f"{u[negative].min() - size:.0f}: they are read with their sign"
            )
            return np.asarray(np.where(negative, u - size, u))
    return u


def unwrapped_position(y: Floats, counts: bool, turn: float, notes: list[str]) -> Floats:
    """Positions without the jumps of a counter of few bits, or of an angle that begins anew after one turn.

    counts  whether they are whole numbers of a counter
    turn    of the shaft, in the unit of y
    """
    extent, largest = float(np.ptp(y)), float(np.abs(np.diff(y)).max())
    of_counter = _COUNTERS if counts and bool(np.all(y == np.round(y))) else ()
    found = [(2.0**bits, f"the counter, of {bits} bits, wrapped: the positions go on") for bits in of_counter]
    found = [(size, said) for size, said in found if extent < size]
    if extent <= turn * (1.0 + 1e-9):
        said = "the positions stay within one turn and jump by most of it: they are an angle that wraps, and go on"
        found.append((turn, said))
    ways = [(np.unwrap(y, period=size), said, size) for size, said in found if largest > 0.5 * size]
    ways = [way for way in ways if (way[2] >= 2.0**_WIDE and way[2] != turn) or _goes_on(y, way[0], way[2])]
    if not ways:
        return y
    # a potentiometer of 10 bits stays at an end in the gap of its turn: there the counter's size is too small a step
    inside = np.flatnonzero((y > y.min()) & (y < y.max()))
    steps = np.diff(inside)
    speeds = [np.diff(on[inside]) / steps for on, _, _ in ways]
    on, said, _ = ways[int(np.argmin([np.abs(np.diff(speed)).sum() for speed in speeds]))]
    notes.append(said)
    return np.asarray(on)


def _goes_on(y: Floats, on: Floats, size: float) -> bool:
    """Whether positions cover all of a range of this size, and go on behind it by steps that are no jumps."""
    return bool(np.ptp(y) >= _COVERS * size - 1.0 and np.quantile(np.abs(np.diff(on)), _NEARLY) <= _MOVES * size)


def unwrapped_velocity(v: Floats, u: Floats, notes: list[str]) -> Floats | None:
    """Velocities of a number of few bits that wraps, as they were; None where they cannot be told.

    Between two rows a quick motor's velocity may change by more than half of what such a number can be. So each row is
    the one nearest to what a motor of first order does under the drive ``u``; that motor is fitted to all rows, and
    fitted again until no row changes. At u = 0, turned either way, a motor has no speed of its own: that tells the
    first row. A number of other than 16 bits, or in other units than one, has to fill its range, and to leave a motor
    far more than what goes on does.
    """
    digit = last_digit(v)
    if not digit:
        return v
    extent, largest = np.ptp(v), float(np.abs(np.diff(v)).max(initial=0.0))
    for bits in _VELOCITIES:
        size = digit * 2.0**bits
        is_usual = bits == _WIDE and digit == 1.0
        if extent >= size or largest <= 0.5 * size or not (is_usual or extent > _FILLS * size):
            continue
        x, error = _as_it_goes_on(v, u, size)
        if not is_usual and float(np.std(error)) > _FAR_LESS * float(np.std(_as_it_goes_on(v, u, math.inf)[1])):
            continue
        if float(np.abs(error).max()) > _SURE * size:
            return None if is_usual else v
        said = f"the velocities, of {bits} bits, wrapped: each row is the one nearest to what a motor does, and goes on"
        notes.append(said)
        return x
    return v


def _as_it_goes_on(v: Floats, u: Floats, size: float) -> tuple[Floats, Floats]:
    """Velocities that wrap at ``size`` as they go on, and what a motor of first order leaves of them; inf: none do."""
    x: Floats = np.unwrap(v, period=size) if math.isfinite(size) else v
    rows = np.stack([np.zeros(v.size - 2), np.diff(u)[1:], np.diff(u)[:-1], np.zeros(v.size - 2)], axis=1)
    law = np.zeros(4)
    for _ in range(_ARX_ROUNDS):
        rows[:, 0], rows[:, 3] = np.diff(x)[:-1], np.diff(np.sign(x))[:-1]
        wanted = np.diff(x)[1:]
        sound = np.ones(wanted.size, dtype=bool)
        for _ in range(3):
            law = np.asarray(np.linalg.lstsq(rows[sound], wanted[sound], rcond=None)[0], dtype=np.float64)
            sound = np.abs(wanted - rows @ law) < 0.25 * size
        before, x = x, _nearest(v, x[:2], rows, law, size) if math.isfinite(size) else x
        if np.array_equal(before, x):
            break
    error = np.diff(x)[1:] - rows @ law
    if math.isfinite(size):
        level = np.stack([x[:-1], u[:-1], u[1:], np.ones(x.size - 1)], axis=1)
        a, *_, c = np.linalg.lstsq(level, x[1:], rcond=None)[0]
        x = x - size * np.round(c / max(1.0 - a, 1e-6) / size)
    return np.asarray(x), np.asarray(error)


def _nearest(v: Floats, first: Floats, rows: Floats, law: Floats, size: float) -> Floats:
    """Each row's velocity, v up to whole multiples of ``size``, nearest to what the law expects."""
    x = np.concatenate((first, np.zeros(v.size - 2)))
    by_drive = rows[:, 1:] @ law[1:]
    for k in range(2, v.size):
        expected = x[k - 1] + law[0] * (x[k - 1] - x[k - 2]) + by_drive[k - 2]
        x[k] = v[k] + size * round((expected - v[k]) / size)
    return x


class Summed(NamedTuple):
    """Positions from velocities, rad, from 0 on, and the rows at which they are known: None, all of them.

    adds_up   whether noise of the velocities adds up in them, as of samples; the steps of a counter do not
    """

    y_rad: Floats
    rows: Integers | None = None
    adds_up: bool = False

    @property
    def is_of_counter(self) -> bool:
        """Whether each row moves by whole steps: over the time of the row, which may be uneven, and of no count."""
        return self.rows is None and not self.adds_up


def last_digit(numbers: Floats) -> float:
    """The least decimal of numbers that were rounded to one, down to 1e-4; 0.0: they were not."""
    for digits in range(5):
        if np.allclose(numbers, np.round(numbers, digits), rtol=0.0, atol=1e-9):
            return 10.0**-digits
    return 0.0


def summed_up(v_rad_per_s: Floats, t_s: Floats, notes: list[str], rounded_rad_s: float = 0.0) -> Summed:
    """The position from velocities, which are rounded by so much at most, rad, from 0 on.

    A velocity is the mean since the row before if it comes from a counter: then each row moves by whole steps. Else it
    is a sample, and in between it changes evenly. A velocity that is held over several rows, because it is computed
    less often than rows are written, is the mean since it was last new: it tells of those rows in which it is new.
    """
    kept = held_rows(v_rad_per_s)
    if kept is None:
        return _integrated(v_rad_per_s, t_s, rounded_rad_s, notes)
    notes.append(
        f"the velocity is new in every {int(kept[1] - kept[0])}th row and held in between: each is the mean since it "
        "was new before, and the position is known in these rows"
    )
    since_s = np.diff(t_s[kept], prepend=t_s[kept[0]])
    return Summed(np.cumsum(v_rad_per_s[kept] * since_s), kept)


def held_rows(v: Floats) -> Integers | None:
    """The rows in which a velocity is new, where it is held over as many rows each time; None where each row is new."""
    changes = np.flatnonzero(np.diff(v)) + 1
    if changes.size < _FEWEST_HELD:
        return None
    every = int(np.min(np.diff(changes)))
    if every < 2:
        return None
    first = int(np.bincount(changes % every).argmax())
    if float(np.mean(changes % every == first)) < _HELD:
        return None
    return np.arange(first, v.size, every)


def _integrated(v_rad_per_s: Floats, t_s: Floats, rounded_rad_s: float, notes: list[str]) -> Summed:
    periods_s = np.diff(t_s, prepend=t_s[0])
    moved = v_rad_per_s * periods_s
    steps = np.abs(moved[moved != 0.0])
    of_counter = False
    if steps.size >= _FEWEST_MOVES:
        one = float(np.median(steps[steps < 1.5 * steps.min()]))
        few = steps[steps < _FEW_STEPS * one] / one
        is_whole = few.size >= _FEWEST_MOVES and float(np.mean(np.abs(few - np.round(few)) < 0.1)) > 0.9
        # of even rows a file rounds a sample to whole steps, too; but its noise is larger than they are
        noise = float(np.median(np.abs(np.diff(moved, 4)))) / math.sqrt(70.0)
        of_counter = is_whole and (noise <= one or float(np.std(periods_s[1:])) > _UNEVEN * float(np.mean(periods_s)))
        if not of_counter and (step := _rounded_step(moved, rounded_rad_s * periods_s)):
            of_counter, moved = True, step * np.round(moved / step)
    if of_counter:
        notes.append("the position is the sum of the velocities, from 0: each is the mean since the row before")
        return Summed(np.cumsum(moved))
    notes.append("the position is the integral of the velocities, from 0: each is a sample, as of a tachometer")
    middle = 0.5 * (v_rad_per_s[1:] + v_rad_per_s[:-1])
    return Summed(np.concatenate(([0.0], np.cumsum(middle * periods_s[1:]))), adds_up=True)


def _rounded_step(moved: Floats, rounded: Floats) -> float | None:
    """The step of a counter, where velocities are rounded nearly as coarsely as it is; None: they show none.

    moved    from row to row
    rounded  by how much each is rounded at most
    Nearly all are then within that of whole steps; of other numbers chance leaves some out.
    """
    each, at = np.unique(np.round(np.abs(moved), 12), return_index=True)
    most = rounded[at][each > 0.0]
    each = each[each > 0.0]
    if np.unique(np.round(np.diff(moved), 12)).size < _FEWEST_KINDS or not float(most.min()) > 0.0:
        return None
    tried = slice(None, None, math.ceil(each.size / _MOST_TRIED))
    each, most = each[tried], most[tried]
    off = float(np.median(most))
    near_enough = 1.0 - 2.0 * _NEAR_STEP
    # log of the chance that so many numbers are near, of which such a share would be by chance (Sanov)
    shares = np.geomspace(_LEAST_SHARE, near_enough, 1000)
    left = (1.0 - near_enough) * np.log((1.0 - near_enough) / (1.0 - shares))
    chance = -each.size * (near_enough * np.log(near_enough / shares) + left)
    if chance[0] > _BY_CHANCE:
        return None
    share = float(shares[np.searchsorted(chance, _BY_CHANCE) - 1])
    low, high = 2.0 * off / share, min(float(each[0]) + off, _COARSE * off)
    count = math.log(max(high / low, 1.0)) * float(each[-1]) / (_NEAR_STEP * off)
    steps = np.geomspace(high, low, math.ceil(min(count, _MOST_STEPS)))
    few = slice(None, None, math.ceil(each.size / _FEW))  # of what is near all, most of some are: others are left out

    def near(some: Floats, at: slice) -> Floats:
        whole = some[:, None] * np.round(each[at] / some[:, None])
        return np.asarray(np.mean(np.abs(each[at] - whole) < (1.0 - _NEAR_STEP) * most[at], axis=1))

    for some in np.array_split(steps, math.ceil(steps.size / 10_000)) if steps.size else ():
        likely = some[near(some, few) > _LIKELY]
        if likely.size and (are_near := near(likely, slice(None))).max() > near_enough:
            return float(likely[np.argmax(are_near)])
    return None


def has_no_sign(v: Floats, u: Floats) -> bool:
    """Whether a velocity is a mere size: it rises from 0 in strokes of a negative drive as it does in positive ones."""
    if v.min() < 0.0 or u.min() >= 0.0 or u.max() <= 0.0:
        return False
    sign = np.sign(u)
    turns = np.flatnonzero(np.diff(sign, append=0.0))
    strokes = [(first, last) for first, last in pairwise([-1, *turns.tolist()]) if sign[last] != 0.0]
    rises = np.array([v[last] - 2.0 * v[first + 1 : last + 1].min() for first, last in strokes])
    forth, back = (float(np.median(rises[[sign[last] == way for _, last in strokes]])) for way in (1.0, -1.0))
    return back > 0.5 * forth > 0.0


def cut_off_at(v: Floats) -> float | None:
    """The largest size of a velocity, where it is cut off there; None where it is not.

    It jumps there, and stays to the last digit. A motor's own largest speed is come to ever more slowly, or has noise.
    """
    kept = held_rows(v)
    v = v if kept is None else v[kept]
    most = float(np.abs(v).max())
    sizes = np.unique(np.abs(v))
    steps = np.diff(sizes[sizes >= 10.0 ** math.floor(math.log10(most))]) if most > 0.0 else np.empty(0)
    if not steps.size:
        return None
    begins = np.flatnonzero(np.diff(v, prepend=np.nan))
    lasts = np.diff(np.append(begins, v.size))
    jumps = np.abs(v[begins] - v[np.maximum(begins - 1, 0)]) > _JUMPS_TO * float(steps.min())
    stays = (lasts >= _STAYS) & jumps & (v[begins] != 0.0)
    at_end = stays & ((v[begins] == v.max()) | (v[begins] == v.min()))
    rows, elsewhere = int(lasts[at_end].sum()), int(lasts[stays & ~at_end].sum())
    return most if at_end.sum() > 1 and rows >= _CUT_ROWS and elsewhere < _ELSEWHERE * rows else None


def is_of_one_count(v: Floats, t: Floats) -> bool:
    """Whether a velocity is one count over the time that it took, which shows in either of two ways.

    That time is a few ticks of a clock: one over each of the largest sizes is a whole number of them. Or a velocity
    stands until the next count, as long as this one takes.
    """
    sizes = np.unique(np.abs(v[v != 0.0]))[: -_SIZES - 1 : -1]
    if sizes.size >= _FEWEST_SIZES:
        most = _MOST_TICKS if sizes.size == _SIZES else 2  # fewer sizes are such by chance
        ticks = np.arange(1, most + 1)[:, None] * sizes[0] / sizes
        near = _NEAR_TICK + ticks * 0.5 * last_digit(v) / sizes
        whole = (np.abs(ticks - np.round(ticks)) < near) & (near < 2.0 * _NEAR_TICK)
        each = np.diff(np.round(ticks), axis=1)
        if np.any(whole.all(axis=1) & (each > 0.0).all(axis=1) & (np.median(each, axis=1) <= 2.0)):
            return True
    if held_rows(v) is not None:
        return False
    begins = np.flatnonzero(np.diff(v)) + 1
    before, after = v[begins[:-1]], v[begins[1:]]
    lasts_s, period_s = np.diff(t[begins]), float(np.median(np.diff(t)))
    # what is rounded stands, too; but then it goes on by a digit
    told = (lasts_s > 1.5 * period_s) & (before * after > 0.0) & (np.abs(after - before) > _FAR_DIGITS * last_digit(v))
    for below in (math.inf, _SLOW * float(np.abs(v).max())):  # at a steady speed some counts take alike times
        at = told & (np.abs(after) < below)
        if np.count_nonzero(at) < _FEWEST_STANDS:
            continue
        each_s, size = lasts_s[at], np.abs(after[at])
        as_long = np.abs(each_s - float(np.median(each_s * size)) / size) < 1.5 * period_s
        varies = float(np.std(np.log(each_s))) > _UNLIKE and float(np.std(size)) > 0.0
        if varies and np.corrcoef(np.log(each_s), np.log(size))[0, 1] < _INVERSE and np.mean(as_long) > _AS_LONG:
            return True
    return False
