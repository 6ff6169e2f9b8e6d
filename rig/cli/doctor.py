"""`rig doctor`: whether machine and link hold the period."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from rig.cli.driving import checked, say_chip_starts
from rig.cli.shared import EXIT_FAILED, JSON, OUT, PATH, FiniteRange, asks_json, fail
from rig.cli.terminal import show_finding


@click.command()
@click.argument("config_path", metavar="[CONFIG]", required=False, type=PATH)
@click.option(
    "--seconds", type=FiniteRange(0.2, 3600.0), default=3.0, show_default=True, help="How long to measure ticks, s."
)
@click.option(
    "--loopback", metavar="PORT",
    help="A bare Uno or Pico at this port, with three wires between its pins and no motor: does the real chip keep "
    "what the firmware promises? Or emulated-chip, emulated-pico.",
)  # fmt: skip
@click.option(
    "--baud", type=click.Choice(["115200", "1000000"]), default="115200", show_default=True,
    help="With --loopback: that the board was flashed for.",
)  # fmt: skip
@OUT
@JSON
def doctor(config_path: Path | None, seconds: float, loopback: str | None, baud: str, out: Path) -> None:
    """Measure whether this machine and the link hold the period.

    Without CONFIG: this machine. With CONFIG: also the link to its device. Says what is in the way, and what to type.
    It opens and reads the device, but never arms it: nothing moves. Exit status 1 if the period will not hold.

    With --loopback: PWM, watchdog, e-stop, reset, session and timing, measured on the board itself through three wires,
    and a report to send in (docs/loopback.md). Exit status 1 if anything is bad.
    """
    from rig.running.doctor.visit import with_config, without_config

    if loopback is not None:
        if config_path is not None:
            fail("--loopback is for a bare board, which no config describes", "leave CONFIG out")
        _loop_back(loopback, int(baud), out)
        return

    findings = []
    if config_path is None:
        visit = without_config(out, seconds)
    else:
        experiment = checked(config_path, drives=False)
        say_chip_starts(experiment.daq.port)
        visit = with_config(experiment, out, seconds)
    for finding in visit:
        findings.append(finding)
        if not asks_json():
            show_finding(finding)
    ok = all(finding.state != "bad" for finding in findings)
    if asks_json():
        click.echo(json.dumps({"ok": ok, "findings": [finding.as_dict() for finding in findings]}))
    sys.exit(0 if ok else EXIT_FAILED)


def _loop_back(port: str, baud: int, out: Path) -> None:
    from datetime import datetime

    from rig.run_folder.live.running import told
    from rig.running.doctor import loopback

    if not asks_json():
        click.echo(loopback.DRAWING + "\n")
    with told(out, "doctor") as flag, loopback.bare_board(port, baud) as board:
        visit = loopback.visit_board(board, flag=flag)
    now = datetime.now()
    unwritten = ""  # why there is no report: what was found is told all the same
    try:
        report = loopback.write_report(visit, port, out, now)
    except OSError as error:
        unwritten = f"{out}: no report can be written there: {error.strerror}"
        click.echo(f"rig: {unwritten}", err=True)
    if asks_json():
        click.echo(json.dumps(loopback.as_dict(visit, port, now)))
    else:
        for finding in visit.findings:
            show_finding(finding)
        if not unwritten:
            click.echo(f"report: {report}/report.json and report.txt; to send it in: docs/loopback.md")
    sys.exit(0 if visit.ok and not unwritten else EXIT_FAILED)
