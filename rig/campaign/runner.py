"""Trials on all cores or on a cluster: chunks of experiments go out, and their rows come back when they are ready."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from functools import cache
from multiprocessing import resource_tracker
from typing import Any, Literal

import joblib

from rig.campaign.grid import BrokenOffError, CampaignError
from rig.campaign.trial import Row, row_of
from rig.config import Campaign

Backend = Literal["joblib", "dask"]

CHUNK = 8  # experiments that a worker takes at a time: a fraction of a second of work
JOIN_S = 15.0  # longest wait for a cluster, s


def run_chunk(campaign: Campaign, numbers: Sequence[int]) -> list[Row]:
    """The rows of these experiments, one after the other."""
    if multiprocessing.parent_process() is not None:
        _end_with_parent()
    return [row_of(campaign, number) for number in numbers]


@cache
def _end_with_parent() -> None:
    """End this worker when its parent was killed. joblib's worker would wait five minutes for work."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold a Ctrl-C until the end of the block. Processes that start in it never get one: only their parent does."""
    resource_tracker.ensure_running()  # first: it lets signals through while it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def workers(backend: Backend, jobs: int, scheduler: str | None = None) -> Iterator[None]:
    """The workers for ``stream_trials`` in the block.

    backend    "joblib": processes of this machine; "dask": a cluster
    jobs       number of processes; not used with a scheduler
    scheduler  address of the cluster's scheduler; without one, dask starts ``jobs`` local processes
    Each worker has one thread: the matrices are thin, and the workers fill the cores already.
    Raises CampaignError if dask is not installed, or if no cluster answers.
    """
    if backend == "joblib":
        with joblib.parallel_config(backend="loky", n_jobs=jobs, inner_max_num_threads=1):
            yield
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise CampaignError(
            "dask is not installed", "pip install 'motor-rig[campaign]', or --backend joblib"
        ) from error
    cluster: Any
    if scheduler is None:
        # dask itself gives its workers OMP_NUM_THREADS=1 and the like
        with _interrupts_held():
            cluster = LocalCluster(  # type: ignore[no-untyped-call]
                n_workers=jobs,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
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
    """Rows of the experiments, chunk by chunk, in the order in which the ``workers`` finish them.

    Raises BrokenOffError if a process of this machine was killed.
    """
    chunks = [list(numbers[k : k + CHUNK]) for k in range(0, len(numbers), CHUNK)]
    with _interrupts_held():
        rows = joblib.Parallel(return_as="generator_unordered")(
            joblib.delayed(run_chunk)(campaign, chunk) for chunk in chunks
        )
    try:
        yield from rows
    except BrokenProcessPool as error:
        raise BrokenOffError(
            "a worker process was killed: the machine ran out of memory, or somebody killed it",
            "the rows so far are kept: run the command again to go on; fewer --jobs need less memory",
        ) from error
