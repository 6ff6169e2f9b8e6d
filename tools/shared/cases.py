"""Many cases, spread over processes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from joblib import Parallel, delayed

Result = TypeVar("Result")


def spread(
    work: Callable[..., Result], cases: Sequence[tuple[Any, ...]], *, jobs: int | None = None, batch: int = 1
) -> Iterator[Result]:
    """What ``work`` makes of each case's arguments, in the order of the cases, each as soon as those before are there.

    work   a function of a module: its processes start anew, without this one's threads
    jobs   processes at a time (default: one a core)
    batch  cases that a process takes at once
    """
    parallel = Parallel(n_jobs=jobs or os.cpu_count() or 1, batch_size=batch, return_as="generator")
    yield from parallel(delayed(work)(*case) for case in cases)
