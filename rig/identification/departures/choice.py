"""Which laws a motor has: forward and backward over all departures, on pieces that grow.

On short pieces the plain motor's fit is near enough for the effect of every departure to be linear. So one Jacobian
shows what each would gain. The best few are fitted, the best of these is taken, and so on; what loses its worth is
dropped again. Then the pieces grow, and the choice is made again where it starts (docs/theory.md 12.7).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.departures.blocks import Blocks, share_cut
from rig.identification.departures.departure import NOTHING, UNIFORM, Bench, Departure
from rig.identification.departures.fit import (
    ENOUGH,
    Enough,
    Fit,
    Known,
    Normal,
    Problem,
    Rows,
    limits_of,
    refitted,
    sigma_of,
    solve,
    solved,
    start,
    unit,
)
from rig.identification.departures.pieces import Cut
from rig.identification.departures.prediction import rise_by_law
from rig.identification.noise import WHITE
from rig.identification.side_by_side import side_by_side
from rig.model.real_motor import RealMotor, index

ORDER = "cogging_per_rad"  # of a wave over the angle: without its size it has no effect on the motion
CYCLES = (0.9, 2.5, 6.0)  # lengths of the pieces, in cycles; then the whole tests
TRIED = 3  # laws that are fitted, of those that promise most
TRIAL_ITERATIONS = 12
NEAR = 0.05  # of what a law must bring: above noise or behind steps a trial that gains less in a step is near its end
FINISHED = 0.1  # residual of such a trial over that without its law, below which it is fitted to its end
RESHAPED = 2  # starts of a law's shape that are fitted again on longer pieces
MOST = 4  # laws of one motor
ROBUST = 3.0  # residuals beyond so many standard deviations count by their size
GROWN = 1.05  # growth of the RMS residual from one length of pieces to the next that ends the growth
HIDDEN = 1.4  # residual over the noise of a coarse sensor's steps up to which they hide what a motor leaves
PREDICTED = 2.5  # largest length of a piece that is predicted from others, cycles
AT_NOISE = 1.05  # scatter of the residual over the sensor's noise of a fit that leaves nothing to explain
FIRST_STEP = 1.0  # first size of a law, at most so many times its range
# of a step: the error of rounding is half a step at most, a start's comes on top; normal noise of its size leaves 98 %
WITHIN_STEP, NEARLY_ALL = 0.65, 0.99
OF_STEP = 0.5  # mean way from row to row, of a step of the sensor: below it rows lie within the steps
STEPS_SHOW = 2.0  # coloured noise over white noise in a residual that is a coarse sensor's steps
# length of blocks in which a law must show, s, in time constants, and in steps of the sensor: the longest of them
LAW_BLOCK, LAW_STEPS = (0.5, 6.0), 32.0
# Error in blocks of a plain motor that needs no law, if laws move tau, K and friction by no more than a share of each;
# friction counts as no smaller than so much of the largest drive
FINE, MOVES, SMALL = 1e-3, 0.025, 0.03
NOTHING_OF_RANGE = 0.01  # size of a law over its range, below which it is rounding
LOST = 30.0  # residual over noise from which on rows are not compared with noise, but with what a fit leaves of most
BENT = 2.0  # growth of the residual in a fit with its noise beyond which it is no noise
FAR, FIRST_CUT = 8.0, 0.08  # residual over noise of a fit where a law must show at once, by this share of it
LEAPS = (0.35, 0.5, 0.7, 0.85, 1.2, 1.45, 1.7, 2.0)  # sizes that are looked at beside that of a law that leaps, over it
LEAP_ITERATIONS = 4
# From where a fit begins anew beside its end, standard deviations of friction; and its steps
ASIDE, NEAR_BY = 2.0, 6
VALLEY = (0.5, 1.0, 2.0)  # sizes that are looked at about that with which a law in a valley begins, over it
ONE_WAVE_RAD = 0.5  # between two waves at the ends of the travel, up to which they may be one
ALIKE = 1e-11  # of a singular value of scaled columns: such columns say the same
CHANCE = 3.84  # chi-squared of one degree, 95 %
FAINT = 200.0  # twice the log likelihood that a law brings, up to which something else may stand in its place


Trial = Mapping[str, float]
Ends = dict[frozenset[str], tuple[float, tuple["Fit", tuple[Departure, ...]] | None]]  # by names of laws: cost, end


class Asked(NamedTuple):
    """What a law must bring, in units of twice the log likelihood; beyond Schwarz's criterion, where nothing is said.

    entry     to enter: at most one of a hundred plain motors gets a law (docs/theory.md 12.7)
    stay      to stay
    predicts  rise for what was not fitted; nothing beyond it: 4 are odds of 7 to 1
    cuts      share of the error beyond the sensor's noise that a law must take away in blocks that were not fitted: in
              all together, and in their geometric mean
    """

    entry: float = 5.0
    stay: float = 2.5
    predicts: float = 4.0
    cuts: float = 0.25


ASKED = Asked()


@dataclass(frozen=True)
class Promise:
    """What a law would gain, by the linear model.

    gain      fall of the sum of squares
    law       the law
    first     numbers and shape to start a fit from
    """

    gain: float
    law: Departure
    first: Mapping[str, float]


@dataclass(frozen=True)
class Choice:
    """The chosen laws and the fit with them.

    laws      in the order in which they were found
    fit       of the longest pieces that the motor bears
    growth    length of the pieces, s, and the RMS residual on them, rad
    """

    laws: tuple[Departure, ...]
    fit: Fit
    growth: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Chooser:
    """How laws are chosen.

    candidates  the laws
    bench       sizes that their ranges are measured in
    core        plain numbers that are fitted
    delay_s     bounds of the delay, s
    sigma_rad   the sensor's noise, rad
    step_rad    its step, rad; 0: none is known
    asked       what a law must bring
    known       what is known of the numbers from beside the tests; None: nothing
    """

    candidates: Sequence[Departure]
    bench: Bench
    core: tuple[str, ...]
    delay_s: tuple[float, float]
    sigma_rad: float
    step_rad: float = 0.0
    asked: Asked = ASKED
    known: Known | None = None

    def choose(self, whole: Cut, motor: RealMotor, cycle_s: float) -> Choice:
        """From a motor near the true one: a plain one, or with laws, which then are the first."""
        laws = tuple(law for law in self.candidates if any(getattr(motor, name) for name in law.numbers))
        if self.candidates and not laws and self._steps_hide(whole, motor):
            return replace(self, candidates=()).choose(whole, motor, cycle_s)
        growth: list[tuple[float, float]] = []
        hidden_rad = HIDDEN * self.sigma_rad if self.within_steps else 0.0
        fit: Fit | None = None
        lengths_s = [*(cycles * cycle_s for cycles in CYCLES), math.inf]
        while lengths_s:
            # what leaves noise alone on short pieces may be right; the whole tests say whether it is
            leaps = len(growth) == 1 and fit is not None and fit.rms_rad < AT_NOISE * fit.noise_rad
            length_s = math.inf if leaps else lengths_s.pop(0)
            cut = whole if math.isinf(length_s) else whole.every(length_s)
            if fit is not None and len(cut.begins) == len(fit.problem.cut.begins):
                if leaps:
                    break
                continue
            longer = solve(self._begun(cut, laws, motor))
            grown = 1.0 if fit is None else max(GROWN * longer.noise_rad / fit.noise_rad, GROWN)
            most_rad = math.inf if fit is None else max(grown * max(fit.rms_rad, fit.noise_rad), hidden_rad)
            if fit is not None and not math.isfinite(longer.cost):
                break  # on these pieces it takes too many steps
            longer, found = self._at_best_shape(longer, laws), laws
            if not leaps or longer.rms_rad <= most_rad:
                longer, found = self._of_one_turn(*self._settle(longer, laws))
            growth.append((cut.longest_s, longer.rms_rad))
            is_borne = not longer.rms_rad > most_rad
            if is_borne:
                fit, laws, motor = longer, found, longer.motor
            if leaps == is_borne:  # the whole is borne, or no longer pieces are
                break
        assert fit is not None
        fit, laws = self._last(fit, laws)
        while (leaner := self._leaner(fit, laws)) is not None:
            fit, laws = self._last(*leaner)
        fit, laws = self._predicting(fit, laws, whole)
        while laws:
            rises = rise_by_law(self._shares(fit, whole, cycle_s).with_own_noise, laws, self.bench)
            normal = Normal.of(fit.rows, fit.problem.cut)
            # normal equations say nothing of a law that leaps, nor of one that stays though it is worth nothing by them
            told = [
                law
                for law in laws
                if not law.leaps and loss(normal, fit, law) >= self.price(law, fit, self.asked.stay) * unit(fit)
            ]
            least = min(told, key=lambda law: rises[law], default=None)
            if least is None or rises[least] >= self.asked.predicts:
                break
            fit, laws = self._less(fit, laws, least)
        return Choice(laws, self._deepest(fit), tuple(growth))

    def _deepest(self, fit: Fit) -> Fit:
        """The best of this fit and of two that begin with less friction and with more.

        Whether a shaft comes to rest at a reversal makes valleys beside one another. In one that is hardly less deep
        the slopes say the wrong thing of laws that hide.
        """
        if "fc_V" not in fit.problem.free:
            return fit
        apart_V = ASIDE * sigma_of(fit, "fc_V")
        others = [fit.motor._replace(fc_V=max(fit.motor.fc_V + by_V, 0.0)) for by_V in (-apart_V, apart_V)]
        return min((fit, *(solve(refitted(fit, motor=one), NEAR_BY) for one in others)), key=lambda one: one.cost)

    def _begun(self, cut: Cut, laws: tuple[Departure, ...], motor: RealMotor) -> Fit:
        """The motor on these pieces, to be fitted so that rows count less which are farther off than the others.

        Where it leaves far more than noise, nearly all are farther off than noise is, and a fit by their sizes takes
        many times the steps.
        """
        fit = start(self.problem(cut, laws, math.inf), motor)
        robust = refitted(fit, replace(fit.problem, robust_rad=ROBUST * fit.noise_rad))
        if fit.rms_rad <= LOST * fit.noise_rad:
            return robust
        by_squares = solve(fit, LEAP_ITERATIONS)
        if by_squares.scatter_rad <= LOST * fit.noise_rad:
            return robust
        return refitted(by_squares, replace(by_squares.problem, robust_rad=ROBUST * by_squares.scatter_rad))

    def tells(self, fit: Fit, tests: int, tested: int) -> bool:
        """Whether a fit tells whole tests to the sensor's noise: the first ``tests`` windows, and ``tested`` rows."""
        is_whole = all(rows.size == 1 for rows in fit.problem.cut.rows[:tests])
        return is_whole and float(np.sqrt(np.mean(fit.residual_rad[:tested] ** 2))) <= AT_NOISE * self.sigma_rad

    @property
    def within_steps(self) -> bool:
        """Whether rows lie within the steps of a coarse sensor: then their errors are not white, whatever they seem."""
        return self.bench.path_per_row_rad <= OF_STEP * self.step_rad

    def _blocks(self, whole: Cut, tau_s: float) -> Blocks:
        """Blocks in which a law must show, for a motor of this time constant."""
        row_s = sum(window.duration_s for window in whole.windows) / whole.t_s.size
        of_steps_s = LAW_STEPS * self.step_rad / max(self.bench.path_per_row_rad, 1e-12) * row_s
        return Blocks.of(whole, tau_s, (max(LAW_BLOCK[0], of_steps_s), LAW_BLOCK[1]))

    def _steps_hide(self, whole: Cut, motor: RealMotor) -> bool:
        """Whether the steps of a coarse sensor hide any law.

        In blocks the plain motor leaves so little beyond them that the best law could not take away half of what is
        asked.
        """
        if not self.within_steps:
            return False
        blocks = Blocks.of(whole, motor.tau_s, LAW_BLOCK)
        noise = np.array(blocks.cut.lengths) * self.sigma_rad**2
        squares = blocks.held_out(self.problem(blocks.cut, (), math.inf), motor, starts_known=True)
        most = 1.0 - math.exp(-0.5 * float(np.mean(np.log(np.maximum(squares / noise, 1.0)))))
        return most < 0.5 * self.asked.cuts

    def with_drift(self, law: Departure) -> Chooser:
        """The same, but friction drifts as ``law`` says: of records whose frames say so."""
        return replace(self, candidates=[law if one.name == "drift" else one for one in self.candidates])

    def better_each(self, choice: Choice, each: Cut, drift: Departure) -> bool:
        """Whether this drift alone explains the pieces of ``choice`` as well as all its laws do.

        each   the records with the course of friction that ``drift`` goes by
        """
        fit = choice.fit
        cut = replace(fit.problem.cut, frames=each.frames)
        problem = replace(self.problem(cut, (drift,), math.inf), noise=fit.problem.noise)
        motor = RealMotor(*fit.motor[:4], delay_s=fit.motor.delay_s)
        alone = solve(start(problem, motor))
        prices = sum(self.price(law, fit, 0.0) for law in choice.laws)
        return (alone.cost - fit.cost) / unit(fit) + self.price(drift, fit, drift.beyond) < prices

    def _at_best_shape(self, fit: Fit, laws: tuple[Departure, ...]) -> Fit:
        """Each law's shape looked for anew: a short piece can take one order of cogging for another."""
        for law in laws:
            if law.leaps:
                fit = at_best_size(fit, law)
            trials = law.trials(self.bench)
            if not law.shape or len(trials) == 1:
                continue
            others = tuple(one for one in laws if one is not law)
            bare = solve(self.with_laws(fit, others, without(fit.motor, law)), TRIAL_ITERATIONS)
            for promise in self._starts([law], Columns(bare))[:RESHAPED]:
                trial = solve(self.with_laws(bare, laws, bare.motor._replace(**promise.first)), TRIAL_ITERATIONS)
                if trial.cost < fit.cost:
                    fit = solve(trial)
        return fit

    def _leaner(self, fit: Fit, laws: tuple[Departure, ...]) -> tuple[Fit, tuple[Departure, ...]] | None:
        """The fit without a law that another shape of the others makes up for, or that is next to nothing; or None.

        The speed of a Stribeck effect has more than one minimum. In the wrong one a drag is worth its number. And in a
        record with hardly any noise, rounding is worth a law of a thousandth of what benches have.
        """
        for law in laws:
            bare = self.bare(fit, laws, law)
            size = math.hypot(*(getattr(fit.motor, name) for name in law.numbers))
            if size < NOTHING_OF_RANGE * law.range_of(self.bench):
                return bare, tuple(one for one in laws if one is not law)
            if (bare.cost - fit.cost) / unit(fit) < self.price(law, fit, self.asked.stay):
                return bare, tuple(one for one in laws if one is not law)
        return None

    def bare(self, fit: Fit, laws: Sequence[Departure], law: Departure) -> Fit:
        """The fit of the same rows without one of its laws, the others at their best shape, with the same noise."""
        if law.name not in fit.bare:
            others = tuple(one for one in laws if one is not law)
            bare = solve(self.with_laws(fit, others, without(fit.motor, law)))
            is_faint = (bare.cost - fit.cost) / unit(fit) < FAINT
            fit.bare[law.name] = self._at_best_shape(bare, others) if is_faint else bare
        return fit.bare[law.name]

    def _predicting(self, fit: Fit, laws: tuple[Departure, ...], whole: Cut) -> tuple[Fit, tuple[Departure, ...]]:
        """The fit without laws that take too little of the error in blocks that were not fitted, the least one first.

        Likelihood under noise that real records do not have buys a law for anything. Where a fit leaves more than the
        sensor's noise, what it leaves is the motor, and a law that hardly changes that is not it; nor is one that
        does so in few blocks alone. Nor is one where the plain motor predicts to a part in a thousand, and laws
        hardly move its numbers: what is left there is what the readings are off. Where a fit leaves white noise,
        likelihood is right; so it is where it tells whole tests, each from its start on, to the sensor's noise. Laws
        that only together take as much as is asked stay together. A coarse sensor leaves its steps, which are never
        white.
        """
        tells_all = len(fit.problem.cut.begins) == len(whole.begins)
        if tells_all and fit.rms_rad <= AT_NOISE * self.sigma_rad and not self.within_steps:
            return fit, laws
        blocks = self._blocks(whole, fit.motor.tau_s)
        rows = np.array(blocks.cut.lengths)
        noise = rows * (self.sigma_rad * blocks.cut.adds_up) ** 2
        chance = noise
        if self.within_steps:  # rows within a step are no further readings
            steps = np.maximum(rows * self.bench.path_per_row_rad / self.step_rad, 1.0)
            chance = noise * np.minimum(np.sqrt(2.0 / steps), 1.0)
        known: dict[tuple[Departure, ...], Array] = {}

        def left(laws: tuple[Departure, ...], motor: RealMotor) -> Array:
            if laws not in known:
                problem = self.problem(blocks.cut, laws, math.inf)
                known[laws] = np.maximum(blocks.held_out(problem, motor, starts_known=True) - noise, 0.0)
            return known[laws]

        if laws and self._asks_blocks(fit):
            none = fit.motor
            for law in laws:
                none = without(none, law)
            stays = float(blocks.squares(blocks.stays_rad()).sum())
            if math.sqrt(float(left((), none).sum()) / max(stays, 1e-300)) < FINE:
                plain = self._last(refitted(fit, self.problem(fit.problem.cut, (), math.inf), none), ())
                if self._moves(fit, plain[0]) <= MOVES:
                    return plain
        first = fit, laws
        while laws and self._asks_blocks(fit):
            full = left(laws, fit.motor)
            cuts = {
                law: share_cut(full, left(tuple(o for o in laws if o is not law), without(fit.motor, law)), chance)
                for law in laws
                if not self._is_shown_beside(fit, law)
            }
            least = min(cuts, key=lambda law: cuts[law], default=None)
            if least is None or cuts[least] >= self.asked.cuts:
                break
            fit, laws = self._less(fit, laws, least)
        if laws == first[1]:
            return first
        together = share_cut(left(first[1], first[0].motor), left(laws, fit.motor), chance)
        return first if together >= self.asked.cuts else (fit, laws)

    def _moves(self, fit: Fit, other: Fit) -> float:
        """Largest share by which tau, K or friction of another fit differ."""
        here, there = fit.motor, other.motor
        tau, gain = abs(there.tau_s / here.tau_s - 1.0), abs(there.K_rad_s_V / here.K_rad_s_V - 1.0)
        return max(tau, gain, abs(there.fc_V - here.fc_V) / max(here.fc_V, SMALL * self.bench.largest_V))

    def _asks_blocks(self, fit: Fit) -> bool:
        return self.within_steps or not fit.problem.noise.white

    def _is_shown_beside(self, fit: Fit, law: Departure) -> bool:
        """Whether what is known from beside the tests alone asks for the law: no block of them need show it."""
        surprise = fit.problem.surprise
        rise = (surprise(without(fit.motor, law)) - surprise(fit.motor)) / unit(fit)
        return rise >= self.price(law, fit, self.asked.stay)

    def _shares(self, fit: Fit, whole: Cut, cycle_s: float) -> Fit:
        """The last fit on pieces short enough that some of them can be predicted from the others."""
        cut = fit.problem.cut
        length_s = PREDICTED * cycle_s
        if cut.longest_s > length_s:
            cut = whole.every(length_s)
        return solve(start(replace(fit.problem, cut=cut, noise=WHITE), fit.motor), TRIAL_ITERATIONS)

    def problem(self, cut: Cut, laws: Sequence[Departure], robust_rad: float) -> Problem:
        """The problem of these laws on this cut."""
        of_laws = (name for law in laws for name in (*law.numbers, *law.shape))
        free = tuple(dict.fromkeys((*self.core, *of_laws)))  # two laws may share a number of their shape
        limits = limits_of(free, cut, self.delay_s) | limits_of_laws(laws, self.bench)
        return Problem(cut, free, limits, self.sigma_rad, robust_rad, known=self.known)

    def _settle(self, fit: Fit, laws: tuple[Departure, ...]) -> tuple[Fit, tuple[Departure, ...]]:
        """Add and drop laws until none gains and none is without worth.

        The law that gains most at first need not be a right one: two wrong laws can stand in for a third. So each of
        the most promising laws is followed to its end, and the best end is taken.
        """
        fit, laws = self._dropped(fit, laws)
        first = self._steps(fit, laws, set())
        if not first:
            return fit, laws
        seen: Ends = {}
        end = self._greedy(*first[0], seen)
        if len(end[1]) == len(laws) + 1 and end[0].scatter_rad < AT_NOISE * end[0].noise_rad:
            return end  # it leaves nothing: another start would need two laws for as much
        return self._ranked([end, *(self._greedy(*step, seen) for step in first[1:])])[0]

    def _ranked(self, ends: list[tuple[Fit, tuple[Departure, ...]]]) -> list[tuple[Fit, tuple[Departure, ...]]]:
        """Fits of the same rows, the best first: by what each leaves, and the price of its laws.

        The noise is that of the finest: by noises of their own two that leave next to nothing are far apart.
        """
        if len(ends) < 2:
            return ends
        finest = min((end for end, _ in ends), key=lambda end: end.scatter_rad).with_own_noise

        def worth(end: tuple[Fit, tuple[Departure, ...]]) -> float:
            of, found = end
            squares = finest.problem.cost(of.residual_rad, of.motor) / unit(finest)
            return squares + sum(self.price(law, of, self.asked.entry) for law in found)

        return sorted(ends, key=worth)

    def _of_one_turn(self, fit: Fit, laws: tuple[Departure, ...]) -> tuple[Fit, tuple[Departure, ...]]:
        """With a force over position in place of cogging of one period a turn, as of a pendulum: it has a number less.

        Which of both a search takes first hangs on where its trials end.
        """
        of_name = {law.name: law for law in self.candidates}
        wave, force = of_name.get("cogging"), of_name.get("force_over_position")
        if wave not in laws or force is None or force in laws:
            return fit, laws
        motor, centre_rad = fit.motor, fit.problem.cut.frames[0].centre_rad
        if abs(motor.cogging_per_rad - 1.0) * self.bench.half_travel_rad > ONE_WAVE_RAD:
            return fit, laws
        sin_V, cos_V = motor.cogging_sin_V, motor.cogging_cos_V
        same = without(motor, wave)._replace(
            force_sin_V=sin_V * math.cos(centre_rad) - cos_V * math.sin(centre_rad),
            force_cos_V=sin_V * math.sin(centre_rad) + cos_V * math.cos(centre_rad),
        )
        others = tuple(force if law is wave else law for law in laws)
        return self._ranked([(fit, laws), (solve(self.with_laws(fit, others, same)), others)])[0]

    def _greedy(self, fit: Fit, laws: tuple[Departure, ...], seen: Ends) -> tuple[Fit, tuple[Departure, ...]]:
        """One law after the other, the best each time; ``seen``: where the laws of other ways led, which it adds to.

        Two ways that come to the same laws go on alike, but for one whose fit is better by as much as a law.
        """
        left: set[str] = set()
        passed: list[tuple[frozenset[str], float]] = []
        while True:
            before = {law.name for law in laws}
            fit, laws = self._dropped(fit, laws)
            names = frozenset(law.name for law in laws)
            left |= before - names
            cost, end = seen.get(names, (math.inf, None))
            if end is None or cost - fit.cost > self.asked.stay * unit(fit):
                passed.append((names, fit.cost))
                steps = self._steps(fit, laws, left)
                end = None if steps else (fit, laws)
            if end is not None:
                seen.update((names, (cost, end)) for names, cost in passed)
                return end
            fit, laws = steps[0]

    def is_rounding(self, fit: Fit) -> bool:
        """Whether each row is off by no more than its rounding to the sensor's steps, which repeats as a wave would.

        A few rows that are far off, as behind reversals, are no rounding.
        """
        most_rad = WITHIN_STEP * self.step_rad
        off_rad = np.abs(fit.problem.cut.counting(fit.residual_rad))
        return fit.rms_rad <= most_rad / UNIFORM and float(np.mean(off_rad <= most_rad)) >= NEARLY_ALL

    def _dropped(self, fit: Fit, laws: tuple[Departure, ...]) -> tuple[Fit, tuple[Departure, ...]]:
        """Without laws that are not worth their numbers."""
        while (leaner := self._without_worst(fit, fit.with_own_noise, laws)) is not None:
            fit, laws = leaner
        return fit, laws

    def _without_worst(
        self, fit: Fit, seen: Fit, laws: tuple[Departure, ...]
    ) -> tuple[Fit, tuple[Departure, ...]] | None:
        """The fit without the law whose loss costs least, if it is not worth its numbers; None: all are.

        seen   the same fit with its noise: the linear model of it says what a loss costs
        Beside another law a large one may seem worth nothing, for it is not linear over its size. So one whose loss
        costs far more in the fit without it stays.
        """
        for cost, law in self._losses(seen, laws):
            if cost >= self.price(law, seen, self.asked.stay):
                return None
            others = tuple(one for one in laws if one is not law)
            bare = solve(self.with_laws(fit, others, without(fit.motor, law)))
            if _gain(bare, fit) < FAINT:
                return bare, others
        return None

    def _steps(self, fit: Fit, laws: tuple[Departure, ...], left: set[str]) -> list[tuple[Fit, tuple[Departure, ...]]]:
        """Fits with one more law that is worth it, the best first. ``left``: names of laws that were dropped before."""
        seen = fit.with_own_noise
        steps_show = fit.rms_rad < AT_NOISE * self.sigma_rad and seen.problem.noise.ratio > STEPS_SHOW
        if len(laws) >= MOST or steps_show or self.is_rounding(fit):
            return []  # the sensor's own steps are left, which look like anything

        def price(law: Departure) -> float:
            return self.price(law, fit, self.asked.entry)

        def tried(promise: Promise) -> tuple[float, Fit, tuple[Departure, ...]]:
            law = promise.law
            trial = self.with_laws(fit, (*laws, law), fit.motor._replace(**promise.first))
            trial = solve(in_valley(trial, law) if law.valley else trial, TRIAL_ITERATIONS, near)
            if is_far and trial.rms_rad < FINISHED * fit.rms_rad:  # near an end of what was far: there a step says less
                trial = solve(trial, TRIAL_ITERATIONS)
            trial = at_best_size(trial, law) if law.leaps else trial
            return _gain(fit, trial) - price(law), trial, (*laws, law)

        is_far = self.within_steps or fit.rms_rad > FAR * self.sigma_rad
        near = Enough(NEAR * self.asked.entry * unit(fit), 0.0) if is_far else ENOUGH
        first = self.promises(seen, laws)[:TRIED]
        wanted = [one for one in first if one.law.name not in left and one.gain >= price(one.law)]
        trials = side_by_side(tried, wanted, fit.residual_rad.size)
        found = [one for one in trials if one[0] > 0.0 and not self._hardly_shows(fit, one[1])]
        found.sort(key=lambda entry: -entry[0])
        return [(trial, more) for _, trial, more in found]

    def _hardly_shows(self, fit: Fit, richer: Fit) -> bool:
        """Whether the richer fit leaves nearly as much, far beyond noise: no further law is tried on top of it."""
        if fit.rms_rad < FAR * self.sigma_rad:
            return False
        left, all_of_it = (max(one.rms_rad**2 - self.sigma_rad**2, 1e-300) for one in (richer, fit))
        return 1.0 - math.sqrt(left / all_of_it) < FIRST_CUT

    def _less(self, fit: Fit, laws: tuple[Departure, ...], law: Departure) -> tuple[Fit, tuple[Departure, ...]]:
        """``_last`` of the fit without this law."""
        laws = tuple(one for one in laws if one is not law)
        return self._last(refitted(fit, self.problem(fit.problem.cut, laws, math.inf), without(fit.motor, law)), laws)

    def _last(self, fit: Fit, laws: tuple[Departure, ...]) -> tuple[Fit, tuple[Departure, ...]]:
        """The least-squares fit with the noise of its own residual, without the laws that are not worth it then."""
        while True:
            problem = self.problem(fit.problem.cut, laws, math.inf)
            noise = WHITE
            fit = solve(refitted(fit, problem))
            for _ in range(2):
                noise = problem.cut.noise_of(fit.residual_rad)
                if noise.white:
                    break
                seen = refitted(fit, replace(problem, noise=noise))
                found = solve(seen)
                if found.rms_rad > BENT * fit.rms_rad:
                    fit = seen  # what is left is the motor, not noise: a noise that takes it up would bend the numbers
                    break
                fit = found
            leaner = self._without_worst(fit, fit, laws)
            if leaner is None:
                return fit, laws
            fit, laws = leaner

    def with_laws(self, fit: Fit, laws: Sequence[Departure], motor: RealMotor) -> Fit:
        """The same rows with these laws and this motor to begin with, the same noise, and the starts of ``fit``."""
        problem = self.problem(fit.problem.cut, laws, fit.problem.robust_rad)
        return refitted(fit, replace(problem, noise=fit.problem.noise), motor)

    def price(self, law: Departure, fit: Fit, beyond: float) -> float:
        """Gain in twice the log likelihood that a law must reach: Schwarz's criterion and ``beyond``."""
        return law.costs * math.log(max(fit.problem.cut.freedom, 2)) + beyond

    def promises(self, fit: Fit, laws: Sequence[Departure]) -> list[Promise]:
        """What each absent law would gain, the best first."""
        absent = [law for law in self.candidates if law not in laws]
        columns = Columns(fit, [law for law in absent if law.trials(self.bench) == (NOTHING,)])
        best = {promise.law: promise for promise in reversed(self._starts(absent, columns))}
        found = [replace(promise, gain=promise.gain / unit(fit)) for promise in best.values()]
        return sorted(found, key=lambda promise: -promise.gain)

    def _starts(self, laws: Sequence[Departure], columns: Columns) -> list[Promise]:
        """What each start of absent laws would gain, as a fall of the whitened sum of squares, the best first."""
        found = []
        tried = [(law, trial) for law in laws for trial in law.trials(self.bench)]
        for (law, trial), (gain, sizes, scale) in zip(tried, columns.gains(tried), strict=True):
            if not math.isfinite(gain) or (law.one_sided and sizes[0] <= 0.0):
                continue
            most = FIRST_STEP * law.range_of(self.bench)
            clipped = np.clip(sizes * scale, -most, most).tolist()
            first = dict(zip(law.numbers, clipped, strict=True)) if scale != 0.0 else {}
            found.append(Promise(gain, law, {**first, **trial}))
        return sorted(found, key=lambda promise: -promise.gain)

    def _losses(self, fit: Fit, laws: Sequence[Departure]) -> list[tuple[float, Departure]]:
        """What the loss of each law would cost, by the linear model if it has one; the least first."""
        if not laws:
            return []
        normal = Normal.of(fit.rows, fit.problem.cut)

        def cost(law: Departure) -> float:
            if not law.leaps:
                return loss(normal, fit, law)
            others = [one for one in laws if one is not law]
            bare = self.with_laws(fit, others, without(fit.motor, law))
            return solve(bare, LEAP_ITERATIONS).cost - fit.cost

        return sorted(((cost(law) / unit(fit), law) for law in laws), key=lambda entry: entry[0])


def levels(fit: Fit, of: Sequence[str]) -> dict[str, float]:
    """By recording how much more friction it has than all together, relative: one step of least squares.

    fit   by least squares, with its noise; ``of``: for each window the name of its recording
    """
    problem, cut = fit.problem, fit.problem.cut
    rows = fit.rows
    names = list(dict.fromkeys(of))
    beside = rows.residual.size - cut.t_s.size  # what is known from beside the tests is of all of them
    own = np.repeat([names.index(name) for name in of], [window.t_s.size for window in cut.windows])
    every_s = [sum(w.duration_s for w, one in zip(cut.windows, of, strict=True) if one == name) for name in names]
    weight = np.array(every_s) / sum(every_s)
    shares = np.concatenate((np.eye(len(names))[own], np.tile(weight, (beside, 1))))
    at = problem.free.index("fc_V")
    by_number = np.column_stack((np.delete(rows.by_number, at, axis=1), rows.by_number[:, [at]] * shares))
    normal = Normal.of(replace(rows, by_number=by_number), cut)
    nothing_held = np.zeros(by_number.shape[1], dtype=bool)
    step_V = normal.step(nothing_held, 0.0)[0][-len(names) :]
    level_V = np.maximum(fit.motor.fc_V + step_V, 0.0)
    mean_V = max(float(weight @ level_V), 1e-12)
    return dict(zip(names, (level_V / mean_V - 1.0).tolist(), strict=True))


def limits_of_laws(laws: Sequence[Departure], bench: Bench) -> dict[str, tuple[float, float]]:
    """Bounds of the fields of laws in a fit, by name."""
    limits: dict[str, tuple[float, float]] = {}
    for law in laws:
        largest = law.most(bench)
        limits |= dict.fromkeys(law.numbers, (0.0 if law.one_sided else -largest, largest))
        limits |= law.limits(bench)
    return limits


def _gain(fit: Fit, richer: Fit) -> float:
    """Twice the gain in log likelihood, with the noise of the richer fit's residual."""
    seen = richer.with_own_noise
    return (seen.problem.cost(fit.residual_rad, fit.motor) - seen.cost) / unit(seen)


def without(motor: RealMotor, law: Departure) -> RealMotor:
    """The motor without a law."""
    return motor._replace(**dict.fromkeys(law.fields, 0.0))


def by_size(fit: Fit, law: Departure) -> list[tuple[float, Fit]]:
    """Fits of the rest at sizes of a law that leaps, its own first, each with its size (docs/theory.md 8.4)."""
    [name] = law.numbers
    size, most = getattr(fit.motor, name), fit.problem.limits[name][1]
    others = replace(fit.problem, free=tuple(one for one in fit.problem.free if one != name))

    def fitted(other: float) -> tuple[float, Fit]:
        one = solve(refitted(fit, others, fit.motor._replace(**{name: other})), LEAP_ITERATIONS)
        return other, replace(one, problem=fit.problem)

    sizes = [share * size for share in LEAPS if 0.0 < share * size <= most]
    return [(size, fit), *side_by_side(fitted, sizes, fit.residual_rad.size)]


def in_valley(trial: Fit, law: Departure) -> Fit:
    """The best of fits of the rest at some sizes of a law, about that of ``trial``; with the problem of ``trial``."""
    [name] = law.numbers
    problem, motor = trial.problem, trial.motor
    others = replace(problem, free=tuple(one for one in problem.free if one not in (name, *law.shape)))
    sizes = [share * getattr(motor, name) for share in VALLEY]
    each = [solve(refitted(trial, others, motor._replace(**{name: size})), TRIAL_ITERATIONS) for size in sizes]
    return replace(min(each, key=lambda one: one.cost), problem=problem)


def at_best_size(fit: Fit, law: Departure) -> Fit:
    """The best fit of ``by_size``."""
    return min((one for _, one in by_size(fit, law)), key=lambda one: one.cost)


def as_likely(fit: Fit, law: Departure) -> tuple[float, float]:
    """Between which sizes those of a law that leaps are as likely as that of the fit, at 95 %."""
    found = sorted((size, (one.cost - fit.cost) / unit(fit) < CHANCE) for size, one in by_size(fit, law))
    near = [k for k, (_, likely) in enumerate(found) if likely]
    low = found[near[0] - 1][0] if near[0] > 0 else 0.0
    return low, found[min(near[-1] + 1, len(found) - 1)][0]


def loss(normal: Normal, fit: Fit, law: Departure) -> float:
    """Rise of the sum of squares if a law's numbers were 0, by the linear model."""
    free = fit.problem.free
    own = [free.index(name) for name in law.numbers]
    shape = [free.index(name) for name in law.shape]
    rest = [k for k in range(len(free)) if k not in own and k not in shape]
    size = np.array([getattr(fit.motor, name) for name in law.numbers])
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal.matrix), 1e-300))
    matrix = normal.matrix * np.outer(scale, scale)
    cross = np.linalg.lstsq(matrix[np.ix_(rest, rest)], matrix[np.ix_(rest, own)], rcond=1e-12)[0]
    left = matrix[np.ix_(own, own)] - matrix[np.ix_(own, rest)] @ cross
    size = size / scale[own]
    return float(size @ left @ size)


class Columns:
    """Further columns beside those of a fit, for laws that it has not.

    smooth   laws whose columns are taken at once: those without a shape, and with a derivative at 0
    """

    def __init__(self, fit: Fit, smooth: Sequence[Departure] = ()) -> None:
        self._fit = fit
        self._smooth: dict[str, Array] = {}
        if smooth:
            names = [name for law in smooth for name in law.numbers]
            found = fit.problem.cut.derivatives(fit.motor, fit.starts, [index(name) for name in names])
            self._smooth = dict(zip(names, self._white(found.by_number, names).T, strict=True))

    @cached_property
    def base(self) -> Normal:
        """The normal equations of the fit."""
        return Normal.of(self._fit.rows, self._fit.problem.cut)

    def gains(self, tried: Sequence[tuple[Departure, Trial]]) -> Iterator[tuple[float, Array, float]]:
        """``gain`` for each law and trial, and the second value of ``of``; all from the same normal equations."""
        found: list[tuple[Array, float]] = []
        for law, each in groupby(tried, key=lambda one: one[0]):
            found += self.of_all(law, [trial for _, trial in each])
        if not found:
            return
        ends = np.cumsum([column.shape[1] for column, _ in found])
        normal = self.normal(np.nan_to_num(np.column_stack([column for column, _ in found]), posinf=0.0, neginf=0.0))
        for end, (column, scale) in zip(ends.tolist(), found, strict=True):
            of = np.arange(end - column.shape[1], end)
            is_number = bool(np.isfinite(column).all())
            yield *(self._gain(normal, of) if is_number else (math.nan, np.zeros(of.size))), scale

    def of_all(self, law: Departure, trials: Sequence[Trial]) -> Iterator[tuple[Array, float]]:
        """``of`` for each of the trials; those of a wave over the angle in one go."""
        if law.shape != (ORDER,):
            yield from (self.of(law, trial) for trial in trials)
            return
        fit = self._fit
        found = fit.problem.cut.derivatives(fit.motor, fit.starts, (), [trial[ORDER] for trial in trials])
        white = self._white(found.by_number, law.numbers * len(trials))
        yield from ((white[:, 2 * k : 2 * k + 2], 1.0) for k in range(len(trials)))

    def of(self, law: Departure, trial: Trial) -> tuple[Array, float]:
        """Derivatives by the law's numbers at 0, (n, k), whitened as the residual, and 1.0.

        Where the trial gives the numbers themselves, the column is the whole change that they make, and the second
        value is 0.
        """
        fit = self._fit
        if all(name in self._smooth for name in law.numbers):
            return np.column_stack([self._smooth[name] for name in law.numbers]), 1.0
        cut, motor = fit.problem.cut, fit.motor._replace(**trial)
        if any(name in trial for name in law.numbers):
            change = cut.readings(motor, fit.starts) - cut.y_rad - fit.residual_rad
            known = fit.problem.known
            beside = np.zeros(0) if known is None else known.off(motor) - known.off(fit.motor)
            return np.concatenate((self._weighed(change[:, None]), beside[:, None])), 0.0
        found = cut.derivatives(motor, fit.starts, [index(name) for name in law.numbers])
        return self._white(found.by_number, law.numbers), 1.0

    def of_change(self, change: Array) -> Array:
        """A change of the readings, (n, 1), rad for 1 of a law, whitened; nothing beside the tests tells of it."""
        known, white = self._fit.problem.known, self._weighed(change)
        return white if known is None else np.concatenate((white, np.zeros((known.root.shape[0], change.shape[1]))))

    def gain(self, added: Array) -> tuple[float, Array]:
        """Fall of the whitened sum of squares with the columns ``added``, 1 per unit of their numbers; their sizes.

        nan for a law that the motor cannot be followed with.
        """
        if not np.isfinite(added).all():
            return math.nan, np.zeros(added.shape[1])
        return self._gain(self.normal(added), np.arange(added.shape[1]))

    def _gain(self, normal: Normal, of: NDArray[np.int64]) -> tuple[float, Array]:
        """``gain`` of some of the columns behind the fit's own: ``of`` says which."""
        m = len(self._fit.problem.free)
        at = np.concatenate((np.arange(m), m + of))
        scale = np.sqrt(np.maximum(np.diag(normal.raw)[at], 1e-300))
        matrix, gradient = normal.matrix[np.ix_(at, at)] / np.outer(scale, scale), normal.gradient[at] / scale
        nothing = np.zeros(at.size, dtype=bool)
        with_it = solved(matrix, gradient, nothing, ALIKE)
        alone = solved(matrix[:m, :m], gradient[:m], nothing[:m], ALIKE)
        return float(gradient[:m] @ alone - gradient @ with_it), (with_it / scale)[m:]

    def normal(self, added: Array) -> Normal:
        """The normal equations with the columns ``added``, 1 per unit of their numbers, behind the fit's own."""
        rows = self._fit.rows
        both = Rows(rows.residual_rad, rows.residual, np.column_stack((rows.by_number, added)), rows.by_start)
        return Normal.of(both, self._fit.problem.cut)

    def _white(self, columns: Array, names: Sequence[str]) -> Array:
        """Derivatives by these numbers, whitened; behind them those of what is known from beside the tests."""
        known = self._fit.problem.known
        white = self._weighed(columns)
        return white if known is None else np.concatenate((white, known.by(names)))

    def _weighed(self, columns: Array) -> Array:
        problem = self._fit.problem
        if math.isinf(problem.robust_rad):
            return problem.whitened(columns)
        return problem.robust_weight(self._fit.residual_rad)[:, None] * columns
