"""Trials over all cores, or over a cluster: chunks of experiments, their rows as they come."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import joblib

from rig.campaign.trial import Row, run_trial
from rig.config.campaign import Campaign

CHUNK = 8  # experiments that a worker takes at once: about a second of work


def run_chunk(campaign: Campaign, numbers: Sequence[int]) -> list[Row]:
    """The rows of these experiments, one after the other."""
    return [run_trial(campaign, number) for number in numbers]


def stream_trials(campaign: Campaign, numbers: Sequence[int], jobs: int) -> Iterator[list[Row]]:
    """Rows of the experiments, a chunk at a time, in whatever order the chunks get ready.

    jobs  processes, >= 1; under another ``joblib.parallel_config`` its workers
    """
    chunks = [numbers[k : k + CHUNK] for k in range(0, len(numbers), CHUNK)]
    # one thread a worker: the matrices are thin, and the workers fill the cores already
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        yield from joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
            joblib.delayed(run_chunk)(campaign, chunk) for chunk in chunks
        )


def run_trials(campaign: Campaign, numbers: Sequence[int], jobs: int = 2) -> list[Row]:
    """Rows of the experiments, by number."""
    rows = [row for chunk in stream_trials(campaign, numbers, jobs) for row in chunk]
    return sorted(rows, key=lambda row: int(row["number"]))
