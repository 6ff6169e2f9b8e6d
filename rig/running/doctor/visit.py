"""What `rig doctor` looks at: the machine, and with a config the link and the device behind it.

Of both it times ticks: wake-ups, exchanges, and the margin that they leave. Nothing is armed and nothing moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.backends.clock import MonotonicClock
from rig.backends.driver import Clock
from rig.backends.emulated.words import in_real_time, in_virtual_time
from rig.backends.link_budget import LINK_SHARE
from rig.backends.registry import backend_of, connect
from rig.config.schema import Experiment
from rig.control.loop.real_time import real_time
from rig.core.faults import Fault, since_the_last_run
from rig.core.signals import percent
from rig.running.doctor import machine
from rig.running.doctor.finding import Finding, bad, good, note, poor
from rig.running.preflight.room_to_stop import watchdog_words
from rig.running.session import real_time_of

_SLOWER, _MACHINES_S = 1.2, 0.5e-3  # a round trip may exceed its sum by this factor plus this time
_LATE_SHARE = 0.1  # of the period: wake-ups later than that show in the recording


@dataclass(frozen=True)
class Ticks:
    """Ticks on an absolute grid, one entry per tick: how late each woke, and how long its exchange took, s.

    skipped  ticks of the grid that passed before the previous tick was over
    """

    period_s: float
    late_s: tuple[float, ...]
    exchange_s: tuple[float, ...]
    skipped: int

    @property
    def longest_s(self) -> float:
        """The longest from due to done, s."""
        return max(late + exchange for late, exchange in zip(self.late_s, self.exchange_s, strict=True))


def run_ticks(clock: Clock, period_s: float, number: int, exchange: Callable[[], object] | None = None) -> Ticks:
    """Run ``number`` >= 1 ticks of a loop that does nothing but ``exchange``."""
    late_s: list[float] = []
    exchange_s: list[float] = []
    skipped = tick = 0
    t0_s = clock.now_s() + period_s
    for _ in range(number):
        due_s = t0_s + tick * period_s
        woke_s = clock.sleep_until(due_s)
        if exchange is not None:
            exchange()
        done_s = clock.now_s()
        late_s.append(woke_s - due_s)
        exchange_s.append(done_s - woke_s)
        passed = max(int((done_s - due_s) / period_s), 0)
        skipped += passed
        tick += 1 + passed
    return Ticks(period_s, tuple(late_s), tuple(exchange_s), skipped)


def wake_ups(ticks: Ticks) -> Finding:
    """How late a loop of this period wakes here."""
    words = f"{_quantiles(ticks.late_s)} late, {len(ticks.late_s)} of {ticks.period_s * 1e3:g} ms"
    p99_s = float(np.quantile(ticks.late_s, 0.99))
    if ticks.skipped or p99_s > _LATE_SHARE * ticks.period_s:
        skipped = f"; {ticks.skipped} ticks skipped" if ticks.skipped else ""
        return Finding(
            "wake-up",
            "bad" if ticks.skipped else "poor",
            words + skipped,
            "allow real-time scheduling, close programs that load the machine, or use a longer period_s",
        )
    return good("wake-up", words)


def round_trip(ticks: Ticks, total_s: float, written: str) -> Finding:
    """The measured readings beside the link budget of one: its total ``total_s``, and ``written`` in words."""
    words = f"{_quantiles(ticks.exchange_s)}, {len(ticks.exchange_s)} exchanges"
    if not written:
        return note("round trip", f"{words}; this driver's link has no budget to compare with")
    words += f"; by the config one takes: {written}"
    if float(np.median(ticks.exchange_s)) > _SLOWER * total_s + _MACHINES_S:
        return poor(
            "round trip",
            words,
            "slower than the config says: check the USB chip's latency timer, hubs, and the device's turnaround",
        )
    return good("round trip", words)


def verdict(ticks: Ticks, unmeasured_s: float = 0.0) -> Finding:
    """Whether machine and link together hold the period.

    unmeasured_s  what a tick that drives takes more, by the link budget: nothing is driven here
    """
    worst_s, period_ms = ticks.longest_s + unmeasured_s, ticks.period_s * 1e3
    margin = 1.0 - worst_s / ticks.period_s
    words = f"the longest of {len(ticks.late_s)} ticks took {ticks.longest_s * 1e3:.2f} ms of {period_ms:g} ms"
    if unmeasured_s > 0.0:
        words += f", and by the config a tick that drives takes {unmeasured_s * 1e3:.2f} ms more"
    if worst_s <= LINK_SHARE * ticks.period_s and not ticks.skipped:
        return good("period", f"held: {words}, margin {percent(margin)}")
    cure = f"period_s: {_rounded_up(worst_s / LINK_SHARE):g} or longer leaves room; or follow the hints above"
    if worst_s <= ticks.period_s and not ticks.skipped:
        return poor("period", f"held, but tight: {words}, margin {percent(margin)}", cure)
    return bad("period", f"NOT held: {words}, {ticks.skipped} skipped", cure)


def _rounded_up(value: float) -> float:
    """To two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(round(value / unit, 6)) * unit


def _quantiles(values_s: Sequence[float]) -> str:
    """Median, p99 and largest, in us below a ms and in ms above."""
    p50, p99, largest = (float(q) for q in np.quantile(values_s, [0.5, 0.99, 1.0], method="inverted_cdf"))
    unit, scale = ("us", 1e6) if largest < 1e-3 else ("ms", 1e3)
    digits = 0 if unit == "us" else 2
    written = " / ".join(f"{q * scale:.{digits}f}" for q in (p50, p99, largest))
    return f"{written} {unit} (median / p99 / largest)"


SECONDS = 3.0  # of ticks
_PERIOD_S, _SPIN_S = 0.01, 200e-6  # without a config


def without_config(run_folder: Path, seconds: float = SECONDS) -> Iterator[Finding]:
    """Findings about the machine; the loop's ticks are timed for ``seconds``, s."""
    yield from machine.examine(run_folder)
    with real_time():
        ticks = run_ticks(MonotonicClock(_SPIN_S), _PERIOD_S, _number(seconds, _PERIOD_S))
    yield wake_ups(ticks)


def with_config(experiment: Experiment, run_folder: Path, seconds: float = SECONDS) -> Iterator[Finding]:
    """Findings about the machine, and about the link and the device of ``experiment``.

    The device is opened and read at the experiment's period for ``seconds``, s. It is never armed. A device that does
    not answer is a finding.
    """
    d = experiment.device
    yield from machine.examine(run_folder, ports=False)
    port_name = experiment.daq.port or ""
    backend = backend_of(d)
    adapter = backend.adapter_behind(d)
    if port_name.startswith("/"):
        port = machine.serial_port(Path(port_name))
        yield port
        if port.state == "bad":
            return
    if words := watchdog_words(experiment):
        topic, _, told = words.partition(": ")
        yield note(topic, told)
    try:
        with connect(d) as bench:
            yield good("device", bench.driver.backend)
            for remark in bench.info.remarks:
                yield note("device", remark)
            for code in bench.info.acknowledged:
                yield note("device", since_the_last_run(code))
            for topic, told in getattr(bench.driver, "link_words", {}).items():
                yield note(topic, told)
            if adapter is not None:  # only now: opening the port asks an FTDI to wait for 1 ms only
                yield machine.usb_adapter(port_name, adapter)
            if not isinstance(bench.clock, MonotonicClock):
                real = "" if not in_virtual_time(port_name) else f"daq.port: {in_real_time(port_name)} has one to time"
                yield note("period", "this bench runs in virtual time: it holds every period", real)
                return
            with real_time(real_time_of(experiment)):
                number = _number(seconds, experiment.period_s)
                ticks = run_ticks(bench.clock, experiment.period_s, number, bench.driver.read)
            waits_s: float = getattr(bench.driver, "waits_s", 0.0)
    except Fault as fault:
        detail = f" ({fault.detail})" if fault.detail else ""
        yield bad("device", f"{fault.code}: {fault.cause}{detail}", fault.cure)
        return
    yield wake_ups(ticks)
    reading = backend.reading_budget(d)
    drives_s = backend.budget(d).total_s - reading.total_s + waits_s  # a second exchange, or none where nothing waits
    if waits_s:
        reading = reading._replace(terms=(*reading.terms, ("return delay", waits_s)))
    yield round_trip(ticks, reading.total_s, reading.written if reading.terms else "")
    yield verdict(ticks, drives_s)


def _number(seconds: float, period_s: float) -> int:
    return max(round(seconds / period_s), 20)
