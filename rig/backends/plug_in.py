"""Drivers of other packages: what an entry point must be, and how such a driver becomes a backend.

A package offers one in its pyproject.toml:

    [project.entry-points."rig.daq"]
    mycard = "mypackage.card:CardDriver"

The entry point is a class: constructed with a ``DriverSettings`` it is a ``Driver``. Or it is a ``Backend``, if the
device has more than a driver: a section of its own, rules, a link budget, an emulated device.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType

from typing_extensions import override

from rig.backends.backend import Backend, Unopened, host_clock, truth_of
from rig.backends.driver import DeviceWatchdog, Driver, DriverSettings, RelayDriver, StrokeDriver
from rig.config.problems import ConfigError, Problem, printable, wrong
from rig.config.schema import DeviceSetup
from rig.core import plug_ins
from rig.core.plug_ins import PlugInError

GROUP = "rig.daq"
_ARGUMENTS = {"open": 0, "arm": 1, "read": 0, "write": 1, "safe_stop": 0, "close": 0}


def registered() -> dict[str, EntryPoint]:
    """What installed packages offer, by name. Raises PlugInError if two offer the same name."""
    return plug_ins.offered(GROUP, "driver", entry_points)


def loaded(entry: EntryPoint) -> Backend:
    """The backend that the entry point names, or that of its driver class.

    Raises PlugInError if it cannot be imported, or is neither driver class nor backend.

    The constructor of a driver class takes one argument; its methods take as many as those of ``Driver``.
    """
    who, found = plug_ins.imported(entry, "driver")
    if isinstance(found, Backend):
        if found.name != entry.name:
            raise PlugInError(f"{who}: its name must be {entry.name!r}, not {found.name!r}")
        return found
    if not isinstance(found, type):
        raise PlugInError(f"{who} is not a class")
    missing = [method for method in _ARGUMENTS if not callable(getattr(found, method, None))]
    if missing:
        raise PlugInError(f"{who} lacks {', '.join(missing)}")
    if not plug_ins.takes(found, 1):
        raise PlugInError(f"{who} must be constructed as {found.__name__}(settings), with one DriverSettings")
    for method, arguments in _ARGUMENTS.items():
        if not plug_ins.takes(getattr(found, method), 1 + arguments):
            raise PlugInError(f"{who}: {method} must take {arguments or 'no'} argument{'s' * (not arguments)}")
    return _plug_in(who, found)


def constructed(who: str, driver_class: type[Driver], settings: DriverSettings) -> Driver:
    """A driver of that class, not opened yet.

    Raises ValueError where it refuses its options; PlugInError where it fails otherwise, or lacks an attribute of
    ``Driver``.
    """
    try:
        driver: Driver = driver_class(settings)  # type: ignore[call-arg]
    except ValueError:
        raise
    except Exception as error:  # whatever it is, the other package did it
        raise PlugInError(f"{who} cannot be constructed: {plug_ins.in_words(error)}") from error
    missing = [name for name in ("order", "failsafe", "backend", "link_statistics") if not hasattr(driver, name)]
    if missing:
        raise PlugInError(f"{who} lacks {', '.join(missing)}")
    if driver.order not in ("sample_first", "write_first"):
        raise PlugInError(f"{who}: order must be sample_first or write_first, not {driver.order!r}")
    if driver.failsafe is not None and not isinstance(driver.failsafe, DeviceWatchdog):
        raise PlugInError(f"{who}: failsafe must be a DeviceWatchdog, or None, not {driver.failsafe!r}")
    if not isinstance(driver.link_statistics, Mapping):
        raise PlugInError(f"{who}: link_statistics must be a mapping, not {driver.link_statistics!r}")
    clock = getattr(driver, "clock", None)
    if clock is not None and not all(callable(getattr(clock, m, None)) for m in ("now_s", "sleep_until")):
        raise PlugInError(f"{who}: clock must have now_s and sleep_until; leave it out for time.monotonic")
    return driver


def driver_settings_of(d: DeviceSetup) -> DriverSettings:
    """What a driver of another package is constructed with."""
    return DriverSettings(
        options=MappingProxyType(dict(d.daq.options or {})),
        calibration=d.sensor.curve,
        drive_map=d.drive.map,
        rail_counts=d.sensor.rails,
        counts_max=d.sensor.counts_max or 0,
        timeout_s=d.daq.timeout_s,
        period_s=d.period_s,
        watchdog_s=d.daq.watchdog_s,
    )


class PlugIn(Backend):
    """A driver class of another package as a backend; or the reason why it cannot be used.

    who           it in words: its name, where it is, and the package that offers it
    driver_class  the class; None where it cannot be used
    refusal       why it cannot be used; None where it can
    """

    shared_keys = frozenset({"options"})

    def __init__(self, who: str = "", driver_class: type[Driver] | None = None, refusal: Problem | None = None) -> None:
        self.who = who
        self.driver_class = driver_class
        self.refusal = refusal
        self._checked: tuple[DeviceSetup, Driver | Problem] | None = None

    def construct(self, settings: DriverSettings) -> Driver:
        """A driver, not opened. Raises as ``constructed``; ConfigError where there is none."""
        if self.driver_class is None:
            raise ConfigError([] if self.refusal is None else [self.refusal])
        return constructed(self.who, self.driver_class, settings)

    @override
    def foreign_key(self, d: DeviceSetup, key: str, owner: str = "") -> Problem:
        """What the driver asks for stands under ``daq.options``."""
        return wrong(f"daq.{key}", f"is a key of built-in drivers, not of `{d.daq.driver}`", "see daq.options")

    @override
    def rules(self, d: DeviceSetup) -> Iterator[Problem]:
        """Constructs the driver, so that it refuses wrong options here, not in front of a motor."""
        driver = self._tried(d)
        self._checked = (d, driver)
        if isinstance(driver, Problem):
            yield driver
        elif d.runs_relay and not isinstance(driver, RelayDriver):
            yield wrong("relay.where", f"driver {d.daq.driver!r} has no relay in its device", "set it to host")
        elif d.runs_strokes and not isinstance(driver, StrokeDriver):
            yield wrong(
                "relay.where",
                f"driver {d.daq.driver!r} runs no strokes in its device; relay.until does",
                "set it to host",
            )

    def _tried(self, d: DeviceSetup) -> Driver | Problem:
        """The driver, not opened; or why there is none."""
        if self.refusal is not None:
            return self.refusal
        try:
            return self.construct(driver_settings_of(d))
        except PlugInError as error:
            return refused(error)
        except ValueError as error:
            return wrong("daq.options", f"driver {d.daq.driver!r}: {error}")

    @override
    def words(self, d: DeviceSetup) -> str:
        return f"plug-in driver {d.daq.driver}: assume a REAL MOTOR"

    @override
    def plan(self, d: DeviceSetup) -> Iterator[str]:
        yield "link: the budget of a plug-in driver is not known; `rig doctor` measures it"
        if d.runs_relay:
            yield "relay in the device: as the plug-in driver runs it; the gain search runs in the host"
        # `rig check` asks for the rules first: once constructed is enough
        driver = self._checked[1] if self._checked is not None and self._checked[0] == d else self._tried(d)
        self._checked = None
        if not isinstance(driver, Problem):
            failsafe = "none"
            if driver.failsafe is not None:
                failsafe = f"0 V after {driver.failsafe.time_s * 1e3:g} ms of silence"
            order = driver.order.replace("_", " ")
            yield f"{self.who}: {order}; failsafe before it is opened: {failsafe}"

    @override
    def failsafe_words(self, d: DeviceSetup) -> str:
        return "failsafe: the plug-in driver's; if its device has none, a run " + (
            "drives all the same (daq.accept_no_watchdog: true): keep the motor's supply switch in reach"
            if d.daq.accept_no_watchdog
            else "is refused"
        )

    @override
    @contextmanager
    def unopened(self, d: DeviceSetup) -> Iterator[Unopened]:
        """Raises ConfigError where there is no such driver, or it refuses its options."""
        driver = self._tried(d)
        if isinstance(driver, Problem):
            raise ConfigError([driver])
        yield Unopened(driver, getattr(driver, "clock", None) or host_clock(d), truth_of(d))


def offered_backend(name: str, built_in: Iterable[str]) -> Backend:
    """The device of that name from another package. If there is none: a backend whose rules refuse every config.

    built_in  names of rig's own devices, for the refusal
    """
    try:
        known = registered()
        return loaded(known[name]) if name in known else PlugIn(refusal=_unknown(name, built_in, sorted(known)))
    except PlugInError as error:
        return PlugIn(refusal=refused(error))


def _unknown(name: str, built_in: Iterable[str], installed: list[str]) -> Problem:
    """The problem of a driver that is neither built in nor installed."""
    close = get_close_matches(name, [*built_in, *installed], n=1)
    return wrong(
        "daq.driver",
        f"no driver {printable(name)!r}; built in: {', '.join(built_in)}; "
        f"plug-ins installed: {', '.join(installed) or 'none'}",
        f"did you mean '{close[0]}'?" if close else "install the package that offers it (docs/plug-in-driver.md)",
    )


@lru_cache(maxsize=8)
def _plug_in(who: str, driver_class: type[Driver]) -> PlugIn:
    """The backend of a driver class: one object, so that it knows what it has checked already."""
    return PlugIn(who, driver_class)


def refused(error: PlugInError) -> Problem:
    """The problem of a driver that cannot be used."""
    return wrong("daq.driver", str(error), "see docs/plug-in-driver.md, or ask its author")
