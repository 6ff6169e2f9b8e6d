"""`rig predict`: the check table of docs/theory.md 3.4 to 1e-9, and where there is no simple oscillation, why."""

from __future__ import annotations

from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from paper.ideal_relay import Relay, half_periods, ideal_relay
from rig.model import limit_cycle as theorem
from rig.model.describing_function import predict
from rig.model.friction import coulomb
from rig.model.limit_cycle import LimitCycle, NoLimitCycle, effective_inputs, limit_cycle
from rig.model.motor import Motor, State
from rig.model.prediction import predict_cycle

# tau, K, fc, h1, h2; t1, t2, t3 (docs/theory.md 3.4, where they have six digits)
TABLE = [
    ("1", "1", "0.5", "0.8", "1", "0.046812", "0.837516", "0.927743"),
    ("1", "1", "0.5", "0.5", "1.2", "0.127438", "1.774867", "2.085097"),
    ("0.17", "6.5", "0.5", "0.8", "1", "0.007958", "0.142378", "0.157716"),
    ("0.35", "3", "0.4", "1.2", "1.35", "0.027935", "0.368297", "0.421179"),
    ("0.17", "6.5", "0", "0.8", "1", "0.031401", "0.282368", "0.345168"),
]

Vector = list[Decimal]


def solve(matrix: list[Vector], right: Vector) -> Vector:
    """Gauss-Jordan with pivots."""
    n = len(right)
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[best] = rows[best], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(n):
            if i != k:
                rows[i] = [a - rows[i][k] * b for a, b in zip(rows[i], rows[k], strict=True)]
    return [row[n] for row in rows]


class Exact:
    """Theorems 2.1 and 2.2 in 50 digits, written anew from docs/theory.md 1.3, 3.2 and 3.3."""

    def __init__(self, tau: Decimal, K: Decimal, fc: Decimal, h1: Decimal, h2: Decimal, guess: Vector) -> None:
        self.tau, self.K = tau, K
        self.inputs = [h1 + h2 + fc, h1 + h2 - fc, -h1 + h2 - fc]
        t, step = guess, Decimal(10) ** -25
        for _ in range(8):
            base = self.conditions(t)
            columns = [self.conditions([t[i] + (step if i == k else 0) for i in range(3)]) for k in range(3)]
            slopes = [[(columns[k][i] - base[i]) / step for k in range(3)] for i in range(3)]
            t = [a - b for a, b in zip(t, solve(slopes, base), strict=True)]
        self.durations = t
        self.states = self.path(t)

    def path(self, t: Vector) -> list[Vector]:
        """States at the begin and the end of the stages: v(t1) = 0, y(t1 + t2) = 0 and z(0) = 0 are built in."""
        v0 = self.K * self.inputs[0] * (1 - (t[0] / self.tau).exp())
        states = [[v0, Decimal(0), Decimal(0)]]
        for h, U in zip(t, self.inputs, strict=True):
            states.append(self.flow(states[-1], h, U))
        lift = -states[2][1]
        states = [[v0, lift, Decimal(0)]]
        for h, U in zip(t, self.inputs, strict=True):
            states.append(self.flow(states[-1], h, U))
        return states

    def flow(self, x: Vector, h: Decimal, U: Decimal) -> Vector:
        v, y, z = x
        e, target, tau = (-h / self.tau).exp(), self.K * U, self.tau
        glide = tau * (1 - e)
        return [
            target + (v - target) * e,
            y + target * h + (v - target) * glide,
            z + y * h + target * h * h / 2 + (v - target) * (tau * h - tau * glide),
        ]

    def conditions(self, t: Vector) -> Vector:
        """What odd symmetry leaves: x(T/2) = -x(0)."""
        states = self.path(t)
        return [a + b for a, b in zip(states[3], states[0], strict=True)]

    def jacobians(self) -> list[list[Vector]]:
        found = []
        for i, (h, U) in enumerate(zip(self.durations, self.inputs, strict=True)):
            end = self.states[i + 1]
            w = [(self.K * U - end[0]) / self.tau, end[0], end[1]]
            units = [[Decimal(int(a == k)) for a in range(3)] for k in range(3)]
            columns = [self.flow(unit, h, Decimal(0)) for unit in units]
            found.append([[columns[c][r] - w[r] * columns[c][i] / w[i] for c in range(3)] for r in range(3)])
        return found


def eigenvalues(m: list[Vector]) -> Vector:
    """Those of a matrix that has 0 among them, by falling magnitude."""
    half = (m[0][0] + m[1][1] + m[2][2]) / 2
    minors = sum((m[i][i] * m[j][j] - m[i][j] * m[j][i] for i, j in ((0, 1), (0, 2), (1, 2))), Decimal(0))
    root = (half * half - minors).sqrt()
    return sorted([half + root, half - root], key=abs, reverse=True)


def product(a: list[Vector], b: list[Vector]) -> list[Vector]:
    return [[sum((a[i][k] * b[k][j] for k in range(3)), Decimal(0)) for j in range(3)] for i in range(3)]


@pytest.mark.parametrize("row", TABLE)
def test_prediction_is_exact_to_1e_9(row: tuple[str, ...]) -> None:
    with localcontext() as context:
        context.prec = 50
        numbers = [Decimal(text) for text in row]
        exact = Exact(numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5:])
        j1, j2, j3 = exact.jacobians()
        whole, last = eigenvalues(product(j3, product(j2, j1))), eigenvalues(j3)
        assert max(map(abs, exact.conditions(exact.durations))) < Decimal(10) ** -40
        for duration, six_digits in zip(exact.durations, row[5:], strict=True):
            assert abs(duration - Decimal(six_digits)) <= Decimal("0.5e-6")
    tau, K, fc, h1, h2 = map(float, row[:5])
    found: Any = predict_cycle(tau, K, fc, fc, h1, h2).as_json()
    assert found["oscillates"] and found["reason"] is None and found["stable"]
    assert found["durations_s"] == pytest.approx([float(t) for t in exact.durations], abs=1e-9)
    assert found["y_switch_rad"] == pytest.approx([float(x[1]) for x in exact.states[:2]], abs=1e-9)
    assert found["period_s"] == pytest.approx(2.0 * float(sum(exact.durations)), abs=1e-9)
    assert found["amplitude_rad"] == pytest.approx(-float(exact.states[1][1]), abs=1e-9)
    assert [re for re, _ in found["eigenvalues"]] == pytest.approx([*map(float, whole), 0.0], abs=1e-9)
    assert [im for _, im in found["eigenvalues"]] == [0.0, 0.0, 0.0]
    assert found["largest_eigenvalue_J3"] == pytest.approx(abs(float(last[0])), abs=1e-9)


@pytest.mark.parametrize(
    ("fc", "fs", "h1", "h2", "words"),
    [
        (0.5, 0.5, 0.8, 0.5, r"h2 = 0\.5 V does not exceed the friction of 0\.5 V \(Property 3\.1\)"),
        (0.5, 0.5, 0.8, 0.0, "Property 3"),
        (0.5, 1.9, 0.8, 1.0, r"sticks: h1 \+ h2 = 1\.8 V does not exceed static friction, 1\.9 V"),
        (0.5, 1.8, 0.8, 1.0, "sticks"),
        (0.5, 0.5, 8000.0, 1.0, "no cycle can be computed"),
        (0.5, 0.5, 1e-5, 1.0, "no cycle can be computed"),
    ],
)
def test_where_there_is_no_simple_oscillation_it_says_why(
    fc: float, fs: float, h1: float, h2: float, words: str
) -> None:
    found: Any = predict_cycle(0.17, 6.5, fc, fs, h1, h2).as_json()
    assert not found["oscillates"] and "durations_s" not in found
    with pytest.raises(NoLimitCycle, match=words):
        raise NoLimitCycle(found["reason"])
    # a sine knows nothing of static friction
    assert (found["describing_function"] is None) == (h2 <= fc)


# ------------------------------------------------------------------ no additional switching (Theorem 2.1)


def made_up(*states: tuple[float, float, float]) -> LimitCycle:
    return LimitCycle((0.1, 0.2, 0.3), effective_inputs(0.5, 0.8, 1.0), np.array(states), 1.0, 1.0)


@pytest.mark.parametrize(
    ("cycle", "words"),
    [
        (made_up((0.2, -1, 0), (0, -1, -1), (1, 0, -1), (1, 1, 0)), "RA"),
        (made_up((-1, -1, 0), (0, -1, -1), (1, 0, -1), (-0.1, 1, 0)), "RA"),
        (made_up((-1, 0.3, 0), (0, -1, -1), (1, 0, -1), (1, -0.3, 0)), "RB"),
        (made_up((-1, -1, 0), (0, -1, 0.1), (1, 0, 0.1), (1, 1, 0)), "RC"),
    ],
)
def test_a_solution_of_the_equations_with_additional_switching_is_no_cycle(cycle: LimitCycle, words: str) -> None:
    """The switching conditions have such solutions as well; the theorem excludes them."""
    with pytest.raises(NoLimitCycle, match=f"additional switching of {words}"):
        theorem._check_no_additional_switching(cycle)


@settings(max_examples=examples(60), deadline=None)
@given(
    st.floats(0.05, 1.0), st.floats(0.5, 20.0), st.floats(0.0, 1.0), st.floats(0.02, 2.0), st.floats(0.05, 3.0)
)  # fmt: skip
def test_started_on_the_cycle_the_loop_switches_as_the_theorem_says_and_not_once_more(
    tau: float, K: float, fc: float, beyond: float, h1: float
) -> None:
    cycle = limit_cycle(tau, K, fc, h1, fc + beyond)
    # from the switching of RC itself; rounding decides which side of its plane a start lies on, so z is 0 and kept
    start = State(*cycle.states[0])._replace(z=0.0)
    run = ideal_relay(Motor(tau, K, coulomb(fc)), Relay(h1, fc + beyond), start, 2.2 * cycle.period_s, (-1.0, -1.0))
    halves = half_periods(run.events)
    assert len(halves) == 3 and all(half.is_simple for half in halves)
    for half in halves:
        assert half.durations_s == pytest.approx(cycle.durations_s, abs=1e-8 * cycle.period_s)


# ------------------------------------------------------------------ Properties 3.1 and 3.2, of the exact cycle


@settings(max_examples=examples(40), deadline=None)
@given(st.floats(0.05, 1.0), st.floats(0.5, 20.0), st.floats(0.05, 1.0), st.floats(0.0, 1.0), st.floats(0.05, 2.0))
def test_property_3_1_no_cycle_unless_h2_exceeds_the_friction(
    tau: float, K: float, fc: float, share: float, h1: float
) -> None:
    with pytest.raises(NoLimitCycle, match=r"Property 3\.1"):
        limit_cycle(tau, K, fc, h1, share * fc)
    # and in motion: whatever cycle begins dies away, at rest on the plane or held by friction
    motor = Motor(tau, K, coulomb(fc))
    size = K * tau * fc
    run = ideal_relay(motor, Relay(h1, 0.9 * share * fc), State(0.0, -size, -0.1 * size * tau), 400.0 * tau)
    tops = [abs(half.start.y) for half in half_periods(run.events)]
    assert run.end != "time" or len(tops) < 3 or tops[-1] < tops[0]


@settings(max_examples=examples(40), deadline=None)
@given(
    st.floats(0.05, 1.0), st.floats(0.5, 20.0), st.floats(0.0, 0.8), st.floats(0.1, 2.0), st.floats(0.1, 2.0),
    st.floats(1.05, 2.0),
)  # fmt: skip
def test_property_3_2_holds_of_the_exact_cycle_and_not_of_the_sine_alone(
    tau: float, K: float, fc: float, h1: float, beyond: float, more: float
) -> None:
    """Amplitude grows with h2 and falls with h1; frequency falls with h2 and grows with h1."""
    base = limit_cycle(tau, K, fc, h1, fc + beyond)
    h2_up = limit_cycle(tau, K, fc, h1, fc + more * beyond)
    h1_up = limit_cycle(tau, K, fc, more * h1, fc + beyond)
    assert h2_up.amplitude_rad > base.amplitude_rad > h1_up.amplitude_rad
    assert h2_up.period_s > base.period_s > h1_up.period_s
    sine = predict(tau, K, fc, h1, fc + beyond)
    assert 0.4 < base.period_s / sine.period_s < 2.5
