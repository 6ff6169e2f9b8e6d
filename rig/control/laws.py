"""Laws that a config names in its section `law`: rig's own, and those of other packages.

A package offers one in its pyproject.toml:

    [project.entry-points."rig.laws"]
    pid = "mypackage.laws:Pid"

It is a class, or a function, that takes the config's ``law.options`` by name and gives an ``OwnLaw``.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points

from rig.control.law import OwnLaw
from rig.core.plug_ins import OptionError, PlugInError, imported, in_words, offered, require_options

GROUP = "rig.laws"
TUNED = "tuned"
OWN = {TUNED: EntryPoint(TUNED, "rig.control.tuned:tuned", GROUP)}  # of rig itself


def registered() -> dict[str, EntryPoint]:
    """What rig and installed packages offer, by name. Raises PlugInError if two packages offer the same name."""
    return offered(GROUP, "law", entry_points) | OWN


def construct(name: str, options: Mapping[str, object]) -> OwnLaw:
    """A law by its name, made with these options.

    Raises LookupError, which lists the known laws, if none has that name; OptionError if it does not take the options;
    PlugInError if it cannot be imported, fails in another way, or is no law.
    """
    known = registered()
    if name not in known:
        listed = ", ".join(sorted(known)) or "none is installed"
        raise LookupError(f"no law {name!r} in entry point group {GROUP!r}; known: {listed}")
    who, make = imported(known[name], "law")
    if not callable(make):
        raise PlugInError(f"{who} is neither a class nor a function")
    require_options(make, who, options)
    try:
        law: OwnLaw = make(**options)
    except ValueError as error:
        raise OptionError(f"{who}: {error}") from error
    except Exception as error:  # whatever it is, the other package did it
        raise PlugInError(f"{who} cannot be constructed: {in_words(error)}") from error
    if not callable(getattr(law, "step", None)):
        raise PlugInError(f"{who} has no method step(sample) that returns volts")
    return law
