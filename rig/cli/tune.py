"""`rig tune`: a position or velocity loop for the motor of a run, and what it will do."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from rig.cli import shared
from rig.cli.driving import checked_bench, perform

if TYPE_CHECKING:
    from rig.running.session import Outcome


@click.command()
@click.argument("run_folder", metavar="MOTOR", type=shared.PATH)
@click.option(
    "--loop", type=click.Choice(["position", "velocity"]), default="position", show_default=True,
    help="What the loop controls.",
)  # fmt: skip
@click.option(
    "--bandwidth", "bandwidth_1_s", type=shared.Positive(), metavar="RAD/S",
    help="Where the response to the set-point is 3 dB down, rad/s. Default: the largest that keeps the margins.",
)  # fmt: skip
@click.option(
    "--step", type=shared.Positive(), metavar="SIZE",
    help="The step that the drive must have room for, rad; of a velocity loop rad/s. Default: a quarter of the travel, "
    "or of the largest speed.",
)  # fmt: skip
@click.option(
    "--phase-margin", "phase_deg", type=shared.FiniteRange(0.0, 90.0), default=45.0, show_default=True,
    help="That every motor within the intervals keeps, degrees.",
)  # fmt: skip
@click.option(
    "--gain-margin", "gain_dB", type=shared.FiniteRange(0.0, 40.0), default=6.0, show_default=True,
    help="The same, dB.",
)  # fmt: skip
@click.option(
    "--draws", type=click.IntRange(39, 1000), default=79, show_default=True,
    help="Motors, drawn from the intervals, on which the loop is simulated.",
)  # fmt: skip
@click.option("--to", "file", type=shared.FILE, metavar="FILE",
    help="Write the picture: .png, .svg or .pdf.",
)  # fmt: skip
@click.option("--try", "config_path", type=shared.PATH, metavar="CONFIG",
    help="Then drive the step and the tracking on the bench of this config, and show them beside the prediction.",
)  # fmt: skip
@click.option(
    "--servo", metavar="MODEL",
    help="Instead: the gains of this servo's own position loop, duty = gain x error. It writes none of them.",
)  # fmt: skip
@click.option(
    "--p-scale", type=shared.Positive(), metavar="1/RAD",
    help="For --servo: the share of full duty that a gain of 1 makes of 1 rad, as `rig servo facts` measures it. "
    "Default: all that manuals and BAM say.",
)  # fmt: skip
@click.option(
    "--supply-V", "supply_V", type=shared.Positive(), metavar="V",
    help="For --servo: its supply. Default: as the run says; the answer of a log does not say it.",
)  # fmt: skip
@shared.OUT
@shared.PACE
@shared.JSON
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
    servo: str | None,
    p_scale: float | None,
    supply_V: float | None,
    out: Path,
    pace: float | None,
) -> None:
    """Tune a loop for an identified motor, and predict what it does.

    MOTOR is a run folder, or a file with what `rig identify LOG --json` printed. Feed-forward by the identified law,
    feedback of the observed state, and an integral. The gains keep the margins for every motor that the run or the log
    does not exclude. The step and the tracking are simulated on motors drawn from its intervals, with the delay, the
    sensor's noise and its steps. A run must hold its config; of a log its own period, drives, speeds and travel count.
    """
    if servo is not None:
        _of_servo(run_folder, servo, p_scale, supply_V, (phase_deg, gain_dB))
        return
    for option, value in (("--p-scale", p_scale), ("--supply-V", supply_V)):
        if value is not None:
            shared.fail(f"{option} is for the loop of a servo", "add --servo MODEL")
    shared.require_new(file, shared.PICTURES)
    bench = None if config_path is None else checked_bench(config_path, pace)
    from rig.cli.terminal import patience, progress, show_tuned

    with patience("loading"):
        from rig.output.report import tuned_loop
        from rig.run_folder.recording.errors import CannotWriteError, RecordingError
        from rig.run_folder.results.meta import REHEARSAL
        from rig.running.run_tuning import Asked, tune_run, written_up

    with progress("simulating motors", shared.asks_json()) as on_progress:
        asked = Asked("position" if loop == "position" else "velocity", bandwidth_1_s, step, phase_deg, gain_dB)
        found = tune_run(run_folder, asked, draws, bench, on_progress)
    outcome: Outcome | None = None
    result = found.result()
    if bench is not None:
        from rig.running.experiment import script

        outcome = perform(partial(script.run, found.config_with_law(bench), out))
        try:
            record = found.record_of(outcome.folder)
        except RecordingError:
            if not outcome.failure:
                raise
            record = None  # it ended before it had rows
        if record is not None:
            result = found.result(record)
            written_up(outcome.folder, outcome.result, result)
    unsaved = ""  # why the picture is not there: what was found, and driven, is told all the same
    if file is not None:
        try:
            tuned_loop.save(result, f"{loop} loop for the motor of {run_folder.name}", file)
        except CannotWriteError as error:
            unsaved = str(error)
            click.echo(f"rig: {unsaved}", err=True)
    failure = "" if outcome is None else outcome.failure
    if shared.asks_json():
        tried = {} if outcome is None else {"bench_run": str(outcome.folder), "bench_failure": failure}
        made_up = {"rehearsal": True} if found.made_up else {}
        shared.say_json({"ok": not (failure or unsaved), **made_up, **result.as_json(), **tried})
    else:
        if found.made_up:
            click.echo(f"{run_folder.name}: {REHEARSAL}")
        show_tuned(result)
        if file is not None and not unsaved:
            click.echo(f"picture: {file}")
    if failure or unsaved:
        sys.exit(shared.EXIT_FAILED)


_ONLY_OF_RIGS_LOOP = ("loop", "bandwidth_1_s", "step", "draws", "file", "config_path")


def _of_servo(
    run_folder: Path, model: str, p_scale: float | None, supply_V: float | None, least: tuple[float, float]
) -> None:
    """The gains of a servo's own loop; ``least``: its margins, degrees and dB."""
    context = click.get_current_context()
    for name in _ONLY_OF_RIGS_LOOP:
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT:
            option = next(one.opts[0] for one in context.command.params if one.name == name)
            shared.fail(f"{option} is for rig's own loop, and --servo for the servo's", "leave one of them out")
    from rig.backends.servo.first_config import model_named
    from rig.cli.terminal import show_servo_loop
    from rig.design.tune.margins import Margins
    from rig.running.run_tuning import servo_loop_of

    servo = model_named(model)
    phase_deg, gain_dB = least
    found = servo_loop_of(run_folder, servo, Margins(gain_dB, phase_deg, 0.0), p_scale, supply_V)
    if shared.asks_json():
        shared.say_json({"ok": True, "run": run_folder.resolve().name, **found.as_json()})
    else:
        show_servo_loop(found)
