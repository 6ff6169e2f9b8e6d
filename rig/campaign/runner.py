"""Trials over all cores, or over a cluster: chunks of experiments, their rows as they get ready."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, Literal

import joblib

from rig.campaign.grid import CampaignError
from rig.campaign.trial import Row, run_trial
from rig.config import Campaign

Backend = Literal["joblib", "dask"]

CHUNK = 8  # experiments that a worker takes at once: a fraction of a second of work
JOIN_S = 15.0  # longest wait for a cluster


def run_chunk(campaign: Campaign, numbers: Sequence[int]) -> list[Row]:
    """The rows of these experiments, one after the other."""
    if multiprocessing.parent_process() is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C on the terminal is for the parent, which ends us
    return [_run(campaign, number) for number in numbers]


def _run(campaign: Campaign, number: int) -> Row:
    try:
        return run_trial(campaign, number)
    except Exception as error:
        error.add_note(f"in experiment {number} of campaign {campaign.name}, seed {campaign.seed}")
        raise


@contextmanager
def workers(backend: Backend, jobs: int, scheduler: str | None = None) -> Iterator[None]:
    """What ``stream_trials`` in the block runs on.

    joblib  ``jobs`` processes of this machine
    dask    the cluster of the scheduler at this address; without one, a cluster of ``jobs`` local processes
    One thread a worker: the matrices are thin, and the workers fill the cores already.
    Raises CampaignError where dask is not installed, or no cluster answers.
    """
    if backend == "joblib":
        with joblib.parallel_config(backend="loky", n_jobs=jobs, inner_max_num_threads=1):
            yield
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise CampaignError("dask is not installed", "pip install 'rig[cluster]', or --backend joblib") from error
    cluster: Any
    if scheduler is None:
        # its workers get OMP_NUM_THREADS=1 and the like from dask itself
        cluster = LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=jobs, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
        )
    else:
        cluster = nullcontext(scheduler)
    with cluster as where:
        try:
            client = Client(where, timeout=JOIN_S)  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            raise CampaignError(
                f"no dask scheduler at {where}: {error}", "start one (`dask scheduler`, `dask worker`), or leave it out"
            ) from error
        with client, joblib.parallel_config(backend="dask", n_jobs=-1):
            yield


def stream_trials(campaign: Campaign, numbers: Sequence[int]) -> Generator[list[Row]]:
    """Rows of the experiments, a chunk at a time, in whatever order the chunks get ready; on the ``workers``."""
    chunks = [list(numbers[k : k + CHUNK]) for k in range(0, len(numbers), CHUNK)]
    yield from joblib.Parallel(return_as="generator_unordered")(
        joblib.delayed(run_chunk)(campaign, chunk) for chunk in chunks
    )


def run_trials(campaign: Campaign, numbers: Sequence[int], jobs: int = 2) -> list[Row]:
    """Rows of the experiments, by number, from ``jobs`` processes of this machine."""
    with workers("joblib", jobs):
        rows = [row for chunk in stream_trials(campaign, numbers) for row in chunk]
    return sorted(rows, key=lambda row: int(row["number"]))
