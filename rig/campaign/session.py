"""One session of a campaign: it does the missing experiments, then sums up and draws all of them.

Chunks of experiments go out to all cores or to a cluster, and their rows come back when they are ready.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import shlex
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Literal

import joblib

from rig.campaign import results, summary
from rig.campaign.random_motors import BrokenOffError, CampaignError
from rig.campaign.trial import FAILED, Row, row_of
from rig.config import Campaign
from rig.run_folder.recording.folder import CONFIG, json_text, write_whole

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
            cluster = LocalCluster(
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
            client = Client(where, timeout=JOIN_S)
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


SUMMARY = "summary.json"
SYSTEMATIC = 16  # experiments: if the first 16 all fail, the rest will fail too


@dataclass(frozen=True)
class CampaignSession:
    """The outcome of a session.

    folder       of the campaign
    done, added  experiments of the campaign that have a row now, and how many of them this session did
    seconds      time of this session, s, without summary and drawing
    interrupted  whether Ctrl-C ended it: the folder can be resumed
    summary      of the rows, and this session's speed; None if interrupted
    """

    folder: Path
    done: int
    added: int
    seconds: float
    interrupted: bool
    summary: summary.Summary | None


def run(
    campaign: Campaign,
    folder: Path,
    *,
    jobs: int,
    backend: Backend = "joblib",
    scheduler: str | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> CampaignSession:
    """Do the experiments that have no row in ``folder`` yet. Write its summary.json, campaign.png and report.html.

    on_progress  called after each chunk with the experiments done, and of how many
    Raises CampaignError as ``results.opened`` and ``workers`` do; OSError or RecordingError if the folder cannot
    be written; BrokenOffError if the first ``SYSTEMATIC`` experiments of the folder fail, or all of fewer. It keeps no
    row of these.
    """
    tell = on_progress or (lambda done, of: None)
    began = time.perf_counter()
    with results.opened(folder, campaign) as file:
        more = 1 + max(file.done, default=-1)
        if more > campaign.experiments:
            raise CampaignError(
                f"{folder}: has experiments up to number {more - 1} already",
                f"ask for at least {more}, or choose another folder",
            )
        missing = [number for number in range(campaign.experiments) if number not in file.done]
        before = campaign.experiments - len(missing)
        interrupted = False
        tell(before, campaign.experiments)
        try:
            if missing:
                with workers(backend, jobs, scheduler):
                    _fill(file, campaign, missing, tell)
        except KeyboardInterrupt:
            interrupted = True
        seconds = time.perf_counter() - began
        table = results.read(folder, campaign.experiments)
        done = int(table["number"].size)
        added = done - before
        if interrupted:
            return CampaignSession(folder, done, added, seconds, True, None)
        sums = summary.summarise(table)
        found: summary.Summary = {
            "campaign": campaign.name,
            "session": {
                "backend": backend,
                "workers": scheduler or f"{jobs} local processes",
                "experiments": added,
                "seconds": seconds,
                "experiments_per_s": added / seconds if added else None,
            },
            **sums,
            "repeat": repeated_by(folder, sums["failed"][0]) if sums["failed"] else None,
        }
        from rig.campaign.report import write_report  # here: matplotlib loads slowly

        write_whole(folder / SUMMARY, json_text(found))
        write_report(folder, campaign, table, found)
    return CampaignSession(folder, done, added, seconds, False, found)


def _fill(file: results.ResultFile, campaign: Campaign, missing: list[int], tell: Callable[[int, int], None]) -> None:
    """Append the rows of the missing experiments as they come."""
    with warnings.catch_warnings(), closing(stream_trials(campaign, missing)) as chunks:
        # joblib warns after a Ctrl-C, though the user asked for the end
        warnings.filterwarnings("ignore", ".*have been cancelled", UserWarning)
        left = len(missing)
        held: list[Row] = []  # failed rows, until one experiment succeeds
        sound = bool(file.done)
        for rows in chunks:
            held += rows
            sound = sound or any(row["verdict"] != FAILED for row in rows)
            left -= len(rows)
            if sound:
                file.append(held)
                held = []
                tell(campaign.experiments - left, campaign.experiments)
            elif len(held) >= min(SYSTEMATIC, len(missing)):
                raise BrokenOffError(
                    f"{file.folder}: the first {len(held)} experiments all failed; the first error: "
                    f"{held[0]['reasons']}",
                    f"repeat it to see where: {repeated_by(file.folder, int(held[0]['number']))}",
                )


def repeated_by(folder: Path, number: int) -> str:
    """The command that repeats one experiment of a campaign folder. It shows the row, or where it fails."""
    return shlex.join(["rig", "campaign", str(folder / CONFIG), "--experiment", str(number)])
