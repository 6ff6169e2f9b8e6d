"""Keys of ``daq`` that only some devices have."""

from __future__ import annotations

from collections.abc import Iterator

from rig.config.problems import Problem, wrong
from rig.config.schema import Experiment


def foreign_keys(e: Experiment, *taken: str, instead: str = "remove it") -> Iterator[Problem]:
    """A problem for each key that is given and that this device does not have.

    ``taken`` are the keys that it has, of port, adapter, modbus and options.

    instead  the hint for daq.adapter
    """
    daq = e.daq
    given = {"port": daq.port, "adapter": daq.adapter, "modbus": daq.modbus, "options": daq.options}
    for key, value in given.items():
        if value is None or key in taken:
            continue
        if key == "port":
            yield wrong("daq.port", f"`driver: {daq.driver}` has no port", "remove it, or set daq.driver to serial")
        elif key == "options":
            yield wrong("daq.options", f"is a key of plug-in drivers, not of `driver: {daq.driver}`", "remove it")
        elif key == "adapter":
            yield wrong("daq.adapter", f"is a key of `driver: serial`, not of `{daq.driver}`", instead)
        else:
            yield wrong("daq.modbus", f"is a key of `driver: modbus`, not of `driver: {daq.driver}`", "remove it")


def keys_of_built_in(e: Experiment) -> Iterator[Problem]:
    """A problem for each key that is given and that no plug-in device has."""
    if e.daq.adapter is not None:
        yield wrong("daq.adapter", f"is a key of `driver: serial`, not of `{e.daq.driver}`", "remove it")
    for key in ("port", "modbus"):
        if getattr(e.daq, key) is not None:
            yield wrong(f"daq.{key}", f"is a key of built-in drivers, not of `{e.daq.driver}`", "see daq.options")
