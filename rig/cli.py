"""The command `rig`: its commands and options. ``rig.terminal`` shows the results.

Exit status: 0 done, 1 the experiment failed or was refused, 2 bad input.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import click
from rich.console import Console

from rig import config, preflight
from rig.backends.emulated.errors import EmulationError
from rig.faults import Fault
from rig.package import VERSION
from rig.recording.errors import CannotWriteError, RecordingError
from rig.recording.folder import json_text
from rig.results import RunMeta, RunResult, known
from rig.terminal import (
    patience,
    progress,
    show_campaign,
    show_estimates,
    show_finding,
    show_prediction,
    show_replay,
    show_run,
    show_scatter,
)

if TYPE_CHECKING:  # scipy comes with it
    from rig.identify import IdentifyError
    from rig.session import OnStart

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2


class _Rows(click.ParamType):  # type: ignore[type-arg]
    """``FIRST:LAST``; either may be left out."""

    name = "rows"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The two numbers; None for one that is left out."""
        first, colon, last = str(value).partition(":")
        if not colon or not all(part == "" or part.isdecimal() for part in (first, last)):
            self.fail(f"{value!r} must be FIRST:LAST: two row numbers, such as 120:899", param, ctx)
        return int(first) if first else None, int(last) if last else None


CONFIG = click.argument("config_path", metavar="CONFIG", type=click.Path(path_type=Path))
# In every command --out is the folder in which rig makes run folders, and --to is the file that it writes.
OUT = click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("runs"), show_default=True,
    help="Folder in which rig makes the run folder.",
)  # fmt: skip
ROWS = click.option(
    "--rows", metavar="FIRST:LAST", type=_Rows(), default=None,
    help="Only these rows, both included. They count from 0, as in messages and result.json. Leave out either.",
)  # fmt: skip
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout, and nothing else.")


def _fail(status: int, cause: str, cure: str = "") -> NoReturn:
    """Print the cause and the cure, a line each, on stderr; with --json one JSON object on stdout. Then exit."""
    if click.get_current_context().params.get("as_json"):
        click.echo(json.dumps({"ok": False, "cause": cause, "cure": cure}))
    else:
        click.echo(f"rig: {cause}", err=True)
        if cure:
            click.echo(f"     {cure}", err=True)
    sys.exit(status)


def _fail_input(error: RecordingError | IdentifyError) -> NoReturn:
    """Exit for a bad recording or a full disk: print file and line, the cause, the cure."""
    place = ""
    if isinstance(error, RecordingError):
        place = f"{error.path}: " if error.line is None else f"{error.path}:{error.line}: "
    status = EXIT_FAILED if isinstance(error, CannotWriteError) else EXIT_BAD_INPUT
    _fail(status, place + error.cause, error.cure)


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")


def _fail_config(error: config.ConfigError, verdict: str = "") -> NoReturn:
    """Exit for a bad config: print each problem with file, line and key; then ``verdict`` on stdout."""
    if click.get_current_context().params.get("as_json"):
        last = {"verdict": verdict.removeprefix("verdict: ")} if verdict else {}
        click.echo(json.dumps({"ok": False, **last, "problems": str(error).splitlines()}))
    else:
        click.echo(str(error), err=True)
        if verdict:
            click.echo(verdict)
    sys.exit(EXIT_BAD_INPUT)


def _load(path: Path, *, drives: bool = True) -> config.Experiment:
    """The checked experiment of a config file. Exits with status 2 and the problems if the config is bad.

    drives  False: no motor turns, so the config need not name the bridge; `rig doctor` reads it from the firmware
    """
    try:
        experiment, _ = preflight.check(path, () if drives else ("drive.bridge",))
    except config.ConfigError as error:
        _fail_config(error)
    return experiment


def _load_bench(path: Path) -> config.Experiment:
    """``_load`` for a command that drives a bench. If its port is missing, exits with status 1 before slow imports."""
    from rig.backends.links.device_file import require_device_file

    experiment = _load(path)
    with _faults():
        require_device_file(experiment.daq.port)
    return experiment


class _Commands(click.Group):
    """Commands that a Ctrl-C ends with one line, not a traceback, while no run's loop is going."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("rig: interrupted; no drive is on", err=True)
            ctx.exit(EXIT_FAILED)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(VERSION, prog_name="rig")
def main() -> None:
    """Identify and control a friction-impeded DC motor by relay feedback."""


@main.command()
@CONFIG
@OUT
@click.option(
    "--repeat",
    type=click.IntRange(1, 1000),
    default=1,
    help="Run it N times and show the scatter between runs. An emulated bench takes seed, seed + 1, ...",
)
@JSON
def run(config_path: Path, out: Path, repeat: int, as_json: bool) -> None:
    """Run the whole experiment, identify the motor, write a report.

    The stages: breakaway, search, relay, identify, verify, report.
    """
    experiment = _load_bench(config_path)
    if Console(stderr=True).is_terminal and not as_json:
        click.echo("opening the bench ...", err=True)
    from rig import experiment as script

    with _faults():
        outcomes = script.repeated(experiment, repeat, out, partial(_perform, as_json=as_json))
    if as_json:
        results = [outcome.as_json() for outcome in outcomes]
        ok = all(result["ok"] for result in results)
        click.echo(json_text(results[0] if repeat == 1 else {"ok": ok, "runs": results}), nl=False)
    elif repeat > 1:
        show_scatter([outcome.result for outcome in outcomes])
    sys.exit(EXIT_FAILED if any(outcome.failure for outcome in outcomes) else 0)


@main.command()
@CONFIG
@OUT
@JSON
def relay(config_path: Path, out: Path, as_json: bool) -> None:
    """Run breakaway, gain search and relay tests, and identify.

    No tracking check follows.
    """
    experiment = _load_bench(config_path)
    from rig import experiment as script

    _finish(_perform(partial(script.run_relay, experiment, out), as_json), as_json)


@main.command()
@CONFIG
@click.option(
    "--model",
    "model_run",
    required=True,
    type=click.Path(path_type=Path),
    help="Run folder from which the models come.",
)
@OUT
@JSON
def track(config_path: Path, model_run: Path, out: Path, as_json: bool) -> None:
    """Run the tracking check with the models of an earlier run."""
    experiment = _load_bench(config_path)
    from rig import experiment as script
    from rig.identify import IdentifyError, identify
    from rig.recording.reader import read_run

    if experiment.tracking is None:
        _fail(EXIT_BAD_INPUT, f"{config_path} has no section `tracking`", "add one, as in config/demo.yaml")
    try:
        models = identify([read_run(model_run)])
    except (RecordingError, IdentifyError) as error:
        _fail_input(error)
    _finish(_perform(partial(script.run_tracking, experiment, models, model_run, out), as_json), as_json)


@main.command()
@CONFIG
@click.option("--u-V", "u_V", type=float, required=True, help="Drive, V; its sign is the direction.")
@click.option("--seconds", type=click.FloatRange(0.01, 5.0), default=0.3, show_default=True, help="How long.")
@OUT
@JSON
def jog(config_path: Path, u_V: float, seconds: float, out: Path, as_json: bool) -> None:
    """Drive the shaft for a moment, within the limits.

    If it stands outside the limits, it can only be driven inward: that brings it back.
    """
    experiment = _load_bench(config_path)
    from rig import experiment as script

    if not abs(u_V) <= experiment.drive.max_V:
        _fail(
            EXIT_BAD_INPUT,
            f"--u-V {u_V:g} is beyond drive.max_V {experiment.drive.max_V:g}",
            f"ask for --u-V between {-experiment.drive.max_V:g} and {experiment.drive.max_V:g}, or raise drive.max_V",
        )
    outcome = _perform(lambda on_start: script.jog(experiment, u_V, seconds, out, on_start), as_json)
    moved = outcome.result.jog
    if moved is not None and not as_json:
        click.echo(f"y {known(moved.from_rad):+.3f} -> {known(moved.to_rad):+.3f} rad")
        if moved.refused_ticks:
            click.echo(f"the guard cut the drive in {moved.refused_ticks} ticks: it drove outward; try the other sign")
    _finish(outcome, as_json)


@main.command()
@CONFIG
@JSON
def check(config_path: Path, as_json: bool) -> None:
    """Check a config; no device is needed, nothing moves.

    Checks keys, units, limits, stopping distance and link budget, and prints what a run would do.
    """
    try:
        if config.is_campaign(config_path):
            lines = list(config.campaign_lines(config.load_campaign(config_path)))
        else:
            lines = list(preflight.check(config_path)[1].lines)
    except config.ConfigError as error:
        _fail_config(error, f"verdict: refused, {_counted(len(error.problems), 'problem')}; nothing would be run")
    notes = sum(line.startswith("note: ") for line in lines)
    verdict = f"ok with {_counted(notes, 'note')}" if notes else "ok"
    if as_json:
        click.echo(json.dumps({"ok": True, "verdict": verdict, "lines": lines}))
    else:
        click.echo("\n".join([*lines, f"verdict: {verdict}"]))


@main.command()
@click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=click.Path(path_type=Path))
@click.option(
    "--method",
    "methods",
    multiple=True,
    type=click.Choice(["sampled-data", "triple-relay", "describing-function", "least-squares"]),
    help="Repeat for several. Default: all that the data allows. "
    "least-squares takes two CSV files, each of a hysteretic relay.",
)
@ROWS
@JSON
def identify(
    paths: Sequence[Path], methods: Sequence[str], rows: tuple[int | None, int | None] | None, as_json: bool
) -> None:
    """Identify gain, time constant and friction from recordings.

    A recording is a run folder, or a CSV file with columns t_s,u_V,y_rad. Several recordings must be of one motor: rig
    says so if they do not agree.
    """
    from rig.identify import IdentifyError
    from rig.identify import identify as identify_recordings
    from rig.recording.path_kind import require_distinct
    from rig.recording.reader import read

    if rows is not None and len(paths) > 1:
        _fail(EXIT_BAD_INPUT, f"--rows takes one recording, not {len(paths)}", "identify one at a time")
    try:
        require_distinct(paths)
        with patience("reading and identifying"):
            recordings = [read(path) if rows is None else read(path).only_rows(*rows) for path in paths]
            found = identify_recordings(recordings, tuple(methods) or None)
    except (RecordingError, IdentifyError) as error:
        _fail_input(error)
    result = found.as_result()
    ok = any(not estimate.is_refused for estimate in result.estimates.values())
    if as_json:
        click.echo(json_text({"ok": ok, "records": [str(path) for path in paths], **result.as_json()}), nl=False)
    else:
        for note in result.notes:
            click.echo(note)
        show_estimates(result.estimates, None)
    sys.exit(0 if ok else EXIT_FAILED)


@main.command()
@click.option("--tau", type=float, required=True, help="Time constant, s.")
@click.option("--K", "K", type=float, required=True, help="Velocity gain, (rad/s)/V.")
@click.option("--fc", type=float, required=True, help="Coulomb friction, V.")
@click.option("--fs", type=float, default=None, help="Static friction, V. Default: as --fc.")
@click.option("--h1", type=float, required=True, help="Gain of the relay on position, V.")
@click.option("--h2", type=float, required=True, help="Gain of the relay on the integral, V.")
@JSON
def predict(tau: float, K: float, fc: float, fs: float | None, h1: float, h2: float, as_json: bool) -> None:
    """Predict limit cycle and stability for given relay gains.

    By Theorems 2.1 and 2.2, and by the describing function.
    """
    from rig.model.prediction import predict_cycle

    try:
        prediction = predict_cycle(tau, K, fc, fc if fs is None else fs, h1, h2)
    except ValueError as error:
        _fail(EXIT_BAD_INPUT, str(error), "--tau and --K must be > 0, friction and gains >= 0, --fs at least --fc")
    if as_json:
        click.echo(json.dumps(prediction.as_json()))
    else:
        show_prediction(prediction)
    sys.exit(EXIT_FAILED if prediction.exact is None else 0)


@main.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
def report(run_folder: Path) -> None:
    """Write the report of a run again, and print its path."""
    from rig.recording.path_kind import require_run
    from rig.report import write_report

    try:
        require_run(run_folder)
        with patience("drawing the report"):
            path = write_report(run_folder)
    except RecordingError as error:
        _fail_input(error)
    except OSError as error:
        _fail(EXIT_FAILED, f"{run_folder}: cannot be read: {error.strerror}", "check the disk and its permissions")
    click.echo(path)


@main.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--to", "file", required=True, type=click.Path(path_type=Path), metavar="FILE",
    help="Its suffix names the format: .mat (MATLAB, Octave), .npz (numpy), .csv (t_s,u_V,y_rad,t_u_s) or .json.",
)  # fmt: skip
@click.option("--stage", default=None, help="Only the rows of this stage, such as relay-1. Default: all.")
@ROWS
@click.option("--force", is_flag=True, help="Replace FILE if it is there already.")
@JSON
def export(
    run_folder: Path,
    file: Path,
    stage: str | None,
    rows: tuple[int | None, int | None] | None,
    force: bool,
    as_json: bool,
) -> None:
    """Write a run to one file that other programs open.

    The file holds samples, events and result; a .csv file holds the samples.
    """
    from rig.export import export as export_run

    try:
        run = export_run(run_folder, file, stage, rows, overwrite=force)
    except RecordingError as error:
        _fail_input(error)
    number = len(run.recording)
    if as_json:
        click.echo(json.dumps({"ok": True, "file": str(file), "rows": number, "notes": run.notes}))
        return
    for note in run.notes:
        click.echo(note)
    click.echo(f"{file}: {number} rows")


@main.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@JSON
def replay(run_folder: Path, as_json: bool) -> None:
    """Replay a run: compute each drive again and compare.

    The recorded samples go through laws and guard again. Prints that each drive is the same, tick for tick, or the
    first difference.
    """
    from rig.replay import replay as replay_run

    try:
        with progress(f"replaying {run_folder.name}", as_json) as on_progress:
            done = replay_run(run_folder, on_progress)
    except RecordingError as error:
        _fail_input(error)
    except config.ConfigError as error:
        _fail_config(error)
    if as_json:
        click.echo(json_text(done.as_json()), nl=False)
    else:
        show_replay(done)
    sys.exit(0 if done.is_same else EXIT_FAILED)


@main.command()
@CONFIG
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("runs"),
    show_default=True,
    help="Folder in which rig makes the campaign's folder. The same campaign goes on where it stopped.",
)
@click.option(
    "--resume",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    default=None,
    help="Go on in this campaign folder.",
)
@click.option("--number", type=click.IntRange(1), default=None, help="Number of experiments, instead of the config's.")
@click.option(
    "--experiment", "only", metavar="K", type=click.IntRange(0), default=None,
    help="Run only experiment K, and print its row, or where it fails. No file is written.",
)  # fmt: skip
@click.option("--jobs", type=click.IntRange(1, 1024), default=None, help="Number of processes. Default: one per core.")
@click.option("--backend", type=click.Choice(["joblib", "dask"]), default="joblib", show_default=True,
    help="What runs the processes.",
)  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", default=None, help="Dask cluster to join. Default: start one here.")
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
    as_json: bool,
) -> None:
    """Simulate and identify thousands of random experiments.

    Prints the errors beside the smallest possible ones (Cramér-Rao), and how often the intervals hold the true value.
    """
    try:
        asked = config.load_campaign(config_path)
    except config.ConfigError as error:
        _fail_config(error)
    if scheduler is not None and backend != "dask":
        _fail(EXIT_BAD_INPUT, "--scheduler needs Dask", "add --backend dask")
    asked = asked if number is None else asked.model_copy(update={"experiments": number})
    if only is not None and only >= asked.experiments:
        _fail(EXIT_BAD_INPUT, f"there is no experiment {only}", f"give --experiment 0 to {asked.experiments - 1}")
    folder = resume or out
    from rig.campaign.grid import BrokenOffError, CampaignError

    try:
        if only is not None:
            from rig.campaign.trial import run_trial

            click.echo(json_text(run_trial(asked, only)), nl=False)  # a defect ends here in its traceback
            return
        from rig.campaign import results, session

        folder = resume or results.folder_for(out, asked)
        jobs = jobs or os.cpu_count() or 1
        with progress(f"campaign {asked.name}", as_json) as on_progress:
            done = session.run(asked, folder, jobs=jobs, backend=backend, scheduler=scheduler, on_progress=on_progress)
    except CampaignError as error:
        _fail(EXIT_FAILED if isinstance(error, BrokenOffError) else EXIT_BAD_INPUT, error.cause, error.cure)
    except RecordingError as error:
        _fail_input(error)
    except OSError as error:
        _fail(EXIT_FAILED, f"{folder}: {error.strerror}", "the rows so far are kept: the same command goes on there")
    except KeyboardInterrupt:
        _fail(EXIT_FAILED, "interrupted; no experiment was going on", "the same command goes on")
    if done.summary is None:
        _fail(
            EXIT_FAILED,
            f"interrupted: {done.done} of {asked.experiments} experiments are done in {folder}",
            "the same command goes on from there",
        )
    if as_json:
        click.echo(json_text(done.summary | {"folder": str(folder)}), nl=False)
    else:
        show_campaign(done.summary, folder)
    sys.exit(EXIT_FAILED if done.summary["failed"] else 0)


@main.command()
@CONFIG
@click.option(
    "--link", type=click.Path(path_type=Path), default=None, help="Make a symbolic link to the port with this name."
)
@click.option(
    "--trace",
    type=click.Path(path_type=Path),
    default=None,
    help="Write the drive at the pin over time to this CSV file.",
)
@click.option("--chip", is_flag=True, help="Emulate the Uno's chip, and run its firmware on it at daq.baud.")
def emulate(config_path: Path, link: Path | None, trace: Path | None, chip: bool) -> None:
    """Run the emulated device of a config until Ctrl-C."""
    from rig.backends.registry import backend_of, emulated_board

    experiment = _load(config_path, drives=False)
    if experiment.emulated is None:
        _fail(EXIT_BAD_INPUT, f"{config_path} has no section `emulated`", "add one, as in config/demo.yaml")
    backend = backend_of(experiment)
    if chip and not backend.has_chip:
        _fail(EXIT_BAD_INPUT, "--chip emulates the Uno, which does not speak Modbus", "leave --chip out")
    from rig.loop.stop_request import stop_on_signals

    with stop_on_signals() as stop, _faults(), emulated_board(experiment, link, trace, chip=chip) as board:
        port = board.port
        click.echo(
            f"emulated device on {link or port}; set daq.port to that, and run rig in another terminal. Ctrl-C ends it."
        )
        if hint := backend.emulated_hint(experiment, str(link or port)):
            click.echo(hint)
        while stop.reason is None:
            board.check()
            time.sleep(0.1)


@main.command()
@click.argument("config_path", metavar="[CONFIG]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--seconds",
    type=click.FloatRange(0.2, 3600.0),
    default=3.0,
    show_default=True,
    help="How long to measure ticks, s.",
)
@OUT
@JSON
def doctor(config_path: Path | None, seconds: float, out: Path, as_json: bool) -> None:
    """Measure whether this machine and the link hold the period.

    Without CONFIG: this machine. With CONFIG: also the link to its device. Says what is in the way, and what to type.
    It opens and reads the device, but never arms it: nothing moves. Exit status 1 if the period will not hold.
    """
    from rig.doctor.visit import with_config, without_config

    findings = []
    with _faults():
        if config_path is None:
            visit = without_config(out, seconds)
        else:
            visit = with_config(_load(config_path, drives=False), out, seconds)
        for finding in visit:
            findings.append(finding)
            if not as_json:
                show_finding(finding)
    ok = all(finding.state != "bad" for finding in findings)
    if as_json:
        click.echo(json.dumps({"ok": ok, "findings": [finding.as_dict() for finding in findings]}))
    sys.exit(0 if ok else EXIT_FAILED)


@main.command()
@click.option("--port", default=None, help="Serial port. Default: the Uno or clone, if just one is plugged in.")
@click.option(
    "--baud", type=click.Choice(["115200", "1000000"]), default="115200", show_default=True,
    help="Baud rate of the firmware; the config's daq.baud must be the same.",
)  # fmt: skip
@click.option(
    "--bridge", type=click.Choice(["pwm-dir", "in1-in2"]), default="pwm-dir", show_default=True,
    help="Kind of inputs that the H-bridge has (docs/real-bench.md).",
)  # fmt: skip
@click.option("--tachometer", is_flag=True, help="A tachometer is wired to A1.")
@click.option("--supply", is_flag=True, help="The motor supply is wired to A2, through a divider by 4.")
@click.option("--end-switches", is_flag=True, help="End switches are wired to D5 and D6.")
@click.option(
    "--hex", "hex_file", type=click.Path(path_type=Path, exists=True, dir_okay=False), default=None,
    help="Write this file. Default: build it here, for the options above.",
)  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Build, and print the command; touch no board.")
def flash(
    port: str | None,
    baud: str,
    bridge: str,
    tachometer: bool,
    supply: bool,
    end_switches: bool,
    hex_file: Path | None,
    dry_run: bool,
) -> None:
    """Build the Arduino Uno's firmware and write it to the board.

    avrdude writes it; then rig asks the board which firmware it runs.

    Switch off the motor's supply first: while a board is written, its pins float.
    """
    from rig.backends.serial import flash as uno
    from rig.backends.serial.emulated.firmware_build import UnoOptions, build_uno

    options = UnoOptions(bridge.upper().replace("-", "_"), int(baud), tachometer, supply, end_switches)
    if hex_file is not None and options != UnoOptions(baud=int(baud)):
        _fail(
            EXIT_BAD_INPUT,
            "with --hex only --baud has an effect: the file is built already",
            "leave out the other options, or --hex",
        )
    try:
        with _faults():
            avrdude = uno.find_avrdude()
            if avrdude is None and not dry_run:
                raise uno.no_avrdude()
            if port is None:
                try:
                    found = uno.only_candidate(uno.serial_ports())
                except uno.FlashError as none:
                    if not dry_run:
                        raise
                    click.echo(f"{none.cause}: PORT stands for its port")
                    port = "PORT"
                else:
                    click.echo(f"found: {found}")
                    port = found.device
            command = uno.avrdude_command(avrdude or "avrdude", port, hex_file or build_uno(options))
            if dry_run:
                click.echo(f"would run: {shlex.join(command)}")
                if avrdude is None:
                    click.echo(f"avrdude is missing here. {uno.no_avrdude().cure}")
                return
            uno.check_port(port)
            click.echo(f"running: {shlex.join(command)}")
            uno.write(command, port, partial(click.echo, nl=False, err=True))
            click.echo("written; waiting for the board to answer ...")
            click.echo(f"{port}: {uno.in_words(uno.meet(port, int(baud)))}")
            if hex_file is None:
                click.echo(f"before you switch on the motor's supply: {uno.AT_REST[bridge]}")
    except uno.FlashError as error:
        _fail(error.status, error.cause, error.cure)


@main.command()
@click.option(
    "--to", "file", type=click.Path(path_type=Path, dir_okay=False), default=None, metavar="FILE",
    help="File to write. Default: stdout.",
)  # fmt: skip
@click.option("--out", "old_name", type=click.Path(path_type=Path, dir_okay=False), default=None, hidden=True)
@click.option(
    "--of", "of", type=click.Choice(["config", "campaign", "meta", "result"]), default="config", show_default=True,
    help="What it describes: a config, a config of `rig campaign`, a run's meta.json, or its result.json.",
)  # fmt: skip
@click.option("--campaign", "of_campaign", is_flag=True, help="The same as --of campaign.")
def schema(file: Path | None, old_name: Path | None, of: str, of_campaign: bool) -> None:
    """Write a JSON Schema of a config, for editors, or of a run's files."""
    if of_campaign and of not in ("config", "campaign"):
        _fail(EXIT_BAD_INPUT, f"--campaign and --of {of} name two schemas", "leave one of them out")
    if of in ("meta", "result"):
        from rig.results.json_schema import schema_text

        text = schema_text(RunMeta if of == "meta" else RunResult)
    else:
        text = config.schema_text(config.Campaign if of_campaign or of == "campaign" else config.Experiment)
    if old_name is not None:
        click.echo(f"note: --out is now --to: `rig schema --to {old_name}`", err=True)
    file = file or old_name
    if file is None:
        click.echo(text, nl=False)
    else:
        try:
            file.write_text(text, encoding="utf-8")
        except OSError as error:
            _fail(EXIT_BAD_INPUT, f"{file}: cannot be written: {error.strerror}", "name a file in an existing folder")


@main.group("config")
def ready_configs() -> None:
    """List the ready configs that come with rig, or copy one."""


@ready_configs.command("list")
def list_configs() -> None:
    """List the ready configs, and what each is for."""
    from rig.config import ready

    names = ready.names()
    width = max(map(len, names))
    for name in names:
        click.echo(f"{name:{width}}  {ready.purpose(name)}")


@ready_configs.command("copy")
@click.argument("name", metavar="NAME")
@click.option(
    "--to", "file", type=click.Path(path_type=Path, dir_okay=False), default=None, metavar="FILE",
    help="File to write. Default: NAME.yaml here.",
)  # fmt: skip
def copy_config(name: str, file: Path | None) -> None:
    """Copy a ready config, so that you can change it.

    It never replaces a file.
    """
    from rig.config import ready

    try:
        text = ready.text(name)
    except ready.UnknownConfigError as error:
        _fail(EXIT_BAD_INPUT, error.cause, error.cure)
    file = file or Path(f"{name.removesuffix('.yaml')}.yaml")
    try:
        with file.open("x", encoding="utf-8") as new:
            new.write(text)
    except FileExistsError:
        _fail(EXIT_BAD_INPUT, f"{file} is there already", "name another file: --to FILE")
    except OSError as error:
        _fail(EXIT_BAD_INPUT, f"{file}: cannot be written: {error.strerror}", "name a file in an existing folder")
    click.echo(f"{file}: check it with `rig check {shlex.quote(str(file))}`")


@contextlib.contextmanager
def _faults() -> Any:
    try:
        yield
    except Fault as fault:
        _fail(EXIT_FAILED, str(fault), fault.cure)
    except EmulationError as error:
        _fail(EXIT_FAILED, *str(error).split("\n", maxsplit=1))
    except RecordingError as error:
        _fail_input(error)


def _perform(start: Callable[[OnStart], Any], as_json: bool) -> Any:
    """Run with live progress (in a pipe: one line per stage), then show the result; with --json neither."""
    from rig.recording.follow import following

    with _faults(), contextlib.ExitStack() as stack:

        def on_start(folder: Path, notes: tuple[str, ...]) -> None:
            for note in notes:
                click.echo(f"rig: {note}", err=True)
            if not as_json:
                stack.enter_context(following(folder))

        outcome = start(on_start)
    if not as_json:
        show_run(outcome)
    return outcome


def _finish(outcome: Any, as_json: bool) -> NoReturn:
    if as_json:
        click.echo(json_text(outcome.as_json()), nl=False)
    sys.exit(EXIT_FAILED if outcome.failure else 0)


if __name__ == "__main__":
    main()
