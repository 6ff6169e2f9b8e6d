"""The relay with hysteresis, and one run of it from rest."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated_bench import DEMO, LIMITS, simulated_bench

from rig.control.hysteretic import HystereticRun
from rig.control.relay import HystereticRelay
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.friction import coulomb
from rig.model.motor import Motor


def sample(y_rad: float, t_s: float = 0.0) -> Sample:
    return Sample(t_s, y_rad, 512)


def test_it_switches_beyond_the_band_alone_and_keeps_its_state_within() -> None:
    relay = HystereticRelay(0.8, 0.3)
    positions = [0.0, 0.29, 0.3, 0.301, 0.3, -0.29, -0.3, -0.301, 0.0, 0.31]
    drives = [0.8, 0.8, 0.8, -0.8, -0.8, -0.8, -0.8, 0.8, 0.8, -0.8]
    assert [relay.step(sample(y)) for y in positions] == drives


@given(st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=60), st.floats(0.01, 1.0), st.sampled_from([-0.7, 1.2]))
def test_each_change_of_drive_has_its_reason_and_points_inward(positions: list[float], eps: float, d: float) -> None:
    relay = HystereticRelay(d, eps)
    last = d
    for y in positions:
        u = relay.step(sample(y))
        assert abs(u) == abs(d)
        if abs(y) > eps:
            assert u * y < 0.0
        else:
            assert u == last
        last = u


def test_the_mirrored_relay_is_the_mirror_image() -> None:
    up, down = HystereticRelay(0.8, 0.3), HystereticRelay(-0.8, 0.3)
    for y in (0.0, 0.2, 0.4, 0.1, -0.5, 0.0):
        assert up.step(sample(y)) == -down.step(sample(-y))


@pytest.mark.parametrize(("d", "eps"), [(0.0, 0.3), (math.nan, 0.3), (1.0, 0.0), (1.0, -0.1)])
def test_senseless_relays_are_refused(d: float, eps: float) -> None:
    with pytest.raises(ValueError, match="hysteretic"):
        HystereticRelay(d, eps)


def run_on_bench(
    d_V: float, eps_rad: float, switchings: int = 5, motor: Motor = DEMO.motor, **changes: Any
) -> tuple[HystereticRun, list[dict[str, Any]]]:
    bench = simulated_bench(motor=motor, noise_rad=0.0, offset_rad=0.0, **changes)
    bench.guard.sign_proven = True
    law = HystereticRun(HystereticRelay(d_V, eps_rad), rest_s=0.3, switchings=switchings, timeout_s=5.0)
    with bench.loop.armed(LIMITS):
        bench.loop.run(law, "hysteretic-1")
    return law, bench.record.rows


@pytest.mark.parametrize("d_V", [0.8, -0.8])
def test_a_run_rests_drives_switches_beyond_the_band_and_ends_at_0_V(d_V: float) -> None:
    law, rows = run_on_bench(d_V, 0.5)
    assert all(row["asked_V"] == 0.0 and abs(row["y_rad"]) < 0.003 for row in rows if row["t_s"] < 0.295)
    driven = [row for row in rows if row["t_s"] > 0.305]
    assert driven[0]["asked_V"] == pytest.approx(d_V, abs=0.02)  # in steps of the PWM
    first = next(row for row in driven if row["asked_V"] * d_V < 0.0)
    assert first["t_s"] == law.first_switching_s
    assert abs(first["y_rad"]) > 0.5 >= max(abs(row["y_rad"]) for row in driven if row["t_s"] < first["t_s"])
    assert law.seen == 5
    assert rows[-1]["asked_V"] == 0.0
    # the bound that `rig check` uses: two periods and v tau (1 - ln 2) at the speed that it has there
    speed = 6.5 * (0.8 - 0.46)
    assert max(abs(row["y_rad"]) for row in rows) < 0.5 + speed * (0.02 + 0.17 * (1.0 - math.log(2.0)))


def test_a_relay_that_does_not_switch_is_a_fault_with_its_numbers() -> None:
    with pytest.raises(Fault) as caught:
        run_on_bench(0.45, 0.5)  # below static friction
    assert caught.value.code == "NO_SWITCHING"
    assert "+0.45 V for 5 s" in caught.value.detail


def test_after_the_first_switching_a_time_out_only_ends_the_run() -> None:
    sticky = Motor(0.17, 6.5, coulomb(0.2, 0.3), bias_V=0.2)  # 0.35 V moves it upwards and not back
    law, rows = run_on_bench(0.35, 0.2, motor=sticky)
    assert law.finished
    assert law.seen == 1
    assert rows[-1]["asked_V"] == 0.0
