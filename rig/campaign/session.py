"""One session of a campaign: what is missing in the folder is done, then summed up and drawn."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.campaign import results, runner, summary
from rig.campaign.report import write_report
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
    wanted = range(campaign.experiments)
    tell = on_progress or (lambda done, of: None)
    began = time.perf_counter()
    interrupted = False
    with results.opened(folder, campaign) as file:
        missing = [number for number in wanted if number not in file.done]
        before = len(wanted) - len(missing)
        tell(before, len(wanted))
        added = 0
        try:
            if missing:
                with runner.workers(backend, jobs, scheduler), closing(runner.stream_trials(campaign, missing)) as rows:
                    for chunk in rows:
                        file.append(chunk)
                        added += len(chunk)
                        tell(before + added, len(wanted))
        except KeyboardInterrupt:
            interrupted = True
        seconds = time.perf_counter() - began
        if interrupted:
            return Session(folder, before + added, added, seconds, True, {})
        table = results.read(folder, campaign.experiments)
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
        (folder / SUMMARY).write_text(json_text(found), encoding="utf-8")
        write_report(folder, campaign, table, found)
    return Session(folder, before + added, added, seconds, False, found)
