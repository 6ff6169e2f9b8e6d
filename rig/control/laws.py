"""Laws that a config names in its section `law`: rig's own, and those of other packages.

A package offers one in its pyproject.toml:

    [project.entry-points."rig.laws"]
    pid = "mypackage.laws:Pid"

It is a class, or a function, that takes the config's ``law.options`` by name and gives an ``OwnLaw``.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points

from rig.control.law import OwnLaw
from rig.core.plug_ins import PlugInError, described, in_words, offered

GROUP = "rig.laws"
TUNED = "tuned"
OWN = {TUNED: EntryPoint(TUNED, "rig.control.tuned:tuned", GROUP)}  # of rig itself


class OptionError(ValueError):
    """Options that a law does not take.

    key  the option that is wrong; "" if nobody can tell
    """

    def __init__(self, message: str, key: str = "") -> None:
        self.key = key
        super().__init__(message)


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
    who = described(known[name], "law")
    try:
        make = known[name].load()
    except Exception as error:  # whatever it is, the other package did it
        raise PlugInError(f"{who} cannot be imported: {in_words(error)}") from error
    if not callable(make):
        raise PlugInError(f"{who} is neither a class nor a function")
    _check_options(make, who, options)
    try:
        law: OwnLaw = make(**options)
    except ValueError as error:
        raise OptionError(f"{who}: {error}") from error
    except Exception as error:  # as above
        raise PlugInError(f"{who} cannot be constructed: {in_words(error)}") from error
    if not callable(getattr(law, "step", None)):
        raise PlugInError(f"{who} has no method step(sample) that returns volts")
    return law


def _check_options(make: object, who: str, options: Mapping[str, object]) -> None:
    """Raise OptionError where a law cannot be called with these options."""
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
