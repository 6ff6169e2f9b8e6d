"""A motor that is 30 % off in everything stays inside the soft limits in the test that is designed for the wrong one.

On the real loop, with its guard, in virtual time.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from evidence import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from simulated_bench import LIMITS, PERIOD_S, simulated_bench

from rig.control.guard import velocity_noise_rad_s
from rig.control.law import Law, Rest
from rig.control.relay import DualChannelRelay
from rig.control.strokes import StrokeTest, StrokeTiming
from rig.core.signals import FLAG_GUARD_BRAKED, FLAG_GUARD_CLIPPED
from rig.design.belief import Belief
from rig.design.best_test import Kind, best_test
from rig.design.outlook import Task
from rig.design.planned_test import Design, Reading, RelayGains, Room
from rig.model.friction import Friction
from rig.model.motor import Motor

pytestmark = pytest.mark.long

OFF = 0.3
INSIDE = 0.95
SECONDS = 6.0
HORIZON_S = 0.33  # the guard's reaction and coasting
SPEED_RAD_S = 4.9
RAD_PER_COUNT = 4.2 / 1024


@st.composite
def motors(draw: st.DrawFn) -> tuple[Motor, tuple[float, float, float, float]]:
    """A true motor and the wrong one that is believed: tau, K and the friction of both directions up to 30 % off."""

    def off() -> float:
        return draw(st.floats(1.0 / (1.0 + OFF), 1.0 + OFF))

    tau = math.exp(draw(st.floats(math.log(0.08), math.log(0.5))))
    speed = draw(st.floats(0.6, 6.0))  # at 0.5 V beyond friction, rad/s
    plus, minus = draw(st.floats(0.1, 0.5)), draw(st.floats(0.1, 0.5))
    minus = min(max(minus, 0.7 * plus), 1.4 * plus)
    true = Motor(tau, speed / 0.5, Friction(plus, minus, 1.1 * plus, 1.1 * minus))
    believed_plus, believed_minus = plus * off(), minus * off()
    mean, asym = 0.5 * (believed_plus + believed_minus), 0.5 * (believed_minus - believed_plus)
    return true, (tau * off(), speed / 0.5 * off(), mean, asym)


def planned(true: Motor, believed: tuple[float, float, float, float], kind: Kind) -> Design | None:
    """The test designed for the wrong motor; its breakaway check has measured the true one's static friction."""
    f = true.friction
    low, high = LIMITS.soft_rad
    scatter_rad_s = 4.0 * velocity_noise_rad_s(RAD_PER_COUNT, PERIOD_S)
    stop_rad = LIMITS.hard_rad[1] - scatter_rad_s * HORIZON_S
    static_V = max(f.static_plus_V, f.static_minus_V)
    room = Room(
        INSIDE * low, INSIDE * high, LIMITS.max_u_V, SPEED_RAD_S - scatter_rad_s, static_V, (-stop_rad, stop_rad),
        HORIZON_S,
    )  # fmt: skip
    reading = Reading(PERIOD_S, 0.003, RAD_PER_COUNT, 0.0012)
    return best_test(Task(Belief.within(believed, 100.0 * OFF), np.zeros((5, 5)), room, reading, 1.0), (kind,))


@pytest.mark.hypothesis
@pytest.mark.parametrize("kind", ["strokes", "relay"])
@settings(
    max_examples=examples(15, at_least=2),
    deadline=None,
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow],
)
@given(pair=motors(), seed=st.integers(0, 1000), start=st.floats(-0.8, 0.8))
def test_a_wrong_model_leaves_no_limit(
    kind: Kind, pair: tuple[Motor, tuple[float, float, float, float]], seed: int, start: float
) -> None:
    """Strokes may begin anywhere in the room, as where another test gives way to them."""
    true, believed = pair
    design = planned(true, believed, kind)
    if design is None:
        return  # nothing is driven
    start_rad = start * LIMITS.soft_rad[1] if kind == "strokes" else 0.0
    bench = simulated_bench(seed=seed, motor=true, offset_rad=0.0, start_rad=start_rad)
    bench.guard.sign_proven = True
    bench.guard.static_V = max(true.friction.static_plus_V, true.friction.static_minus_V)
    if isinstance(design.test, RelayGains):
        law: Law = _For(DualChannelRelay(design.test.h1_V, design.test.h2_V, 10.0), SECONDS)
    else:
        timing = StrokeTiming(SECONDS, 2.0 * design.test.longest_stroke_s)
        law = StrokeTest(design.test.strokes, timing, 0.02)
    with bench.loop.armed(LIMITS):
        bench.loop.run(Rest(0.1), "rest")
        bench.loop.run(law, "test")
    low, high = LIMITS.soft_rad
    assert all(low <= row["y_rad"] <= high for row in bench.record.rows)
    assert not any(row["flags"] & (FLAG_GUARD_BRAKED | FLAG_GUARD_CLIPPED) for row in bench.record.rows)


class _For:
    """A law for a time."""

    z_rad_s = math.nan
    yd_rad = math.nan

    def __init__(self, relay: DualChannelRelay, seconds: float) -> None:
        self._relay, self._rest = relay, Rest(seconds)
        self.finished = False

    def step(self, sample):  # type: ignore[no-untyped-def]
        self._rest.step(sample)
        self.finished = self._rest.finished
        return self._relay.step(sample)
