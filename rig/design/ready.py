"""Compiles what the advisor needs before the first row: compiling would take longer than the tests."""

from __future__ import annotations


def make_ready() -> None:
    """Nothing yet."""
