"""Many cases, spread over processes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from typing import Any, TypeVar

from joblib import Parallel, delayed

Result = TypeVar("Result")


def spread(
    work: Callable[..., Result], cases: Sequence[tuple[Any, ...]], *, jobs: int | None = None, batch: int = 1
) -> Iterator[tuple[int, Result]]:
    """The number of each case and what ``work`` makes of its arguments, as they get ready.

    work   a function of a module: its processes start anew, without this one's threads
    jobs   processes at a time (default: one a core)
    batch  cases that a process takes at once
    """
    parallel = Parallel(n_jobs=jobs or os.cpu_count() or 1, batch_size=batch, return_as="generator_unordered")
    yield from parallel(delayed(_numbered)(number, work, case) for number, case in enumerate(cases))


def in_order(
    work: Callable[..., Result], cases: Sequence[tuple[Any, ...]], *, jobs: int | None = None, batch: int = 1
) -> list[Result]:
    """All that ``spread`` gives, in the order of the cases."""
    return [result for _, result in sorted(spread(work, cases, jobs=jobs, batch=batch), key=itemgetter(0))]


def _numbered(number: int, work: Callable[..., Result], case: tuple[Any, ...]) -> tuple[int, Result]:
    return number, work(*case)
