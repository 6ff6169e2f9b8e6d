"""The live fit: what everything driven so far says of the motor, again and again while the run goes on.

Breakaway check, gain search and tests are pieces of one record. Each piece begins where the record is cut or where the
shaft begins to move (``rig.identification.motions``). A fit begins where the last one ended. So it costs a few
milliseconds
for each second of record, and the same rows in the same portions give the same numbers (docs/theory.md 7.12). Where the
residual says that the motor has more than tau, K and friction, laws are looked for, and fitted from then on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.departures import DEPARTURES
from rig.identification.departures.choice import limits_of_laws
from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.fit import CORE, DELAY, Fit, Known, Normal, Problem, limits_of, solve, unit
from rig.identification.departures.fit import start as begin
from rig.identification.departures.pieces import Cut
from rig.identification.driven import PART_S, bears
from rig.identification.live_laws import laws_so_far
from rig.identification.motions import Motion, in_parts, motions
from rig.identification.stated_errors import StatedErrors
from rig.model.real_motor import Frame, FramedMotor, RealMotor
from rig.run_folder.recording.series import FEWEST_ROWS, TimeSeries, Window

NORMAL_95 = 1.959964
GAP_PERIODS = 2.5  # between two rows: from there on the record is cut
QUICK = 0.5  # of the period: rows closer than that are of a law in the device
FEWEST_MOVING_ROWS = 40
ITERATIONS = 12
COLD_ITERATIONS, POLISHED = 20, 3
COLD_TAUS, COLD_SHARES = 8, (0.15, 0.4, 0.6, 0.75, 0.88, 0.97)  # of the friction, in the smallest drive that moved
SURE_PERCENT = 5.0  # half width from which on the fit's valley is the right one
STRANGE = (
    1.2  # residual over the noise beyond which another valley is looked for, or a delay, once the record has doubled
)
LACKING = 1.1  # residual over the noise beyond which laws are looked for, once the record has doubled
LONGER = 1.2  # times the record in which laws were looked for last: worth another look if one is asked for
EXPLAINS = 0.8  # of the residual, that a delay which no row tells must leave at most
USABLE_PERCENT = 60.0  # half width beyond which a fit says nothing
UNEXPLAINED = 0.3  # residual over the spread of positions beyond which a fit says nothing
DIFFERENT = 1.6  # mean speed of quick swings over that of slow ones
ENOUGH_SWINGS = 3  # of either kind
LARGE_SWING = 15.0  # in standard deviations of the noise: tiny cycles agree with any law
OF_PARAMETERS = ("tau_s", "K_rad_s_V", "fc_V")


class LiveRows(NamedTuple):
    """Rows of a run, in order; each an array of n values.

    row     number of the row in the run
    t_s     time of the sample, s
    y_rad   position, rad
    t_u_s   time at which the row's drive took effect, s; nan: the device does not tell
    u_V     drive as it acted, V
    """

    row: NDArray[np.int64]
    t_s: Array
    y_rad: Array
    t_u_s: Array
    u_V: Array


@dataclass(frozen=True)
class LiveSettings:
    """What is known before the first row.

    period_s        sampling period, s
    noise_rad       standard deviation of the reading at rest, rad
    lsb_rad         step of the reading, rad; 0: none
    largest_V       largest drive, V
    delay_s         an unknown constant delay from a sample to the effect of its drive, s: least and most; None: the
                    rows say when each drive acted
    prior           the motor as an earlier run shows it, with its laws; None: nothing is known
    prior_percent   standard deviation of its tau, K and f_c, in % of each
    stated          errors of the bench that no row shows
    """

    period_s: float
    noise_rad: float
    lsb_rad: float
    largest_V: float
    delay_s: tuple[float, float] | None = None
    prior: FramedMotor | None = None
    prior_percent: float = 30.0
    stated: StatedErrors = field(default_factory=StatedErrors)

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the noise of a moving reading, rad: a reading at rest may hide the sensor's steps."""
        steps_rad = self.lsb_rad / math.sqrt(12.0)
        if self.noise_rad >= 0.5 * self.lsb_rad:
            return max(self.noise_rad, 1e-9)
        return max(math.hypot(self.noise_rad, steps_rad), 1e-9)


@dataclass(frozen=True, eq=False)
class LiveEstimate:
    """The motor by the rows so far.

    row, t_s        last row that counted, and its time, s
    tau_s, K_rad_s_V, fc_V, asym_V, delay_s   s, (rad/s)/V, V, V, s; the delay is from t_u_s on if rows tell that
    half_percent    half width of the 95 % interval of tau_s, K_rad_s_V and fc_V, in % of each
    covariance      (5, 5), of log tau, log K, f_c, asymmetry and delay; 0 for what is not fitted
    residual_over_noise   RMS residual of the rows in motion over the noise; 1 for a motor that the law describes
    residual_error  standard error of that, from the number of rows
    drives_differ   whether large swings of clearly different speeds were seen
    laws            names of the laws beyond the plain one that are fitted
    seconds_of_data how long the shaft moved in these rows, s
    framed          the motor with its laws
    """

    row: int
    t_s: float
    tau_s: float
    K_rad_s_V: float
    fc_V: float
    asym_V: float
    delay_s: float
    half_percent: Mapping[str, float]
    covariance: Array
    residual_over_noise: float
    residual_error: float
    drives_differ: bool
    laws: tuple[str, ...]
    seconds_of_data: float
    framed: FramedMotor = field(repr=False)

    @property
    def worst_percent(self) -> float:
        """Half width of the widest interval, in % of its parameter."""
        return max(self.half_percent.values())

    def motor(self) -> FramedMotor:
        """The motor with its laws."""
        return self.framed


class _Laws(NamedTuple):
    """Laws that are fitted.

    frame   what laws over the angle refer to
    bench   sizes that their ranges are measured in; None: those of the prior motor
    """

    laws: tuple[Departure, ...]
    frame: Frame
    bench: Bench | None = None

    @classmethod
    def of(cls, prior: FramedMotor | None) -> _Laws:
        """Those of a prior motor; but for drift, which belongs to its own run."""
        if prior is None:
            return cls((), Frame())
        return cls(tuple(law for law in DEPARTURES if law.name in prior.parts and law.name != "drift"), prior.frame)

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(law.name for law in self.laws)

    @property
    def numbers(self) -> tuple[str, ...]:
        """Their fields of ``RealMotor``."""
        return tuple(name for law in self.laws for name in (*law.numbers, *law.shape))

    @property
    def fitted(self) -> tuple[str, ...]:
        """Those that are fitted: no derivative shows the size of a law that leaps, so it stays as it was found."""
        return tuple(name for law in self.laws if not law.leaps for name in (*law.numbers, *law.shape))


class LiveFit:
    """The fit of everything driven so far. It reads no clock and draws no random numbers."""

    def __init__(self, settings: LiveSettings) -> None:
        self.settings = settings
        self._laws = self._known_laws = _Laws.of(settings.prior)  # that are fitted
        self._laws_at = 0.0  # seconds of motion when laws were looked for last
        self._rows: list[LiveRows] = []
        self._count = 0
        self._last: Fit | None = None
        self._starts: dict[float, Array] = {}
        self._cold_at = 0.0  # seconds of motion at the last search for a start
        self._sure = False
        self._late = False  # whether drives act later than the rows say: then the delay is fitted, too
        self._late_at = 0.0  # seconds of motion when that was looked at

    def take(self, rows: LiveRows) -> None:
        """Append rows. Raises ValueError on columns of unequal length."""
        if any(column.shape != rows.row.shape or column.ndim != 1 for column in rows):
            raise ValueError("every column needs one value a row")
        if rows.row.size:
            self._rows.append(rows)
            self._count += int(rows.row.size)

    def estimate(self, *, seeks_laws: bool = False) -> LiveEstimate | None:
        """What the rows so far say; None if they say next to nothing, and nothing was known beforehand.

        seeks_laws  whether to look for laws although the residual does not ask for them: it takes a second
        """
        record = self._record()
        if record is None:
            return self._of_prior()
        windows, found = record
        cut = self._parts(windows, found)
        moving = sum((m.stop - m.first) * w.period_s for w, each in zip(windows, found, strict=True) for m in each)
        fit = self._warm(cut)
        if fit is None or self._looks_elsewhere(fit, moving):
            self._cold_at = moving
            others = [solve(trial, COLD_ITERATIONS) for trial in self._cold(cut)]
            fits = [one for one in (fit, *others) if one is not None and math.isfinite(one.cost)]
            fit = min(fits, key=_cost) if fits else None
        if fit is None:
            return self._of_prior()
        self._keep(fit)
        fit = self._lengthened(fit)
        if self._looks_late(fit, moving):
            fit, found = self._later(fit, found)
        speeds = swing_speeds(fit.problem.cut.windows, found, self.settings.sigma_rad)
        if self._looks_for_laws(fit, moving, len(speeds), seeks_laws):
            self._laws_at = moving
            fit = self._with_laws(fit, found, 2.0 * moving / len(speeds))
        estimate = self._estimate(fit, speeds, moving)
        if estimate is None:
            self._last = None
            self._laws = self._known_laws
            return self._of_prior()
        self._sure = estimate.worst_percent <= SURE_PERCENT
        return estimate

    def _looks_late(self, fit: Fit, moving_s: float) -> bool:
        """Whether to look for a delay that no row tells: the residual is strange, and the record has doubled since."""
        free = self._late or DELAY in fit.problem.free
        return not free and math.sqrt(unit(fit)) > STRANGE and moving_s > 2.0 * self._late_at

    def _later(self, fit: Fit, found: list[list[Motion]]) -> tuple[Fit, list[list[Motion]]]:
        """The fit with a delay beyond the times of the rows, and its motions, if that explains much; else the same."""
        self._late_at = sum((m.stop - m.first) * self.settings.period_s for each in found for m in each)
        self._late = True
        record = self._record()
        if record is not None:
            windows, later = record
            late = self._warm(self._cut(windows, self._motions(windows, through=True)))
            if late is not None and late.rms_rad < EXPLAINS * fit.rms_rad:
                self._keep(late)
                return late, later
        self._late = False
        return fit, found

    def _looks_for_laws(self, fit: Fit, moving_s: float, swings: int, seeks: bool) -> bool:
        """Whether to look for laws: asked to, or by the residual; and the record has grown since they were last."""
        if swings < 2 * ENOUGH_SWINGS:
            return False
        if seeks and moving_s > LONGER * self._laws_at:
            return True
        return math.sqrt(unit(fit)) > LACKING and moving_s > 2.0 * self._laws_at

    def _with_laws(self, fit: Fit, found: list[list[Motion]], cycle_s: float) -> Fit:
        """The fit with the laws that the rows show, if these explain more; else the same fit."""
        windows = fit.problem.cut.windows
        delay_s = self._delay_s if DELAY in fit.problem.free else None
        plain = fit.motor._replace(**dict.fromkeys(self._laws.numbers, 0.0))
        sigma_rad, stated = self.settings.sigma_rad, self.settings.stated
        shown = laws_so_far([window.series for window in windows], plain, cycle_s, sigma_rad, delay_s, stated)
        if set(shown.laws) <= set(self._laws.laws):
            return fit
        before = self._laws
        self._laws = _Laws(shown.laws, shown.frame, shown.bench)
        self._last = replace(fit, motor=shown.motor)
        richer = self._warm(self._parts(windows, found))
        if richer is not None and richer.rms_rad < fit.rms_rad:
            self._keep(richer)
            return self._lengthened(richer)
        self._laws = before
        self._keep(fit)
        return fit

    def _parts(self, windows: Sequence[Window], found: Sequence[Sequence[Motion]]) -> Cut:
        """The motions in parts short enough for any motor to be fitted."""
        longest = [max(FEWEST_MOVING_ROWS, round(PART_S / window.period_s)) for window in windows]
        return self._cut(windows, [in_parts(each, rows) for each, rows in zip(found, longest, strict=True)])

    def _lengthened(self, fit: Fit) -> Fit:
        """The fit of the same motions without cuts, if the motor bears it; else the same."""
        windows = fit.problem.cut.windows
        longer = self._warm(self._cut(windows, self._motions(windows, through=True)))
        if longer is None or not bears(longer, fit):
            return fit
        self._keep(longer)
        return longer

    def _keep(self, fit: Fit) -> None:
        """Take this fit as the start of the next one."""
        self._last = fit
        begins_s = fit.problem.cut.t_s[fit.problem.cut.begins]
        self._starts |= dict(zip(begins_s.tolist(), fit.starts, strict=True))

    def _cut(self, windows: Sequence[Window], found: Sequence[Sequence[Motion]]) -> Cut:
        return Cut.of_motions(windows, [self._frame(windows)] * len(windows), found)

    def _record(self) -> tuple[list[Window], list[list[Motion]]] | None:
        """The rows so far between gaps, and the motions in each part; None if the shaft has hardly moved."""
        if self._count < FEWEST_ROWS:
            return None
        self._rows = [LiveRows(*(np.concatenate(columns) for columns in zip(*self._rows, strict=True)))]
        windows: list[Window] = []
        for series in self._series(self._rows[0]):
            latest_s = (self._delay_s[1] if self._late else 0.0) if series.delay_s is None else series.delay_s[1]
            if len(series) - np.searchsorted(series.t_s, series.edge_s[0] + latest_s) < FEWEST_ROWS:
                continue
            windows.append(series.predictable(latest_s))
        found = self._motions(windows)
        windows = [window for window, each in zip(windows, found, strict=True) if each]
        found = [each for each in found if each]
        if sum(motion.stop - motion.first for each in found for motion in each) < FEWEST_MOVING_ROWS:
            return None
        return windows, found

    def _motions(self, windows: Sequence[Window], *, through: bool = False) -> list[list[Motion]]:
        sensor = self.settings.sigma_rad, self.settings.lsb_rad
        return [motions(window, *sensor, through=through) for window in windows]

    def _series(self, rows: LiveRows) -> list[TimeSeries]:
        """The rows between gaps of the record, each part at one rate."""
        out = []
        for part in np.split(np.arange(rows.t_s.size), _cuts(rows.t_s, self.settings.period_s)):
            known = np.isfinite(rows.t_u_s[part])
            tells = self.settings.delay_s is None and bool(known.any())
            kept = part[known] if tells else part
            if kept.size < FEWEST_ROWS:
                continue
            t_u_s = np.maximum.accumulate(rows.t_u_s[kept]) if tells or known.all() else None
            series = TimeSeries(rows.t_s[kept], rows.y_rad[kept], t_u_s, rows.u_V[kept], int(rows.row[kept[0]]))
            out.append(series if tells else series.with_unknown_delay(self._delay_s))
        return out

    @property
    def _delay_s(self) -> tuple[float, float]:
        """Bounds of the delay that is fitted, s."""
        return self.settings.delay_s or (0.0, 2.0 * self.settings.period_s)

    def _frame(self, windows: Sequence[Window]) -> Frame:
        start_s = float(windows[0].t_s[0])
        return self._laws.frame._replace(start_s=start_s, duration_s=max(float(windows[-1].t_s[-1]) - start_s, 1e-9))

    def _problem(self, cut: Cut) -> Problem:
        """The fit as least squares; a prior motor is known to its percentage."""
        free_delay = self._late or any(window.series.t_u_s is None for window in cut.windows)
        core = (*CORE, DELAY) if free_delay else CORE
        free = core + self._laws.fitted
        limits = limits_of(free, cut, self._delay_s)
        limits["fc_V"] = (0.0, self.settings.largest_V)
        limits["tau_s"] = (0.2 * self.settings.period_s, 100.0)
        prior = self.settings.prior
        known = None
        bench = self._laws.bench
        if bench is None and prior is not None:
            bench = cut.bench(prior.motor, 0.0)
        if bench is not None:
            limits |= limits_of_laws(self._laws.laws, bench)
        if prior is not None:
            share, motor = 0.01 * self.settings.prior_percent, prior.motor
            errors = [share, share, share * max(motor.fc_V, 1e-3 * self.settings.largest_V)]
            mean = [math.log(motor.tau_s), math.log(motor.K_rad_s_V), motor.fc_V]
            known = Known.of(CORE[:3], mean, np.diag(np.square(errors)))
        return Problem(cut, free, limits, self.settings.sigma_rad, known=known)

    def _warm(self, cut: Cut) -> Fit | None:
        """The fit from the last one on, or from the prior motor; None without either."""
        prior = self.settings.prior
        motor = self._last.motor if self._last is not None else None if prior is None else self._first(prior)
        if motor is None:
            return None
        fit = begin(self._problem(cut), motor)
        for k, t_s in enumerate(cut.t_s[cut.begins].tolist()):
            if t_s in self._starts:
                fit.starts[k] = self._starts[t_s]
        residual = cut.readings(fit.motor, fit.starts) - cut.y_rad
        fit = replace(fit, residual_rad=residual, cost=fit.problem.cost(residual, fit.motor))
        return solve(fit, ITERATIONS)

    def _first(self, prior: FramedMotor) -> RealMotor:
        return prior.motor._replace(delay_s=sum(self._delay_s) / 2.0 if self.settings.delay_s is not None else 0.0)

    def _looks_elsewhere(self, fit: Fit, moving_s: float) -> bool:
        """Whether another start is tried, too: until the fit is sure, and where its residual is strange."""
        if self.settings.prior is not None:
            return False
        if not self._sure:
            return moving_s > 1.25 * self._cold_at
        return math.sqrt(unit(fit)) > STRANGE and moving_s > 2.0 * self._cold_at

    def _cold(self, cut: Cut) -> list[Fit]:
        """Fits to start from where nothing is known: the best of a grid of tau and friction, each with its gain."""
        problem = self._problem(cut)
        weight = weight_of(cut)
        guessed = cut.guessed()
        moved_V = _least_drive(cut)
        longest_s = max(0.1 * cut.longest_s, 40.0 * self.settings.period_s)
        scored: list[tuple[float, float, float, float]] = []
        counts = np.maximum(np.add.reduceat(weight, cut.begins), 1.0)

        def centred(y: Array) -> Array:
            """Without the mean of each piece."""
            means = np.add.reduceat(weight * y, cut.begins) / counts
            return np.asarray(weight * (y - means[cut.piece]))

        seen = centred(cut.y_rad)
        for tau in np.geomspace(1.5 * self.settings.period_s, longest_s, COLD_TAUS).tolist():
            for share in COLD_SHARES:
                gain, cost = 0.3 * float(np.ptp(cut.y_rad)) / (longest_s * moved_V), math.inf
                for _ in range(2):
                    motor = RealMotor(tau, gain, share * moved_V, 0.0, float(np.mean(self._delay_s)))
                    shape = centred(cut.readings(motor, guessed))
                    power = float(shape @ shape)
                    if power <= 0.0 or (ratio := float(shape @ seen) / power) <= 0.0:
                        break
                    off = seen - ratio * shape
                    gain, cost = gain * ratio, float(off @ off)
                scored.append((cost, tau, gain, share * moved_V))
        scored.sort()
        delay_s = float(np.mean(self._delay_s)) if DELAY in problem.free else 0.0
        return [
            begin(problem, RealMotor(tau, gain, friction_V, 0.0, delay_s))
            for cost, tau, gain, friction_V in scored[:POLISHED]
            if math.isfinite(cost)
        ]

    def _estimate(self, fit: Fit, speeds: Sequence[float], moving_s: float) -> LiveEstimate | None:
        """The fit with its intervals; None if it says nothing. ``speeds``: as ``swing_speeds``."""
        problem, motor, cut = fit.problem, fit.motor, fit.problem.cut
        normal = Normal.of(problem.rows(motor, fit.starts), cut)
        if not normal.is_finite:
            return None
        counted = weight_of(cut) > 0.0
        freedom = max(cut.freedom - len(problem.free), 1)
        ratio = math.sqrt(float(np.sum(fit.residual_rad[counted] ** 2)) / freedom) / problem.sigma_rad
        spread = float(np.std(cut.y_rad[counted]))
        inverse = _inverse(normal.matrix)
        if inverse is None or ratio * problem.sigma_rad > UNEXPLAINED * spread + 3.0 * problem.sigma_rad:
            return None
        core = (*CORE, DELAY)
        at = [problem.free.index(name) for name in core if name in problem.free]
        to = [k for k, name in enumerate(core) if name in problem.free]
        covariance = np.zeros((5, 5))
        covariance[np.ix_(to, to)] = inverse[np.ix_(at, at)] * max(1.0, ratio) ** 2
        sizes = (1.0, 1.0, max(motor.fc_V, 1e-12))
        errors = np.sqrt(np.diag(covariance)[:3]) / sizes
        half = {name: 100.0 * NORMAL_95 * float(error) for name, error in zip(OF_PARAMETERS, errors, strict=True)}
        prior = self.settings.prior
        if max(half.values()) > (USABLE_PERCENT if prior is None else 1e3):
            return None
        return LiveEstimate(
            int(self._rows[0].row[-1]),
            float(self._rows[0].t_s[-1]),
            *motor[:5],
            half,
            covariance,
            ratio,
            1.0 / math.sqrt(2.0 * freedom),
            drives_differ(speeds),
            self._laws.names,
            moving_s,
            FramedMotor(motor, cut.frames[0]),
        )

    def _of_prior(self) -> LiveEstimate | None:
        """The prior motor as an estimate; None without one."""
        prior = self.settings.prior
        if prior is None:
            return None
        motor, share = self._first(prior), 0.01 * self.settings.prior_percent
        asym_V = share * max(motor.fc_V, 0.05 * self.settings.largest_V)
        delay = 0.0 if self.settings.delay_s is None else (self._delay_s[1] - self._delay_s[0]) / math.sqrt(12.0)
        rows = self._rows[-1] if self._rows else None
        return LiveEstimate(
            -1 if rows is None else int(rows.row[-1]),
            math.nan if rows is None else float(rows.t_s[-1]),
            *motor[:5],
            dict.fromkeys(OF_PARAMETERS, 100.0 * NORMAL_95 * share),
            np.diag(np.array([share, share, share * motor.fc_V, asym_V, delay]) ** 2),
            math.nan,
            math.inf,
            False,
            self._laws.names,
            0.0,
            replace(prior, motor=motor),
        )


def _cuts(t_s: Array, period_s: float) -> NDArray[np.int64]:
    """Rows at which a record is cut: after a gap, and where its rate changes, as a law in the device has its own."""
    step_s = np.diff(t_s)
    is_quick = step_s < QUICK * period_s
    changes = np.concatenate(([False], is_quick[1:] != is_quick[:-1]))[: step_s.size]
    return np.asarray(np.flatnonzero((step_s > GAP_PERIODS * period_s) | changes) + 1)


def drives_differ(speeds: Sequence[float]) -> bool:
    """Whether there are large swings of clearly different mean speeds. ``speeds``: as ``swing_speeds``."""
    rising = sorted(speeds)
    return len(rising) >= 2 * ENOUGH_SWINGS and rising[-ENOUGH_SWINGS] > DIFFERENT * rising[ENOUGH_SWINGS - 1]


def swing_speeds(windows: Sequence[Window], found: Sequence[Sequence[Motion]], noise_rad: float) -> list[float]:
    """Mean speed of each large swing of the motions, rad/s."""
    speeds: list[float] = []
    for window, each in zip(windows, found, strict=True):
        # one swing may be several motions; standstills between them take no time
        step_s = np.diff(window.t_s, prepend=window.t_s[0])
        moves = np.zeros(step_s.size, dtype=bool)
        for motion in each:
            moves[motion.first : motion.stop] = True
        speeds += _swings(np.cumsum(np.where(moves, step_s, 0.0)), window.y_rad, LARGE_SWING * noise_rad)
    return speeds


def _swings(t_s: Array, y_rad: Array, least_rad: float) -> list[float]:
    """Mean speeds of the swings of at least ``least_rad``, rad/s."""
    speeds = []
    low = high = turn = 0
    way = 0
    for k in range(1, y_rad.size):
        high = k if y_rad[k] > y_rad[high] else high
        low = k if y_rad[k] < y_rad[low] else low
        if way >= 0 and y_rad[high] - y_rad[k] > least_rad:
            if way > 0:
                speeds.append(float((y_rad[high] - y_rad[turn]) / max(t_s[high] - t_s[turn], 1e-9)))
            way, turn, low = -1, high, k
        elif way <= 0 and y_rad[k] - y_rad[low] > least_rad:
            if way < 0:
                speeds.append(float((y_rad[turn] - y_rad[low]) / max(t_s[low] - t_s[turn], 1e-9)))
            way, turn, high = 1, low, k
    return speeds


def weight_of(cut: Cut) -> Array:
    """Weight of each row, 0 or 1, (n,)."""
    return np.ones(cut.t_s.size) if cut.weight is None else cut.weight


def _cost(fit: Fit) -> float:
    return fit.cost


def _least_drive(cut: Cut) -> float:
    """The smallest of the largest drives of all pieces that count, V: friction is below it."""
    weight = weight_of(cut)
    drives = []
    for window in cut.windows:
        edge_s, u_V = window.steps
        drives.append(np.abs(u_V[np.maximum(np.searchsorted(edge_s, window.t_s, side="right") - 1, 0)]))
    largest = np.maximum.reduceat(weight * np.concatenate(drives), cut.begins)
    return float(np.min(largest[largest > 0.0], initial=math.inf))


def _inverse(matrix: Array) -> Array | None:
    """Inverse of normal equations; None if they do not tell the numbers."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if values[0] < 1e-11 * values[-1]:
        return None
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))
