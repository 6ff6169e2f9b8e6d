"""The plain motor on pieces of 0.15 to 2 s, each with a start of its own, from several starts.

Over a whole record a small force that the model leaves out moves its motion far from the recorded one, and a fit ends
anywhere. Over a piece it cannot. So where the whole record does not give a motor, its pieces do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rig.core.arrays import Array
from rig.core.motor_numbers import NUMBERS
from rig.identification.chance import student_975
from rig.identification.departures.blocks import Blocks
from rig.identification.departures.departure import LARGEST_FORCE, NOTHING
from rig.identification.departures.fit import (
    CORE,
    DELAY,
    POSITIVE,
    Enough,
    Fit,
    Problem,
    begun,
    limits_of,
    solve,
)
from rig.identification.departures.fit import start as begin
from rig.identification.departures.laws import FREE
from rig.identification.departures.pieces import Cut, parabolas
from rig.identification.estimate import PARAMETERS, Estimate, intervals
from rig.identification.noise import WHITE, noise_of_sensor
from rig.identification.plausibility import one_way
from rig.identification.side_by_side import side_by_side
from rig.identification.thinning import thinned
from rig.model.real_motor import Frame, RealMotor
from rig.model.real_step import mean_cosine
from rig.run_folder.recording.series import TimeSeries, Window, delays_of_all_s, noise_of_all_rad

INDEX = {name: k for k, name in enumerate((*CORE, DELAY))}  # in the order of ``PARAMETERS``
LENGTHS_S = (0.15, 0.5, 2.0)
TAUS = 4
FRICTIONS = (0.05, 0.35)  # of the largest drive
FIRST_ITERATIONS, PIECE_ITERATIONS = 7, 8
ROUGHLY = Enough(0.01, 1e-3)  # of a fit that is only compared
MOST_ROWS = 4000
SMALLEST_NOISE = 1e-6  # of half the travel: a record without noise
LONGEST_TAU_S = 3.0
STRETCHES_S = (0.04, 0.12)
FEWEST_STRETCHES = 12  # of a series: twice the numbers of the balance
BALANCED = 0.5  # share of a drive's variance that its motion leaves, at most, where its sign is wrong
AT_REST = 0.05  # of the largest speed: friction at rest balances anything
POOR = 0.25  # error in blocks from which on the plain motor's numbers mean nothing, and a load is tried with it
LOADED = 0.75  # error with the load over that without it, at most
FORCE, DEAD_BAND, SAG, PIECE_S = ("force_sin_V", "force_cos_V"), "dead_band_V", "sag_per_V", 0.5


def fit_in_pieces(tests: Sequence[TimeSeries], *, free_delay: bool) -> tuple[Fit, Blocks]:
    """The best fit on pieces of any of the lengths, by what it predicts of blocks. Raises IdentifyError if too short.

    tests   of at most some 4,000 rows
    """
    delay_s = delays_of_all_s(tests) if free_delay else (0.0, 0.0)
    whole = Cut.whole(tests, delay_s[1])
    core = tuple(name for name in CORE if name != "bias_V" or not one_way(tests))
    free = (*core, DELAY) if free_delay else core
    sigma = noise_of_all_rad(tests)
    sigma = max(sigma, SMALLEST_NOISE * whole.frames[0].half_travel_rad)
    largest_V = max(float(np.abs(window.steps.u_V).max()) for window in whole.windows)
    longest_s = max(window.duration_s for window in whole.windows)
    found: list[Fit] = []
    for length_s in LENGTHS_S:
        cut = whole.every(length_s)
        if found and cut.begins.size == found[-1].problem.cut.begins.size:
            continue
        problem = Problem(cut, free, limits_of(free, cut, delay_s), sigma, noise=noise_of_sensor(tests, sigma))
        found.append(best_of_starts(problem, found, longest_s, 0.25 * delay_s[1] if free_delay else 0.0))
    blocks = Blocks.of(whole, float(np.median([fit.motor.tau_s for fit in found])))
    best = min(found, key=lambda fit: error_of(fit.motor, found[-1].problem, blocks))
    if (error := blocks.error(best.motor, best.problem)) > POOR:
        loaded = _with_force(best, whole, largest_V, longest_s)
        if blocks.error(loaded.motor, loaded.problem) < LOADED * error:
            return loaded, blocks
    return best, blocks


def error_of(motor: RealMotor, problem: Problem, blocks: Blocks) -> float:
    """What a motor is off where it predicts blocks; where noise adds up in them, and hides that, in these pieces."""
    if problem.noise.white:
        return blocks.error(motor, problem)
    return math.sqrt(solve(begin(replace(problem, free=()), motor)).cost)


def _with_force(best: Fit, whole: Cut, largest_V: float, longest_s: float) -> Fit:
    """The best fit with a force over position, as a hanging load has: beside it the plain numbers mean nothing."""
    given = best.problem
    tau_s = given.limits["tau_s"][0], LONGEST_TAU_S
    most_V = LARGEST_FORCE * largest_V
    limits = {**given.limits, **dict.fromkeys(FORCE, (-most_V, most_V)), "tau_s": tau_s}
    problem = replace(given, cut=whole.every(PIECE_S), free=(*given.free, *FORCE), limits=limits)
    return best_of_starts(problem, (), longest_s, best.motor.delay_s)


def best_of_starts(
    problem: Problem,
    earlier: Sequence[Fit],
    longest_s: float,
    delay_s: float,
    laws: Mapping[str, float] = NOTHING,
) -> Fit:
    """The best of the starts on these pieces: a grid, and what other lengths found.

    laws   further numbers that each of them begins with
    """
    cut = problem.cut
    period_s = min(window.period_s for window in cut.windows)
    speed = float(np.sqrt(np.mean(cut.guessed()[:, 0] ** 2)))
    drive_V = max(float(np.sqrt(np.mean([np.mean(w.steps.u_V**2) for w in cut.windows]))), 1e-9)
    taus = np.geomspace(max(4.0 * period_s, 0.01), max(min(1.0, longest_s / 3.0), 8.0 * period_s), TAUS)
    motors = [fit.motor for fit in earlier]
    motors += [balanced(cut, length_s, problem.free, delay_s) for length_s in STRETCHES_S]
    for tau in taus.tolist():
        for share in FRICTIONS:
            motors.append(RealMotor(tau, max(speed, 1e-9) / drive_V / (1.0 - share), share * drive_V, 0.0, delay_s))
    starts, rows = cut.guessed(), cut.t_s.size
    fresh = [begun(problem, motor._replace(**laws), starts) for motor in motors]
    tried = side_by_side(lambda fit: solve(fit, FIRST_ITERATIONS), fresh, rows)
    ranked = sorted((fit for fit in tried if math.isfinite(fit.cost)), key=lambda fit: fit.cost)
    return min(side_by_side(solve, ranked[:2], rows), key=lambda fit: fit.cost)


def plain_residual_rad(tests: Sequence[TimeSeries], plain: Estimate) -> float:
    """RMS residual of the plain motor, begun at ``plain``, on pieces of half a second, rad; as ``plain_in_pieces``."""
    return plain_in_pieces(tests, plain).rms_rad


def free_between(tests: Sequence[TimeSeries]) -> Mapping[str, float]:
    """A bridge that lets the motor run free between its pulses, to begin with."""
    return {"free_between": 0.8, "full_drive_V": max(float(np.abs(test.steps.u_V).max()) for test in tests)}


def plain_in_pieces(
    tests: Sequence[TimeSeries],
    plain: Estimate,
    bridge: Mapping[str, float] = NOTHING,
    walks: Sequence[TimeSeries] = (),
    iterations: int = PIECE_ITERATIONS,
    *,
    starts_alone: bool = False,
) -> Fit:
    """The plain motor, begun at ``plain``, on pieces of half a second.

    bridge   sizes of laws of a bridge that it stands behind, to begin with: where it does not brake, the plain tau is
             next to nothing at times
    walks    these tests as they were logged, where the fit heeds that noise adds up in them
    starts_alone   the motor is ``plain``, and only where each piece starts is fitted

    Raises IdentifyError if a test is too short.
    """
    rows = math.ceil(sum(len(test) for test in tests) / MOST_ROWS)
    thin = [thinned(test, rows) for test in tests]
    delay_s = delays_of_all_s(tests)
    cut = Cut.whole(thin, delay_s[1]).every(PIECE_S)
    free = tuple(name for name in (*CORE, DELAY) if name != "bias_V" or not one_way(thin))
    late_s = plain.delay_s if starts_alone else max(plain.delay_s, 0.0)
    motor = RealMotor(plain.tau_s, plain.K_rad_s_V, max(plain.fc_V, 0.0), plain.asym_V, late_s)
    most_V = max(float(np.abs(test.u_V).max()) for test in thin)
    sizes = [name for name in bridge if not NUMBERS[name].is_shape]
    limits = limits_of(free, cut, delay_s)
    most = {DEAD_BAND: (0.0, most_V), SAG: (0.0, 0.5 / most_V)}
    most |= dict.fromkeys(FORCE, (-LARGEST_FORCE * most_V, LARGEST_FORCE * most_V))
    limits |= {name: most.get(name, FREE) for name in sizes}
    sigma = 1e-3 * cut.frames[0].half_travel_rad
    fitted = () if starts_alone else (*free, *sizes)
    problem = Problem(cut, fitted, limits, sigma, noise=noise_of_sensor(walks, sigma))
    if bridge:
        motor = motor._replace(tau_s=max(plain.tau_s, 4.0 * thin[0].period_s), **bridge)
    return solve(begin(problem, motor), iterations, ROUGHLY)


def balanced(cut: Cut, length_s: float, free: Sequence[str], delay_s: float) -> RealMotor:
    """The motor whose voltages balance best on stretches of the tests: u = (v + tau a) / K + friction + bias + force.

    length_s     of a stretch, s; shorter where a series would have fewer than twelve; at least five rows: its speed and
                 acceleration are those of a parabola
    free         the numbers that it may have: ``FORCE`` and bias_V among them or not
    Linear least squares of the inverse model (Gautier and Khalil, IEEE Int. Conf. Robotics and Automation, 1988): it
    needs no start, and it is one. Its numbers carry what noise does to an acceleration.
    """
    table, u_V = _all_stretches(cut, length_s, delay_s)
    speeds, largest_V = np.abs(table[:, 0]), max(float(np.abs(u_V).max()), 1e-9)
    names = ("by_speed", "by_curve", "fc_V", "bias_V", *FORCE)
    used = [k for k, name in enumerate(names) if k < 3 or name in free]
    least = np.array([1e-3 * largest_V / max(float(speeds.max()), 1e-9), 0.0, 0.0, -np.inf, -np.inf, -np.inf])[used]
    table = table[:, used]
    scale = np.maximum(np.linalg.norm(table, axis=0), 1e-12)
    found = _no_less(table / scale, u_V, least * scale) / scale
    by_speed, by_curve, *rest = found.tolist()
    tau_s = max(by_curve / by_speed, 2.0 * min(window.period_s for window in cut.windows))
    numbers = dict(zip((names[k] for k in used[2:]), rest, strict=True))
    return RealMotor(tau_s, 1.0 / by_speed, 0.0, 0.0, delay_s)._replace(**numbers)


def is_reversed(tests: Sequence[TimeSeries]) -> bool:
    """Whether the drive of the tests has the wrong sign: speed and acceleration both go against it, and explain it.

    Behind a filter the speed of a quick swing goes against it, too; but then the acceleration goes along. A loop that
    brakes a motor which mostly stands looks alike in stretches: but friction takes no work from it.
    """
    if sum(float(test.u_V[:-1] @ np.diff(test.y_rad)) for test in tests) > 0.0:
        return False
    table, u_V = _all_stretches(Cut.whole(tests, 0.0), STRETCHES_S[1], 0.0)
    found = np.linalg.lstsq(table, u_V, rcond=None)[0]
    left = float(np.var(u_V - table @ found))
    return bool(found[0] < 0.0 and found[1] < 0.0 and left < BALANCED * float(np.var(u_V)))


def _all_stretches(cut: Cut, length_s: float, delay_s: float) -> tuple[Array, Array]:
    """``_stretches`` of all series, of those in which the shaft moves."""
    each = [_stretches(window, frame, length_s, delay_s) for window, frame in zip(cut.windows, cut.frames, strict=True)]
    table, u_V = np.concatenate([columns for columns, _ in each]), np.concatenate([drives for _, drives in each])
    moves = np.abs(table[:, 0]) >= AT_REST * float(np.abs(table[:, 0]).max())
    return table[moves], u_V[moves]


def _stretches(window: Window, frame: Frame, length_s: float, delay_s: float) -> tuple[Array, Array]:
    """(k, 6) what the drive of each stretch of a series is made up of, for 1 of each number; (k,) its mean drive, V."""
    rows = max(5, min(round(length_s / window.period_s), window.t_s.size // FEWEST_STRETCHES))
    count = window.t_s.size // rows
    t_s, y_rad = (one[: count * rows].reshape(count, rows) for one in (window.t_s, window.y_rad))
    middle_rad, speed, curve = parabolas(t_s - t_s.mean(axis=1, keepdims=True), y_rad)
    at = np.searchsorted(window.steps.edge_s, t_s - delay_s, side="right") - 1
    q = middle_rad - frame.centre_rad
    columns = (speed, 2.0 * curve, np.sign(speed), np.ones(count), np.sin(q), np.cos(q) - mean_cosine(frame))
    return np.column_stack(columns), window.steps.u_V[np.maximum(at, 0)].mean(axis=1)


def _no_less(table: Array, wanted: Array, least: Array) -> Array:
    """Linear least squares, (k,), no number below its ``least``: one after the other that would be stays there."""
    found, free = least.copy(), np.ones(least.size, dtype=bool)
    while free.any():
        left = wanted - table[:, ~free] @ found[~free]
        found[free] = np.linalg.lstsq(table[:, free], left, rcond=None)[0]
        below = np.where(free, found - least, 0.0)
        if not np.any(below < 0.0):
            break
        worst = int(np.argmin(below))
        free[worst], found[worst] = False, least[worst]
    return found


def of_pieces(pieces: Fit, plain: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    """The estimate of a fit on pieces, with the residual of a free run of the whole tests.

    plain   of the same tests: its method and its rows, and its delay where that is known
    """
    cut, free, motor = pieces.problem.cut, pieces.problem.free, pieces.motor
    size = np.array([getattr(motor, name) if name in POSITIVE else 1.0 for name in free])
    full = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    own = [k for k, name in enumerate(free) if name in INDEX]
    at = [INDEX[free[k]] for k in own]
    full[np.ix_(at, at)] = (pieces.covariance * np.outer(size, size))[np.ix_(own, own)]
    delay = motor.delay_s if DELAY in free else plain.delay_s
    values = (motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V, delay)
    quantile = student_975(max(1, cut.freedom - len(free)))
    errors = np.sqrt(np.diag(full)).tolist()
    whole = replace(cut, rows=tuple(np.zeros(1, dtype=np.int64) for _ in cut.windows), resting=None, weight=None)
    run = solve(begin(replace(pieces.problem, cut=whole, free=(), noise=WHITE), motor))
    return replace(
        plain,
        tau_s=motor.tau_s,
        K_rad_s_V=motor.K_rad_s_V,
        fc_V=motor.fc_V,
        asym_V=motor.bias_V,
        delay_s=delay,
        ci95=intervals(values, errors, quantile),
        covariance=full,
        rms_rad=run.rms_rad,
        iterations=len(pieces.iterates),
        verdict="ok",
        reasons=(),
        iterates=pieces.iterates,
        residual_rad=-run.residual_rad,
        residual_t_s=whole.t_s,
        repeated=0.0,
        coloured=None,
        converged=True,
        force_V=(motor.force_sin_V, motor.force_cos_V),
        spoiled=False,
    )
