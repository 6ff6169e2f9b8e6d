"""Example 4.1: where the limit cycle is (Theorem 2.1), that it is stable (Theorem 2.2), and Properties 3.1 and 3.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import MaxNLocator

from paper import surviving
from paper.drawing import (
    CYCLES,
    EXACT,
    INK,
    MUTED,
    SINE,
    Array,
    course,
    finish,
    new_figure,
    note,
    shade_stages,
    zero,
)
from paper.ideal_relay import Relay, half_periods, ideal_relay
from paper.page import Claim, Comparison, Heading, Paragraph, Remark, Section
from paper.solver import RELATIVE, settled_cycle
from paper.solver import Cycle as SolverCycle
from rig.model import describing_function
from rig.model.describing_function import Oscillation, RelayGains
from rig.model.friction import coulomb
from rig.model.limit_cycle import LimitCycle, limit_cycle
from rig.model.motor import Motor, State
from rig.output.report.style import Picture
from shared.page import listed
from shared.table import Cell, Table, number, share, significant

EXPANDS = 1.0 + 1e-9
ARRIVED = 1e-3  # of the cycle's size
STARTS = (State(0.0, -0.9, 0.0), State(0.0, 0.1, 0.0), State(5.0, -0.5, 0.02), State(-7.0, 0.3, -0.05))


@dataclass(frozen=True)
class Found:
    """One pair of gains: the exact cycle, the ODE solver's and the describing function's."""

    gains: RelayGains
    cycle: LimitCycle
    solver: SolverCycle
    sine: Oscillation

    @property
    def segment_eigenvalues(self) -> tuple[float, float, float]:
        """Largest magnitude of an eigenvalue of J1, J2, J3 alone."""
        return tuple(float(np.abs(np.linalg.eigvals(J)).max()) for J in self.cycle.stage_jacobians())  # type: ignore[return-value]

    @property
    def parts(self) -> dict[str, float]:
        """Largest magnitude of an eigenvalue of each segment, and of each two in a row."""
        J = self.cycle.stage_jacobians()
        named = {f"J<sub>{k + 1}</sub>": J[k] for k in range(3)}
        named |= {f"J<sub>{(k + 1) % 3 + 1}</sub>J<sub>{k + 1}</sub>": J[(k + 1) % 3] @ J[k] for k in range(3)}
        return {name: float(np.abs(np.linalg.eigvals(matrix)).max()) for name, matrix in named.items()}


@dataclass(frozen=True)
class Transient:
    """A run of the first pair of gains from some state, in continuous time.

    t_s, v_rad_s, y_rad   its course
    distance              from the cycle at each switching of RC: the larger of those in v and in y, relative to the
                          largest in the cycle
    """

    start: State
    t_s: Array
    v_rad_s: Array
    y_rad: Array
    distance: Array

    @property
    def rate(self) -> float:
        """By how much the distance shrinks in a half period, once it is small."""
        small = self.distance[(self.distance < 0.02) & (self.distance > 1e-9)]
        return float((small[-1] / small[0]) ** (1.0 / (small.size - 1)))


@dataclass(frozen=True)
class Decay:
    """A run with h2 below or above fc: time, position, and whether it ends at rest."""

    h2_V: float
    t_s: Array
    y_rad: Array
    at_rest: bool


@dataclass(frozen=True)
class Sweep:
    """Amplitude and period over one gain: exact and by describing function, the other gain fixed."""

    fixed_V: float
    gain_V: Array
    exact_amplitude_rad: Array
    exact_period_s: Array
    sine_amplitude_rad: Array
    sine_period_s: Array


@dataclass(frozen=True)
class Result:
    """Numbers of Example 4.1."""

    found: tuple[Found, ...]
    transients: tuple[Transient, ...]
    decays: tuple[Decay, ...]
    over_h2: tuple[Sweep, ...]
    over_h1: tuple[Sweep, ...]


def compute(points: int = 31) -> Result:
    """All numbers; ``points`` of each curve of Properties 3.1 and 3.2."""
    tau, K, fc = surviving.MOTOR
    found = []
    for h1, h2 in surviving.GAINS:
        cycle = limit_cycle(tau, K, fc, h1, h2)
        far = (0.0, -1.5 * cycle.amplitude_rad, 0.5 * float(cycle.states[2, 2]))
        sine = describing_function.predict(tau, K, fc, h1, h2)
        found.append(Found(RelayGains(h1, h2), cycle, settled_cycle(tau, K, fc, h1, h2, far), sine))
    over_h2 = tuple(_sweep("h2", h1, np.linspace(fc + 0.06, 1.5, points)) for h1 in (0.5, 0.8, 1.1))
    over_h1 = tuple(_sweep("h1", h2, np.linspace(0.25, 1.5, points)) for h2 in (0.8, 1.0, 1.2))
    transients = tuple(_transient(start, found[0].cycle) for start in STARTS)
    return Result(tuple(found), transients, tuple(_decay(h2) for h2 in (0.9 * fc, 1.3 * fc)), over_h2, over_h1)


def _motor() -> Motor:
    tau, K, fc = surviving.MOTOR
    return Motor(tau, K, coulomb(fc))


def _transient(start: State, cycle: LimitCycle) -> Transient:
    run = ideal_relay(_motor(), Relay(*surviving.GAINS[0]), start, 11.0 * cycle.period_s)
    v, y, _ = cycle.states[0]
    distance = [
        max(abs(half.start.v - v) / cycle.speed_rad_s, abs(half.start.y - y) / cycle.amplitude_rad)
        for half in half_periods(run.events)
    ]
    t = np.linspace(0.0, 4.0 * cycle.period_s, 1600)
    states = run.states(t)
    return Transient(start, t, states[:, 0], states[:, 1], np.array(distance))


def _decay(h2_V: float) -> Decay:
    run = ideal_relay(_motor(), Relay(surviving.GAINS[0].h1_V, h2_V), State(0.0, -0.3, 0.0), 3.0)
    t = np.linspace(0.0, run.duration_s, 1200)
    y = run.states(t)[:, 1]
    # at rest it stays where it is
    return Decay(h2_V, np.append(t, 3.0), np.append(y, y[-1]), run.end != "time")


def _sweep(along: str, fixed_V: float, gain_V: Array) -> Sweep:
    tau, K, fc = surviving.MOTOR
    rows = []
    for gain in gain_V.tolist():
        h1, h2 = (fixed_V, gain) if along == "h2" else (gain, fixed_V)
        exact = limit_cycle(tau, K, fc, h1, h2)
        sine = describing_function.predict(tau, K, fc, h1, h2)
        rows.append((exact.amplitude_rad, exact.period_s, sine.amplitude_rad, sine.period_s))
    columns = np.array(rows).T
    return Sweep(fixed_V, gain_V, *columns)


def section(result: Result) -> Section:
    """Its part of the page."""
    first = result.found[0]
    eigenvalue = first.segment_eigenvalues[2]
    largest = float(np.abs(first.cycle.eigenvalues()).max())
    blocks = (
        Paragraph(
            "Under u = −h<sub>1</sub> sgn(y) − h<sub>2</sub> sgn(z) the Coulomb friction is a third relay. Theorem 2.1 "
            "gives the durations of the three stages of a half period, Theorem 2.2 says whether the cycle is locally "
            f"stable. The two pairs of gains and f<sub>c</sub> = {surviving.FC_V} V are the paper's."
        ),
        Remark(
            "chosen",
            f"τ and K of the paper's example did not survive: τ = {surviving.MOTOR.tau_s} s and K = "
            f"{surviving.MOTOR.K_rad_s_V} (rad/s)/V here. Durations scale with τ and amplitudes with Kτ; the "
            "eigenvalues depend on h<sub>1</sub>, h<sub>2</sub> and f<sub>c</sub> alone, so they compare without any "
            "choice.",
        ),
        _cycle_table(result),
        _stability_table(result),
        Remark(
            expands_and_is_stable(result).agreement,
            f"J<sub>3</sub> of the first cycle has {significant(eigenvalue, 7)}, the paper "
            f"{surviving.SEGMENT_EIGENVALUE}, "
            f"{significant(abs(eigenvalue - surviving.SEGMENT_EIGENVALUE), 1)} away; the largest eigenvalue of the "
            "whole "
            f"half period is {significant(largest, 6)} in magnitude: the cycle is "
            f"{Claim(first.cycle.stable).says('stable', 'unstable')}.",
        ),
        Remark(
            more_expand(result).agreement,
            "Of the other segments the paper says “so do …”; the rest of that sentence did not survive. "
            f"{_segments_words(result)}",
        ),
        _courses(result),
        _portraits(result),
        Heading("Convergence to the cycle"),
        Paragraph(
            f"From {sum(t.distance[-1] < ARRIVED for t in result.transients)} of {len(result.transients)} initial "
            "states "
            f"the loop comes within {significant(ARRIVED, 1)} of the cycle's size. Near it the distance changes in "
            "every "
            "half period by the factor "
            f"{listed([f'{t.rate:.4f}' for t in result.transients])}; the largest eigenvalue of J says {largest:.4f}."
        ),
        _convergence(result),
        Heading("Exact, by an ODE solver, and by describing function"),
        _methods_table(result),
        _overlay(result),
        Heading("Properties 3.1 and 3.2: what the gains do"),
        Paragraph(
            "A cycle is excited only if h<sub>2</sub> &gt; f<sub>c</sub>. The amplitude grows with h<sub>2</sub> and "
            "falls with h<sub>1</sub>; the frequency falls with h<sub>2</sub> and grows with h<sub>1</sub>. "
            f"{_property_words(result)}"
        ),
        _properties(result),
        _decays(result),
    )
    return Section("example-4-1", "4.1", "Example 4.1: the limit cycle and its stability", blocks, _comparisons(result))


def _comparisons(result: Result) -> tuple[Comparison, ...]:
    first = result.found[0]
    eigenvalue = first.segment_eigenvalues[2]
    spectral = float(np.abs(first.cycle.eigenvalues()).max())
    return (
        Comparison(
            "4.1",
            f"largest eigenvalue of one segment, (h<sub>1</sub>, h<sub>2</sub>) = {_named(first.gains)}",
            f"{surviving.SEGMENT_EIGENVALUE}",
            significant(eigenvalue, 7),
            near(eigenvalue).agreement,
            f"by {significant(abs(eigenvalue - surviving.SEGMENT_EIGENVALUE), 1)}; independent of τ and K",
        ),
        Comparison(
            "4.1",
            "the cycle is stable though one segment expands",
            "stable",
            f"{'stable' if first.cycle.stable else 'unstable'}: |λ| = {significant(spectral, 4)}",
            expands_and_is_stable(result).agreement,
            f"Theorem 2.2; transients from {len(result.transients)} states change by "
            f"{listed([f'{t.rate:.4f}' for t in result.transients])} in a half period",
        ),
        Comparison(
            "4.1",
            "Properties 3.1, 3.2: no cycle for h<sub>2</sub> ≤ f<sub>c</sub>; which way amplitude and frequency go",
            "as stated",
            f"exact cycle: {properties_hold(result).says('same', 'not the same')}",
            properties_hold(result).agreement,
            f"{_pairs(result)} pairs of gains, and the loop at {len(result.decays)} values of h<sub>2</sub>",
        ),
    )


def near(eigenvalue: float) -> Claim:
    """It is the paper's to all of the paper's digits, one unit in the last allowed."""
    return Claim(abs(eigenvalue - surviving.SEGMENT_EIGENVALUE) < 1.5e-4)


def expands_and_is_stable(result: Result) -> Claim:
    """The first cycle's third segment has the paper's expanding eigenvalue, and the cycle is stable all the same."""
    first = result.found[0]
    third = first.segment_eigenvalues[2]
    return Claim(near(third).holds and third > 1.0 and first.cycle.stable)


def more_expand(result: Result) -> Claim:
    """Segments other than the third expand by themselves, too, as a sentence of the paper seems to say."""
    alone = [value for found in result.found for value in found.segment_eigenvalues[:2]]
    return Claim(any(value > EXPANDS for value in alone))


def properties_hold(result: Result) -> Claim:
    """Properties 3.1 and 3.2 on the exact cycles and in the loop."""
    return Claim(monotone(result).holds and below_rests(result).holds)


def _segments_words(result: Result) -> str:
    """Every segment by its name: which expand."""
    named = [
        (f"{name} of {_named(found.gains)}", value) for found in result.found for name, value in found.parts.items()
    ]
    expanding = [f"{name} ({significant(value, 5)})" for name, value in named if value > EXPANDS]
    others = [f"{name} ({significant(value, 5)})" for name, value in named if value <= EXPANDS]
    return (
        f"Of the {len(named)} segments of both cycles, single and two in a row, these expand: "
        f"{listed(expanding) if expanding else 'none'}. "
        f"The others do not: {listed(others) if others else 'none'}."
    )


def _pairs(result: Result) -> int:
    return sum(s.gain_V.size for s in result.over_h2 + result.over_h1)


def monotone(result: Result) -> Claim:
    """The exact cycles of the sweeps rise and fall as Property 3.2 says."""
    h2 = all(
        (np.diff(s.exact_amplitude_rad) > 0).all() and (np.diff(s.exact_period_s) > 0).all() for s in result.over_h2
    )
    h1 = all(
        (np.diff(s.exact_amplitude_rad) < 0).all() and (np.diff(s.exact_period_s) < 0).all() for s in result.over_h1
    )
    return Claim(bool(h2 and h1))


def below_rests(result: Result) -> Claim:
    """The loop comes to rest where h2 <= fc, and only there (Property 3.1)."""
    return Claim(all(run.at_rest == (run.h2_V <= surviving.FC_V) for run in result.decays))


def _named(gains: RelayGains) -> str:
    return f"({gains.h1_V:g}, {gains.h2_V:g})"


def _cycle_table(result: Result) -> Table:
    rows = []
    for f in result.found:
        c = f.cycle
        cells = [number(t, 5) for t in c.durations_s] + [number(c.period_s, 5), number(float(c.states[1, 1]), 5)]
        rows.append((Cell(_named(f.gains)), *cells, number(float(c.states[0, 1]), 5), number(c.speed_rad_s, 4)))
    return Table(
        ("(h<sub>1</sub>, h<sub>2</sub>), V", "t<sub>1</sub>, s", "t<sub>2</sub>, s", "t<sub>3</sub>, s", "T, s",
         "y(t<sub>1</sub>), rad", "y(0), rad", "largest |v|, rad/s"),
        tuple(rows),
        "The cycles of Theorem 2.1: durations until RA, RB and RC switch, and where the shaft is then.",
    )  # fmt: skip


def _stability_table(result: Result) -> Table:
    rows = []
    for k, f in enumerate(result.found):
        eigenvalues = np.real_if_close(f.cycle.eigenvalues())
        paper = number(surviving.SEGMENT_EIGENVALUE, 5, whose="paper") if k == 0 else Cell("did not survive")
        rows.append((
            Cell(_named(f.gains)), *(number(float(v), 6) if abs(v) > 1e-9 else Cell("0", 0.0) for v in eigenvalues),
            *(number(v, 7) for v in f.segment_eigenvalues), paper, Cell("stable" if f.cycle.stable else "unstable"),
        ))  # fmt: skip
    return Table(
        ("(h<sub>1</sub>, h<sub>2</sub>), V", "eigenvalues of J", "", "", "of J<sub>1</sub> alone",
         "of J<sub>2</sub> alone", "of J<sub>3</sub> alone", "paper, J<sub>3</sub>", "cycle"),
        tuple(rows),
        "Theorem 2.2: eigenvalues of J = J<sub>3</sub>J<sub>2</sub>J<sub>1</sub>, and the largest magnitude of each "
        "factor's. Inside the unit circle is stable.",
    )  # fmt: skip


def _methods_table(result: Result) -> Table:
    rows = []
    for f in result.found:
        c, s, d = f.cycle, f.solver, f.sine
        rows += [
            (Cell(f"{_named(f.gains)} exact"), number(c.period_s, 7), Cell(""), number(c.amplitude_rad, 7), Cell("")),
            (
                Cell(f"{_named(f.gains)} ODE solver with events"),
                number(s.period_s, 7),
                number(s.period_s / c.period_s - 1.0, 1),
                number(-s.y_ra_rad, 7),
                number(-s.y_ra_rad / c.amplitude_rad - 1.0, 1),
            ),
            (
                Cell(f"{_named(f.gains)} describing function"),
                number(d.period_s, 4),
                share(d.period_s / c.period_s - 1.0),
                number(d.amplitude_rad, 4),
                share(d.amplitude_rad / c.amplitude_rad - 1.0),
            ),
        ]
    return Table(
        ("(h<sub>1</sub>, h<sub>2</sub>), V, method", "T, s", "relative error", "amplitude, rad", "relative error"),
        tuple(rows),
        f"The same cycles three ways. The ODE solver (DOP853, relative tolerance {significant(RELATIVE, 1)}) starts "
        "away from the "
        "cycle and knows only the equations of motion; the describing function assumes a sine.",
    )


def _property_words(result: Result) -> str:
    worst = max(
        float(np.abs(s.sine_amplitude_rad / s.exact_amplitude_rad - 1.0).max()) for s in result.over_h2 + result.over_h1
    )
    told = monotone(result).says(
        "So does the exact cycle at every one of the", "The exact cycle does not at all of the"
    )
    off = f"the sine's amplitude is up to {100 * worst:.0f} % off it"
    return f"{told} {_pairs(result)} pairs of gains computed here; {off}."


def _courses(result: Result) -> Picture:
    figure = new_figure(6.0)
    panels = figure.subplots(5, 2, sharex="col", height_ratios=(1.3, 1.3, 1.3, 0.9, 0.8))
    fc = surviving.FC_V
    for column, (f, ink) in enumerate(zip(result.found, CYCLES, strict=True)):
        curve = course(f.cycle, 900, 2.0)
        drive = np.array([f.cycle.inputs_V[s] + (fc if s else -fc) for s in range(3)])
        u = np.concatenate((drive, -drive))[curve["stage"]]
        friction = np.where(curve["v"] > 0.0, -fc, fc)
        for axes, key in zip(panels[:3, column], ("y", "v", "z"), strict=True):
            axes.plot(curve["t"], curve[key], color=ink)
            zero(axes)
        panels[3, column].plot(curve["t"], u, color=ink)
        panels[4, column].plot(curve["t"], friction, color=MUTED)
        for axes in panels[:, column]:
            shade_stages(axes, f.cycle, 2.0)
        panels[0, column].set_title(f"h1 = {f.gains.h1_V:g} V,  h2 = {f.gains.h2_V:g} V")
        panels[4, column].set(xlabel="time since the drive stepped up, s", xlim=(0.0, 2.0 * f.cycle.period_s))
    names = ("y, rad", "v, rad/s", "z, rad s", "u, V\n(RB, RC)", "−f_c sgn v, V\n(RA)")
    for axes, text in zip(panels[:, 0], names, strict=True):
        axes.set_ylabel(text)
    figure.align_ylabels(panels[:, 0])
    return finish(
        figure,
        "Time courses of position, velocity, integral and the three relays' signals over two periods.",
        "Time courses over two periods, exact: position, velocity, integral of position, the drive of the dual-channel "
        "relay, and the friction as a relay on velocity. Shaded: stage 1 (narrow, blue; until RA switches), stage 2 "
        "(white; until RB), stage 3 (sand; until RC).",
    )


def _portraits(result: Result) -> Picture:
    figure = new_figure(3.9)
    left, right = figure.subplots(1, 2)
    marks = (("o", "RC"), ("D", "RA"), ("s", "RB"))
    for k, (f, ink) in enumerate(zip(result.found, CYCLES, strict=True)):
        curve = course(f.cycle, 900)
        left.plot(curve["y"], curve["v"], color=ink, label=_named(f.gains) + " V")
        right.plot(curve["y"], curve["z"], color=ink)
        for (shape, name), state in zip(marks, f.cycle.states[:3], strict=True):
            for sign in (1.0, -1.0):
                label = f"{name} switches" if k == 0 and sign > 0 else None
                for axes, value in ((left, state[0]), (right, state[2])):
                    axes.plot(
                        sign * state[1],
                        sign * value,
                        shape,
                        ms=5.0,
                        mfc="white",
                        mec=ink,
                        mew=1.2,
                        label=label,
                        zorder=3,
                    )
    for axes in (left, right):
        zero(axes)
        axes.axvline(0.0, color=MUTED, lw=0.7)
        axes.set_xlabel("position y, rad")
        axes.margins(0.08)
    left.set_ylabel("velocity v, rad/s")
    right.set_ylabel("integral z, rad s")
    left.set_title("velocity over position")
    right.set_title("integral over position")
    right.legend(*left.get_legend_handles_labels(), loc="upper left", ncols=1, fontsize=7.5)
    low, high = right.get_xlim()
    right.set_xlim(low - 0.55 * (high - low), high)
    return finish(
        figure,
        "Phase planes of both cycles with the switching points.",
        "Phase planes of both cycles with the points at which relays switch: RA on v = 0, RB on y = 0, RC on z = 0.",
    )


def _convergence(result: Result) -> Picture:
    figure = new_figure(3.9)
    left, right = figure.subplots(1, 2)
    inks = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
    cycle = result.found[0].cycle
    curve = course(cycle, 900)
    for k, (run, ink) in enumerate(zip(result.transients, inks, strict=True)):
        name = f"v = {run.start.v:g}, y = {run.start.y:g}, z = {run.start.z:g}".replace("-", "−")
        left.plot(run.y_rad, run.v_rad_s, color=ink, lw=0.8)
        left.plot(run.start.y, run.start.v, "o", ms=5.0, color=ink, label=name)
        seen = run.distance > 1e-7
        right.semilogy(np.arange(1, seen.sum() + 1), run.distance[seen], "o-", ms=3.0, lw=0.8, color=ink)
        if k == 0:
            size = float(np.abs(cycle.eigenvalues()).max())
            halves = np.arange(1, 20)
            right.semilogy(halves, run.distance[5] * size ** (halves - 6.0), "k--", lw=1.2, label=f"{size:.4f} each")
    left.plot(curve["y"], curve["v"], color=EXACT, lw=2.0, label="limit cycle")
    zero(left)
    left.set(xlabel="position y, rad", ylabel="velocity v, rad/s")
    left.set_ylim(top=15.5)
    left.legend(loc="upper right", title="from", fontsize=7.5)
    right.set(xlabel="switching of RC", ylabel="distance from the cycle", xlim=(0.0, 20.0))
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    right.legend(loc="upper right")
    return finish(
        figure,
        "Transients from four initial states into the limit cycle, and how fast they approach it.",
        "Left: transients in the phase plane, from four initial states (dots), switching at the very instants of the "
        "crossings. Right: distance from the cycle at each switching of RC, relative to the cycle's size; dashed: the "
        "rate of Theorem 2.2.",
    )


def _decays(result: Result) -> Picture:
    figure = new_figure(2.3)
    panels = figure.subplots(1, len(result.decays), sharey=True)
    for axes, run in zip(panels, result.decays, strict=True):
        axes.plot(run.t_s, run.y_rad, color=INK)
        zero(axes)
        axes.set(title=f"h2 = {run.h2_V:g} V: {'comes to rest' if run.at_rest else 'a cycle'}", xlabel="time, s")
    panels[0].set_ylabel("position y, rad")
    return finish(
        figure,
        "The loop below and above the limit of Property 3.1.",
        f"Property 3.1 in the loop itself, h1 = {surviving.GAINS[0].h1_V:g} V, f<sub>c</sub> = {surviving.FC_V:g} V: "
        f"{listed([_decay_words(run) for run in result.decays])}.",
    )


def _decay_words(run: Decay) -> str:
    return f"at h2 = {run.h2_V:g} V {Claim(run.at_rest).says('the shaft comes to rest', 'there is a cycle')}"


def _overlay(result: Result) -> Picture:
    figure = new_figure(2.9)
    panels = figure.subplots(1, 2)
    for axes, f in zip(panels, result.found, strict=True):
        curve = course(f.cycle)
        axes.plot(curve["t"], curve["y"], color=EXACT, label="exact (the ODE solver's lies on it)")
        omega = f.sine.omega_rad_s
        # in phase where the exact cycle crosses zero upwards
        at = sum(f.cycle.durations_s[:2])
        axes.plot(
            curve["t"], f.sine.amplitude_rad * np.sin(omega * (curve["t"] - at)), "--", color=SINE, label="sine (DF)"
        )
        s = f.solver.durations_s
        peer = np.cumsum((0.0, *s))
        positions = (f.solver.y_rc_rad, f.solver.y_ra_rad, 0.0, -f.solver.y_rc_rad)
        axes.plot(peer, positions, "o", ms=4.5, mfc="white", mec="#E69F00", mew=1.3, label="switchings, ODE solver")
        zero(axes)
        axes.set_title(f"h1 = {f.gains.h1_V:g} V,  h2 = {f.gains.h2_V:g} V")
        axes.set_xlabel("time since the drive stepped up, s")
        axes.set_ylim(-1.25 * f.cycle.amplitude_rad, 1.75 * f.cycle.amplitude_rad)
    panels[0].set_ylabel("position y, rad")
    panels[0].legend(loc="upper left", ncols=1)
    return finish(
        figure,
        "One period of position: exact, by ODE solver, by describing function.",
        "One period of the position: exact, with the switchings that the ODE solver found, and the sine of the "
        "describing function, laid on the upward crossing. The real curve is no sine: its acceleration jumps at each "
        "switching.",
    )


def _properties(result: Result) -> Picture:
    figure = new_figure(5.0)
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    inks = ("#56B4E9", "#0072B2", "#1f2d5c")
    for column, (sweeps, other, along) in enumerate(((result.over_h2, "h1", "h2"), (result.over_h1, "h2", "h1"))):
        for sweep, ink in zip(sweeps, inks, strict=True):
            top, bottom = panels[0, column], panels[1, column]
            top.plot(sweep.gain_V, sweep.exact_amplitude_rad, color=ink, label=f"{other} = {sweep.fixed_V:g} V")
            top.plot(sweep.gain_V, sweep.sine_amplitude_rad, "--", color=ink, lw=0.9)
            bottom.plot(sweep.gain_V, 1.0 / sweep.exact_period_s, color=ink)
            bottom.plot(sweep.gain_V, 1.0 / sweep.sine_period_s, "--", color=ink, lw=0.9)
        panels[1, column].set_xlabel(f"{along}, V")
        panels[0, column].set_title(f"over {along}")
        panels[0, column].legend(loc="upper left" if column == 0 else "upper right")
    for axes in panels[:, 0]:
        axes.set_xlim(0.3, 1.52)
        axes.axvspan(0.3, surviving.FC_V, color="#f3e3e3", lw=0)
    note(panels[1, 0], "no cycle:\nh2 ≤ fc", loc="upper left", colour="#9a1b1b")
    for row, text in enumerate(("amplitude, rad", "frequency, Hz")):
        panels[row, 0].set(ylabel=text, yscale="log")
    return finish(
        figure,
        "Amplitude and frequency of the cycle over both gains.",
        "Properties 3.1 and 3.2: amplitude and frequency over h2 (left) and over h1 (right), the other fixed. Solid: "
        "exact; dashed: describing function. Logarithmic scales.",
    )
