"""rig: relay-feedback identification and tracking control of a friction-impeded DC motor.

The names below are the Python API (docs/api.md). They are loaded when they are first asked for: scipy and matplotlib
take a second, which `import rig` does not.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

from rig.errors import RigError

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
    from rig.package import VERSION as __version__

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


class _Package(ModuleType):
    """`rig.identify`, `rig.replay` and `rig.compare` are functions, although rooms have these names, too.

    Python sets a package's attribute when it loads the room. Here the function stays; `from rig.identify import ...`
    finds the room all the same.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in __all__ and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'rig' has no attribute {name!r}")
    if name == "__version__":
        from rig.package import VERSION as value
    else:
        value = getattr(import_module("rig.api"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
