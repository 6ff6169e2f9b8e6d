"""One session of a campaign: what is missing in the folder is done, then summed up and drawn."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.campaign import results, runner, summary
from rig.campaign.grid import CampaignError
from rig.config import Campaign
from rig.recording.folder import json_text

SUMMARY = "summary.json"


@dataclass(frozen=True)
class Session:
    """How a session ended.

    folder       the campaign's
    done, added  experiments of the campaign that have a row now, and those of them that this session did
    seconds      of this session, without summary and drawing
    interrupted  ended by Ctrl-C: the folder can be resumed
    summary      ``summary.summarise`` of the rows, and this session's speed; empty if interrupted
    """

    folder: Path
    done: int
    added: int
    seconds: float
    interrupted: bool
    summary: dict[str, Any]


def run(
    campaign: Campaign,
    folder: Path,
    *,
    jobs: int,
    backend: runner.Backend = "joblib",
    scheduler: str | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Session:
    """Do the experiments that ``folder`` has no row of yet; write its summary.json, campaign.png and report.html.

    on_progress  told after each chunk: experiments done, of how many
    Raises CampaignError as ``results.opened`` and ``runner.workers``, OSError where the folder cannot be written.
    """
    tell = on_progress or (lambda done, of: None)
    began = time.perf_counter()
    with results.opened(folder, campaign) as file:
        more = 1 + max(file.done, default=-1)
        if more > campaign.experiments:
            raise CampaignError(
                f"{folder}: has experiments up to number {more - 1} already", f"ask for {more} at least, or elsewhere"
            )
        missing = [number for number in range(campaign.experiments) if number not in file.done]
        before = campaign.experiments - len(missing)
        interrupted = False
        tell(before, campaign.experiments)
        try:
            if missing:
                with runner.workers(backend, jobs, scheduler):
                    _fill(file, campaign, missing, tell)
        except KeyboardInterrupt:
            interrupted = True
        seconds = time.perf_counter() - began
        table = results.read(folder, campaign.experiments)
        done = int(table["number"].size)
        added = done - before
        if interrupted:
            return Session(folder, done, added, seconds, True, {})
        found = {
            "campaign": campaign.name,
            "session": {
                "backend": backend,
                "workers": scheduler or f"{jobs} local processes",
                "experiments": added,
                "seconds": seconds,
                "experiments_per_s": added / seconds if added else None,
            },
            **summary.summarise(table),
        }
        from rig.campaign.report import write_report  # matplotlib takes its time to load

        (folder / SUMMARY).write_text(json_text(found), encoding="utf-8")
        write_report(folder, campaign, table, found)
    return Session(folder, done, added, seconds, False, found)


def _fill(file: results.ResultFile, campaign: Campaign, missing: list[int], tell: Callable[[int, int], None]) -> None:
    """Append the rows of the missing experiments as they come."""
    with warnings.catch_warnings(), closing(runner.stream_trials(campaign, missing)) as chunks:
        # joblib says so after a Ctrl-C, where it is what was asked for
        warnings.filterwarnings("ignore", ".*have been cancelled", UserWarning)
        left = len(missing)
        for rows in chunks:
            file.append(rows)
            left -= len(rows)
            tell(campaign.experiments - left, campaign.experiments)
