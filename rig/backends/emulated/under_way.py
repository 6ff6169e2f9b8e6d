"""What is under way on an emulated line: sent at some time, there at a later one. Pure: the caller gives the time."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from typing import Generic, TypeVar

Sent = TypeVar("Sent")


class UnderWay(Generic[Sent]):
    """Things by their time of arrival, s; in the order of sending where that is the same."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Sent]] = []
        self._n = 0

    def __len__(self) -> int:
        return len(self._heap)

    def send(self, what: Sent, arrives_s: float) -> None:
        """Something will arrive then."""
        self._n += 1
        heapq.heappush(self._heap, (arrives_s, self._n, what))

    def next_s(self) -> float:
        """When the next one arrives; inf: nothing is under way."""
        return self._heap[0][0] if self._heap else math.inf

    def take(self) -> tuple[float, Sent]:
        """The next one, and when it arrives. Raises IndexError where nothing is under way."""
        at_s, _, what = heapq.heappop(self._heap)
        return at_s, what

    def arrived(self, t_s: float) -> list[Sent]:
        """What has arrived by ``t_s``, in order, once."""
        there = []
        while self.next_s() <= t_s:
            there.append(self.take()[1])
        return there

    def change(self, changed: Callable[[float, Sent], tuple[float, Sent] | None]) -> None:
        """Give each another time and content; one for which ``changed`` has None never arrives."""
        found = [(changed(at_s, what), n) for at_s, n, what in self._heap]
        self._heap = [(new[0], n, new[1]) for new, n in found if new is not None]
        heapq.heapify(self._heap)

    def clear(self) -> None:
        """Nothing of it arrives."""
        self._heap.clear()
