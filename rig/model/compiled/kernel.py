"""How the loops of this room are compiled: they call the plain functions of ``rig.model``, and are kept on disk.

numba compares only a loop's own file with the compiled copy on disk. A loop here also calls functions of other files,
so the text of all of them is part of the key.

The loops take plain tuples of numbers and name them (``Plant``, ``State``) inside. For a named tuple numba would need
5 us at each call to find its type, and could not read its copy on disk once the class has gone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, TypeVar

from numba import njit
from numba.core.caching import FunctionCache
from numba.extending import register_jitable

from rig.model import real_step, step, stribeck

PARTS: tuple[ModuleType, ...] = (stribeck, step, real_step)  # whose functions the loops may call

Function = TypeVar("Function", bound=Callable[..., Any])


def _digest() -> str:
    """Digest of the text of all files that a loop may call."""
    files = [*(Path(str(part.__file__)) for part in PARTS), *sorted(Path(__file__).parent.glob("*.py"))]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()


class _Cache(FunctionCache):
    """numba's cache, with that text in the key."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The copy on disk; None without one: then numba compiles."""
        found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if found is None:
            for begins in _told:
                begins()
        return found

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return super()._index_key(sig, codegen), SOURCE  # type: ignore[no-untyped-call]


_told: list[Callable[[], None]] = []


@contextmanager
def compiling(begins: Callable[[], None]) -> Iterator[None]:
    """Call ``begins`` before each loop that is compiled within the block because it is not on disk."""
    _told.append(begins)
    try:
        yield
    finally:
        _told.remove(begins)


def kernel(function: Function) -> Function:
    """A loop over samples, compiled at its first call, and kept on disk until it or what it calls changes."""
    compiled = njit(function)
    compiled._cache = _Cache(function)  # type: ignore[no-untyped-call]
    return compiled  # type: ignore[no-any-return]


SOURCE = _digest()
for part in PARTS:
    for value in vars(part).values():
        if isinstance(value, FunctionType) and value.__module__ == part.__name__:
            register_jitable(value)
