"""One session of a campaign: it does the missing experiments, then sums up and draws all of them."""

from __future__ import annotations

import shlex
import time
import warnings
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from rig.campaign import results, runner, summary
from rig.campaign.grid import BrokenOffError, CampaignError
from rig.campaign.trial import FAILED, Row
from rig.config import Campaign
from rig.run_folder.recording.folder import CONFIG, json_text, write_whole

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
    backend: runner.Backend = "joblib",
    scheduler: str | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> CampaignSession:
    """Do the experiments that have no row in ``folder`` yet. Write its summary.json, campaign.png and report.html.

    on_progress  called after each chunk with the experiments done, and of how many
    Raises CampaignError as ``results.opened`` and ``runner.workers`` do; OSError or RecordingError if the folder cannot
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
                with runner.workers(backend, jobs, scheduler):
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

        write_whole(folder / SUMMARY, json_text(found).encode("utf-8"))
        write_report(folder, campaign, table, found)
    return CampaignSession(folder, done, added, seconds, False, found)


def _fill(file: results.ResultFile, campaign: Campaign, missing: list[int], tell: Callable[[int, int], None]) -> None:
    """Append the rows of the missing experiments as they come."""
    with warnings.catch_warnings(), closing(runner.stream_trials(campaign, missing)) as chunks:
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
