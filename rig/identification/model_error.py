"""Errors of the model itself: pieces of the tests that say different numbers, and low and high drives that do.

On a motor that is what the model says both are no larger than the scatter of the fit tells, and add nothing. On another
the pieces differ by more than that, for the noise of each is not the cause: then what they differ by says how far the
numbers may be off (a sandwich covariance over pieces, and half the difference between the halves with low and with high
drive). The numbers of a record differ by much the same ratio, and few pieces tell each one's own badly: so what the
others say joins it, of white noise all that the fit has. Neither sees an error that all pieces share. Where the model
leaves far more than noise, 3 % stands for it, but not for a plain motor that predicts to a part in 200: what is left
there is rounding, or noise of a velocity. It stands for three laws and more, too, whatever they leave: so many stand in
for something that no law here describes.

A law of the catalogue is not quite that of a bench. Where a fit with one or two laws leaves white noise, or rounding
to the sensor's steps, they are the bench's. Else what a law leaves beyond noise, over what is left without it, is the
share of its motion that is not the bench's; twice that share of what the law moves a number by stands for what the
number is off, and at most three tenths of it. Friction may move by more than itself: without a law of friction f_c has
in it what the law took.

A drive that bends, as by a sag, has numbers for its bend, and a dead band is one more. Each size of drive tells one
number: K, then those of the bend. Where the tests hold no more sizes than that, any bend fits, as of a stage that gives
less than its largest drive: no record tells it. Where they hold more, and the fit leaves more than noise, the bend is
another one. Nor does a record tell whether a dead band comes before a sag or behind it: there K is larger by 2 s d, and
f_c smaller, for u - d - s u^2 is (1 - 2 s d) u' - s u'^2 with u' = u - d, but for d^2.

Of a record with one size of drive, which acts as a share of itself, tau is known, and K times that share, and K f_c:
speeds that it drives to, reversals and coasting have nothing else in them. So no record of that kind shows a dead band,
or a stage that gives less, and K and f_c are as uncertain as that share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.identification.chance import chi_squared_quantile, student_975
from rig.identification.departures.budget import COVERAGE, Entry
from rig.identification.departures.departure import UNIFORM
from rig.identification.departures.fit import DELAY, POSITIVE, Fit, refitted, solve, sums_of_pieces, to_diagonal_1, unit
from rig.identification.departures.fit import start as begin
from rig.identification.departures.laws import LONG_DELAY_S, TAKEN
from rig.identification.departures.nuisances import OF
from rig.identification.departures.pieces import Cut
from rig.model.real_motor import is_plain
from rig.run_folder.recording.series import Window

CHANCE = 0.005  # that pieces of a motor that the model describes seem to differ
FEWEST_PIECES = 6
NORMAL = 3.0  # fourth moment of a normal distribution over the square of its variance
APART = 1.15  # drive of the half with high drives over that of the other: less tells nothing
DIFFER = 2.5  # standard deviations by which the halves must differ
PIECES = "pieces that differ"
DRIVES = "low and high drive"
LEFT = "what the model leaves out"
LIKE = "laws that are only like the bench's"
ALIKE = 0.3  # of what a law moves a number by, at most
FARTHEST = 0.5  # of tau or K: a fit without the law that is farther off has lost its way, and counts as that far
LEAVES = 3.0  # residual over the sensor's noise of a fit that leaves more than noise: then pieces may share an error
SHARED = 0.03  # of each number
MANY_LAWS = 3
ONE_DRIVE, OFTEN = 0.02, 0.02  # of the largest drive: within it two are one size; of the time: less is no size
ALIKE_DRIVES = 0.1  # of the largest drive: within it two tell little of a bend; and noise of a drive that was measured
BY_CHANCE = 3.0  # standard errors of a stroke's mean
STAIRS, RAMPS = 5, 1.0 / 3.0  # drives of a stroke, at least, and of its time, at most, where it is ramped at its ends
FAR_BENT = 0.35  # of the largest drive: a sag of more is another bend, such as saturation; benches have 30 % at most
BENDS = "a bend of the drive"
ORDER = "a dead band before or behind the sag"
BY_SIZE = ("sag", "source")
BENDS_BY = {"sag": 1, "source": 2, "dead_band": 1}  # numbers of what acts of each size of drive
ONE_SIZE = "one size of drive"
OF_READINGS = "a lag of the readings"
UNTOLD = "a dead band that never shows"
TIMES = "times of the drives"
NOT_SHOWN = {
    ONE_SIZE: "one size of drive does not tell how much of it friction takes; record drives of several sizes",
    UNTOLD: "what a dead band of the drive takes is in f_c, for the drive never brakes the shaft, nor coasts; record "
    "strokes that it reverses, or rests at 0 V while the shaft turns",
}
WAITED = (
    "when its drives acted is reckoned from exchanges that waited; end what else runs on this machine, or take a USB "
    "adapter that waits less"
)
PREDICTED = 0.005  # error in blocks of a plain motor that leaves nothing to share


class ModelError(NamedTuple):
    """Lines of the budget, and how many rows say as much as one, >= 1: by how much pieces differ more than noise.

    effect   of all numbers
    of_each  of tau, K and friction
    """

    lines: tuple[Entry, ...] = ()
    effect: float = 1.0
    of_each: tuple[float, ...] = (1.0, 1.0, 1.0)

    def with_rounding(self, grown: Array) -> ModelError:
        """The same, with no less scatter than a sensor's rounding makes.

        grown   (3,) by how much it makes a variance larger, 1
        """
        of_all = float(np.exp(np.mean(np.log(grown))))
        return self._replace(effect=max(self.effect, of_all), of_each=tuple(np.maximum(self.of_each, grown).tolist()))


def model_error(fit: Fit, blocks: Cut, predicts: float, laws: int = 0) -> ModelError:
    """The lines of the budget for what pieces, and low and high drives, differ by; none where they do not.

    fit        by least squares, with its noise
    blocks     the tests in blocks: they count where the fit's own pieces are longer
    predicts   error of its motor in blocks that it has not seen, 1
    laws       how many it has
    """
    leaves = fit.rms_rad > LEAVES * fit.noise_rad and not (is_plain(fit.motor) and predicts < PREDICTED)
    if fit.problem.cut.longest_s > 1.01 * blocks.longest_s:
        given = replace(fit.problem, cut=blocks)
        at_these = solve(begin(replace(given, free=()), fit.motor))
        fit = refitted(replace(at_these, problem=given))
    matrix, gradient = sums_of_pieces(fit.rows, fit.problem.cut.begins)
    free = fit.problem.free
    at = [free.index(name) for name in OF if name in free]
    if gradient.shape[0] < FEWEST_PIECES or len(at) < len(OF):
        return ModelError()
    size = np.array([getattr(fit.motor, name) if name in POSITIVE else 1.0 for name in OF])
    others = [k for k in range(len(free)) if k not in at] if fit.problem.noise.white else []
    beyond, effect, each = beyond_noise(matrix, gradient, unit(fit), [*at, *others], as_noise=not leaves)
    of_pieces, of_each = beyond[: len(at)], each[: len(at)]
    lines = (of_pieces, _drives(matrix, gradient, unit(fit), at, _drive_V(fit.problem.cut)))
    found = [
        Entry(source, *(half * size).tolist())
        for source, half in zip((PIECES, DRIVES), lines, strict=True)
        if half.any()
    ]
    if leaves or laws >= MANY_LAWS:
        found.append(Entry(LEFT, *(SHARED * abs(getattr(fit.motor, name)) for name in OF)))
    return ModelError(tuple(found), effect, tuple(of_each.tolist()))


def only_like(
    fit: Fit, bare: Iterable[Fit], near: Iterable[tuple[Fit, float]] = (), laws: int = 0
) -> tuple[Entry, ...]:
    """The line for laws that leave more than white noise, or that are many: what they may be off.

    fit    with its noise
    bare   for each of its laws the fit without it: the law takes away what that leaves more
    near   with other laws in place of one, which leave hardly more, and how much each counts: the motor may be that one
    laws   how many it has
    """
    if fit.problem.noise.white and laws < MANY_LAWS:
        return ()
    others = list(bare)
    here = np.array([getattr(fit.motor, name) for name in OF])
    there = np.array([[getattr(one.motor, name) for name in OF] for one in others]).reshape(-1, len(OF))
    moves, most = np.abs(there - here), FARTHEST * np.abs(here)
    lost = np.any(moves[:, :2] > most[:2], axis=1)
    moves = np.where(lost[:, None], np.minimum(moves, most), moves)
    if laws < MANY_LAWS:
        white = min(unit(fit), 1.0) * fit.problem.sigma_rad**2
        left, all_of_it = (np.sqrt([max(one.rms_rad**2 - white, 0.0) for one in each]) for each in ([fit], others))
        moves *= np.minimum(COVERAGE * left / np.maximum(all_of_it, 1e-300), ALIKE)[:, None]
    else:
        moves *= ALIKE
    apart = [count * np.abs([getattr(one.motor, name) for name in OF] - here) for one, count in near]
    half = np.max([np.sqrt((moves**2).sum(axis=0)), *apart], axis=0)
    return (Entry(LIKE, *half.tolist()),) if half.any() else ()


def any_bend(fit: Fit, bare: Mapping[str, Fit], *, goes_along: bool = False) -> tuple[Entry, ...]:
    """The line for a law that bends the drive, where the tests do not say that this is the bend.

    They hold too few sizes of it, or leave more than noise, or it takes more than any bench's. Else for the order of it
    and a dead band.

    bare         for each law of ``fit`` the fit without it
    goes_along   whether the drive always pushes the way that the shaft turns, and never rests: then f_c is told by the
                 sizes, too, and a dead band is in it
    """
    bent = [name for name in BY_SIZE if name in bare]
    numbers = 1 + goes_along + sum(BENDS_BY.get(name, 0) for name in bare)
    is_told = drive_sizes(fit.problem.cut) > numbers and fit.rms_rad <= LEAVES * fit.problem.sigma_rad
    largest_V = float(np.abs(_drives_of(fit.problem.cut)[0]).max())
    far = abs(fit.motor.sag_per_V) * largest_V > FAR_BENT
    if not bent:
        return ()
    if is_told and not far:
        dead_V = min(TAKEN * largest_V, fit.motor.fc_V) if goes_along else fit.motor.dead_band_V
        share = 2.0 * abs(fit.motor.sag_per_V) * dead_V
        of_both = Entry(ORDER, 0.0, share * fit.motor.K_rad_s_V, share * fit.motor.fc_V, laws=("sag", "dead_band"))
        return (of_both,) if share else ()
    here = np.array([getattr(fit.motor, name) for name in OF])
    moves = [np.abs([getattr(bare[name].motor, one) for one in OF] - here) for name in bent]
    tau_s, K, fc_V = np.minimum(np.max(moves, axis=0), np.abs(here)).tolist()
    fc_V = max(fc_V, K / here[1] * here[2]) if far else fc_V  # the drive of friction bends as small drives do
    return (Entry(BENDS, tau_s, K, fc_V, laws=tuple(bent)),)


def of_long_lag(fit: Fit, bare: Mapping[str, Fit], late_s: float) -> tuple[Entry, ...]:
    """The line for a lag that is longer than any drive's: of the readings, it hides what friction does at reversals.

    bare     as for ``any_bend``: what the other laws took from f_c there may be friction
    late_s   delay from which on a bench is late
    A delay as long may be one, too, where the fit leaves more than noise: then what it makes late is partly tau's.
    """
    leaves = fit.rms_rad > LEAVES * fit.problem.sigma_rad
    lag_s = fit.motor.delay_s if leaves and fit.motor.delay_s > max(late_s, LONG_DELAY_S) else 0.0
    if max(lag_s, fit.motor.lag_s) < LONG_DELAY_S:
        return ()
    taken_V = [fit.motor.dead_band_V, *(one.motor.fc_V - fit.motor.fc_V for name, one in bare.items() if name != "lag")]
    taken = COVERAGE * float(np.abs(taken_V).max())
    return (Entry(OF_READINGS, lag_s, 0.0, max(taken, ALIKE * abs(fit.motor.fc_V))),)


def of_shift(fit: Fit, shift_s: float) -> tuple[Entry, ...]:
    """The line for drives that may all have acted earlier or later than they say, by up to so much, s.

    It is as likely to be any of that. A delay that is fitted takes it in.
    """
    if shift_s <= 0.0 or DELAY in fit.problem.free:
        return ()
    moved = solve(refitted(fit, motor=fit.motor._replace(delay_s=fit.motor.delay_s + shift_s)))
    expanded = COVERAGE / UNIFORM
    return (Entry(TIMES, *(expanded * abs(getattr(moved.motor, name) - getattr(fit.motor, name)) for name in OF)),)


def of_one_size(fit: Fit) -> tuple[Entry, ...]:
    """The line for what acts of a drive of one size, each way; none where the drives have several."""
    if not _is_one_size(fit.problem.cut):
        return ()
    return (Entry(ONE_SIZE, 0.0, TAKEN / (1.0 - TAKEN) * fit.motor.K_rad_s_V, TAKEN * abs(fit.motor.fc_V)),)


def _is_one_size(cut: Cut) -> bool:
    """Whether nearly all drives of a direction are alike, in both: a size more in one of them alone is its asymmetry's.

    Drives at 0 and near it do not count. The drives of a stroke may scatter, as measured ones do: their mean counts.
    """
    largest_V = float(np.abs(_drives_of(cut)[0]).max())
    for way in (1.0, -1.0):
        strokes = [(way * u_V, last_s) for u_V, last_s in _strokes(cut, ONE_DRIVE * largest_V) if way * u_V[0] > 0.0]
        if not strokes:
            continue
        since_s = np.array([last_s.sum() for _, last_s in strokes])
        mean_V = np.array([u_V @ last_s / last_s.sum() for u_V, last_s in strokes])
        chance_V = BY_CHANCE * np.array([u_V.std() / math.sqrt(u_V.size) for u_V, _ in strokes])
        order = np.argsort(mean_V)
        middle_V = mean_V[order][np.searchsorted(np.cumsum(since_s[order]), 0.5 * since_s.sum())]
        others_s = since_s[np.abs(mean_V - middle_V) > ONE_DRIVE * largest_V + chance_V].sum()
        far_s = sum(float(last_s[np.abs(u_V - middle_V) > ALIKE_DRIVES * largest_V].sum()) for u_V, last_s in strokes)
        if max(others_s, far_s) > OFTEN * since_s.sum():
            return False
    return True


def _strokes(cut: Cut, least_V: float) -> Iterator[tuple[Array, Array]]:
    """The drives of each stroke one way, beyond ``least_V``, V, and for how long they act, s; without its ramps."""
    for window in cut.windows:
        u_V, last_s = _drives_in(window)
        way = np.where(np.abs(u_V) > least_V, np.sign(u_V), 0.0)
        begins = np.append(0, np.flatnonzero(np.diff(way)) + 1)
        for first, stop in pairwise([*begins.tolist(), way.size]):
            if way[first] and last_s[first:stop].sum() > 0.0:
                held = slice(first, stop) if stop - first < STAIRS else _held(u_V, last_s, first, stop, least_V)
                yield u_V[held], last_s[held]


def _held(u_V: Array, last_s: Array, first: int, stop: int, least_V: float) -> slice:
    """Where a drive is held between a ramp up and a ramp down; all of it where these take long, as of a sine.

    first, stop   of its stroke
    least_V       of a stair, V

    A device may ramp its drive. And where rows are taken as one, the first and last drive of a stroke may be the mean
    of two strokes.
    """
    up, down = first, stop - 1
    while up < down and abs(u_V[up]) < abs(u_V[up + 1]) - least_V:
        up += 1
    while down > up and abs(u_V[down]) < abs(u_V[down - 1]) - least_V:
        down -= 1
    is_short = last_s[up : down + 1].sum() >= (1.0 - RAMPS) * last_s[first:stop].sum()
    return slice(up, down + 1) if is_short else slice(first, stop)


def drive_sizes(cut: Cut) -> int:
    """How many sizes of drive the tests hold that tell a bend, beside 0: those that act for some time."""
    u_V, last_s = _drives_of(cut)
    u_V = np.abs(u_V)
    order = np.argsort(u_V)
    order = order[u_V[order] > ONE_DRIVE * u_V.max()]
    count, driven_s = 0, float(last_s[order].sum())
    while order.size:
        alike = u_V[order] < u_V[order[0]] + ALIKE_DRIVES * u_V.max()
        count += float(last_s[order[alike]].sum()) >= OFTEN * driven_s
        order = order[~alike]
    return count


def _drives_of(cut: Cut) -> tuple[Array, Array]:
    """Every drive of the tests, V, and for how long it acts, s."""
    sizes, lasts = zip(*map(_drives_in, cut.windows), strict=True)
    return np.concatenate(sizes), np.concatenate(lasts)


def _drives_in(window: Window) -> tuple[Array, Array]:
    steps = window.steps
    return steps.u_V, np.diff(np.append(steps.edge_s, max(window.t_s[-1], steps.edge_s[-1])))


def beyond_noise(
    matrix: Array, gradient: Array, noise: float, at: Sequence[int], *, as_noise: bool = True
) -> tuple[Array, float, Array]:
    """(k,) half widths that pieces show beyond the scatter of as many rows as count, and how many rows count as one.

    matrix, gradient   (p, m, m) and (p, m): normal equations of each piece
    noise              variance of its rows
    at                 (k,) which numbers
    as_noise           whether pieces are taken to differ by noise alone until chance hardly makes them differ so
    How many count as one is for all numbers, and (k,) for each. Degrees of freedom are those of normal pieces as
    unequal as these are, by what each says of a number and by how far it moves it, whichever are fewer.

    By how much more than noise a number differs between few pieces is hardly known from that number, and the numbers of
    a record differ by much the same ratio. So what the others say joins it, as far as they move otherwise than it does
    (as the moderated variances of Smyth, Stat. Appl. Genet. Mol. Biol. 3, 2004).
    """
    inverse = _inverse(matrix.sum(axis=0))
    moves = -(gradient @ inverse)[:, at]
    moves = moves - moves.mean(axis=0)
    count = moves.shape[0]
    squares = (moves**2).sum(axis=0) * count / max(count - gradient.shape[1] / 2.0, 1.0)
    naive = np.maximum(np.diag(inverse)[at] * noise, 1e-300)
    by_noise = np.maximum(np.einsum("ik,pkl,li->pi", inverse[at], matrix, inverse[:, at]), 0.0)
    effective = np.maximum(np.minimum(_as_many(by_noise) - 1.0, NORMAL * _as_many(moves**2) - 2.0), 1.0)
    own = np.maximum(squares / naive, 1e-300)
    freedom = float(effective.max())
    of_all = float(np.exp(np.average(np.log(own), weights=effective)))
    if of_all <= (chi_squared_quantile(freedom, CHANCE) / freedom if as_noise else 1.0):
        return np.zeros(len(at)), 1.0, np.ones(len(at))
    products = moves.T @ moves
    alike = products**2 / np.maximum(np.outer(np.diag(products), np.diag(products)), 1e-300)
    weight = effective * np.maximum(1.0 - alike - np.eye(len(at)), 0.0)
    of_others = np.exp(weight @ np.log(own) / np.maximum(weight.sum(axis=1), 1e-300))
    joining = np.minimum(weight.sum(axis=1), freedom)
    of_each = np.maximum((effective * own + joining * of_others) / (effective + joining), 1.0)
    sure = np.array([student_975(one) for one in effective + joining])
    beyond = np.sqrt(np.maximum(sure**2 - COVERAGE**2, 0.0) * of_each * naive)
    return beyond, of_all, of_each


def _as_many(squares: Array) -> Array:
    """(k,) by how many of equal size the (p, k) ``squares`` count (Satterthwaite, Biometrics Bulletin 2, 1946)."""
    return np.asarray(squares.sum(axis=0) ** 2 / np.maximum((squares**2).sum(axis=0), 1e-300))


def _drives(matrix: Array, gradient: Array, noise: float, at: Sequence[int], drive_V: Array) -> Array:
    """(3,) half the difference between the halves with low and with high drive, less what chance makes it.

    noise   variance of the rows: pieces that are alike by luck do not make chance smaller than it does
    """
    nothing = np.zeros(len(at))
    high = drive_V > np.median(drive_V)
    if min(np.count_nonzero(high), np.count_nonzero(~high)) < FEWEST_PIECES // 2:
        return nothing
    if drive_V[high].mean() < APART * drive_V[~high].mean():
        return nothing
    found, variance = [], []
    for half in (high, ~high):
        inverse = _inverse(matrix[half].sum(axis=0))
        moves = -(gradient[half] @ inverse)[:, at]
        found.append(moves.sum(axis=0))
        off = moves - moves.mean(axis=0)
        by_pieces = (off**2).sum(axis=0) * len(off) / max(len(off) - 1, 1)
        variance.append(np.maximum(by_pieces, np.diag(inverse)[at] * noise))
    difference, chance = found[0] - found[1], variance[0] + variance[1]
    shows = difference**2 > DIFFER**2 * chance
    return np.where(shows, 0.5 * np.sqrt(np.maximum(difference**2 - chance, 0.0)), 0.0)


def _drive_V(cut: Cut) -> Array:
    """(p,) RMS drive of each piece, V."""
    found = []
    for window, rows in zip(cut.windows, cut.rows, strict=True):
        u_V = _at_rows(window)
        found.append(np.sqrt(np.add.reduceat(u_V**2, rows) / np.diff(np.append(rows, u_V.size))))
    return np.concatenate(found)


def _at_rows(window: Window) -> Array:
    """(n,) the drive that acts at each row, V."""
    steps = window.steps
    return steps.u_V[np.maximum(np.searchsorted(steps.edge_s, window.t_s, side="right") - 1, 0)]


def _inverse(matrix: Array) -> Array:
    scale = to_diagonal_1(matrix)
    return np.asarray(
        np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-12, hermitian=True) * np.outer(scale, scale)
    )
