"""`rig tune`: a position or velocity loop for the motor of a run, and what it will do."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli.driving import checked_bench, perform
from rig.cli.failure import EXIT_BAD_INPUT, EXIT_FAILED, fail, fail_config, fail_input, faults
from rig.cli.options import JSON, OUT, PACE
from rig.config import ConfigError
from rig.recording.errors import RecordingError
from rig.recording.folder import json_text

if TYPE_CHECKING:
    from rig.config import Experiment
    from rig.session import Outcome


@click.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--loop", type=click.Choice(["position", "velocity"]), default="position", show_default=True,
    help="What the loop controls.",
)  # fmt: skip
@click.option(
    "--bandwidth", "bandwidth_1_s", type=click.FloatRange(min=0.0, min_open=True), metavar="RAD/S",
    help="Where the response to the set-point is 3 dB down, rad/s. Default: the largest that keeps the margins.",
)  # fmt: skip
@click.option(
    "--step", type=click.FloatRange(min=0.0, min_open=True), metavar="SIZE",
    help="The step that the drive must have room for, rad; of a velocity loop rad/s. Default: a quarter of the travel, "
    "or of the largest speed.",
)  # fmt: skip
@click.option(
    "--phase-margin", "phase_deg", type=click.FloatRange(0.0, 90.0), default=45.0, show_default=True,
    help="That every motor within the intervals keeps, degrees.",
)  # fmt: skip
@click.option(
    "--gain-margin", "gain_dB", type=click.FloatRange(0.0, 40.0), default=6.0, show_default=True,
    help="The same, dB.",
)  # fmt: skip
@click.option(
    "--draws", type=click.IntRange(39, 1000), default=79, show_default=True,
    help="Motors, drawn from the intervals, on which the loop is simulated.",
)  # fmt: skip
@click.option("--to", "file", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
    help="Write the picture: .png, .svg or .pdf.",
)  # fmt: skip
@click.option("--try", "config_path", type=click.Path(path_type=Path), metavar="CONFIG",
    help="Then drive the step and the tracking on the bench of this config, and show them beside the prediction.",
)  # fmt: skip
@OUT
@PACE
@JSON
def tune(
    run_folder: Path,
    loop: str,
    bandwidth_1_s: float | None,
    step: float | None,
    phase_deg: float,
    gain_dB: float,
    draws: int,
    file: Path | None,
    config_path: Path | None,
    out: Path,
    pace: float | None,
    as_json: bool,
) -> None:
    """Tune a loop for the motor of a run, and predict what it does.

    Feed-forward by the identified law, feedback of the observed state, and an integral. The gains keep the margins for
    every motor that the run does not exclude. The step and the tracking are simulated on motors drawn from its
    intervals, with the delay, the sensor's noise and its steps. RUN must hold its config.
    """
    bench = None if config_path is None else checked_bench(config_path, pace)
    from rig.terminal import patience, progress, show_tuned

    with patience("loading"):
        from rig.report import tuned_loop
        from rig.results.meta import REHEARSAL
        from rig.run_tuning import Asked, tune_run, written_up
        from rig.tune.tuning import TuneError

    if file is not None and file.suffix.lower() not in tuned_loop.FORMATS:
        fail(EXIT_BAD_INPUT, f"{file}: rig writes no such picture", f"give one of {', '.join(tuned_loop.FORMATS)}")
    if file is not None and file.exists():
        fail(EXIT_BAD_INPUT, f"{file} is there already", "remove it, or give another name")
    if file is not None and not file.parent.is_dir():
        fail(EXIT_BAD_INPUT, f"{file.parent} is no folder", "make it first, or name a file in another folder")
    try:
        with progress("simulating motors", as_json) as on_progress:
            asked = Asked("position" if loop == "position" else "velocity", bandwidth_1_s, step, phase_deg, gain_dB)
            found = tune_run(run_folder, asked, draws, bench, on_progress)
    except RecordingError as error:
        fail_input(error)
    except ConfigError as error:
        fail_config(error)
    except TuneError as error:
        fail(EXIT_FAILED, error.cause, error.cure)
    outcome: Outcome | None = None
    result = found.result()
    if bench is not None:
        outcome = _tried(found.config_with_law(bench), out, as_json)
        record = found.record_of(outcome.folder)
        if record is not None:
            result = found.result(record)
            with faults():
                written_up(outcome.folder, outcome.result, result)
    if file is not None:
        try:
            tuned_loop.save(result, f"{loop} loop for the motor of {run_folder.name}", file)
        except OSError as error:
            fail(EXIT_FAILED, f"{file}: {error.strerror}", "choose a folder that you may write to")
    failure = "" if outcome is None else outcome.failure
    if as_json:
        tried = {} if outcome is None else {"bench_run": str(outcome.folder), "bench_failure": failure}
        made_up = {"rehearsal": True} if found.made_up else {}
        click.echo(json_text({"ok": not failure, **made_up, **result.as_json(), **tried}), nl=False)
    else:
        if found.made_up:
            click.echo(f"{run_folder.name}: {REHEARSAL}")
        show_tuned(result)
        if file is not None:
            click.echo(f"picture: {file}")
    if failure:
        sys.exit(EXIT_FAILED)


def _tried(experiment: Experiment, out: Path, as_json: bool) -> Outcome:
    """The run on the bench."""
    from rig import experiment as script

    return perform(partial(script.run, experiment, out), as_json)
