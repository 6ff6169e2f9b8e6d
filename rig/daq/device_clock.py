"""The device's clock seen from the host: 32-bit microseconds that wrap, run fast or slow, and start anywhere.

A ceramic resonator is half a per cent off, and all of it would go into tau (theory section 8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

_WRAP = 1 << 32
_HALF = 1 << 31
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
    """Line through the exchanges, each weighted by how far it can be off: what it took longer than the fastest.

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
    trips = sorted(trip for trip, _, _ in points)
    fastest, quarter = trips[0], trips[len(trips) // 4]
    resolution_s = quarter - fastest + 1e-6
    weights = [1.0 / (trip - fastest + resolution_s) ** 2 for trip, _, _ in points]
    slope, intercept = _weighted_line([p[1] for p in points], [p[2] for p in points], weights)
    return DeviceClock(host_s=first.sent_s, device_us=first.device_us + intercept, ratio=slope * 1e-6)


def _weighted_line(x: Sequence[float], y: Sequence[float], weights: Sequence[float]) -> tuple[float, float]:
    """Slope and intercept of the weighted least-squares line."""
    total = sum(weights)
    x_mean = sum(w * a for w, a in zip(weights, x, strict=True)) / total
    y_mean = sum(w * b for w, b in zip(weights, y, strict=True)) / total
    spread = sum(w * (a - x_mean) ** 2 for w, a in zip(weights, x, strict=True))
    if not spread > 0.0:
        raise ValueError("timed exchanges that take no time are too short")
    slope = sum(w * (a - x_mean) * (b - y_mean) for w, a, b in zip(weights, x, y, strict=True)) / spread
    return slope, y_mean - slope * x_mean
