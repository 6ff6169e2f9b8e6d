"""What other packages offer by entry point: found by name, and described in words. Any room may import this module."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint
from pathlib import Path

from rig.core.errors import RigError

Finder = Callable[..., Iterable[EntryPoint]]


class PlugInError(RigError):
    """A driver or a law of another package that cannot be used: who offers it, and what is wrong with it."""


class OptionError(ValueError):
    """Options that something does not take.

    key  the option that is wrong; "" if nobody can tell
    """

    def __init__(self, message: str, key: str = "") -> None:
        self.key = key
        super().__init__(message)


def offered(group: str, kind: str, finder: Finder) -> dict[str, EntryPoint]:
    """What installed packages offer in a group of entry points, by name.

    kind    what it is, in words: "driver"
    finder  ``importlib.metadata.entry_points``
    Raises PlugInError if two packages offer the same name.
    """
    found: dict[str, EntryPoint] = {}
    for entry in _installed(finder, group, tuple(map(_place, sys.path))):
        if entry.name in found and found[entry.name].value != entry.value:
            raise PlugInError(
                f"two {kind}s are called {entry.name!r}: {found[entry.name].value} and {entry.value}; "
                "uninstall one of the packages"
            )
        found[entry.name] = entry
    return found


def _place(folder: str) -> tuple[str, int]:
    """A folder that packages are in, and when it changed last: installing a package changes it."""
    try:
        return folder, Path(folder).stat().st_mtime_ns
    except OSError:
        return folder, 0


@lru_cache(maxsize=8)
def _installed(finder: Finder, group: str, places: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    """What is offered. Looking through all packages takes milliseconds: once for each state of the places."""
    return tuple(finder(group=group))


def described(entry: EntryPoint, kind: str) -> str:
    """An entry in words: its name, where it is, and the package that offers it."""
    package = f" of {entry.dist.name} {entry.dist.version}" if entry.dist is not None else ""
    return f"{kind} {entry.name!r} ({entry.value}{package})"


def imported(entry: EntryPoint, kind: str) -> tuple[str, object]:
    """An entry in words, and what it names. Raises PlugInError where that cannot be imported."""
    who = described(entry, kind)
    try:
        return who, entry.load()
    except Exception as error:  # whatever it is, the other package did it
        raise PlugInError(f"{who} cannot be imported: {in_words(error)}") from error


def takes(function: object, arguments: int) -> bool:
    """Whether something can be called with so many positional arguments."""
    try:
        inspect.signature(function).bind(*[None] * arguments)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True


def require_options(make: object, who: str, options: Mapping[str, object]) -> None:
    """Raise OptionError where ``make`` cannot be called with these options; ``who``: what it is, in words."""
    try:
        signature = inspect.signature(make)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return  # it does not say what it takes: calling it tells
    named = [p.name for p in signature.parameters.values() if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    takes_any = any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values())
    for key in options:
        if key not in named and not takes_any:
            raise OptionError(f"{who} takes no option {key!r}; it takes: {', '.join(named) or 'none'}", key)
    try:
        signature.bind(**options)
    except TypeError as error:
        raise OptionError(f"{who}: {error}") from error


def in_words(error: BaseException) -> str:
    """An exception of another package: what, and in which of its lines."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{type(error).__name__}: {error}{place}"
