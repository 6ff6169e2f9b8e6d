"""Drivers from other packages, found by entry point.

A package offers one in its pyproject.toml:

    [project.entry-points."rig.daq"]
    mycard = "mypackage.card:CardDriver"

It is a class that is constructed with a ``DriverSettings`` and is then a ``Driver``.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from rig.backends.driver import DeviceWatchdog, Driver, DriverSettings

GROUP = "rig.daq"
_ARGUMENTS = {"open": 0, "arm": 1, "read": 0, "write": 1, "safe_stop": 0, "close": 0}


class PlugInError(Exception):
    """A driver that cannot be used: who offers it, and what is wrong with it."""


def registered() -> dict[str, EntryPoint]:
    """The drivers that installed packages offer, by name. Raises PlugInError if two offer the same name."""
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=GROUP):
        if entry.name in found and found[entry.name].value != entry.value:
            raise PlugInError(
                f"two drivers are called {entry.name!r}: {found[entry.name].value} and {entry.value}; "
                "uninstall one of the packages"
            )
        found[entry.name] = entry
    return found


def load(name: str) -> type[Driver]:
    """The driver class of that name.

    Raises LookupError if there is none, naming those there are; PlugInError if it cannot be imported, or is no driver
    class: one argument for the constructor, the methods of ``Driver`` with as many as there.
    """
    known = registered()
    if name not in known:
        listed = ", ".join(sorted(known)) or "none is installed"
        raise LookupError(f"no driver {name!r} in entry point group {GROUP!r}; known: {listed}")
    who = described(known[name])
    try:
        loaded: object = known[name].load()
    except Exception as error:  # whatever it is, the other package did it
        raise PlugInError(f"{who} cannot be imported: {_in_words(error)}") from error
    if not isinstance(loaded, type):
        raise PlugInError(f"{who} is not a class")
    missing = [method for method in _ARGUMENTS if not callable(getattr(loaded, method, None))]
    if missing:
        raise PlugInError(f"{who} lacks {', '.join(missing)}")
    if not _takes(loaded, 1):
        raise PlugInError(f"{who} must be constructed as {loaded.__name__}(settings), with one DriverSettings")
    for method, arguments in _ARGUMENTS.items():
        if not _takes(getattr(loaded, method), 1 + arguments):
            raise PlugInError(f"{who}: {method} must take {arguments or 'no'} argument{'s' * (not arguments)}")
    return loaded


def construct(name: str, settings: DriverSettings) -> Driver:
    """A driver of that name, not opened.

    Raises as ``load``; ValueError where the driver refuses its options; PlugInError where it fails otherwise, or lacks
    one of the attributes of ``Driver``.
    """
    loaded = load(name)
    who = described(registered()[name])
    try:
        driver: Driver = loaded(settings)  # type: ignore[call-arg]
    except ValueError:
        raise
    except Exception as error:  # whatever it is, the other package did it
        raise PlugInError(f"{who} cannot be constructed: {_in_words(error)}") from error
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


def described(entry: EntryPoint) -> str:
    """A driver in words: its name, where it is, and the package that offers it."""
    package = f" of {entry.dist.name} {entry.dist.version}" if entry.dist is not None else ""
    return f"driver {entry.name!r} ({entry.value}{package})"


def _takes(function: object, arguments: int) -> bool:
    """Whether something can be called with so many positional arguments."""
    try:
        inspect.signature(function).bind(*[None] * arguments)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True


def _in_words(error: Exception) -> str:
    """An exception of another package: what, and in which of its lines."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{type(error).__name__}: {error}{place}"
