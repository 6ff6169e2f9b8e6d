"""Friction by linear least squares on the transient (Besancon-Voda and Besancon; docs/theory.md 5.1 and 5.2).

Hysteretic relays with different drives d_i start from rest at zero. Until the first switching the motion is linear:
y_i(t) = (d_i - f) g(t) with one g for all runs. So y_j d_i - y_i d_j = f (y_j - y_i), with one unknown, by least
squares. f is the moving friction in the direction of the runs, less the bias: fc - asym upwards, fc + asym downwards.
tau and K stay unknown.

Both sides of the equation contain noise, and every start that is not zero. Both bias the estimate: noise pulls it
towards the mean of the drives, and a start of a few mrad can cost several per cent. The value is the method's own. Its
interval comes from a fit that allows for both: total least squares of (y_1, ..., y_n) against (d_1 - f, ..., d_n - f)
on displacements from the measured starts. If the two disagree, the estimate is doubtful, with the numbers.

The method cannot see a motor that changes between runs, or friction that depends on speed: these runs, too, look nearly
like multiples of one curve. ``compared_with`` compares it with an estimate that can see this.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rig.core.arrays import Array
from rig.identification import sampled_data
from rig.identification.chance import student_975
from rig.identification.estimate import Estimate
from rig.identification.estimator import Estimator
from rig.identification.measurements import Measurements
from rig.identification.plausibility import Objection
from rig.identification.verdict import in_percent
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.results import HystereticResult

METHOD = "least-squares"
FEWEST_SAMPLES = 8  # from the first drive to the first switching
START_S = 0.4  # length of the rows before the first drive that show the start
START_MATTERS = 0.05  # error from the starts, relative to the friction, from which on the starts count as not zero
MOTION_COUNTS = 4.0  # smallest motion, in sensor steps or in standard deviations of its noise
WIDE, TOO_WIDE = 0.1, 0.5  # half width of the interval, relative to the friction
NOISY = 2.0  # residual over the sensor's noise
NEGLIGIBLE = 0.003  # residual over the spread of positions, below which it does not matter
CORRELATED = 4.0  # largest correlation of neighbours in the residual, in standard deviations of white noise
DITHERED = 0.4  # noise over the sensor's step from which on a mean is finer than the steps


class LeastSquares(Estimator):
    """Friction alone, from the runs of hysteretic relays. It reads each run until its drive changes."""

    name = METHOD
    reads_relay_tests = False

    def applies(self, data: Measurements) -> IdentifyError | None:
        """From two runs on."""
        return lacking(data.hysteretic)

    def fit(self, data: Measurements) -> Estimate:
        """From all runs."""
        return fit(data.hysteretic)

    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        """Compare it with the sampled-data estimate, which uses the whole motion."""
        whole = earlier.get(sampled_data.METHOD)
        return estimate if whole is None else compared_with(estimate, whole, data.hysteretic)


@dataclass(frozen=True)
class Transient:
    """One run from its first drive to its first switching.

    name            of the series
    d_V             its drive, V
    t_s, y_rad      time since the drive took effect, s, and recorded position, rad; from the last row before the drive
    start_rad       mean position at rest before the drive, rad; start_error_rad its standard error
    start_v_rad_s   slope of the position there, and start_v_error_rad_s its standard error (inf if not recorded)
    noise_rad, step_rad   standard deviation of the sensor's noise, and its resolution, rad
    switched        whether the first switching is recorded
    timed           whether the time at which the drive took effect is recorded
    rows            first and last row of ``t_s`` in the file
    """

    name: str
    d_V: float
    t_s: Array
    y_rad: Array
    start_rad: float
    start_error_rad: float
    start_v_rad_s: float
    start_v_error_rad_s: float
    noise_rad: float
    step_rad: float
    switched: bool
    timed: bool
    rows: tuple[int, int]

    @classmethod
    def of(cls, series: TimeSeries) -> Transient:
        """The transient of a series. Its drive is 0 at first, if that is recorded, then d until it changes.

        Raises IdentifyError if the drive is always 0, or if the series has too few rows.
        """
        driven = np.flatnonzero(series.u_V != 0.0)
        if driven.size == 0:
            raise IdentifyError(
                f"{series.name}: the drive is 0 V throughout the run",
                "record a hysteretic relay from rest: `rig relay CONFIG` with relay.hysteretic",
            )
        first = int(driven[0])
        d_V = float(series.u_V[first])
        changed = np.flatnonzero(series.u_V[first:] != d_V)
        switched = changed.size > 0 and series.u_V[first + int(changed[0])] * d_V < 0.0
        last = first + int(changed[0]) if changed.size else len(series) - 1
        noise, step = series.noise_rad(), series.resolution_rad()
        # the sample in the row of the first drive is from before that drive
        rest = slice(int(np.searchsorted(series.t_s, series.t_s[first] - START_S)), first + 1)
        t, y = series.t_s[rest], series.y_rad[rest]
        error = noise / math.sqrt(y.size)
        if float(np.std(y)) < DITHERED * step:
            error = math.hypot(error, step / math.sqrt(12.0))
        slope, slope_error = 0.0, math.inf
        if y.size >= 4:
            x = t - t.mean()
            power = float(x @ x)
            slope, slope_error = float(x @ y) / power, math.hypot(noise, step) / math.sqrt(power)
        return cls(
            series.name,
            d_V,
            series.t_s[first : last + 1] - float(series.edge_s[first]),
            series.y_rad[first : last + 1],
            float(y.mean()),
            error,
            slope,
            slope_error,
            noise,
            step,
            bool(switched),
            series.t_u_s is not None,
            (series.first_row + first, series.first_row + last),
        )

    def as_result(self) -> HystereticResult:
        """As in result.json; ``switched_s`` and ``switched_rad`` are None if no switching is recorded."""
        return HystereticResult.of(
            self,
            stage=self.name,
            switched_s=float(self.t_s[-1]) if self.switched else None,
            switched_rad=float(self.y_rad[-1]) if self.switched else None,
        )

    @property
    def moves(self) -> bool:
        """Whether it moved from its start by more than noise and resolution of the sensor."""
        way = math.copysign(1.0, self.d_V)
        reached = float(np.median(way * (self.y_rad[-3:] - self.start_rad)))
        return reached > MOTION_COUNTS * max(self.noise_rad, self.step_rad, 1e-12)


@dataclass(frozen=True)
class OneWay:
    """Friction from runs that all start in one direction.

    friction_V      the method's value, V: least squares on the recorded positions
    corrected_V     total least squares on displacements from the measured starts, V
    error_V         standard error of ``corrected_V``, with ``freedom`` degrees of freedom
    by_starts_V, by_noise_V   parts of the method's value from starts and from noise, V
    by_timing_V_s   change of the value for each second by which one run's drive acts later than the other's, V/s
    t_s             n times since the drive took effect, s
    trace_V         n values of the recursion, V
    residual_rad    (n, runs - 1) residuals of the corrected fit, across (d_1 - f, ...), rad
    rms_rad         their RMS, by the degrees of freedom, rad
    """

    friction_V: float
    corrected_V: float
    error_V: float
    freedom: int
    by_starts_V: float
    by_noise_V: float
    by_timing_V_s: float
    t_s: Array
    trace_V: Array
    residual_rad: Array
    rms_rad: float


def batch(y_rad: Array, d_V: Array) -> float:
    """Least-squares friction, V, from (n, runs) positions under the drives ``d_V``; nan if the runs do not differ."""
    x, b = _equation(y_rad, d_V)
    power = float(x @ x)
    return float(x @ b) / power if power > 0.0 else math.nan


def recursive(y_rad: Array, d_V: Array, first_V: float = 0.0, covariance: float = math.inf) -> Array:
    """Recursive least squares: n estimates of the friction, V, one after each of n samples of all runs.

    first_V, covariance   start value, V, and its covariance (V^2/rad^2, of unit noise); by default nothing is known
                          at the start, and the last value is that of ``batch``
    Entries are nan until the runs differ.
    """
    x, b = _equation(y_rad, d_V)
    pairs = x.size // y_rad.shape[0]
    power = 0.0 if math.isinf(covariance) else 1.0 / covariance
    estimate = first_V
    trace = np.empty(y_rad.shape[0])
    for k in range(trace.size):
        for p in range(k * pairs, (k + 1) * pairs):
            power += x[p] * x[p]
            if power > 0.0:
                estimate += x[p] * (b[p] - x[p] * estimate) / power
        trace[k] = estimate if power > 0.0 else math.nan
    return trace


def total(y_rad: Array, d_V: Array) -> float:
    """Total least squares: the f, V, for which (n, runs) displacements are nearest to g(t) (d_1 - f, ..., d_n - f).

    Nearest means the least sum of squares over all runs, with g free at each time. This is maximum likelihood if all
    runs have equal white noise. The extremes of |Y w|^2/|w|^2 over w = d - f are the roots of a quadratic in f.
    """
    scatter = y_rad.T @ y_rad
    ones = np.ones(d_V.size)
    a, b, c = float(d_V @ scatter @ d_V), float(ones @ scatter @ d_V), float(ones @ scatter @ ones)
    A, B, N = float(d_V @ d_V), float(d_V.sum()), float(d_V.size)
    roots = np.roots([b * N - B * c, c * A - a * N, a * B - b * A])
    roots = roots[np.isreal(roots)].real
    if roots.size == 0:
        return math.nan
    return float(max(roots, key=lambda f: (a - 2.0 * b * f + c * f * f) / (A - 2.0 * B * f + N * f * f)))


def _equation(y_rad: Array, d_V: Array) -> tuple[Array, Array]:
    """Both sides of b = f x, for each sample and pair of runs; the first index is the sample."""
    pairs = list(combinations(range(d_V.size), 2))
    x = np.stack([y_rad[:, j] - y_rad[:, i] for i, j in pairs], axis=1)
    b = np.stack([y_rad[:, j] * d_V[i] - y_rad[:, i] * d_V[j] for i, j in pairs], axis=1)
    return x.ravel(), b.ravel()


def one_way(runs: Sequence[Transient]) -> OneWay:
    """Friction from two or more runs that start in one direction with different drives.

    Raises IdentifyError if the runs have too few samples in common.
    """
    from scipy.interpolate import Akima1DInterpolator  # they load slowly, and few records are of such runs
    from scipy.linalg import null_space

    shortest = min(runs, key=lambda run: float(run.t_s[-1]))
    begin, end = max(max(0.0, float(run.t_s[0])) for run in runs), float(shortest.t_s[-1])
    inside = (shortest.t_s[1:] > begin) & (shortest.t_s[1:] <= end)
    t_s = shortest.t_s[1:][inside]
    if t_s.size < FEWEST_SAMPLES:
        raise IdentifyError(
            f"{t_s.size} samples before the first switching are too few",
            "sample faster, widen the hysteresis, or lower the drives",
        )
    y = np.stack([np.asarray(Akima1DInterpolator(run.t_s, run.y_rad)(t_s)) for run in runs], axis=1)
    way = math.copysign(1.0, runs[0].d_V)
    y *= way
    d = np.array([abs(run.d_V) for run in runs])
    moved = y - way * np.array([run.start_rad for run in runs])
    friction, moved_friction, corrected = batch(y, d), batch(moved, d), total(moved, d)
    w = d - corrected
    shape = moved @ w / float(w @ w)
    residual = moved @ null_space(w[np.newaxis, :])
    freedom = max(1, t_s.size * (d.size - 1) - 1)
    rms = math.sqrt(float(np.sum(residual**2)) / freedom)
    across = 1.0 - w * float(w.sum()) / float(w @ w)  # change of w with f, its part perpendicular to w
    power = float(across @ across) * float(shape @ shape)
    starts = np.array([run.start_error_rad for run in runs])
    variance = rms**2 / power + float(np.sum((across * starts) ** 2)) * (float(shape.sum()) / power) ** 2
    speed = np.gradient(shape, t_s)
    return OneWay(
        friction,
        corrected,
        math.sqrt(variance),
        freedom,
        friction - moved_friction,
        moved_friction - corrected,
        float(np.max(np.abs(across * w))) * abs(float(shape @ speed)) / power,
        t_s,
        recursive(y, d),
        residual,
        rms,
    )


def lacking(tests: Sequence[TimeSeries]) -> IdentifyError | None:
    """Why these runs are not enough, and what to record; None if they are."""
    if len(tests) >= 2:
        return None
    return IdentifyError(
        f"{METHOD} needs two runs from rest with different drives, not {len(tests)}",
        "give relay.hysteretic two or more entries, or name two CSV files",
    )


def fit(tests: Sequence[TimeSeries]) -> Estimate:
    """Friction from the runs of hysteretic relays, with its verdict.

    tests    two or more runs, each from rest at zero, with different drives of one sign; two or more runs of the other
             sign also give the asymmetry
    tau_s and K_rad_s_V are nan: the method does not give them. ``iterates`` is the recursion: nan, nan, friction.
    Raises IdentifyError for fewer than two runs.
    """
    wrong = lacking(tests)
    if wrong is not None:
        raise wrong
    runs = [Transient.of(series) for series in tests]
    rows = (min(run.rows[0] for run in runs), max(run.rows[1] for run in runs))
    nothing = Estimate(METHOD, math.nan, math.nan, math.nan, rows=rows)
    unusable = [*_unusable(runs), *_unequal(runs)]
    if unusable:
        return nothing.judged("refused", *unusable)
    ways = [way for way in ([r for r in runs if r.d_V > 0.0], [r for r in runs if r.d_V < 0.0]) if way]
    try:
        found = [one_way(way) for way in ways]
    except IdentifyError as error:
        return nothing.judged("refused", f"{error.cause}: {error.cure}")
    return _judged(_combined(found, rows), found, ways)


def _unusable(runs: Sequence[Transient]) -> list[str]:
    """One sentence for each run that did not move, or did not switch."""
    reasons = []
    for run in runs:
        if not run.moves:
            reasons.append(
                f"{run.name}: {run.d_V:+.3g} V does not move the shaft, which takes more than static friction: "
                "record with a larger drive"
            )
        elif not run.switched:
            reasons.append(
                f"{run.name}: the recording ends before the first switching, so nothing shows that the relay ran: "
                "record until the drive has changed sign"
            )
    return reasons


def _unequal(runs: Sequence[Transient]) -> list[str]:
    """One sentence for each direction with equal drives, or with a single run."""
    reasons = []
    for word, way in (
        ("rising", [run for run in runs if run.d_V > 0.0]),
        ("falling", [run for run in runs if run.d_V < 0.0]),
    ):
        drives = sorted(abs(run.d_V) for run in way)
        if len(way) == 1:
            reasons.append(f"only one run starts towards {word} positions: record two with different drives each way")
        elif drives and drives[-1] - drives[0] < 0.02 * drives[-1]:
            written = ", ".join(f"{drive:.3g}" for drive in drives)
            reasons.append(
                f"the drives towards {word} positions ({written} V) do not differ, so the equation is 0 = 0: "
                "record with different drives"
            )
    return reasons


def _combined(found: Sequence[OneWay], rows: tuple[int, int]) -> Estimate:
    """One estimate from one direction or both: f = fc - asym upwards, fc + asym downwards."""
    share = 1.0 / len(found)
    fc = share * sum(way.friction_V for way in found)
    corrected = share * sum(way.corrected_V for way in found)
    error = share * math.sqrt(sum(way.error_V**2 for way in found))
    reach = student_975(min(way.freedom for way in found)) * error
    covariance = np.full((5, 5), np.nan)
    covariance[2, 2] = error**2
    intervals = {"fc_V": (corrected - reach, corrected + reach)}
    asym = 0.0
    if len(found) == 2:
        up, down = found
        asym = 0.5 * (down.corrected_V - up.corrected_V)  # the method does not define it: use the unbiased values
        intervals["asym_V"] = (asym - reach, asym + reach)
        covariance[3, 3] = error**2
        covariance[2, 3] = covariance[3, 2] = 0.25 * (down.error_V**2 - up.error_V**2)
    count = max(way.trace_V.size for way in found)
    trace = share * np.sum([np.pad(way.trace_V, (0, count - way.trace_V.size), "edge") for way in found], axis=0)
    return Estimate(
        METHOD,
        math.nan,
        math.nan,
        fc,
        asym,
        ci95=intervals,
        covariance=covariance,
        rms_rad=math.sqrt(sum(way.rms_rad**2 for way in found) * share),
        iterations=count,
        rows=rows,
        iterates=np.column_stack((np.full((count, 2), np.nan), trace)),
        residual_rad=np.concatenate([way.residual_rad.ravel() for way in found]),
        residual_t_s=np.concatenate([np.repeat(way.t_s, way.residual_rad.shape[1]) for way in found]),
    )


def _judged(estimate: Estimate, found: Sequence[OneWay], ways: Sequence[Sequence[Transient]]) -> Estimate:
    """The estimate with its verdict. ``found`` and ``ways``: each direction's fit, and its runs."""
    runs = [run for way in ways for run in way]
    for objections in (
        _starts_in_motion(runs),
        _starts_off_zero(estimate, found, runs),
        _wide_interval(estimate, runs),
        _several_shapes(estimate, found, runs),
        _unknown_delays(found, ways),
        _one_direction(runs),
    ):
        for verdict, reason, _ in objections:
            estimate = estimate.judged(verdict, reason)
    return estimate


def _interval(estimate: Estimate) -> tuple[float, float]:
    """Middle and half width of the friction's interval, V. The middle is the friction without the method's bias."""
    low, high = estimate.ci95["fc_V"]
    return 0.5 * (high + low), 0.5 * (high - low)


def _size_V(estimate: Estimate, runs: Sequence[Transient]) -> float:
    """Friction that errors are relative to, V; a small part of the drives where friction is almost zero."""
    return max(abs(_interval(estimate)[0]), 0.03 * max(abs(run.d_V) for run in runs))


def _starts_in_motion(runs: Sequence[Transient]) -> Iterator[Objection]:
    """Runs that do not start from rest, and runs whose start no row shows."""
    for run in runs:
        if abs(run.start_v_rad_s) > 4.0 * run.start_v_error_rad_s:
            yield Objection(
                "refused",
                f"{run.name}: the shaft turns at {1e3 * run.start_v_rad_s:+.2g} mrad/s before the drive: the "
                "method needs a start from rest; let it come to rest",
            )
    unseen = [run.name for run in runs if math.isinf(run.start_v_error_rad_s)]
    if unseen:
        yield Objection(
            "doubtful",
            f"{', '.join(unseen)}: too few rows before the drive to see that the shaft rests: record "
            f"{START_S:g} s at 0 V before each run",
        )


def _starts_off_zero(estimate: Estimate, found: Sequence[OneWay], runs: Sequence[Transient]) -> Iterator[Objection]:
    """Starts that change the value, or a value off the middle of its interval."""
    corrected, reach = _interval(estimate)
    by_starts, by_noise = (
        sum(shifts) / len(found) for shifts in ([w.by_starts_V for w in found], [w.by_noise_V for w in found])
    )
    starts = ", ".join(f"{1e3 * run.start_rad:+.1f} mrad ({run.name})" for run in runs)
    seen = any(abs(run.start_rad) > 3.0 * run.start_error_rad for run in runs)
    off = abs(estimate.fc_V - corrected)
    if seen and any(abs(way.by_starts_V) > START_MATTERS * _size_V(estimate, runs) for way in found):
        yield Objection(
            "refused",
            f"the runs do not start from zero but from {starts}: this changes the value by "
            f"{by_starts:+.2g} V; bring the shaft to zero before each run",
        )
    elif off > 0.5 * reach:
        yield Objection(
            "doubtful" if off > reach else "ok",
            f"the method's value lies {'outside' if off > reach else 'off the middle of'} its interval: starts of "
            f"{starts} move it by {1e3 * by_starts:+.2g} mV and noise in both sides of the equation by "
            f"{1e3 * by_noise:+.2g} mV; without both it is {corrected:.4f} V",
        )


def _wide_interval(estimate: Estimate, runs: Sequence[Transient]) -> Iterator[Objection]:
    share = _interval(estimate)[1] / _size_V(estimate, runs)
    if share > WIDE:
        yield Objection(
            "refused" if share > TOO_WIDE else "doubtful",
            f"f_c is {f'only known to {in_percent(share)}' if share <= 1.0 else 'unknown'} (at 95 %): "
            "record drives that differ more, with a wider hysteresis, or sample faster",
        )


def _several_shapes(estimate: Estimate, found: Sequence[OneWay], runs: Sequence[Transient]) -> Iterator[Objection]:
    """Runs that are not multiples of one curve plus white noise."""
    neighbours = max(_neighbours(way.residual_rad) for way in found)
    noise = math.sqrt(sum(run.noise_rad**2 for run in runs) / len(runs))
    spread = max(float(np.ptp(run.y_rad)) for run in runs)
    if estimate.rms_rad > NEGLIGIBLE * spread and (estimate.rms_rad > NOISY * noise or neighbours > CORRELATED):
        yield Objection(
            "doubtful",
            f"the runs are not multiples of one curve: the residual, {1e3 * estimate.rms_rad:.2g} mrad, is "
            f"{estimate.rms_rad / noise if noise > 0.0 else math.inf:.1f} times the sensor's noise, and its neighbours "
            f"correlate by {neighbours:.1f} standard deviations: the motor changed between the runs, friction is "
            "more than Coulomb friction, the runs do not start from rest, or their times are wrong",
        )


def _unknown_delays(found: Sequence[OneWay], ways: Sequence[Sequence[Transient]]) -> Iterator[Objection]:
    untimed = [way.by_timing_V_s for way, runs in zip(found, ways, strict=True) if not all(r.timed for r in runs)]
    if untimed:
        yield Objection(
            "ok",
            "without t_u_s rig assumes that the drives of all runs act equally late: a difference of 1 ms would change "
            f"the value by {max(untimed):.2g} mV",
        )


def _one_direction(runs: Sequence[Transient]) -> Iterator[Objection]:
    rising = [run.d_V > 0.0 for run in runs]
    if all(rising) or not any(rising):
        side, sign = ("rising", "-") if rising[0] else ("falling", "+")
        yield Objection(
            "doubtful",
            f"this is the friction towards {side} positions alone, f_c {sign} a: the interval does not show the "
            "asymmetry; record two more runs with d_V of the other sign",
        )


def _neighbours(residual: Array) -> float:
    """Lag-one autocorrelation of (n, runs - 1) residuals, in standard deviations for white noise."""
    power = float(np.sum(residual**2))
    return math.sqrt(residual.size) * float(np.sum(residual[1:] * residual[:-1])) / power if power > 0.0 else 0.0


def compared_with(estimate: Estimate, whole: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    """Compare the friction with that of ``whole``, an estimate of the whole motor.

    The estimate becomes doubtful if the two differ by more than both intervals together.
    """
    if "fc_V" not in estimate.ci95 or "fc_V" not in whole.ci95 or whole.verdict == "refused":
        return estimate
    ways = {math.copysign(1.0, Transient.of(series).d_V) for series in tests}
    friction, names = whole.fc_V, ["fc_V"]
    if len(ways) == 1:
        friction -= ways.pop() * whole.asym_V
        names.append("asym_V")
    low, high = estimate.ci95["fc_V"]
    room = 0.5 * (high - low)
    room += sum(0.5 * (bounds[1] - bounds[0]) for name in names if (bounds := whole.ci95.get(name)) is not None)
    if abs(0.5 * (low + high) - friction) <= room:
        return estimate
    return estimate.judged(
        "doubtful",
        f"the {whole.method} estimate says {friction:.4f} V here, which differs by more than both intervals: "
        "perhaps friction depends on speed, or the motor changed between the runs; trust "
        f"the {whole.method} estimate",
    )
