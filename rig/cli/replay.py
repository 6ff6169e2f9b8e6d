"""`rig replay`: compute each drive of a run again."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from rig.cli.shared import EXIT_FAILED, JSON, PATH, asks_json, say_json
from rig.cli.terminal import progress, show_replay


@click.command()
@click.argument("run_folder", metavar="RUN", type=PATH)
@JSON
def replay(run_folder: Path) -> None:
    """Replay a run: compute each drive again and compare.

    The recorded samples go through laws and guard again. Prints that each drive is the same, tick for tick, or the
    first difference.
    """
    from rig.running.replay import replay as replay_run

    with progress(f"replaying {run_folder.name}", asks_json()) as on_progress:
        done = replay_run(run_folder, on_progress)
    if asks_json():
        say_json(done.as_json())
    else:
        show_replay(done)
    sys.exit(0 if done.is_same else EXIT_FAILED)
