"""Example 4.3: Tustin's friction (Stribeck effect and viscous part), identified as if it were Coulomb's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from paper import example_4_2c, surviving
from paper.drawing import Array, finish, new_figure, zero
from paper.gauss_newton import STOPS, Path, iterate
from paper.ideal_relay import HalfPeriod, Relay, ideal_relay, settled_cycle
from paper.page import Claim, Comparison, Heading, Paragraph, Remark, Section
from rig.identification import describing_function
from rig.identification.triple_relay import Features
from rig.model.describing_function import RelayGains
from rig.model.friction import tustin
from rig.model.motor import Motor, State
from rig.output.report.style import Picture
from shared.table import Cell, Table, fixed, number, share, significant

# Chosen, none of them survived: near the surviving durations with the tau and K of Example 4.1 (see `section`).
FC_V = 0.47
FS_V = 0.52
STRIBECK_RAD_S = 0.1
VISCOUS_V_S_RAD = 0.01
# With another gain a law exists that gives all the surviving digits; one of a family, with a strong Stribeck effect.
REPRODUCING = Motor(0.17, 6.75, tustin(0.39, 0.8361, 0.4, 0.03665))
# With the tau and K of Example 4.1 and no Stribeck effect at all, the paper's t2 and t3, but not its t1 and position.
WITHOUT_STRIBECK = Motor(surviving.MOTOR.tau_s, surviving.MOTOR.K_rad_s_V, tustin(0.45043, 0.45043, 0.0, 0.01724))
SAME = 1e-6  # relative, of ends of the iteration
TOLERANCE = 1e-9  # of the settled cycle


@dataclass(frozen=True)
class Case:
    """One friction law: the motor, its cycle, and what the triple-relay equations make of the cycle.

    paths   where plain Gauss-Newton goes, by the name of its start; the first starts at the motor's own values
    """

    name: str
    motor: Motor
    cycle: HalfPeriod
    paths: dict[str, Path]

    @property
    def theta(self) -> Array:
        """Where the first path ends: tau, K, fc."""
        return next(iter(self.paths.values())).theta

    def arrives(self, path: Path) -> bool:
        """Whether it ends where the first does."""
        return path.converged and bool(np.abs(path.theta / self.theta - 1.0).max() < SAME)

    @property
    def effective(self) -> tuple[float, float]:
        """tau, s, and K, (rad/s)/V, with the viscous part absorbed."""
        shrink = 1.0 + self.motor.K_rad_s_V * self.motor.friction.viscous_V_s_rad
        return self.motor.tau_s / shrink, self.motor.K_rad_s_V / shrink

    @property
    def position_rad(self) -> float:
        """Largest position, rad."""
        return max(abs(y) for y in self.cycle.y_events_rad)

    @property
    def ratio_error(self) -> float:
        """Error of the identified tau/K against the motor's own."""
        own = self.motor.tau_s / self.motor.K_rad_s_V
        return float(self.theta[0] / self.theta[1]) / own - 1.0


@dataclass(frozen=True)
class Result:
    """Numbers of Example 4.3.

    viscous, tustin   viscous friction alone, and Tustin's law as chosen
    reproducing   a law whose cycle has the paper's digits
    without_stribeck   the cycle under Coulomb and viscous friction alone that has the paper's t2 and t3
    step_V    Stribeck steps fs - fc of the sweep; errors (n, 3): of tau_eff, K_eff, fc; ratio_errors (n,): of tau/K
    """

    viscous: Case
    tustin: Case
    reproducing: Case
    without_stribeck: HalfPeriod
    step_V: Array
    errors: Array
    ratio_errors: Array


def compute(points: int = 7) -> Result:
    """The cycles in continuous time, and their identification."""
    steps = np.linspace(0.0, 0.15, points)
    sweep = [_case(f"fs - fc = {step:.3f} V", FC_V + float(step)) for step in steps.tolist()]
    return Result(
        _case("viscous alone", FC_V),
        _case("Tustin", FS_V),
        _case_of("Tustin, with the paper's digits", REPRODUCING),
        _cycle(WITHOUT_STRIBECK),
        steps,
        np.array([_errors(case) for case in sweep]),
        np.array([case.ratio_error for case in sweep]),
    )


def _case(name: str, fs_V: float) -> Case:
    tau, K, _ = surviving.MOTOR
    return _case_of(name, Motor(tau, K, tustin(FC_V, fs_V, STRIBECK_RAD_S, VISCOUS_V_S_RAD)))


def _case_of(name: str, motor: Motor) -> Case:
    tau, K, fc = motor.tau_s, motor.K_rad_s_V, motor.friction.plus_V
    cycle = _cycle(motor)
    t1, t2, t3 = cycle.durations_s
    seen = Features(t1, t2, t3, cycle.y_events_rad[1], cycle.y_events_rad[0])
    starts = {"the motor's own values": (tau, K, fc), "describing function (two-stage)": _two_stage(motor, cycle)}
    starts |= {f"({', '.join(f'{v:g}' for v in guess)})": guess for guess in example_4_2c.STARTS}
    return Case(name, motor, cycle, {key: iterate(seen, surviving.GAINS[0], at) for key, at in starts.items()})


def _two_stage(motor: Motor, first: HalfPeriod) -> tuple[float, float, float]:
    """The describing function's estimate from this cycle and that of the second pair of gains."""
    cycles = (first, _cycle(motor, surviving.GAINS[1]))
    omegas = np.array([np.pi / cycle.duration_s for cycle in cycles])
    amplitudes = np.array([max(map(abs, cycle.y_events_rad)) for cycle in cycles])
    h1_V, h2_V = np.array(surviving.GAINS).T
    tau, K, fc = (float(value) for value in describing_function.solve(omegas, amplitudes, h1_V, h2_V))
    return tau, K, fc


def _cycle(motor: Motor, gains: RelayGains = surviving.GAINS[0]) -> HalfPeriod:
    return settled_cycle(motor, gains.h1_V, gains.h2_V, State(0.0, -0.3, -0.01), TOLERANCE)


def _numbers(cycle: HalfPeriod) -> tuple[float, ...]:
    """Durations, s, and largest position, rad."""
    return (*cycle.durations_s, max(abs(y) for y in cycle.y_events_rad))


def _gains_words() -> str:
    return f"({surviving.GAINS[0].h1_V:g}, {surviving.GAINS[0].h2_V:g})"


def _law_words(motor: Motor) -> str:
    f = motor.friction
    return (
        f"f<sub>c</sub> = {f.plus_V:g} V, f<sub>s</sub> = {f.static_plus_V:g} V, v<sub>s</sub> = {f.stribeck_rad_s:g} "
        f"rad/s, f<sub>v</sub> = {f.viscous_V_s_rad:g} V/(rad/s)"
    )


PAPER = (*surviving.TUSTIN_DURATIONS_S, surviving.TUSTIN_POSITION_RAD)


def _digits(cycle: HalfPeriod) -> list[bool]:
    """Which of t1, t2, t3 and the largest position have all the paper's digits."""
    return [f"{a:.4f}" == f"{b:.4f}" for a, b in zip(_numbers(cycle), PAPER, strict=True)]


def reproduced(result: Result) -> Claim:
    """The reproducing law's cycle has all the paper's digits."""
    return Claim(all(_digits(result.reproducing.cycle)))


def ratio_without_stribeck(result: Result) -> Claim:
    """Coulomb and viscous friction alone give the paper's t2 and t3, with the tau and K of Example 4.1."""
    return Claim(all(_digits(result.without_stribeck)[1:3]))


def four_iterations(result: Result) -> Claim:
    """From a start other than the motor's own values the iteration takes the paper's count, by one of the rules."""
    return Claim(
        any(
            surviving.TUSTIN_ITERATIONS in path.counts
            for path in list(result.tustin.paths.values())[1:]
            if result.tustin.arrives(path)
        )
    )


def _errors(case: Case) -> Array:
    tau, K = case.effective
    return np.asarray(case.theta / np.array([tau, K, case.motor.friction.plus_V]) - 1.0)


def section(result: Result) -> Section:
    """Its part of the page."""
    case, viscous = result.tustin, result.viscous
    tau, K = case.effective
    off = _duration_errors(result)
    blocks = (
        Paragraph(
            "Model uncertainty: the motor's friction follows Tustin's law, f(v) = (f<sub>c</sub> + (f<sub>s</sub> − "
            "f<sub>c</sub>) e<sup>−|v|/v<sub>s</sub></sup>) sgn v + f<sub>v</sub>v, and is identified as if it were "
            f"Coulomb's, gains {_gains_words()}. The viscous part cannot be told from the motor's own damping: it is "
            "absorbed, "
            "τ<sub>eff</sub> = τ/(1 + Kf<sub>v</sub>) and K<sub>eff</sub> = K/(1 + Kf<sub>v</sub>). So τ/K survives, "
            "and is the check. The cycle here is in continuous time, from crossing to crossing."
        ),
        Remark(
            "chosen",
            f"None of the law's parameters survived. With the τ and K of Example 4.1, f<sub>c</sub> = {FC_V} V, "
            f"f<sub>s</sub> = {FS_V} V, v<sub>s</sub> = {STRIBECK_RAD_S} rad/s and f<sub>v</sub> = {VISCOUS_V_S_RAD} "
            "V/(rad/s) come near the paper's durations.",
        ),
        _duration_table(result),
        Remark(
            ratio_without_stribeck(result).agreement,
            f"The law chosen is off by up to {100 * float(np.abs(off).max()):.1f} %. With the same τ and K, and no "
            "Stribeck "
            f"effect at all ({_law_words(WITHOUT_STRIBECK)}), t<sub>2</sub> and t<sub>3</sub> "
            f"{ratio_without_stribeck(result).says('are the paper’s', 'are not the paper’s')}: "
            f"{_numbers(result.without_stribeck)[1]:.4f} and {_numbers(result.without_stribeck)[2]:.4f} s; "
            "t<sub>1</sub> "
            f"is {_percent(_relative(result.without_stribeck)[0])} and the position "
            f"{_percent(_relative(result.without_stribeck)[3])} off then.",
        ),
        Remark(
            reproduced(result).agreement,
            f"With K = {REPRODUCING.K_rad_s_V:g} (rad/s)/V and {_law_words(REPRODUCING)} the cycle "
            f"{reproduced(result).says('has all the surviving digits', 'does not have all the surviving digits')} "
            "(last "
            "line of the table). Four numbers do not fix the six of motor and law, so this need not be the paper's. "
            f"Identified as Coulomb's, its τ/K is {_percent(result.reproducing.ratio_error)} off.",
        ),
        Heading("Identified as Coulomb friction"),
        Paragraph(
            "The iteration of this table starts at the motor's own τ, K and f<sub>c</sub>, which nobody knows on a "
            "bench; "
            "the next table starts it elsewhere. The paper's start did not survive."
        ),
        _identified_table(result),
        _starts_table(case),
        Remark(
            four_iterations(result).agreement,
            f"From {_arrivals(case)} of {len(case.paths)} starts the iteration comes to the same solution. The "
            "paper's takes "
            f"{surviving.TUSTIN_ITERATIONS} iterations; here that {four_iterations(result).says('is', 'is not')} the "
            "count "
            "by one of the rules, from a start that is not the motor's own.",
        ),
        Remark(
            holds(result).agreement,
            f"The check {holds(result).says('holds', 'does not hold')}: the identified τ/K is "
            f"{significant(float(case.theta[0] / case.theta[1]), 5)} V s²/rad, the motor's own "
            f"{significant(case.motor.tau_s / case.motor.K_rad_s_V, 5)} "
            f"({100 * case.ratio_error:+.2f} %), {nearer(result).says('though', 'and')} τ itself is "
            f"{100 * (float(case.theta[0]) / case.motor.tau_s - 1.0):+.1f} % off the motor's. With viscous friction "
            f"alone τ<sub>eff</sub> = {significant(tau, 6)} s and K<sub>eff</sub> = "
            f"{significant(K, 6)} (rad/s)/V are found to "
            f"{significant(float(np.abs(_errors(viscous)).max()), 1)}.".replace("-", "−"),
        ),
        _law_figure(result),
        _sweep_figure(result),
    )
    return Section("example-4-3", "4.3", "Example 4.3: Tustin's friction", blocks, _comparisons(result, off))


def _duration_errors(result: Result) -> Array:
    return _relative(result.tustin.cycle)


def _relative(cycle: HalfPeriod) -> Array:
    """How far t1, t2, t3 and the largest position are off the paper's."""
    return np.asarray(np.array(_numbers(cycle)) / np.array(PAPER) - 1.0)


def _percent(share: float) -> str:
    return f"{100.0 * share:+.1f} %".replace("-", "−")


def _arrivals(case: Case) -> int:
    return sum(case.arrives(path) for path in case.paths.values())


def holds(result: Result) -> Claim:
    """Tau/K survives: exactly with viscous friction alone, to 2 % with Tustin's law."""
    return Claim(abs(result.tustin.ratio_error) < 0.02 and abs(result.viscous.ratio_error) < 1e-6)


def nearer(result: Result) -> Claim:
    """Tau/K is nearer to the motor's own than tau is."""
    tau = float(result.tustin.theta[0]) / result.tustin.motor.tau_s - 1.0
    return Claim(abs(result.tustin.ratio_error) < abs(tau))


def _comparisons(result: Result, off: Array) -> tuple[Comparison, ...]:
    paper = ", ".join(f"{t:.4f}" for t in surviving.TUSTIN_DURATIONS_S)
    ours = ", ".join(f"{t:.4f}" for t in result.tustin.cycle.durations_s)
    ratio = result.tustin.ratio_error
    return (
        Comparison(
            "4.3",
            "durations t<sub>1</sub>, t<sub>2</sub>, t<sub>3</sub>, s",
            paper,
            ours,
            "not comparable",
            f"friction law chosen to come near: within {100 * float(np.abs(off[:3]).max()):.1f} %; without Stribeck "
            "effect "
            "t<sub>2</sub>, t<sub>3</sub> "
            f"{ratio_without_stribeck(result).says('to all digits', 'not to all digits')}, "
            f"with another gain {reproduced(result).says('all four', 'not all four')}",
        ),
        Comparison(
            "4.3",
            "position |y(t<sub>1</sub>)|, rad",
            f"{surviving.TUSTIN_POSITION_RAD}",
            f"{result.tustin.position_rad:.4f}",
            "not comparable",
            f"likewise: {100 * float(off[3]):+.1f} %".replace("-", "−"),
        ),
        Comparison(
            "4.3",
            "viscous friction is absorbed: τ<sub>eff</sub>/K<sub>eff</sub> = τ/K",
            "the check",
            f"{100 * ratio:+.2f} % with Tustin's law, {significant(abs(result.viscous.ratio_error), 1)} with viscous "
            "alone".replace("-", "−"),
            holds(result).agreement,
            "identified from the cycle alone, the iteration started at the motor's own values",
        ),
        Comparison(
            "4.3",
            "iterations of Gauss-Newton",
            str(surviving.TUSTIN_ITERATIONS),
            "; ".join(
                f"{name}: {_counted(path)}" for name, path in result.tustin.paths.items() if result.tustin.arrives(path)
            ),
            four_iterations(result).agreement,
            f"until a step is below {', '.join(significant(stop, 1) for stop in STOPS)}; the paper's start and rule "
            "did "
            "not survive",
        ),
    )


def _counted(path: Path) -> str:
    """Iterations by each of ``STOPS``."""
    return ", ".join("–" if count is None else str(count) for count in path.counts)


def _starts_table(case: Case) -> Table:
    rows = []
    for name, path in case.paths.items():
        there = case.arrives(path)
        counts = [Cell(f"{count}", float(count)) if there and count is not None else Cell("–") for count in path.counts]
        end = [number(float(v), 5) if there else Cell("–") for v in path.theta]
        rows.append((Cell(name), *counts, *end, Cell("yes") if there else Cell("no", None, "bad")))
    paper = Cell(f"paper: {surviving.TUSTIN_ITERATIONS}, start and rule unknown", None, "paper")
    rows.append((paper, *([Cell("")] * (len(STOPS) + 4))))
    return Table(
        ("start", *(f"step below {significant(stop, 1)}" for stop in STOPS), "τ, s", "K, (rad/s)/V", "f<sub>c</sub>, V",
         "the same solution"),
        tuple(rows),
        "Plain Gauss-Newton on the cycle under Tustin's law: iterations until a step changes no parameter by more than "
        "this, and where it ends.",
    )  # fmt: skip


def _duration_table(result: Result) -> Table:
    case = result.tustin
    off = _duration_errors(result)
    paper = [fixed(t, 4, whose="paper") for t in (*surviving.TUSTIN_DURATIONS_S, surviving.TUSTIN_POSITION_RAD)]
    ours = [fixed(t, 5) for t in (*case.cycle.durations_s, case.position_rad)]
    return Table(
        ("", "t<sub>1</sub>, s", "t<sub>2</sub>, s", "t<sub>3</sub>, s", "|y(t<sub>1</sub>)|, rad"),
        (
            (Cell("paper", None, "paper"), *paper),
            (Cell("ours, continuous time"), *ours),
            (Cell("difference"), *(share(float(e)) for e in off)),
            (Cell("same τ and K, no Stribeck effect"), *(fixed(t, 5) for t in _numbers(result.without_stribeck))),
            (Cell("another K, with a Stribeck effect"), *(fixed(t, 5) for t in _numbers(result.reproducing.cycle))),
        ),
        f"The cycle under Tustin's friction at (h<sub>1</sub>, h<sub>2</sub>) = {_gains_words()}.",
    )


def _identified_table(result: Result) -> Table:
    rows = []
    for case in (result.viscous, result.tustin, result.reproducing):
        tau, K = case.effective
        fc, errors = case.motor.friction.plus_V, _errors(case)
        own = case.motor.tau_s / case.motor.K_rad_s_V
        ratio = float(case.theta[0] / case.theta[1])
        rows += [
            (Cell(f"{case.name}: the motor"), number(case.motor.tau_s, 5), number(case.motor.K_rad_s_V, 5),
             number(fc, 4), number(own, 5)),
            (Cell("with viscous friction absorbed"), number(tau, 5), number(K, 5), number(fc, 4), number(tau / K, 5)),
            (Cell("identified"), *(number(float(v), 5) for v in case.theta), number(ratio, 5)),
            (Cell("error against the absorbed"), *(share(float(e)) for e in errors), share(case.ratio_error)),
        ]  # fmt: skip
    return Table(
        ("", "τ, s", "K, (rad/s)/V", "f<sub>c</sub>, V", "τ/K, V s²/rad"),
        tuple(rows),
        "Triple-relay identification (24)–(29) of the exact cycle, with viscous friction alone (f<sub>s</sub> = "
        "f<sub>c</sub>), with Tustin's law as chosen, and with the law whose cycle has the paper's digits.",
    )


def _law_figure(result: Result) -> Picture:
    case = result.tustin
    figure = new_figure(3.3)
    left, right, plane = figure.subplots(1, 3)
    speeds = np.concatenate((np.linspace(-5.0, -1e-6, 400), np.linspace(1e-6, 5.0, 400)))
    left.plot(speeds, [case.motor.friction.level(float(v)) for v in speeds], color="#1f2328", label="Tustin's law")
    # as identified: the damping beyond the motor's own counts as viscous
    tau, K, fc = (float(v) for v in case.theta)
    damping = 1.0 / K - 1.0 / case.motor.K_rad_s_V
    left.plot(speeds, fc * np.sign(speeds) + damping * speeds, "--", color="#D55E00", label="as identified")
    left.set(xlabel="velocity v, rad/s", ylabel="friction f(v), V")
    left.legend(loc="upper left")
    zero(left)
    gains = surviving.GAINS[0]
    period = 2.0 * case.cycle.duration_s
    t = np.linspace(0.0, period * 0.999, 400)
    run = ideal_relay(case.motor, Relay(*gains), case.cycle.start, period, (-1.0, -1.0))
    states = run.states(t)
    right.plot(t, states[:, 1], color="#1f2328", label="Tustin's friction")
    plane.plot(states[:, 1], states[:, 0], color="#1f2328")
    # the identified motor under the drive of that run
    edges = [step.begin_s for step in run.steps]
    drives = [step.u_V for step in run.steps]
    model = Motor(tau, K, tustin(fc, fc, 0.0))
    start = State(case.cycle.start.v, case.cycle.start.y, 0.0)
    predicted = model.response(start, t, edges, drives)
    right.plot(t, predicted[:, 1], "--", color="#D55E00", label="identified model")
    plane.plot(predicted[:, 1], predicted[:, 0], "--", color="#D55E00")
    plane.set(xlabel="position y, rad", ylabel="velocity v, rad/s")
    right.set(xlabel="time since RC stepped up, s", ylabel="position y, rad")
    low, high = right.get_ylim()
    right.set_ylim(low, high + 0.45 * (high - low))
    right.legend(loc="upper left")
    zero(right)
    return finish(
        figure,
        "Tustin's friction law and what is identified of it; the cycle and the identified model's prediction.",
        "Left: Tustin's friction and what is identified of it, Coulomb's level and the absorbed viscous slope. Middle "
        "and right: one period under Tustin's friction and in its phase plane, and the identified model under the same "
        "drive.",
    )


def _sweep_figure(result: Result) -> Picture:
    figure = new_figure(2.8)
    axes = figure.subplots()
    looks = (("τ_eff", "#0072B2", "o"), ("K_eff", "#D55E00", "s"), ("f_c", "#009E73", "D"))
    for k, (name, ink, mark) in enumerate(looks):
        axes.plot(result.step_V, 100.0 * result.errors[:, k], mark + "-", ms=4.0, color=ink, label=name)
    axes.plot(result.step_V, 100.0 * result.ratio_errors, "k--", lw=1.2, label="τ/K")
    axes.axvline(FS_V - FC_V, color="#b9bfc7", lw=1.0, ls=":")
    zero(axes)
    axes.set(xlabel="Stribeck step f_s − f_c, V", ylabel="error, %")
    axes.legend(loc="upper left", ncols=4)
    return finish(
        figure,
        "Errors of the identified parameters over the size of the Stribeck effect.",
        "How much Stribeck effect the Coulomb model bears: errors against the motor with absorbed viscous friction, "
        "over the step from static to moving friction (dotted: the example's).",
    )
