"""Problems in a config: one per line, with place, key and hint."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from rig.core.errors import RigError
from rig.core.signals import plain

Path = tuple[str | int, ...]  # keys and list indices from the top, e.g. ("relay", "gains", 0, "h1_V")


def key_of(path: Path) -> str:
    """A path as people write it: ``relay.gains[0].h1_V``; control characters escaped."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += ("." if text else "") + printable(part)
    return text


def printable(text: str) -> str:
    """``text`` on one line: what does not print is escaped, and a long text is cut at 60 characters."""
    return plain(text if len(text) <= 60 else text[:57] + "...")


def bracketed(interval: tuple[float, float]) -> str:
    """An interval as people write it: [low, high], four digits."""
    return f"[{interval[0]:.4g}, {interval[1]:.4g}]"


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    path     the key, from the top; () where it is the file as a whole
    message  what is wrong
    hint     what to do; may be empty
    file, line, column   where, counted from 1; "" and 0 where that is not known
    ``str`` gives one line: ``file:line:column: key: message; hint``.
    """

    path: Path
    message: str
    hint: str = ""
    file: str = ""
    line: int = 0
    column: int = 0

    @property
    def key(self) -> str:
        """The key in words, "" for the file as a whole."""
        return key_of(self.path)

    def at(self, file: str, line: int, column: int) -> Problem:
        """The same problem, with its place."""
        return replace(self, file=file, line=line, column=column)

    def __str__(self) -> str:
        place = self.file + (f":{self.line}:{self.column}" if self.line else "")
        parts = [part for part in (place, self.key) if part]
        return plain(": ".join([*parts, self.message]) + (f"; {self.hint}" if self.hint else ""))


def wrong(key: str, message: str, hint: str = "") -> Problem:
    """A problem of ``key``, written with dots: ``daq.port``."""
    return Problem(tuple(key.split(".")), message, hint)


class ConfigError(RigError):
    """A configuration that cannot be used. ``problems``: what is wrong, at least one; ``str``: one line each."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))
