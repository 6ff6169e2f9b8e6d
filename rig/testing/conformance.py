"""A test suite for drivers: does a driver keep the promises of ``rig.backends.driver.Driver``?

Put one line in a test file of your own; pytest does the rest:

    TestCard = rig.testing.conformance.suite("card.yaml")

The shaft moves: the tests drive at most ``drive_V`` either way, for a tick or two at a time, and start inside the soft
limits. With ``silence`` they also drive ``drive_V`` once, for one and a half times the watchdog's time.
"""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from rig import config
from rig.backends.backend import Unopened
from rig.backends.driver import Clock, DeviceInfo, DeviceWatchdog, Driver
from rig.backends.link_budget import LINK_SHARE
from rig.backends.plug_in import PlugIn
from rig.backends.registry import backend_of, unopened
from rig.core.faults import Fault
from rig.core.signals import Limits, Sample, percent
from rig.running.preflight import check

TEST_SHARE = 0.1  # of drive.max_V: the default of drive_V
_TICKS = 40
_TIME_TOLERANCE = 0.1  # of the period: largest error of a fitted device clock
_SAME_DRIVE_V = 1e-9  # less than a step of any converter
_SILENCE = 1.5  # times the watchdog's time


def suite(
    config_path: str | Path,
    *,
    drive_V: float | None = None,
    silence: bool = False,
    cut: Callable[[Driver], None] | None = None,
) -> type[Suite]:
    """A class of tests for the driver of a config; give it a name that begins with ``Test``.

    config_path  absolute, or relative to the calling file
    drive_V      largest drive of the tests, V; default a tenth of drive.max_V
    silence      also test the device's failsafe: leave a drive on and send nothing. The shaft may turn for that time
    cut          breaks the link of an open driver (pulls a plug, ends a process), to test what the driver does then
    Raises ConfigError where the config cannot be loaded.
    """
    path = Path(sys._getframe(1).f_globals.get("__file__", "")).parent / config_path
    experiment = config.load(path)
    bases: list[type[Suite]] = [Suite]
    if isinstance(backend_of(experiment.device), PlugIn):
        bases.append(_Constructed)
    if silence:
        bases.append(_Silenced)
    if cut is not None:
        bases.append(_Cut)
    found = {
        "config_path": path,
        "experiment": experiment,
        "drive_V": TEST_SHARE * experiment.drive.max_V if drive_V is None else drive_V,
        "cut": staticmethod(cut) if cut is not None else None,
    }
    return type("Conformance", tuple(reversed(bases)), found)


class Tick(NamedTuple):
    """One tick: the clock before the reading, the reading, the clock after it, and the drive written then."""

    from_s: float
    sample: Sample
    to_s: float
    u_V: float

    @property
    def write_s(self) -> float:
        """The clock before the write, s."""
        return self.to_s


class Suite:
    """The tests. All share one open device; after a test that closes it, the next test opens it again."""

    config_path: ClassVar[Path]
    experiment: ClassVar[config.Experiment]
    drive_V: ClassVar[float]
    cut: ClassVar[Any]
    _device: ClassVar[ExitStack | None] = None
    _bench: ClassVar[Unopened]
    _info: ClassVar[DeviceInfo]
    _driven: ClassVar[bool]

    # ------------------------------------------------------------------ what pytest calls

    def setup_method(self) -> None:
        """Open the device if it is not open, and stop it."""
        if type(self)._device is None:
            self._open()
        self.driver.safe_stop()

    def teardown_method(self) -> None:
        """Stop the device, whatever happened."""
        if type(self)._device is not None:
            with suppress(Exception):  # another test reports a broken driver
                self.driver.safe_stop()

    @classmethod
    def teardown_class(cls) -> None:
        """Close the device."""
        cls._close()

    # ------------------------------------------------------------------ the tests

    def test_it_says_what_it_is(self) -> None:
        """``open`` returns a DeviceInfo, and ``backend`` says in words what is behind the driver."""
        info = self._info
        require(isinstance(info, DeviceInfo), f"open() must return a DeviceInfo, not {info!r}")
        for name in ("build", "board", "reset_cause"):
            require(isinstance(getattr(info, name), str), f"DeviceInfo.{name} must be text")
        require(isinstance(info.emulated, bool), "DeviceInfo.emulated must be true or false")
        require(0.9 < info.clock_ratio < 1.1, f"DeviceInfo.clock_ratio {info.clock_ratio!r} is no ratio of two clocks")
        backend = self.driver.backend
        require(isinstance(backend, str) and backend != "", f"backend must say what is there, not {backend!r}")

    def test_a_reading_is_complete_before_anything_was_armed(self) -> None:
        """``read`` works unarmed: no drive, no time of a drive, and a position that fits the raw reading."""
        if self._driven:
            self._open()
        sample = self.driver.read()
        require(isinstance(sample, Sample), f"read() must return a Sample, not {sample!r}")
        require(type(sample.y_counts) is int, f"y_counts must be a whole number, not {sample.y_counts!r}")
        expected_rad = self.experiment.sensor.curve.to_rad(sample.y_counts)
        require(
            abs(sample.y_rad - expected_rad) <= self.experiment.sensor.curve.lsb_rad,
            f"y_rad is {sample.y_rad:.4f}, but {sample.y_counts} counts are {expected_rad:.4f} rad by the calibration",
        )
        require(sample.u_V == 0.0, f"drives {sample.u_V} V before anything was written")
        require(math.isnan(sample.t_u_s), f"t_u_s must be nan before the first write, not {sample.t_u_s}")

    def test_it_drives_nothing_unless_it_is_armed(self) -> None:
        """A ``write`` to a device that is not armed is refused, at once or by the device."""
        if self._driven:
            self._open()
        self._expect_no_drive("before arm()")

    def test_it_refuses_limits_that_it_cannot_hold(self) -> None:
        """``arm`` raises for limits beyond sensor or drive, and arms nothing. AssertionError where it does not."""
        good, e = self.experiment.device.arming, self.experiment
        calibration, counts_max = e.sensor.curve, e.sensor.counts_max or 0
        ends = sorted((calibration.to_rad(-0.1 * counts_max), calibration.to_rad(1.1 * counts_max)))
        cases: tuple[tuple[str, Limits], ...] = (
            ("hard limits beyond what the sensor can read", replace(good, hard_rad=(ends[0], ends[1]))),
            ("hard limits that leave out the centre of travel", replace(good, hard_rad=(0.5 * ends[1], ends[1]))),
            ("a drive beyond the supply", replace(good, max_u_V=1.5 * e.drive.map.full_V)),
        )
        for words, limits in cases:
            try:
                self.driver.arm(limits)
            except (ValueError, Fault):
                self._expect_no_drive(f"after arm() refused {words}")
                continue
            raise AssertionError(f"arm() took {words}: {limits}")

    def test_times_are_in_its_clock_and_rise(self) -> None:
        """``t_s`` rises and lies within its ``read``, in the driver's own clock or time.monotonic."""
        period_s = self.experiment.period_s
        ticks = self._run(self._to_and_fro(_TICKS))
        for before, tick in pairwise(ticks):
            require(
                tick.sample.t_s > before.sample.t_s,
                f"t_s must rise: {tick.sample.t_s!r} s after {before.sample.t_s!r} s",
            )
        for tick in ticks:
            require(
                tick.from_s - period_s <= tick.sample.t_s <= tick.to_s + _TIME_TOLERANCE * period_s,
                f"t_s is {tick.sample.t_s!r} s, but its clock said {tick.from_s!r} to {tick.to_s!r} s around read()",
            )

    def test_the_drive_takes_effect_after_its_write_and_in_its_order(self) -> None:
        """``t_u_s`` lies between ``write`` and the next reading; before that ``read`` if ``order`` is sample_first."""
        tolerance_s = _TIME_TOLERANCE * self.experiment.period_s
        order = self.driver.order
        for tick, following in self._with_outcomes(self._to_and_fro(8)):
            t_u_s = following.sample.t_u_s
            require(
                tick.write_s - tolerance_s <= t_u_s <= following.to_s + tolerance_s,
                f"t_u_s is {t_u_s!r} s, but write() was called at {tick.write_s!r} s, reported by {following.to_s!r} s",
            )
            in_write = t_u_s < following.from_s - tolerance_s
            in_read = not in_write and t_u_s <= following.sample.t_s + tolerance_s
            require(
                in_write if order == "sample_first" else in_read,
                f"order is {order}, but the drive of write() at {tick.write_s!r} s acts from {t_u_s!r} s; the next "
                f"read() was called at {following.from_s!r} s and sampled at {following.sample.t_s!r} s",
            )

    def test_the_drive_that_acts_is_reported(self) -> None:
        """``u_V`` of the reading after a ``write`` is that drive, sign included, and 0 V is 0 V."""
        u = self.drive_V
        for tick, following in self._with_outcomes([u, -u, 0.5 * u, 0.0, -0.5 * u, u, 0.0]):
            reported_V = following.sample.u_V
            near = (
                reported_V == 0.0
                if tick.u_V == 0.0
                else abs(reported_V - tick.u_V) <= 0.05 * u + 0.5 * self._step_V(tick)
            )
            require(near, f"write({tick.u_V:+.4f}) was called, and the next reading reports {reported_V:+.4f} V")

    def test_the_drive_is_reported_as_quantised(self) -> None:
        """``u_V`` is the quantised drive: two drives a nanovolt apart give one, a whole number of ``drive_units``."""
        u = self.drive_V
        asked = [value for share in (0.91, 0.83, 0.77) for value in (share * u, share * u + _SAME_DRIVE_V)]
        reported = [following.sample.u_V for _, following in self._with_outcomes(asked)]
        same = sum(a == b for a, b in zip(reported[::2], reported[1::2], strict=True))
        require(same >= 2, f"u_V repeats the written drive instead of the quantised one: {reported}")
        if self._info.drive_units is not None:
            steps = replace(self.experiment.drive.map, full_units=self._info.drive_units)
            for reported_V in reported:
                require(
                    abs(steps.quantised(reported_V) - reported_V) <= 1e-6 * steps.full_V,
                    f"u_V {reported_V!r} V is no whole number of the {self._info.drive_units} drive_units of open()",
                )

    def test_it_refuses_drives_beyond_its_range(self) -> None:
        """``write`` raises ValueError beyond supply and bridge, and for nan; else AssertionError. The drive stays."""
        full_V = self.experiment.drive.map.full_V
        beyond = 1.01 * full_V + 0.1
        with self._armed():
            (tick,) = self._ticks([0.0])
            for u_V in (beyond, -beyond, math.nan, math.inf):
                try:
                    self.driver.write(u_V)
                except ValueError:
                    continue
                self.driver.safe_stop()
                raise AssertionError(f"write({u_V:g}) must raise ValueError: the drive gives {full_V:g} V")
            (tick,) = self._ticks([0.0])
            require(tick.sample.u_V == 0.0, f"a refused write left {tick.sample.u_V} V")

    def test_it_drives_no_more_than_it_was_armed_for(self) -> None:
        """Beyond ``max_u_V`` the device refuses, at once or in the next reading. Opened again, it can be armed."""
        u = self.drive_V
        with self._armed(max_u_V=0.5 * u):
            reported_V = self._try_to_drive(u)
        require(abs(reported_V) <= 0.5 * u + 0.05 * u, f"armed for {0.5 * u:.3f} V, it drives {reported_V:+.3f} V")
        self._open()  # opening clears what the device has latched
        self._run([u, 0.0])

    def test_safe_stop_sets_zero(self) -> None:
        """``safe_stop`` ends a drive and returns True, and the drive stays at 0."""
        with self._armed():
            self._ticks([self.drive_V, self.drive_V])
            confirmed = self.driver.safe_stop()
            require(confirmed is True, f"safe_stop() of a working device must return True, not {confirmed!r}")
            for _ in range(3):
                self._wait(self.experiment.period_s)
                reported_V = self.driver.read().u_V
                require(reported_V == 0.0, f"drives {reported_V:+.4f} V after safe_stop()")

    def test_safe_stop_disarms(self) -> None:
        """After ``safe_stop`` nothing drives until ``arm``; then it does again."""
        with self._armed():
            self._ticks([self.drive_V])
        self._expect_no_drive("after safe_stop()")
        reported_V = [following.sample.u_V for _, following in self._with_outcomes([self.drive_V])]
        require(reported_V[0] > 0.0, "does not drive when it is armed again")

    def test_it_holds_the_period(self) -> None:
        """``read`` and ``write`` together leave a fifth of the period, in the median."""
        period_s = self.experiment.period_s
        took_s: list[float] = []
        with self._armed():
            for _ in range(_TICKS):
                self._wait(period_s)
                started_s = self.clock.now_s()
                self._exchange(0.0)
                took_s.append(self.clock.now_s() - started_s)
        median_s = statistics.median(took_s)
        require(
            median_s <= LINK_SHARE * period_s,
            f"read() and write() take {median_s * 1e3:.2f} ms; the period is {period_s * 1e3:g} ms, of which they may "
            f"take {percent(LINK_SHARE)}",
        )

    def test_its_failsafe_is_declared(self) -> None:
        """``failsafe`` once armed: None where the config accepts that, else no longer than daq.watchdog_s."""
        with self._armed():
            failsafe = self.driver.failsafe
        if failsafe is None:
            require(
                self.experiment.daq.accept_no_watchdog,
                "failsafe is None: without daq.accept_no_watchdog: true no run would start",
            )
            return
        require(isinstance(failsafe, DeviceWatchdog), f"failsafe must be a DeviceWatchdog or None, not {failsafe!r}")
        asked_s = self.experiment.daq.watchdog_s
        require(
            0.0 < failsafe.time_s <= asked_s + 1e-3,
            f"the device stops after {failsafe.time_s:g} s of silence; it was armed with daq.watchdog_s {asked_s:g} s, "
            "which the stopping distance counts on",
        )

    def test_its_link_statistics_only_rise(self) -> None:
        """``link_statistics`` are counts by name that never fall."""
        before = dict(self.driver.link_statistics)
        self._run(self._to_and_fro(4))
        after = self.driver.link_statistics
        require(isinstance(after, Mapping), f"link_statistics must be a mapping, not {after!r}")
        for name, count in after.items():
            require(isinstance(name, str) and type(count) is int, f"link_statistics {name!r} is {count!r}: no count")
            require(count >= before.get(name, 0), f"link_statistics {name!r} fell from {before.get(name)} to {count}")

    def test_safe_stop_and_close_before_open(self) -> None:
        """``safe_stop`` and ``close`` never raise, not even before ``open``."""
        self._close()
        with unopened(self.experiment.device) as bench:
            stopped = bench.driver.safe_stop()
            require(isinstance(stopped, bool), f"safe_stop() must return true or false, not {stopped!r}")
            bench.driver.close()

    def test_close_may_be_called_twice(self) -> None:
        """``close`` again does nothing."""
        with self._given_up() as driver:
            driver.close()
            driver.close()

    def test_safe_stop_after_close_does_not_raise(self) -> None:
        """On a closed link ``safe_stop`` returns, and does not raise."""
        with self._given_up() as driver:
            driver.close()
            stopped = driver.safe_stop()
        require(isinstance(stopped, bool), f"safe_stop() must return true or false, not {stopped!r}")

    # ------------------------------------------------------------------ the device

    @property
    def driver(self) -> Driver:
        """The open driver."""
        return self._bench.driver

    @property
    def clock(self) -> Clock:
        """The driver's clock."""
        return self._bench.clock

    @classmethod
    def _open(cls) -> None:
        """Open the device; if it is open, close it first."""
        cls._close()
        check(cls.config_path)
        with ExitStack() as device:
            cls._bench = device.enter_context(unopened(cls.experiment.device))
            cls._driven = False
            cls._device = device.pop_all()
        try:
            cls._info = cls._bench.driver.open()
        except BaseException:
            cls._close()
            raise

    @classmethod
    def _close(cls) -> None:
        if cls._device is not None:
            with cls._given_up() as driver:
                driver.close()

    @classmethod
    @contextmanager
    def _given_up(cls) -> Iterator[Driver]:
        """The open driver, for a block that closes it. The next test opens another, however the block ends."""
        device, cls._device = cls._device, None
        with device or ExitStack():
            yield cls._bench.driver

    def _armed(self, max_u_V: float | None = None) -> ExitStack:
        """Armed for the block, with the shaft inside the soft limits; stopped after it."""
        limits = self.experiment.device.arming
        self.driver.arm(limits if max_u_V is None else replace(limits, max_u_V=max_u_V))
        with ExitStack() as block:
            block.callback(self.driver.safe_stop)
            y_rad = self.driver.read().y_rad
            low, high = limits.soft_rad
            require(
                low <= y_rad <= high,
                f"the shaft is at {y_rad:.3f} rad: bring it inside the soft limits {low:g} to {high:g} rad first",
            )
            return block.pop_all()

    def _wait(self, duration_s: float) -> None:
        due_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < due_s:
            self.clock.sleep_until(due_s)

    def _exchange(self, u_V: float) -> Tick:
        """One tick, as the loop does it."""
        type(self)._driven = True
        from_s = self.clock.now_s()
        sample = self.driver.read()
        to_s = self.clock.now_s()
        self.driver.write(u_V)
        return Tick(from_s, sample, to_s, u_V)

    def _ticks(self, drives: Sequence[float]) -> list[Tick]:
        """One tick for each drive, a period apart; inside ``_armed``."""
        ticks = []
        for u_V in drives:
            self._wait(self.experiment.period_s)
            ticks.append(self._exchange(u_V))
        return ticks

    def _run(self, drives: Sequence[float]) -> list[Tick]:
        with self._armed():
            return self._ticks(drives)

    def _with_outcomes(self, drives: Sequence[float]) -> list[tuple[Tick, Tick]]:
        """Each drive's tick, with the tick whose reading reports its effect."""
        return list(pairwise(self._run([*drives, 0.0])))

    def _to_and_fro(self, number: int) -> list[float]:
        return [self.drive_V * (-1.0) ** k for k in range(number)]

    def _step_V(self, tick: Tick) -> float:
        """Step of the coarsest expected drive, 8 bits and a sign, V."""
        return self.experiment.drive.map.full_V / 255.0 if tick.u_V else 0.0

    def _try_to_drive(self, u_V: float) -> float:
        """Drive after a ``write`` that should be refused, V; 0 where it raised Fault or ValueError."""
        reported_V = 0.0
        try:
            self._exchange(u_V)
            for _ in range(2):
                self._wait(self.experiment.period_s)
                reported_V = self.driver.read().u_V
        except (Fault, ValueError):
            return 0.0
        return reported_V

    def _expect_no_drive(self, when: str) -> None:
        reported_V = self._try_to_drive(self.drive_V)
        self.driver.safe_stop()
        require(reported_V == 0.0, f"write({self.drive_V:g}) {when} drives {reported_V:+.4f} V")


class _Constructed(Suite):
    """Test of drivers from other packages."""

    def test_constructing_touches_no_device(self) -> None:
        """Constructing another driver, as `rig check` does, changes nothing while this one drives."""
        with self._armed():
            self._ticks([self.drive_V])
            with unopened(self.experiment.device):
                (tick,) = self._ticks([self.drive_V])
            require(tick.sample.u_V > 0.0, f"a second driver was constructed, and this one drives {tick.sample.u_V} V")


class _Silenced(Suite):
    """Test of a device with a failsafe; it drives until that acts."""

    def test_silence_sets_zero_and_latches(self) -> None:
        """After a silence longer than ``failsafe`` the drive is 0, and stays so until the device is opened again."""
        with self._armed():
            failsafe = self.driver.failsafe
            if failsafe is None:
                raise AssertionError("failsafe is None: there is nothing to test; leave out `silence`")
            self._ticks([self.drive_V, self.drive_V])
            self._wait(_SILENCE * failsafe.time_s + self.experiment.period_s)
            try:
                reported_V = self.driver.read().u_V
            except Fault:
                reported_V = 0.0
            require(
                reported_V == 0.0,
                f"silent for {_SILENCE:g} times its {failsafe.time_s:g} s, it drives {reported_V:+.4f} V",
            )
            reported_V = self._try_to_drive(self.drive_V)
            require(reported_V == 0.0, f"after its failsafe it drives {reported_V:+.4f} V again without being armed")
        self._open()
        self._run([self.drive_V, 0.0])


class _Cut(Suite):
    """Test of a driver whose link ``cut`` breaks."""

    def test_a_dead_link_is_a_fault_and_safe_stop_does_not_raise(self) -> None:
        """The link breaks: ``read`` raises Fault within a few ticks, ``safe_stop`` returns False, ``close`` works."""
        failed = False
        self._armed().pop_all()
        self._ticks([0.0, 0.0])
        with self._given_up() as driver:
            self.cut(driver)
            try:
                self._ticks([0.0] * 5)
            except Fault:
                failed = True
            stopped = driver.safe_stop()
            driver.close()
        require(failed, "the link was cut, and read() and write() go on without a Fault")
        require(stopped is False, f"the link was cut, and safe_stop() returns {stopped!r}")


def require(holds: bool, words: str) -> None:
    """Raise AssertionError with ``words`` unless ``holds``. Not ``assert``: that can be switched off."""
    if not holds:
        raise AssertionError(words)
