"""How a benchmark is asked and answers: one JSON object for `make bench`, lines for people."""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Mapping


def options(words: str) -> argparse.ArgumentParser:
    """The command line that every benchmark has."""
    parser = argparse.ArgumentParser(description=words)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def tell(result: Mapping[str, object], *, as_json: bool, text: str | None = None) -> None:
    """Print what was measured; ``text``: for people, where a line a number is not it."""
    lines = (
        f"{name}: {value:.6g}" if isinstance(value, int | float) else f"{name}: {value}"
        for name, value in result.items()
    )
    print(json.dumps(result) if as_json else text if text is not None else "\n".join(lines))


def median_s(work: Callable[[], object], times: int) -> float:
    """Median time of a call, s; the first, which may compile, does not count."""
    work()
    taken = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begin)
    return statistics.median(taken)
