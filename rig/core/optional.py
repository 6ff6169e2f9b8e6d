"""Packages that rig can use, but does not require. Any room may import this module."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def needed(package: str, purpose: str) -> Any:
    """The package that ``purpose`` needs. Raises ImportError, which says what to install, if it is missing."""
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"{purpose} needs the package {package}, which is not installed: python3 -m pip install {package}, "
            "or all that a notebook needs, in rig's clone: python3 -m pip install '.[notebook]'"
        ) from error
