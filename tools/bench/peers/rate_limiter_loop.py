"""A loop on loop-rate-limiters, the usual package for this: for `wake_up.py`, as `our_loop.py`.

rate_limiter_loop.py PRIORITY

It has no grid: each tick counts from when the one before it was over. Lateness is against its own next tick, so that
the drift does not show there; ticks that a grid would have passed meanwhile count as skipped.
"""

from __future__ import annotations

import gc
import sys
from time import perf_counter

from loop_rate_limiters import RateLimiter

from rig.control.loop.real_time import RealTimeSettings, real_time


def main() -> int:
    """Answer each line until the input ends."""
    gc.disable()
    with real_time(RealTimeSettings(int(sys.argv[1]))) as done:
        for line in done.refused:
            print(f"rate_limiter_loop: {line}", file=sys.stderr)
        for line in sys.stdin:
            ticks, period_us = map(int, line.split())
            rate = RateLimiter(1e6 / period_us, warn=False)
            first_s = rate.next_tick
            late_s = []
            for _ in range(ticks):
                due_s = rate.next_tick
                rate.sleep()
                late_s.append(perf_counter() - due_s)
            behind_s = perf_counter() - (first_s + 1e-6 * period_us * (ticks - 1))
            print(int(behind_s / (1e-6 * period_us)), 1, *(f"{1e9 * late:.0f}" for late in late_s), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
