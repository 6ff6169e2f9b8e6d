"""rig: relay-feedback identification and tracking control of a friction-impeded DC motor.

The names below are the Python API (docs/api.md). They are loaded when they are first asked for: scipy and matplotlib
take a second, which `import rig` does not.
"""

from __future__ import annotations

from importlib import import_module

from rig.core.errors import RigError

TYPE_CHECKING = False  # as of typing, which takes longer to load than all of this
if TYPE_CHECKING:
    from rig.api import (
        Compared,
        CompareError,
        Fault,
        Found,
        Motor,
        RealMotor,
        Run,
        Sample,
        Sampling,
        compare,
        coulomb,
        identify,
        predict,
        read,
        ready,
        relay,
        replay,
        run,
        simulate,
    )
    from rig.core.package import VERSION as __version__

__all__ = [
    "CompareError",
    "Compared",
    "Fault",
    "Found",
    "Motor",
    "RealMotor",
    "RigError",
    "Run",
    "Sample",
    "Sampling",
    "__version__",
    "compare",
    "coulomb",
    "identify",
    "predict",
    "read",
    "ready",
    "relay",
    "replay",
    "run",
    "simulate",
]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'rig' has no attribute {name!r}")
    if name == "__version__":
        from rig.core.package import VERSION as value
    else:
        value = getattr(import_module("rig.api"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
