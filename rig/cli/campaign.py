"""`rig campaign`: thousands of simulated experiments."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Literal

import click

from rig import config
from rig.cli.shared import CONFIG, EXIT_FAILED, FOLDER, JSON, asks_json, fail, say_json
from rig.cli.terminal import progress, show_campaign


@click.command()
@CONFIG
@click.option(
    "--out", type=FOLDER, default=Path("runs"), show_default=True,
    help="Folder in which rig makes the campaign's folder. The same campaign goes on where it stopped.",
)  # fmt: skip
@click.option(
    "--resume", type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Go on in this campaign folder.",
)  # fmt: skip
@click.option("--number", type=click.IntRange(1), help="Number of experiments, instead of the config's.")
@click.option(
    "--experiment", "only", metavar="K", type=click.IntRange(0),
    help="Run only experiment K, and print its row, or where it fails. No file is written.",
)  # fmt: skip
@click.option("--jobs", type=click.IntRange(1, 1024), help="Number of processes. Default: one per core.")
@click.option("--backend", type=click.Choice(["joblib", "dask"]), default="joblib", show_default=True,
    help="What runs the processes.",
)  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", help="Dask cluster to join. Default: start one here.")
@JSON
def campaign(
    config_path: Path,
    out: Path,
    resume: Path | None,
    number: int | None,
    only: int | None,
    jobs: int | None,
    backend: Literal["joblib", "dask"],
    scheduler: str | None,
) -> None:
    """Simulate and identify thousands of random experiments.

    Prints the errors beside the smallest possible ones (Cramér-Rao), and how often the intervals hold the true value.
    """
    asked = config.load_campaign(config_path)
    if scheduler is not None and backend != "dask":
        fail("--scheduler needs Dask", "add --backend dask")
    asked = asked if number is None else asked.model_copy(update={"experiments": number})
    if only is not None and only >= asked.experiments:
        fail(f"there is no experiment {only}", f"give --experiment 0 to {asked.experiments - 1}")
    folder = resume or out
    try:
        if only is not None:
            from rig.campaign.trial import run_trial

            say_json(run_trial(asked, only))  # a defect ends here in its traceback
            return
        try:
            from rig.campaign import results, session
        except ModuleNotFoundError as error:
            fail(
                f"many experiments at once need the package {error.name}, which is not installed",
                "python3 -m pip install 'motor-rig[campaign]', or in rig's clone: python3 -m pip install '.[campaign]'",
            )
        folder = resume or results.folder_for(out, asked)
        jobs = jobs or os.cpu_count() or 1
        with progress(f"campaign {asked.name}", asks_json()) as on_progress:
            done = session.run(asked, folder, jobs=jobs, backend=backend, scheduler=scheduler, on_progress=on_progress)
    except OSError as error:
        fail(
            f"{folder}: {error.strerror}",
            "the rows so far are kept: the same command goes on there",
            status=EXIT_FAILED,
        )
    except KeyboardInterrupt:
        fail("interrupted; no experiment was going on", "the same command goes on", status=EXIT_FAILED)
    if done.summary is None:
        fail(
            f"interrupted: {done.done} of {asked.experiments} experiments are done in {folder}",
            "the same command goes on from there",
            status=EXIT_FAILED,
        )
    if asks_json():
        say_json(done.summary | {"folder": str(folder)})
    else:
        show_campaign(done.summary, folder)
    sys.exit(EXIT_FAILED if done.summary["failed"] else 0)
