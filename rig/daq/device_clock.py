"""The device's clock seen from the host: 32-bit microseconds that wrap, run fast or slow, and start anywhere.

A ceramic resonator is half a per cent off, and all of it would go into tau (theory section 8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import linear_regression
from typing import NamedTuple

_WRAP = 1 << 32
_HALF = 1 << 31
_BINS = 10  # stretches of the record that each contribute their fastest exchanges
_PLAUSIBLE = 0.1  # relative rate error beyond which it is a restarted device, not a clock
_SLACK_S = 0.002  # resolution of both clocks, with room


class TimedExchange(NamedTuple):
    """A request that asked for the device's time: sent and received in host s, device time in us (32 bits)."""

    sent_s: float
    received_s: float
    device_us: int


@dataclass(frozen=True)
class DeviceClock:
    """A straight line from device time to host time.

    host_s, device_us  one instant, in both clocks
    ratio              device seconds for one host second
    """

    host_s: float
    device_us: float
    ratio: float

    def to_host_s(self, device_us: int, near_s: float) -> float:
        """Host time of a 32-bit device time that lies within 35 minutes of the host time ``near_s``."""
        per_us = 1e-6 / self.ratio
        expected_us = self.device_us + (near_s - self.host_s) / per_us
        off_us = (device_us - expected_us + _HALF) % _WRAP - _HALF
        return near_s + off_us * per_us


def fit_device_clock(exchanges: Sequence[TimedExchange], request_share: float = 0.5) -> DeviceClock:
    """Line through the fastest of the exchanges, which were held up least.

    exchanges      in order of time, each sent after the one before was received
    request_share  share of a round trip that passes before the device reads its clock, 0 to 1
    Raises ValueError with fewer than four exchanges, or if the device's time jumped (it restarted).
    """
    if len(exchanges) < 4:
        raise ValueError(f"{len(exchanges)} timed exchanges are too few")
    first = exchanges[0]
    points: list[tuple[float, float, float]] = []  # round trip s, host s, device us, both from the first
    device_us = 0
    last = first
    for exchange in exchanges:
        step_us = (exchange.device_us - last.device_us) % _WRAP
        least_s = (exchange.sent_s - last.received_s) * (1.0 - _PLAUSIBLE) - _SLACK_S
        most_s = (exchange.received_s - last.sent_s) * (1.0 + _PLAUSIBLE) + _SLACK_S
        if exchange is not first and not least_s <= step_us * 1e-6 <= most_s:
            raise ValueError(f"the device's clock jumped from {last.device_us} to {exchange.device_us} us")
        device_us += step_us
        trip_s = exchange.received_s - exchange.sent_s
        points.append((trip_s, exchange.sent_s - first.sent_s + request_share * trip_s, float(device_us)))
        last = exchange
    span_s = points[-1][1]
    bins: dict[int, list[tuple[float, float, float]]] = {}
    for point in points:
        bins.setdefault(int(_BINS * point[1] / span_s) if span_s > 0.0 else 0, []).append(point)
    best = [point for group in bins.values() for point in sorted(group)[: -(-len(group) // 4)]]
    if len(best) < 2:
        raise ValueError(f"timed exchanges span {span_s:g} s: too short")
    slope, intercept = linear_regression([p[1] for p in best], [p[2] for p in best])
    return DeviceClock(host_s=first.sent_s, device_us=first.device_us + intercept, ratio=slope * 1e-6)
