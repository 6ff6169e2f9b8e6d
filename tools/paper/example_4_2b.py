"""Example 4.2 (b): identification by describing function, from two experiments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from paper import surviving
from paper.drawing import PARAMETERS, Array, finish, new_figure, zero
from paper.page import Comparison, Paragraph, Remark, Section
from rig.identification import describing_function
from rig.model.describing_function import predict
from rig.model.limit_cycle import limit_cycle
from rig.output.report.style import Picture
from rig.output.report.words import percent
from shared.page import listed
from shared.table import Cell, Table, number, share


@dataclass(frozen=True)
class Result:
    """The estimate from the exact cycles of both pairs of gains, and its error over other second experiments.

    theta              tau, K, fc
    from_sines         the same solution from what the describing function itself predicts: shows that it is inverted
    second_V           h2 of the second experiment, its amplitude scaled (h1 and h2 - fc alike), first as given
    relative_errors    (n, 3) for these
    """

    theta: Array
    from_sines: Array
    second_V: Array
    relative_errors: Array


def compute(points: int = 25) -> Result:
    """Exact cycles in, describing function out."""
    first, second = surviving.GAINS
    rows = []
    ratios = np.concatenate((np.linspace(0.5, 0.93, points // 2), np.linspace(1.08, 2.0, points - points // 2)))
    fc = surviving.MOTOR.fc_V
    for ratio in ratios.tolist():
        other = (ratio * first.h1_V, fc + ratio * (first.h2_V - fc))
        rows.append(_solve(((first.h1_V, first.h2_V), other), sines=False) / np.array(surviving.MOTOR) - 1.0)
    pair = ((first.h1_V, first.h2_V), (second.h1_V, second.h2_V))
    second_V = fc + ratios * (first.h2_V - fc)
    return Result(_solve(pair, sines=False), _solve(pair, sines=True), second_V, np.array(rows))


def _solve(gains: tuple[tuple[float, float], tuple[float, float]], *, sines: bool) -> Array:
    """tau, K, fc from the frequencies and amplitudes of two cycles."""
    tau, K, fc = surviving.MOTOR
    seen = []
    for h1, h2 in gains:
        if sines:
            sine = predict(tau, K, fc, h1, h2)
            seen.append((sine.omega_rad_s, sine.amplitude_rad))
        else:
            cycle = limit_cycle(tau, K, fc, h1, h2)
            seen.append((2.0 * np.pi / cycle.period_s, cycle.amplitude_rad))
    omegas, amplitudes = np.array(seen).T
    h1_V, h2_V = np.array(gains).T
    return np.array(describing_function.solve(omegas, amplitudes, h1_V, h2_V))


def section(result: Result) -> Section:
    """Its part of the page."""
    errors = result.theta / np.array(surviving.MOTOR) - 1.0
    blocks = (
        Paragraph(
            "Two experiments, (h<sub>1</sub>, h<sub>2</sub>) = "
            f"{listed([f'({g.h1_V:g}, {g.h2_V:g})' for g in surviving.GAINS])}, each give a frequency ω and an "
            "amplitude A. πAω/4 = K h<sub>2</sub> − K f<sub>c</sub> is linear in K and K f<sub>c</sub>; τ follows from "
            "ω = h<sub>1</sub>/(τ(h<sub>2</sub> − f<sub>c</sub>)). No noise, no sampling here: all of the error is "
            "that of assuming a sine."
        ),
        Table(
            ("", "τ, s", "K, (rad/s)/V", "f<sub>c</sub>, V"),
            (
                (Cell("true"), *(number(v, 4) for v in surviving.MOTOR)),
                (Cell("describing function, exact cycles"), *(number(float(v), 4) for v in result.theta)),
                (Cell("error"), *(share(float(e)) for e in errors)),
                (Cell("check: from the sines it assumes"), *(number(float(v), 4) for v in result.from_sines)),
            ),
            "Estimate by describing function from two experiments.",
        ),
        Remark(
            "chosen",
            "The paper's own DF estimates of this example did not survive; τ and K are the chosen ones.",
        ),
        _errors_figure(result),
    )
    comparison = Comparison(
        "4.2 (b)",
        "describing function from two experiments",
        "",
        ", ".join(percent(float(e)) for e in errors) + " in τ, K, f<sub>c</sub>",
        "not comparable",
        "noise-free: the error of assuming a sine alone",
    )
    return Section("example-4-2b", "4.2 (b)", "Example 4.2 (b): describing function", blocks, (comparison,))


def _errors_figure(result: Result) -> Picture:
    figure = new_figure(2.7)
    axes = figure.subplots()
    for k, (name, ink, mark) in enumerate(PARAMETERS):
        axes.plot(result.second_V, 100.0 * result.relative_errors[:, k], mark, ms=3.5, color=ink, label=name)
    zero(axes)
    axes.set(xlabel="h2 of the second experiment, V (first: 1 V; h1 and h2 − f_c scaled alike)", ylabel="error, %")
    axes.set_ylim(top=4.0)
    axes.legend(loc="upper right", ncols=3)
    return finish(
        figure,
        "Error of the describing function's estimate over the second experiment's gain.",
        "The describing function's error over the choice of the second experiment, here with the amplitude scaled at "
        "nearly the same period. There is no noise in it: more data would not change it.",
    )
