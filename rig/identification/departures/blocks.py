"""How well a motor predicts motion that it has not seen: blocks, each from its first rows on, in folds.

The first rows of a block show where it starts, and how fast. From there the recorded drive alone says what follows. In
each fold the numbers are fitted to the other blocks; of three recordings and more, to those of the other recordings.
What is left is measured against 'it stays as it was', and beside it stands a linear model, which has no friction, in
the same folds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.departures.fit import Enough, Fit, Problem, solve
from rig.identification.departures.fit import start as begin
from rig.identification.departures.pieces import Cut
from rig.identification.noise import WHITE
from rig.identification.side_by_side import side_by_side
from rig.model.real_motor import RealMotor

BLOCK_S, BLOCK_TAUS = 2.0, 3.0  # length of a block: the longer of both,
FEWEST_BLOCKS = 8  # but so short that there are as many
SHORTEST_BLOCK_S = 0.15
SHOWN_S, SHOWN_ROWS, SHOWN_SHARE = 0.1, 5, 0.34  # of a block: what shows its start
FOLDS = 4
FEWEST_RECORDINGS = 3  # of two, one alone would say all
TURNS = 0.05  # of the whole travel: a recording that moves so far one way turns that way
FOLD_ITERATIONS, START_ITERATIONS = 6, 8
FOLD_ENOUGH = Enough(0.01, 1e-4)  # its share is by how much an error in blocks may be off
SURE = 1.64  # standard errors: one side of 95 %
MOST_ERROR = 0.5  # of a motor that predicts
THAN_LINEAR, ALIKE = 1.1, 0.02  # times the linear model's error, at most; so much more is no difference


@dataclass(frozen=True, eq=False)
class Blocks:
    """The tests in blocks.

    cut     the blocks
    shown   (n,) of each row whether it shows the start of its block
    """

    cut: Cut
    shown: NDArray[np.bool_]

    @classmethod
    def of(cls, whole: Cut, tau_s: float, least: tuple[float, float] = (BLOCK_S, BLOCK_TAUS)) -> Blocks:
        """Of tests, for a motor of this time constant; ``least``: how long they are, s, and in time constants."""
        total_s = sum(window.duration_s for window in whole.windows)
        length_s = max(least[0], least[1] * tau_s if math.isfinite(tau_s) else 0.0)
        length_s = max(min(length_s, total_s / FEWEST_BLOCKS), SHORTEST_BLOCK_S)
        cut = whole.every(length_s)
        since_s = cut.t_s - cut.t_s[cut.begins][cut.piece]
        row = np.arange(cut.t_s.size) - cut.begins[cut.piece]
        most = np.maximum(3, (SHOWN_SHARE * np.array(cut.lengths)).astype(int))[cut.piece]
        return cls(cut, ((since_s <= SHOWN_S) | (row < SHOWN_ROWS)) & (row < most))

    @property
    def length_s(self) -> float:
        """Length of a block, s."""
        return float(np.median(self.cut.durations_s))

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return int(self.cut.begins.size)

    def off_rad(self, motor: RealMotor, problem: Problem, *, starts_known: bool = False) -> Array:
        """(n,) predicted less recorded, rad, of each row; 0 where a row shows the start.

        starts_known   the start of a block is fitted to all of its rows, and none is left out: noise of the start is no
                       error of the motor
        """
        weight = None if starts_known else self.shown.astype(float)
        starts = solve(
            begin(_of_starts(problem, replace(self.cut, weight=weight)), motor), START_ITERATIONS, FOLD_ENOUGH
        ).starts
        off = self.cut.readings(motor, starts) - self.cut.y_rad
        off = np.where(np.isfinite(off), off, np.inf)
        return off if starts_known else np.where(self.shown, 0.0, off)

    def stays_rad(self) -> Array:
        """(n,) what is left of each row if it stays as it was, rad."""
        last = np.maximum.accumulate(np.where(self.shown, np.arange(self.shown.size), 0))
        return np.where(self.shown, 0.0, self.cut.y_rad - self.cut.y_rad[last])

    def squares(self, rows: Array) -> Array:
        """(p,) sum of squares of each block, rad^2; ``rows``: (n,), rad."""
        return np.add.reduceat(rows**2, self.cut.begins)

    def error(self, motor: RealMotor, problem: Problem) -> float:
        """RMS error of a motor over that of 'it stays as it was'; of a motor that was fitted to all blocks."""
        return _ratio(self.squares(self.off_rad(motor, problem)), self.squares(self.stays_rad()))

    def folds(self) -> NDArray[np.int64]:
        """(p,) the fold of each block: of several recordings each is predicted from the others, as far as they can.

        They can where the others turn both ways, if all together do.
        """
        by_block = np.arange(self.count) % min(FOLDS, self.count)
        windows, names = self.cut.windows, list(dict.fromkeys(self.cut.of))
        if len(names) < FEWEST_RECORDINGS:
            return by_block
        of_window = np.array([names.index(name) for name in self.cut.of]) % FOLDS
        span_rad = max(float(np.ptp(window.y_rad)) for window in windows)
        turns = np.array([_turns(window.y_rad, TURNS * span_rad) for window in windows])
        for fold in range(int(of_window.max()) + 1):
            if np.any(turns.any(axis=0) & ~turns[of_window != fold].any(axis=0)):
                return by_block
        return np.repeat(of_window, [rows.size for rows in self.cut.rows])

    def held_out(self, problem: Problem, motor: RealMotor, *, starts_known: bool = False) -> Array:
        """(p,) sum of squares of each block, rad^2, predicted by the numbers that the others say.

        problem        which numbers are free, and their limits
        motor          the fit to all blocks
        starts_known   as ``off_rad``
        """
        folds = self.folds()

        def left(held: NDArray[np.bool_]) -> Array:
            trained = motor
            if not held.all():
                given = replace(problem, cut=self.cut.only(~held), robust_rad=math.inf, noise=WHITE, known=None)
                trained = solve(begin(given, motor), FOLD_ITERATIONS, FOLD_ENOUGH).motor
            unseen = Blocks(self.cut.only(held), self.shown[held[self.cut.piece]])
            return unseen.squares(unseen.off_rad(trained, problem, starts_known=starts_known))

        found, helds = np.zeros(self.count), [folds == fold for fold in range(int(folds.max()) + 1)]
        for held, squares in zip(helds, side_by_side(left, helds, self.shown.size), strict=True):
            found[held] = squares
        return found


def _turns(y_rad: Array, least_rad: float) -> tuple[bool, bool]:
    """Whether the shaft turns forward, and backward, by more than ``least_rad``."""
    forth = float(np.max(y_rad - np.minimum.accumulate(y_rad)))
    back = float(np.max(np.maximum.accumulate(y_rad) - y_rad))
    return forth > least_rad, back > least_rad


def share_cut(full: Array, bare: Array, noise: Array) -> float:
    """The share of the error in blocks that laws take away, at most 1; below 0 they add to it.

    full, bare   (p,) sums of squares of each block with and without them, beyond the sensor's noise, rad^2
    noise        (p,) by how much what the sensor's noise is of each differs by chance, rad^2, > 0
    It is the smaller one of two: of all blocks together, which a single large one may decide, and of their geometric
    mean, which the small ones may. A law of the motor cuts both. A block at rest, which noise alone fills with and
    without laws, has nothing to cut: where the other blocks say more than chance does, each counts by the share of its
    squares that is more than noise.
    """
    if not np.all(np.isfinite(full)):
        return -math.inf  # with the laws it takes too many steps
    of_all = math.sqrt(max(float(full.sum()), 1e-300) / max(float(bare.sum()), 1e-300))
    cuts = 0.5 * np.log((bare + noise) / (full + noise))
    beyond = np.maximum(full, bare)
    weight = np.maximum(beyond / (beyond + noise), 1e-12)
    weight /= weight.sum()
    mean = float(weight @ cuts)
    error = math.sqrt(float(weight @ (cuts - mean) ** 2) / max(1.0 / float(weight @ weight) - 1.0, 1.0))
    of_each = math.exp(-max(float(cuts.mean()), mean if mean > SURE * error else -math.inf))
    return 1.0 - max(of_all, of_each)


class HeldOut(NamedTuple):
    """What a motor predicts, and a linear model in the same folds.

    error, linear_error   RMS error over that of 'it stays as it was'
    block_s, blocks       length and number of the blocks
    """

    error: float
    linear_error: float
    block_s: float
    blocks: int

    @property
    def is_useful(self) -> bool:
        """Whether it predicts: its error is not large, and hardly larger than the linear model's."""
        return self.error <= MOST_ERROR and self.error <= max(
            THAN_LINEAR * self.linear_error, self.linear_error + ALIKE
        )


def held_out(blocks: Blocks, problem: Problem, motor: RealMotor) -> HeldOut:
    """Of a fitted motor, beside the linear model of the same order."""
    stays = blocks.squares(blocks.stays_rad())
    own = _ratio(blocks.held_out(problem, motor), stays)
    straight = linear(blocks, problem, motor)
    return HeldOut(own, _ratio(blocks.held_out(straight.problem, straight.motor), stays), blocks.length_s, blocks.count)


def held_out_error(blocks: Blocks, problem: Problem, motor: RealMotor) -> float:
    """RMS error of a fitted motor over that of 'it stays as it was'."""
    return _ratio(blocks.held_out(problem, motor), blocks.squares(blocks.stays_rad()))


def linear(blocks: Blocks, problem: Problem, motor: RealMotor) -> Fit:
    """The linear model: no friction, no laws, fitted to all blocks."""
    free = tuple(name for name in problem.free if name in ("tau_s", "K_rad_s_V", "bias_V", "delay_s"))
    given = replace(problem, cut=blocks.cut, free=free, robust_rad=math.inf, noise=WHITE)
    plain = RealMotor(motor.tau_s, 0.8 * motor.K_rad_s_V, 0.0, motor.bias_V, motor.delay_s)
    starts = (plain, plain._replace(tau_s=3.0 * motor.tau_s), plain._replace(tau_s=motor.tau_s / 3.0))
    tried = [solve(begin(given, one), 12, FOLD_ENOUGH) for one in starts]
    return solve(min(tried, key=lambda fit: fit.cost))


def _of_starts(problem: Problem, cut: Cut) -> Problem:
    return replace(problem, cut=cut, free=(), robust_rad=math.inf, noise=WHITE, known=None)


def _ratio(squares: Array, stays: Array) -> float:
    total = float(stays.sum())
    return math.sqrt(float(squares.sum()) / total) if total > 0.0 else math.inf
