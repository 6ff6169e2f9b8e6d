"""The ready configs that come with rig: their names, what each is for, and their text."""

from __future__ import annotations

import difflib
from itertools import takewhile
from pathlib import Path

from rig.core.errors import CauseError

_PACKAGE = Path(__file__).resolve().parents[1]
_SUFFIX = ".yaml"


class UnknownConfigError(CauseError):
    """There is no ready config of this name."""

    def __init__(self, name: str) -> None:
        near = difflib.get_close_matches(name, names(), n=1)
        cure = f"did you mean {near[0]}?" if near else "`rig config list` shows all"
        super().__init__(f"there is no ready config {name!r}", cure)


def folder() -> Path:
    """Where the ready configs are: inside an installed package, beside it in a checkout.

    Raises FileNotFoundError where they are in neither place: the installation is damaged.
    """
    for place in (_PACKAGE / "_config", _PACKAGE.parent / "config"):
        if (place / f"demo{_SUFFIX}").is_file():
            return place
    raise FileNotFoundError(f"no ready configs in {_PACKAGE} nor beside it: install rig anew")


def names() -> tuple[str, ...]:
    """Names of the ready configs, without ``.yaml``, sorted."""
    return tuple(sorted(path.stem for path in folder().glob(f"*{_SUFFIX}")))


def text(name: str) -> str:
    """Text of one of them, by its name with or without ``.yaml``. Raises UnknownConfigError."""
    name = name.removesuffix(_SUFFIX)
    if name not in names():
        raise UnknownConfigError(name)
    return (folder() / f"{name}{_SUFFIX}").read_text(encoding="utf-8")


def purpose(name: str) -> str:
    """The first sentence of its first comment. Raises UnknownConfigError."""
    head = takewhile(lambda line: line.startswith("#"), text(name).splitlines())
    comments = [line.removeprefix("#").strip() for line in head]
    words = " ".join(line for line in comments if not line.startswith("yaml-language-server"))
    return words.split(". ")[0].rstrip(".")
