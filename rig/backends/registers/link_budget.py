"""What the exchanges of one tick take on a serial line: bytes, silences, and the device's own time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from rig.backends.link_budget import LinkBudget, wire_term, wire_words


class Transaction(NamedTuple):
    """One request and its reply: bytes of both, framing included."""

    name: str
    request_bytes: int
    reply_bytes: int


def frames_of(asked: Iterable[Transaction]) -> dict[str, int]:
    """Bytes of each frame, by name; of a transaction without a reply only the request."""
    frames: dict[str, int] = {}
    for t in asked:
        frames[f"{t.name} request"] = t.request_bytes
        if t.reply_bytes:
            frames[f"{t.name} reply"] = t.reply_bytes
    return frames


def turnaround_term(count: int, turnaround_s: float) -> tuple[str, float]:
    """The device's own time in so many transactions, as a term."""
    return "turnaround" if count == 1 else f"{count} turnarounds", count * turnaround_s


def serial_budget(asked: Iterable[Transaction], bits: int, baud: int, *others: tuple[str, float]) -> LinkBudget:
    """Of transactions on a serial line, with other terms behind the wire's."""
    frames = frames_of(asked)
    return LinkBudget((wire_term(frames, bits, baud), *others), wire_words(frames, bits, baud))
