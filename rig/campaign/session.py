"""One session of a campaign: what is missing in the folder is done, then summed up and drawn."""

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
from rig.recording.folder import CONFIG, json_text, write_whole

SUMMARY = "summary.json"
SYSTEMATIC = 16  # experiments: where so many fail and none has not, all will


@dataclass(frozen=True)
class CampaignSession:
    """How a session ended.

    folder       the campaign's
    done, added  experiments of the campaign that have a row now, and those of them that this session did
    seconds      of this session, without summary and drawing
    interrupted  ended by Ctrl-C: the folder can be resumed
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
    """Do the experiments that ``folder`` has no row of yet; write its summary.json, campaign.png and report.html.

    on_progress  told after each chunk: experiments done, of how many
    Raises CampaignError as ``results.opened`` and ``runner.workers``; BrokenOffError where the first ``SYSTEMATIC``
    experiments of the folder, or all of fewer, fail: none of them is kept; OSError or RecordingError where the folder
    cannot be written.
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
        from rig.campaign.report import write_report  # matplotlib takes its time to load

        write_whole(folder / SUMMARY, json_text(found).encode("utf-8"))
        write_report(folder, campaign, table, found)
    return CampaignSession(folder, done, added, seconds, False, found)


def _fill(file: results.ResultFile, campaign: Campaign, missing: list[int], tell: Callable[[int, int], None]) -> None:
    """Append the rows of the missing experiments as they come."""
    with warnings.catch_warnings(), closing(runner.stream_trials(campaign, missing)) as chunks:
        # joblib says so after a Ctrl-C, where it is what was asked for
        warnings.filterwarnings("ignore", ".*have been cancelled", UserWarning)
        left = len(missing)
        held: list[Row] = []  # that failed, before there was one that did not
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
                    f"{file.folder}: the first {len(held)} experiments all failed, the first of them by "
                    f"{held[0]['reasons']}",
                    f"see where: {repeated_by(file.folder, held[0]['number'])}",
                )


def repeated_by(folder: Path, number: int) -> str:
    """The command that does one experiment of a campaign folder again: it shows the row, or where it fails."""
    return shlex.join(["rig", "campaign", str(folder / CONFIG), "--experiment", str(number)])
