"""A device clock that runs off and wraps, recovered from exchanges that are sometimes held up."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.backends.serial.device_clock import DeviceClock, TimedExchange, fit_device_clock

WRAP = 2**32


class TrueClock:
    def __init__(self, ratio: float, start_us: float) -> None:
        self.ratio, self.start_us = ratio, start_us

    def device_us(self, host_s: float) -> int:
        return int(self.start_us + host_s * 1e6 * self.ratio) % WRAP

    def exchanges(
        self,
        duration_s: float = 1.0,
        gap_s: float = 0.004,
        jitter_s: float = 0.0,
        held_up: float = 0.0,
        begin_s: float = 500.0,
        seed: int = 1,
    ) -> list[TimedExchange]:
        """Round trips of 1 ms plus jitter, half each way; some held up for up to 20 ms on one leg."""
        rng = random.Random(seed)
        now, out = begin_s, []
        while now < begin_s + duration_s:
            there, back = (0.0005 + rng.expovariate(1.0 / jitter_s) if jitter_s else 0.0005 for _ in range(2))
            if rng.random() < held_up:
                back += rng.uniform(0.0, 0.02)
            out.append(TimedExchange(now, now + there + back, self.device_us(now + there)))
            now += there + back + gap_s
        return out


@settings(max_examples=50)
@given(ppm=st.floats(-20000, 20000), start_us=st.integers(0, WRAP - 1))
def test_exact_exchanges_give_the_exact_clock(ppm: float, start_us: int) -> None:
    true = TrueClock(1.0 + ppm * 1e-6, start_us)
    clock = fit_device_clock(true.exchanges())
    assert clock.ratio == pytest.approx(true.ratio, abs=2e-6)
    for host_s in (500.0, 501.0, 560.0):
        assert clock.to_host_s(true.device_us(host_s), host_s + 0.003) == pytest.approx(host_s, abs=2e-4)


@pytest.mark.parametrize("seed", range(10))
def test_held_up_exchanges_do_not_bend_the_line(seed: int) -> None:
    true = TrueClock(1.005, 17)
    clock = fit_device_clock(true.exchanges(jitter_s=50e-6, held_up=0.3, seed=seed))
    assert clock.ratio == pytest.approx(1.005, abs=100e-6)


def test_a_wrap_during_the_measurement_and_many_during_the_run() -> None:
    true = TrueClock(0.995, WRAP - 500.4e6 * 0.995)  # wraps 0.4 s into the measurement
    clock = fit_device_clock(true.exchanges())
    assert clock.ratio == pytest.approx(0.995, abs=2e-6)
    for minutes in (1, 71, 72, 143, 300):
        host_s = 500.0 + 60.0 * minutes
        assert clock.to_host_s(true.device_us(host_s), host_s) == pytest.approx(host_s, abs=2e-6 * 60 * minutes + 1e-4)


@pytest.mark.parametrize("away_s", [-2000.0, -1.0, 0.0, 1.0, 2000.0])
def test_times_up_to_35_minutes_from_now_are_told_apart(away_s: float) -> None:
    clock = DeviceClock(host_s=10.0, device_us=4e9, ratio=1.0)
    now_s = 5000.0
    device_us = round(4e9 + (now_s + away_s - 10.0) * 1e6) % WRAP
    assert clock.to_host_s(device_us, now_s) == pytest.approx(now_s + away_s, abs=1e-5)


def test_asymmetric_legs_are_accounted_for() -> None:
    """The device reads its clock when the short request is in, before the long reply goes out."""
    exchanges = [TimedExchange(k * 0.01, k * 0.01 + 0.004, round(k * 1e4 + 1e3)) for k in range(100)]
    assert fit_device_clock(exchanges, 0.25).to_host_s(501000, 0.5) == pytest.approx(0.501, abs=1e-6)
    assert fit_device_clock(exchanges, 0.5).to_host_s(501000, 0.5) == pytest.approx(0.502, abs=1e-6)


def test_a_restart_is_no_clock() -> None:
    true, restarted = TrueClock(1.0, 3e6), TrueClock(1.0, -500.5e6)
    exchanges = true.exchanges(duration_s=0.5) + restarted.exchanges(duration_s=0.5, begin_s=500.6)
    with pytest.raises(ValueError, match="jumped"):
        fit_device_clock(exchanges)


def test_too_few_or_too_short() -> None:
    with pytest.raises(ValueError, match="too few"):
        fit_device_clock(TrueClock(1.0, 0).exchanges()[:3])
    with pytest.raises(ValueError, match="too short"):
        fit_device_clock([TimedExchange(1.0, 1.0, 5)] * 10)
