"""The device's clock seen from the host: 32-bit microseconds that wrap, run fast or slow, and start anywhere.

A ceramic resonator is half a per cent off, and all of it would go into tau (docs/theory.md 7.8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

_WRAP = 1 << 32
_HALF = 1 << 31
_PLAUSIBLE = 0.1  # relative rate error beyond which it is a restarted device, not a clock
_SLACK_S = 0.002  # resolution of both clocks, with room
_AT_EDGE = 20  # one exchange in so many, the quickest requests, has the line
_RESOLUTION_US = 2.0  # of the device's clock: what is off by less is as quick


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
    """Line through the exchanges whose request was the quickest; how long a reply takes does not matter.

    A request leaves at once and waits for a frame of USB at most; a reply waits for an adapter's timer, the system's
    buffers and this process. No request is quicker than the wire: the device's times, over those of sending, have a
    straight lower edge.

    exchanges      in order of time, each sent after the one before was received
    request_share  share of the fastest round trip that passes before the device reads its clock, 0 to 1
    Raises ValueError with fewer than four exchanges, or if the device's time jumped (it restarted).
    """
    if len(exchanges) < 4:
        raise ValueError(f"{len(exchanges)} timed exchanges are too few")
    first = exchanges[0]
    sent_s: list[float] = []  # both from the first
    device_us: list[float] = []
    last = first
    total_us = 0
    for exchange in exchanges:
        step_us = (exchange.device_us - last.device_us) % _WRAP
        least_s = (exchange.sent_s - last.received_s) * (1.0 - _PLAUSIBLE) - _SLACK_S
        most_s = (exchange.received_s - last.sent_s) * (1.0 + _PLAUSIBLE) + _SLACK_S
        if exchange is not first and not least_s <= step_us * 1e-6 <= most_s:
            raise ValueError(f"the device's clock jumped from {last.device_us} to {exchange.device_us} us")
        total_us += step_us
        sent_s.append(exchange.sent_s - first.sent_s)
        device_us.append(float(total_us))
        last = exchange
    slope, intercept = _line(sent_s, device_us)
    fastest_s = min(exchange.received_s - exchange.sent_s for exchange in exchanges)
    return DeviceClock(
        host_s=first.sent_s + request_share * fastest_s,
        device_us=first.device_us + intercept,
        ratio=slope * 1e-6,
    )


def _line(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Slope and intercept of the lower edge of points, by least squares over those that lie at it."""
    (x0, y0), (x1, y1) = _lower_edge(x, y)
    late = [b - y0 - (a - x0) * (y1 - y0) / (x1 - x0) for a, b in zip(x, y, strict=True)]
    reach = sorted(late)[len(late) // _AT_EDGE] + _RESOLUTION_US
    at_edge = [(a, b) for a, b, above in zip(x, y, late, strict=True) if above <= reach]
    x_mean = sum(a for a, _ in at_edge) / len(at_edge)
    y_mean = sum(b for _, b in at_edge) / len(at_edge)
    slope = sum((a - x_mean) * (b - y_mean) for a, b in at_edge) / sum((a - x_mean) ** 2 for a, _ in at_edge)
    return slope, y_mean - slope * x_mean


def _lower_edge(x: Sequence[float], y: Sequence[float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """The two points that a line touches which no point is below, and to which they are nearest on the average.

    x must not fall. Raises ValueError where all are one instant.
    """
    hull: list[tuple[float, float]] = []
    for c in zip(x, y, strict=True):
        while hull and hull[-1][0] == c[0] and hull[-1][1] >= c[1]:
            hull.pop()
        if hull and hull[-1][0] == c[0]:
            continue
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-2:]
            if (bx - ax) * (c[1] - ay) > (by - ay) * (c[0] - ax):
                break
            hull.pop()
        hull.append(c)
    mean = sum(x) / len(x)
    for a, b in pairwise(hull):
        if a[0] <= mean <= b[0]:
            return a, b
    raise ValueError("timed exchanges that take no time are too short")
