"""Drivers from other packages, found by entry point.

A package offers one in its pyproject.toml:

    [project.entry-points."rig.daq"]
    mycard = "mypackage.card:CardDriver"
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

from rig.daq.driver import Driver

GROUP = "rig.daq"
_METHODS = ("open", "arm", "read", "write", "safe_stop", "close")


def registered() -> dict[str, EntryPoint]:
    """The drivers that installed packages offer, by name. Raises ValueError if two offer the same name."""
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=GROUP):
        if entry.name in found and found[entry.name].value != entry.value:
            raise ValueError(
                f"two drivers are called {entry.name!r}: {found[entry.name].value} and {entry.value}; "
                "uninstall one of the packages"
            )
        found[entry.name] = entry
    return found


def load(name: str) -> type[Driver]:
    """The driver class of that name.

    Raises LookupError if there is none, naming those there are; TypeError if it is no driver class.
    """
    known = registered()
    if name not in known:
        listed = ", ".join(sorted(known)) or "none is installed"
        raise LookupError(f"no driver {name!r} in entry point group {GROUP!r}; known: {listed}")
    loaded: object = known[name].load()
    if not isinstance(loaded, type):
        raise TypeError(f"driver {name!r} ({known[name].value}) is not a class")
    missing = [member for member in _METHODS if not callable(getattr(loaded, member, None))]
    if missing:
        raise TypeError(f"driver {name!r} ({known[name].value}) lacks {', '.join(missing)}")
    return loaded
