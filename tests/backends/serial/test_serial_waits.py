"""How long a serial driver awaits readings is what preflight counts into the room to stop."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from late_bus import LateBus, longest_reaction_s

from rig.backends.backend import Line, LineBackend
from rig.backends.driver import Clock, Transport
from rig.backends.registry import unopened
from rig.backends.serial.driver import SerialDriver
from rig.config import load
from rig.config.schema import DeviceSetup
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.running.preflight.room_to_stop import known_reaction_s, reaction_periods
from rig.testing.line import lines_opened_by

CONFIG = Path(__file__).resolve().parents[3] / "config" / "demo.yaml"
SEEDS = 40
QUICK_S = 0.004  # of a reading that nobody disturbs
ROUNDING_S = 2e-9  # of the clock in virtual time


class LateLine:
    """A line of a device in virtual time, some of whose answers come late."""

    late: LateBus | None = None
    stands_s = 0.0  # that the host stands still behind the next request

    def __init__(self, line: Transport, clock: Clock) -> None:
        self._line, self._coming = line, deque[tuple[float, bytes]]()
        self.now_s, self.sleep_until, self.close = line.now_s, clock.sleep_until, line.close

    def write(self, data: bytes) -> None:
        if self.late is not None:
            self.late("request", data, self.now_s())
        self._line.write(data)
        stands_s, self.stands_s = self.stands_s, 0.0
        self.sleep_until(self.now_s() + stands_s)

    def read(self, timeout_s: float) -> bytes:
        until_s = self.now_s() + timeout_s
        while not (self._coming and self._coming[0][0] <= self.now_s()):
            next_s = min(until_s, self._coming[0][0]) if self._coming else until_s
            if data := self._line.read(max(next_s - self.now_s(), 0.0)):
                arriving = [(0.0, data)] if self.late is None else self.late("reply", data, self.now_s())
                self._coming.extend((self.now_s() + late_s, one) for late_s, one in arriving)
            elif self.now_s() >= until_s:
                return b""
        return self._coming.popleft()[1]


class LateReadings:
    """The driver; its readings alone have answers, so they alone are late."""

    def __init__(self, driver: SerialDriver, late: LateBus) -> None:
        self._driver, self._late = driver, late

    def read(self) -> Sample:
        self._late.is_late = True
        return self._driver.read()

    def write(self, u_V: float) -> None:
        self._late.is_late = False
        self._driver.write(u_V)

    def safe_stop(self) -> bool:
        return self._driver.safe_stop()


@contextmanager
def opened(
    timeout_s: float, watchdog_s: float, period_s: float = 0.01
) -> Iterator[tuple[DeviceSetup, SerialDriver, LateLine]]:
    """The emulated board of the demo behind a line that may be late, and its driver."""
    e = load(CONFIG)
    daq = e.daq.model_copy(update={"timeout_s": timeout_s, "watchdog_s": watchdog_s})
    d = e.model_copy(update={"period_s": period_s, "daq": daq}).device
    lines = []

    @contextmanager
    def behind_late(backend: LineBackend, setup: DeviceSetup) -> Iterator[Line]:
        with backend.line(setup) as line:
            lines.append(LateLine(line.transport, line.clock))
            yield line._replace(transport=lines[0])

    with lines_opened_by(behind_late), unopened(d) as bench:
        driver = bench.driver
        assert isinstance(driver, SerialDriver)
        driver.open()
        yield d, driver, lines[0]


@pytest.mark.parametrize(("timeout_s", "watchdog_s", "period_s"), [
    (0.01, 0.04, 0.01), (0.03, 0.1, 0.01), (0.06, 0.1, 0.02), (0.03, 0.2, 0.02),
])  # fmt: skip
def test_a_loop_reacts_within_the_time_that_the_room_to_stop_counts(
    timeout_s: float, watchdog_s: float, period_s: float
) -> None:
    """Two readings in a row, each as late as the watchdog let it, took twice as long as was counted."""
    longest_s = 0.0
    with opened(timeout_s, watchdog_s, period_s) as (d, driver, line):
        for seed in range(SEEDS):
            driver.arm(d.arming)
            line.late = late = LateBus(lambda: driver._waits.left_s(line.now_s()), QUICK_S, timeout_s, seed, there=0.0)
            reaction_s = longest_reaction_s(LateReadings(driver, late), line, late, period_s, reaction_periods(d))
            longest_s = max(longest_s, reaction_s)
            line.late = None
            driver.safe_stop()
            line.sleep_until(line.now_s() + 0.5)
    assert watchdog_s < longest_s <= known_reaction_s(d) + ROUNDING_S


@pytest.mark.parametrize(("stands_s", "ends"), [
    ([0.09], False), ([0.05, 0.0, 0.05, 0.0], False), ([0.08, 0.0, 0.08, 0.0], True), ([0.055] * 4, True),
])  # fmt: skip
@pytest.mark.parametrize("between", [False, True])
def test_a_host_that_stands_still_again_while_a_loop_reacts_ends_the_run(
    stands_s: list[float], ends: bool, between: bool
) -> None:
    """Where its reading had come meanwhile that counted for nothing: it drove on for three times as long as counted.

    Nor did anything count a host that stood still between exchanges.
    """
    with opened(0.03, 0.1) as (d, driver, line):
        driver.arm(d.arming)
        fault = None
        try:
            for host_s in [0.0, *stands_s, 0.0]:
                line.stands_s, begins_s = 0.0 if between else host_s, line.now_s()
                driver.read()
                driver.write(0.1)
                line.sleep_until(begins_s + d.period_s + (host_s if between else 0.0))
        except Fault as caught:
            fault = caught
    if not ends:
        assert fault is None
    else:
        assert fault is not None and fault.code == ("LATE" if between else "LINK_TIMEOUT")
        assert "all that `rig check` counts" in fault.detail


@pytest.mark.parametrize("late", ["ahead of a drive", "while a drive is sent"])
def test_no_drive_goes_out_and_nothing_is_asked_once_ticks_came_too_late_together(
    late: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive went out behind each stall, and one that left late let its watchdog act later than rig thought."""
    with opened(0.03, 0.1) as (d, driver, line):
        driver.arm(d.arming)
        driver.read()
        if late == "ahead of a drive":
            line.sleep_until(line.now_s() + 0.08)
            driver.write(0.1)
            driver.read()
        else:
            write = line._line.write
            with monkeypatch.context() as patch:
                patch.setattr(line._line, "write", lambda data: (line.sleep_until(line.now_s() + 0.08), write(data)))
                driver.write(0.1)
        line.sleep_until(line.now_s() + 0.08)
        asked = driver._exchange.seq
        with pytest.raises(Fault, match="LATE"):
            driver.write(0.1) if late == "ahead of a drive" else driver.read()
        assert driver._exchange.seq == asked


@pytest.mark.parametrize(("stands_s", "is_sent"), [(0.125, True), (0.14, False)])
def test_a_drive_behind_a_stall_that_a_boards_watchdog_has_ended_is_not_sent_and_has_its_name(
    stands_s: float, is_sent: bool
) -> None:
    """Within a time-out of the watchdog's time a late frame may have fed it: the board says what is the case."""
    with opened(0.03, 0.1) as (d, driver, line):
        driver.arm(d.arming)
        driver.read()
        driver.safe_stop()
        line.sleep_until(line.now_s() + 0.5)
        driver.arm(d.arming)
        driver.write(0.1)  # a pause is no stall
        driver.read()
        line.sleep_until(line.now_s() + stands_s)
        asked = driver._exchange.seq
        if is_sent:
            driver.write(0.1)
        else:
            with pytest.raises(Fault, match=r"DEVICE_WATCHDOG.*stood still for 14\d ms"):
                driver.write(0.1)
        assert (driver._exchange.seq > asked) == is_sent
