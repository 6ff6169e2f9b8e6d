"""Friction by linear least squares on the transient (Besancon-Voda and Besancon; docs/theory.md 5.1 and 5.2).

Hysteretic relays of different drives d_i start from rest at zero. Until the first switching the motion is linear,
y_i(t) = (d_i - f) g(t) with the same g, so y_j d_i - y_i d_j = f (y_j - y_i): one unknown, by least squares. f is the
moving friction towards the side that the runs go to, less the bias: fc - asym upwards, fc + asym downwards. tau and K
stay unknown.

Both sides of the equation carry noise and every start that is not zero, and both bend the estimate: noise pulls it
towards the mean of the drives, a start of a few mrad can cost several per cent. So the value is the method's, and its
interval is that of a fit which knows both: total least squares of (y_1, ..., y_n) against (d_1 - f, ..., d_n - f) on
displacements from the measured starts. Where the two disagree the estimate is doubtful, with the numbers.

What the method cannot see: runs of a motor that changes between them, or of friction that depends on speed, look nearly
like multiples of one curve too. ``compared_with`` compares it with an estimate that can.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator
from scipy.linalg import null_space
from scipy.special import stdtrit

from rig.identify import sampled_data
from rig.identify.estimate import Estimate
from rig.identify.estimator import Estimator
from rig.identify.measurements import Measurements
from rig.recording.errors import IdentifyError
from rig.recording.series import TimeSeries
from rig.results import HystereticResult

Array = NDArray[np.float64]

METHOD = "least-squares"
FEWEST_SAMPLES = 8  # from the first drive to the first switching
START_S = 0.4  # of the rows before the first drive, which show the start
START_MATTERS = 0.05  # error by the starts, relative to the friction, from which on they are not zero
MOTION_COUNTS = 4.0  # sensor steps, or standard deviations of its noise, that are motion
WIDE, TOO_WIDE = 0.1, 0.5  # half width of the interval, relative to the friction
NOISY = 2.0  # residual over the sensor's noise
NEGLIGIBLE = 0.003  # residual over the spread of positions, below which it is no objection
CORRELATED = 4.0  # neighbours in the residual, in standard deviations of white noise
DITHERED = 0.4  # noise over the sensor's step from which on a mean is not tied to its steps


class LeastSquares(Estimator):
    """Friction alone, from the runs of hysteretic relays. It reads the drive only until that first changes."""

    name = METHOD
    reads_relay_tests = False

    def applies(self, data: Measurements) -> IdentifyError | None:
        """From two runs on."""
        return lacking(data.hysteretic)

    def fit(self, data: Measurements) -> Estimate:
        """From all runs."""
        return fit(data.hysteretic)

    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        """Held to the sampled-data estimate, which sees what a transient cannot show."""
        whole = earlier.get(sampled_data.METHOD)
        return estimate if whole is None else compared_with(estimate, whole, data.hysteretic)


@dataclass(frozen=True)
class Transient:
    """One run from its first drive to its first switching.

    name            of the series
    d_V             its drive, V
    t_s, y_rad      time since the drive took effect, and position as recorded; from the last row before it
    start_rad       mean position at rest before; start_error_rad its standard error
    start_v_rad_s   slope of the position there, and start_v_error_rad_s its standard error (inf where not seen)
    noise_rad, step_rad   of the sensor: standard deviation, resolution
    switched        whether the first switching is in the record
    timed           whether the record says when the drive took effect
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
        """The transient in a series whose drive is 0 at first, if that is recorded, then d until it changes.

        Raises IdentifyError where the series has no drive, or too few rows to look at.
        """
        driven = np.flatnonzero(series.u_V != 0.0)
        if driven.size == 0:
            raise IdentifyError(
                f"{series.name}: the drive is 0 V throughout",
                "record a hysteretic relay from rest: `rig relay CONFIG` with relay.hysteretic",
            )
        first = int(driven[0])
        d_V = float(series.u_V[first])
        changed = np.flatnonzero(series.u_V[first:] != d_V)
        switched = changed.size > 0 and series.u_V[first + int(changed[0])] * d_V < 0.0
        last = first + int(changed[0]) if changed.size else len(series) - 1
        noise, step = series.noise_rad(), series.resolution_rad()
        # the row of the first drive was sampled before it
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
        """As result.json holds it; ``switched_s`` and ``switched_rad`` are None where no switching is recorded."""
        return HystereticResult(
            stage=self.name,
            d_V=self.d_V,
            start_rad=self.start_rad,
            switched_s=float(self.t_s[-1]) if self.switched else None,
            switched_rad=float(self.y_rad[-1]) if self.switched else None,
            rows=self.rows,
        )

    @property
    def moves(self) -> bool:
        """Whether it left its start beyond noise and resolution of the sensor."""
        way = math.copysign(1.0, self.d_V)
        reached = float(np.median(way * (self.y_rad[-3:] - self.start_rad)))
        return reached > MOTION_COUNTS * max(self.noise_rad, self.step_rad, 1e-12)


@dataclass(frozen=True)
class OneWay:
    """Friction from runs that all start the same way.

    friction_V      the method's value: least squares on the positions as recorded
    corrected_V     total least squares on displacements from the measured starts
    error_V         standard error of that; freedom its degrees
    by_starts_V, by_noise_V   what starts and noise add to the method's value
    by_timing_V_s   what it would change for each second by which one run's drive acts later than the other's
    t_s             n times since the drive took effect
    trace_V         n values of the recursion
    residual_rad    (n, runs - 1) of the corrected fit, across (d_1 - f, ...); rms_rad with its degrees of freedom
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
    """Least-squares friction, V, from (n, runs) positions under the drives ``d_V``; nan where they do not differ."""
    x, b = _equation(y_rad, d_V)
    power = float(x @ x)
    return float(x @ b) / power if power > 0.0 else math.nan


def recursive(y_rad: Array, d_V: Array, first_V: float = 0.0, covariance: float = math.inf) -> Array:
    """Recursive least squares: n estimates of the friction, V, one after each of n samples of all runs.

    first_V, covariance   value and covariance (V^2/rad^2, of unit noise) to start from; by default nothing is known,
                          and the last value is the batch's. Entries are nan until the runs differ.
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
    """Total least squares: f for which (n, runs) displacements are nearest to g(t) (d_1 - f, ..., d_n - f), V.

    Nearest in the sum of squares over all runs, g free at each time: maximum likelihood where all have equal white
    noise. The extremes of |Y w|^2/|w|^2 over w = d - f are the roots of a quadratic in f.
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
    """Both sides of b = f x for each sample and pair of runs, samples first."""
    pairs = list(combinations(range(d_V.size), 2))
    x = np.stack([y_rad[:, j] - y_rad[:, i] for i, j in pairs], axis=1)
    b = np.stack([y_rad[:, j] * d_V[i] - y_rad[:, i] * d_V[j] for i, j in pairs], axis=1)
    return x.ravel(), b.ravel()


def one_way(runs: Sequence[Transient]) -> OneWay:
    """Friction from two or more runs that start the same way with different drives.

    Raises IdentifyError where they have too few samples in common.
    """
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
    across = 1.0 - w * float(w.sum()) / float(w @ w)  # how a change of f turns w, seen across it
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
    """Why these runs are not enough, and what to record; None where they are."""
    if len(tests) >= 2:
        return None
    return IdentifyError(
        f"{METHOD} needs two runs from rest with different drives, not {len(tests)}",
        "give relay.hysteretic two or more entries, or name two CSV files",
    )


def fit(tests: Sequence[TimeSeries]) -> Estimate:
    """Friction from the runs of hysteretic relays, with its verdict.

    tests    two or more runs, each from rest at zero, with different drives of one sign; with two or more of the other
             sign too, the friction's asymmetry shows
    tau_s and K_rad_s_V are nan: the method does not give them. ``iterates`` is the recursion: nan, nan, friction.
    Raises IdentifyError where there are no two runs.
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
    """Runs that did not move, or did not switch: a sentence for each."""
    said = []
    for run in runs:
        if not run.moves:
            said.append(
                f"{run.name}: {run.d_V:+.3g} V does not move the shaft: from rest it takes more than static friction; "
                "record with more"
            )
        elif not run.switched:
            said.append(
                f"{run.name}: the first switching is not in the record, so nothing shows that the relay was running: "
                "record on until the drive has changed sign"
            )
    return said


def _unequal(runs: Sequence[Transient]) -> list[str]:
    """Ways in which all drives are equal, or there is one run alone: a sentence for each."""
    said = []
    for word, way in (
        ("rising", [run for run in runs if run.d_V > 0.0]),
        ("falling", [run for run in runs if run.d_V < 0.0]),
    ):
        drives = sorted(abs(run.d_V) for run in way)
        if len(way) == 1:
            said.append(f"one run alone starts towards {word} positions: record two with different drives each way")
        elif drives and drives[-1] - drives[0] < 0.02 * drives[-1]:
            written = ", ".join(f"{drive:.3g}" for drive in drives)
            said.append(f"the drives towards {word} positions ({written} V) do not differ: the equation is 0 = 0 then")
    return said


def _combined(found: Sequence[OneWay], rows: tuple[int, int]) -> Estimate:
    """One estimate from one way or both: f = fc - asym upwards, fc + asym downwards."""
    share = 1.0 / len(found)
    fc = share * sum(way.friction_V for way in found)
    corrected = share * sum(way.corrected_V for way in found)
    error = share * math.sqrt(sum(way.error_V**2 for way in found))
    reach = float(stdtrit(min(way.freedom for way in found), 0.975)) * error
    covariance = np.full((5, 5), np.nan)
    covariance[2, 2] = error**2
    intervals = {"fc_V": (corrected - reach, corrected + reach)}
    asym = 0.0
    if len(found) == 2:
        up, down = found
        asym = 0.5 * (down.corrected_V - up.corrected_V)  # no quantity of the method: without what bends its values
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
    share = 1.0 / len(found)
    low, high = estimate.ci95["fc_V"]
    reach, corrected = 0.5 * (high - low), 0.5 * (high + low)
    by_starts = share * sum(way.by_starts_V for way in found)
    by_noise = share * sum(way.by_noise_V for way in found)
    runs = [run for way in ways for run in way]
    size = max(abs(corrected), 0.03 * max(abs(run.d_V) for run in runs))
    for run in runs:
        if abs(run.start_v_rad_s) > 4.0 * run.start_v_error_rad_s:
            estimate = estimate.judged(
                "refused",
                f"{run.name}: the shaft turns at {1e3 * run.start_v_rad_s:+.2g} mrad/s before the drive: the method "
                "needs a start from rest; let it come to rest",
            )
    unseen = [run.name for run in runs if math.isinf(run.start_v_error_rad_s)]
    if unseen:
        estimate = estimate.judged(
            "doubtful",
            f"{', '.join(unseen)}: too little is recorded before the drive to see that the shaft rests: record "
            f"{START_S:g} s at 0 V before each run",
        )
    starts = ", ".join(f"{1e3 * run.start_rad:+.1f} mrad ({run.name})" for run in runs)
    seen = any(abs(run.start_rad) > 3.0 * run.start_error_rad for run in runs)
    if seen and any(abs(way.by_starts_V) > START_MATTERS * size for way in found):
        estimate = estimate.judged(
            "refused",
            f"the runs do not start from zero but from {starts}, and the method fails then: it moves the value by "
            f"{by_starts:+.2g} V; bring the shaft to zero before each run",
        )
    elif abs(estimate.fc_V - corrected) > 0.5 * reach:
        outside = abs(estimate.fc_V - corrected) > reach
        estimate = estimate.judged(
            "doubtful" if outside else "ok",
            f"the method's value lies {'outside' if outside else 'off the middle of'} its interval: starts of {starts} "
            f"move it by {1e3 * by_starts:+.2g} mV and noise in both sides of the equation by {1e3 * by_noise:+.2g} "
            f"mV; without both it is {corrected:.4f} V",
        )
    if reach > WIDE * size:
        estimate = estimate.judged(
            "refused" if reach > TOO_WIDE * size else "doubtful",
            f"fc_V is only known to {100 * reach / size:.0f} % (95 % interval): record drives that differ more, with "
            "a wider hysteresis, or sample faster",
        )
    estimate = _one_shape(estimate, found, runs)
    untimed = [way.by_timing_V_s for way, group in zip(found, ways, strict=True) if not all(r.timed for r in group)]
    if untimed:
        estimate = estimate.judged(
            "ok",
            "without t_u_s the drives of all runs are taken to act equally late: a difference of 1 ms would change "
            f"the value by {max(untimed):.2g} mV",
        )
    if len(found) == 1:
        side, sign = ("rising", "-") if runs[0].d_V > 0.0 else ("falling", "+")
        estimate = estimate.judged(
            "doubtful",
            f"this is the friction towards {side} positions alone, fc {sign} asym: the interval does not show the "
            "asymmetry; record two more runs with d_V of the other sign",
        )
    return estimate


def _one_shape(estimate: Estimate, found: Sequence[OneWay], runs: Sequence[Transient]) -> Estimate:
    """Whether the runs are multiples of one curve, but for noise, which is white."""
    neighbours = max(_neighbours(way.residual_rad) for way in found)
    noise = math.sqrt(sum(run.noise_rad**2 for run in runs) / len(runs))
    spread = max(float(np.ptp(run.y_rad)) for run in runs)
    if estimate.rms_rad > NEGLIGIBLE * spread and (estimate.rms_rad > NOISY * noise or neighbours > CORRELATED):
        return estimate.judged(
            "doubtful",
            f"the runs are no multiples of one curve: what is left, {1e3 * estimate.rms_rad:.2g} mrad, is "
            f"{estimate.rms_rad / noise if noise > 0.0 else math.inf:.1f} times the sensor's noise, and neighbours in "
            f"it go together by {neighbours:.1f} standard deviations: the motor changed between the runs, friction is "
            "not Coulomb's alone, the runs do not start from rest, or their times are wrong",
        )
    return estimate


def _neighbours(residual: Array) -> float:
    """Lag-one autocorrelation of (n, runs - 1) residuals, in standard deviations of that of white noise."""
    power = float(np.sum(residual**2))
    return math.sqrt(residual.size) * float(np.sum(residual[1:] * residual[:-1])) / power if power > 0.0 else 0.0


def compared_with(estimate: Estimate, whole: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    """The friction held to that of a whole motor, ``whole``: doubtful where they differ beyond both intervals."""
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
        f"the {whole.method} estimate says {friction:.4f} V here, and both intervals together do not reach from one to "
        "the other: friction that depends on speed, or a motor that changed between the runs, would do that; trust "
        f"the {whole.method} estimate",
    )
