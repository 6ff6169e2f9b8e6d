"""Compiled loops: they are announced when they are compiled, and not when they are on disk."""

from __future__ import annotations

from pathlib import Path

import pytest
from numba.core import config

from rig.model.compiled.kernel import compiling, kernel


def doubled(value: float) -> float:
    """A loop of no length."""
    return 2.0 * value


def test_a_loop_is_announced_once_it_is_compiled_and_not_when_it_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    told: list[str] = []
    with compiling(lambda: told.append("compiles")):
        assert kernel(doubled)(1.5) == 3.0
        assert told == ["compiles"]
        assert kernel(doubled)(2.5) == 5.0
        assert told == ["compiles"]
    kernel(doubled)(1)
    assert told == ["compiles"]
