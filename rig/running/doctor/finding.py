"""What the doctor found about one thing."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

from rig.core.signals import plain

State = Literal["good", "note", "poor", "bad"]


@dataclass(frozen=True)
class Finding:
    """One thing that `rig doctor` looked at.

    topic  its name, in a word or two
    state  good; note: neither good nor bad; poor: the loop runs, but later or less reliably; bad: it will not hold
    words  what rig saw, with numbers
    cure   what to type or to change; empty where nothing is wrong
    """

    topic: str
    state: State
    words: str
    cure: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "words", plain(self.words))  # it may quote a port's name or a device
        object.__setattr__(self, "cure", plain(self.cure))

    def lines(self) -> list[str]:
        """For people: what was found, and what to type."""
        return [f"{self.state:>5}  {self.topic}: {self.words}", *([f"       -> {self.cure}"] if self.cure else [])]

    def as_dict(self) -> dict[str, str]:
        """As `rig doctor --json` prints it."""
        return asdict(self)


def good(topic: str, words: str) -> Finding:
    """As it should be."""
    return Finding(topic, "good", words)


def note(topic: str, words: str, cure: str = "") -> Finding:
    """Neither good nor bad."""
    return Finding(topic, "note", words, cure)


def poor(topic: str, words: str, cure: str = "") -> Finding:
    """The loop runs, but later or less reliably."""
    return Finding(topic, "poor", words, cure)


def bad(topic: str, words: str, cure: str = "") -> Finding:
    """It will not hold."""
    return Finding(topic, "bad", words, cure)
