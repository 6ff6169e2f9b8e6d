"""Example 4.2 (a): friction by linear least squares with the single hysteretic relay (Besancon-Voda and Besancon)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from paper import surviving
from paper.drawing import CYCLES, PAPER, Array, finish, new_figure, zero
from paper.page import Agreement, Claim, Comparison, Heading, Paragraph, Remark, Section
from rig.control.relay import HystereticRelay
from rig.core.signals import Sample
from rig.identification import least_squares
from rig.identification.estimate import Estimate
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.output.report.style import Picture
from rig.run_folder.recording.series import TimeSeries
from shared.page import listed
from shared.table import Cell, Table, fixed, number, significant

SAMPLING_S = 0.0002  # 1000 samples end just before the first switching
REST_S = 0.05
DURATION_S = 2.5
NOISE_RAD = 0.001
ASSUMED = 100.0  # covariance at the recursion's start, not the paper's word
COVARIANCES = (10.0, ASSUMED, 1000.0)
FORGETTING = (1.0, 0.9999, 0.999, 0.99)  # factors by which older samples count less from each to the next; 1: never
STARTS_RAD = ((0.0, 0.0), (0.02, 0.02), (0.05, 0.05), (0.05, -0.05))
SEED = 3


@dataclass(frozen=True)
class Run:
    """One run of the relay: hysteresis, rad, drive, V, and what was recorded from the drive's first instant on."""

    eps_rad: float
    d_V: float
    t_s: Array
    y_rad: Array
    u_V: Array

    @property
    def first_switching_s(self) -> float:
        """When the drive changes first, s."""
        return float(self.t_s[np.flatnonzero(self.u_V < 0.0)[0]])


@dataclass(frozen=True)
class Result:
    """Numbers of Example 4.2 (a).

    runs            both, without noise, from rest at zero
    by_covariance   covariance at the start (inf: nothing assumed) -> estimates after each sample, V
    forgetting      (covariance, forgetting factor) -> estimate after the last sample, V
    range_of_covariance   the two that would end at the paper's two values
    by_start        starts of both runs, rad -> estimates after each sample, V
    estimates       the same by the program's estimator, with a millirad of noise
    """

    runs: tuple[Run, Run]
    by_covariance: dict[float, Array]
    forgetting: dict[tuple[float, float], float]
    range_of_covariance: tuple[float, float]
    by_start: dict[tuple[float, float], Array]
    estimates: dict[tuple[float, float], Estimate]


def compute() -> Result:
    """Both runs, the recursion on them, and the estimator's verdict from several starts."""
    samples = surviving.LEAST_SQUARES_SAMPLES
    drives = np.array([d for _, d in surviving.LEAST_SQUARES_RUNS])
    runs = _pair((0.0, 0.0))
    y = _positions(runs, samples)
    by_covariance = {p: least_squares.recursive(y, drives, 0.0, p) for p in (*COVARIANCES, np.inf)}
    # From 0 V with covariance P the last value is fc S P / (1 + S P), S the sum of (y2 - y1)^2.
    S = float(np.sum((y[:, 1] - y[:, 0]) ** 2))
    low, high = (f / (surviving.FC_V - f) / S for f in surviving.LEAST_SQUARES_FC_V)
    forgetting = {(p, factor): _forgetting(y, drives, p, factor) for p in COVARIANCES for factor in FORGETTING}
    by_start, estimates = {}, {}
    for starts in STARTS_RAD:
        pair = _pair(starts)
        by_start[starts] = least_squares.recursive(_positions(pair, samples), drives)
        estimates[starts] = least_squares.fit(
            [_record(run, start, SEED + k) for k, (run, start) in enumerate(zip(pair, starts, strict=True))]
        )
    return Result(runs, by_covariance, forgetting, (low, high), by_start, estimates)


def _forgetting(y_rad: Array, d_V: Array, covariance: float, factor: float) -> float:
    """Last estimate of the recursion from 0 V that forgets: weighted least squares in closed form, V."""
    x, b = y_rad[:, 1] - y_rad[:, 0], y_rad[:, 1] * d_V[0] - y_rad[:, 0] * d_V[1]
    weights = factor ** np.arange(x.size - 1, -1, -1.0)
    return float(np.sum(weights * x * b) / (factor**x.size / covariance + np.sum(weights * x * x)))


def _pair(starts_rad: tuple[float, float]) -> tuple[Run, Run]:
    first, second = (
        _run(eps, d, start) for (eps, d), start in zip(surviving.LEAST_SQUARES_RUNS, starts_rad, strict=True)
    )
    return first, second


def _run(eps_rad: float, d_V: float, start_rad: float) -> Run:
    """The relay of the program, deciding at every sample, on the exact motor."""
    tau, K, fc = surviving.MOTOR
    motor = Motor(tau, K, coulomb(fc))
    relay = HystereticRelay(d_V, eps_rad)
    t: Array = np.arange(round(DURATION_S / SAMPLING_S)) * np.float64(SAMPLING_S)
    y, u = np.empty(t.size), np.empty(t.size)
    state = State(0.0, start_rad)
    for k, now in enumerate(t.tolist()):
        y[k] = state.y
        u[k] = relay.step(Sample(now, state.y, 0))
        state = motor.advance(state, float(u[k]), SAMPLING_S)
    return Run(eps_rad, d_V, t, y, u)


def _positions(runs: tuple[Run, Run], samples: int) -> Array:
    """(samples, 2) positions after the drive's first instant; both runs are before their first switching there."""
    return np.stack([run.y_rad[1 : samples + 1] for run in runs], axis=1)


def _record(run: Run, start_rad: float, seed: int) -> TimeSeries:
    """What a bench would record: a rest before, noise on the position."""
    rest = round(REST_S / SAMPLING_S)
    y = np.concatenate((np.full(rest, start_rad), run.y_rad))
    y += NOISE_RAD * np.random.default_rng(seed).standard_normal(y.size)
    t: Array = np.arange(y.size) * np.float64(SAMPLING_S)
    return TimeSeries(t, y, t, np.concatenate((np.zeros(rest), run.u_V)), name=f"d = {run.d_V:g} V")


def section(result: Result) -> Section:
    """Its part of the page."""
    low, high = surviving.LEAST_SQUARES_FC_V
    ends = {p: float(trace[-1]) for p, trace in result.by_covariance.items()}
    held = _in_range(result)
    blocks = (
        Paragraph(
            "The comparison method: one relay of ±d with hysteresis ε, two runs from rest at zero, (ε, d) = "
            f"{listed([f'({eps:g}, {d:g})' for eps, d in surviving.LEAST_SQUARES_RUNS])}, the paper's. Until the "
            "first switching y<sub>i</sub>(t) = (d<sub>i</sub> − f<sub>c</sub>) "
            "g(t) with one unknown g, so y<sub>2</sub>d<sub>1</sub> − y<sub>1</sub>d<sub>2</sub> = f<sub>c</sub>"
            "(y<sub>2</sub> − y<sub>1</sub>): least squares in one parameter. It gives neither τ nor K."
        ),
        Remark(
            "chosen",
            f"τ and K as in Example 4.1, and the sampling of {1e3 * SAMPLING_S:.1f} ms, of which the paper's "
            f"{surviving.LEAST_SQUARES_SAMPLES} samples take {SAMPLING_S * surviving.LEAST_SQUARES_SAMPLES:.3f} s; the "
            f"second run first switches at {result.runs[1].first_switching_s:.3f} s.",
        ),
        _runs_figure(result),
        Heading(f"The recursion over {surviving.LEAST_SQUARES_SAMPLES} samples"),
        _recursion_table(result),
        _recursion_figure(result),
        _forgetting_table(result),
        Remark(
            "chosen",
            f"How the paper's recursion starts (at 0 with P = {ASSUMED:g} in the summary) and whether it forgets did "
            "not "
            f"survive. Of the {len(result.forgetting)} combinations of the table above {held} end in the paper's "
            "range; "
            f"with P = {ASSUMED:g} alone the end goes from {min(_ends(result, ASSUMED)):.4f} to "
            f"{max(_ends(result, ASSUMED)):.4f} with the forgetting factor.",
        ),
        Remark(
            _reachable(result).agreement,
            f"The paper's estimate is {low} to {high} for f<sub>c</sub> = {surviving.FC_V}. Without noise the equation "
            f"is exact, and a recursion that assumes nothing has {fixed(ends[np.inf], 4).text} from its first sample "
            "on; short of the truth it stays only for its own start. Started at 0 with covariance "
            f"P = {result.range_of_covariance[0]:.0f} to {result.range_of_covariance[1]:.0f} it ends in the paper's "
            f"range; with P = {ASSUMED:g}, a usual choice, at {ends[ASSUMED]:.4f}.",
        ),
        Heading("From starts that are not zero"),
        _starts_table(result),
        _starts_figure(result),
        Remark(
            all_fail(result).agreement,
            f"The paper says that it fails when the initial positions are not zero; here it does from "
            f"{sum(fails_from(result, starts) for starts in STARTS_RAD[1:])} of {len(STARTS_RAD) - 1} such starts: a "
            "start "
            "adds a constant to y<sub>i</sub> that the equation takes for motion. The program's estimator refuses "
            f"{_refused(result)} of them; with the start measured before the run and taken off (“corrected”) "
            f"the worst is {100.0 * _worst_corrected(result):.1f} % off.",
        ),
    )
    return Section("example-4-2a", "4.2 (a)", "Example 4.2 (a): linear least squares", blocks, _comparisons(result))


def _ends(result: Result, covariance: float) -> list[float]:
    return [end for (p, _), end in result.forgetting.items() if p == covariance]


def _in_range(result: Result) -> int:
    """Combinations of covariance and forgetting factor that end in the paper's range."""
    low, high = surviving.LEAST_SQUARES_FC_V
    return sum(low <= end <= high for end in result.forgetting.values())


def _reachable(result: Result) -> Claim:
    """Some start of the recursion, without forgetting, ends in the paper's range."""
    return Claim(0.0 < result.range_of_covariance[0] < result.range_of_covariance[1])


def estimate_agreement(result: Result) -> Agreement:
    """With every combination in the paper's range it agrees, with none it differs, else the choice decides."""
    count = _in_range(result)
    if 0 < count < len(result.forgetting):
        return "not comparable"
    return Claim(count > 0).agreement


def all_fail(result: Result) -> Claim:
    """The plain method fails from every start that is not zero."""
    return Claim(all(fails_from(result, starts) for starts in STARTS_RAD[1:]))


def _refused(result: Result) -> int:
    return sum(result.estimates[starts].verdict == "refused" for starts in STARTS_RAD[1:])


def _corrected(estimate: Estimate) -> float:
    return 0.5 * sum(estimate.ci95["fc_V"])


def _worst_corrected(result: Result) -> float:
    return max(abs(_corrected(estimate) / surviving.FC_V - 1.0) for estimate in result.estimates.values())


def fails_from(result: Result, starts: tuple[float, float]) -> bool:
    """Whether the plain method is more than 5 % off from these starts."""
    end_V = float(result.by_start[starts][-1])
    return abs(end_V / surviving.FC_V - 1.0) > 0.05


def _comparisons(result: Result) -> tuple[Comparison, ...]:
    low, high = surviving.LEAST_SQUARES_FC_V
    end = float(result.by_covariance[ASSUMED][-1])
    others = [starts for starts in STARTS_RAD if starts != (0.0, 0.0)]
    flat = [start for pair in others for start in pair]
    values = [float(result.by_start[starts][-1]) for starts in others]
    return (
        Comparison(
            "4.2 (a)",
            f"least squares: f<sub>c</sub> after {surviving.LEAST_SQUARES_SAMPLES} samples, truth {surviving.FC_V} V",
            f"{low} … {high}",
            f"{end:.4f} (P = {ASSUMED:g}); {float(result.by_covariance[np.inf][-1]):.4f} with nothing assumed",
            estimate_agreement(result),
            f"P = {ASSUMED:g} and no forgetting are assumed; {_in_range(result)} of {len(result.forgetting)} "
            "combinations "
            "end in the paper's range",
        ),
        Comparison(
            "4.2 (a)",
            "it fails from initial positions that are not zero",
            "does not converge",
            f"{min(values):.2f} to {max(values):.2f} V from starts of {1e3 * min(map(abs, flat)):.0f} to "
            f"{1e3 * max(map(abs, flat)):.0f} mrad",
            all_fail(result).agreement,
            f"the estimator refuses {_refused(result)} of {len(others)} such pairs of runs",
        ),
    )


def _recursion_table(result: Result) -> Table:
    marks = (10, 100, 500, surviving.LEAST_SQUARES_SAMPLES)
    rows = []
    for p, trace in result.by_covariance.items():
        name = "nothing assumed (P = ∞)" if np.isinf(p) else f"from 0, P = {p:g}"
        rows.append((Cell(name), *(fixed(float(trace[n - 1]), 4) for n in marks)))
    low, high = surviving.LEAST_SQUARES_FC_V
    paper = (Cell("paper", None, "paper"), *([Cell("")] * 3), Cell(f"{low} … {high}", None, "paper"))
    return Table(
        ("recursion started", *(f"after {n} samples, V" for n in marks)),
        (*rows, paper),
        f"Estimate of f<sub>c</sub> = {surviving.FC_V} V over the recursion; no noise.",
    )


def _forgetting_table(result: Result) -> Table:
    low, high = surviving.LEAST_SQUARES_FC_V
    rows = []
    for p in COVARIANCES:
        ends = [result.forgetting[p, factor] for factor in FORGETTING]
        rows.append((Cell(f"from 0, P = {p:g}"), *(_ranged(end, low, high) for end in ends)))
    return Table(
        ("recursion started", *(f"forgetting factor {factor:g}, V" for factor in FORGETTING)),
        tuple(rows),
        f"The estimate after {surviving.LEAST_SQUARES_SAMPLES} samples over the two assumptions; *: in the paper's "
        "range.",
    )


def _ranged(end: float, low: float, high: float) -> Cell:
    return Cell(f"{end:.4f}{' *' if low <= end <= high else ''}", end)


def _starts_table(result: Result) -> Table:
    rows = []
    for starts, estimate in result.estimates.items():
        plain = float(result.by_start[starts][-1])
        corrected = _corrected(estimate)
        rows.append((
            Cell(f"({1e3 * starts[0]:g}, {1e3 * starts[1]:g})"),
            number(plain, 4, whose="bad" if fails_from(result, starts) else ""),
            number(estimate.fc_V, 4, whose="bad" if fails_from(result, starts) else ""),
            number(corrected, 4), Cell(estimate.verdict),
        ))  # fmt: skip
    return Table(
        ("starts of the two runs, mrad", "no noise, V", f"{1e3 * NOISE_RAD:g} mrad of noise, V",
         "corrected, V", "the estimator's verdict"),
        tuple(rows),
        f"Estimate of f<sub>c</sub> = {surviving.FC_V} V from different initial positions, and the program's "
        "estimator on noisy "
        "recordings of the same runs. (One direction alone can show no asymmetry: that makes the first doubtful.)",
    )  # fmt: skip


def _runs_figure(result: Result) -> Picture:
    figure = new_figure(3.2)
    panels = figure.subplots(2, 2, sharex="col", height_ratios=(2.0, 1.0))
    for column, (run, ink) in enumerate(zip(result.runs, CYCLES, strict=True)):
        top, bottom = panels[:, column]
        top.plot(run.t_s[::10], run.y_rad[::10], color=ink)
        zero(top)
        for side in (1.0, -1.0):
            top.axhline(side * run.eps_rad, color="#b9bfc7", lw=0.9, ls="--")
        bottom.step(run.t_s[::10], run.u_V[::10], where="post", color=ink)
        for axes in (top, bottom):
            axes.axvspan(0.0, surviving.LEAST_SQUARES_SAMPLES * SAMPLING_S, color="#eef3f8", lw=0)
        top.set_title(f"ε = {run.eps_rad:g} rad,  d = {run.d_V:g} V")
        bottom.set_xlabel("time, s")
    panels[0, 0].set_ylabel("position y, rad")
    panels[1, 0].set_ylabel("drive u, V")
    return finish(
        figure,
        "Two runs of the hysteretic relay from rest at zero.",
        "The two runs of the single hysteretic relay. Only the shaded part before the first switching is used; dashed: "
        "the hysteresis.",
    )


def _recursion_figure(result: Result) -> Picture:
    figure = new_figure(2.8)
    panels = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    low, high = surviving.LEAST_SQUARES_FC_V
    for axes in panels:
        axes.axhspan(low, high, color=PAPER, alpha=0.18, lw=0, label=f"paper: {low} … {high}")
        axes.axhline(surviving.FC_V, color="#1f2328", lw=0.8, ls=":")
        axes.set_xlabel("sample")
    for (p, trace), ink in zip(result.by_covariance.items(), ("#56B4E9", "#0072B2", "#1f2d5c", "#009E73"), strict=True):
        name = "nothing assumed" if np.isinf(p) else f"from 0, P = {p:g}"
        for axes in panels:
            axes.plot(np.arange(1, trace.size + 1), trace, color=ink, label=name)
    whole, end = panels
    whole.set(ylabel="estimate of f_c, V", ylim=(0.0, 0.56))
    whole.legend(loc="lower right")
    end.set(xlim=(0.7 * surviving.LEAST_SQUARES_SAMPLES, surviving.LEAST_SQUARES_SAMPLES), ylim=(0.475, 0.505))
    end.set_title("the end of it")
    return finish(
        figure,
        "The recursive estimate of friction over the samples.",
        f"The recursion over the {surviving.LEAST_SQUARES_SAMPLES} samples before the first switching, from "
        "different assumptions at its start.",
    )


def _starts_figure(result: Result) -> Picture:
    figure = new_figure(2.8)
    axes = figure.subplots()
    axes.axhline(surviving.FC_V, color="#1f2328", lw=0.8, ls=":")
    inks = ("#009E73", "#0072B2", "#56B4E9", "#D55E00")
    for (starts, trace), ink in zip(result.by_start.items(), inks, strict=True):
        name = f"from ({1e3 * starts[0]:g}, {1e3 * starts[1]:g}) mrad"
        axes.plot(np.arange(1, trace.size + 1), trace, color=ink, label=name)
    axes.set(xlabel="sample", ylabel="estimate of f_c, V", ylim=(-1.0, 1.6))
    axes.legend(loc="lower right")
    return finish(
        figure,
        "The recursive estimate from initial positions that are not zero.",
        "The same recursion (nothing assumed, no noise) from initial positions that are not zero: it does not converge "
        f"to f<sub>c</sub> = {significant(surviving.FC_V, 1)} V before the transient is over.",
    )
