"""`rig doctor`: whether machine and link hold the period."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from rig.cli.driving import checked
from rig.cli.failure import EXIT_FAILED, faults
from rig.cli.options import JSON, OUT
from rig.terminal import show_finding


@click.command()
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
    with faults():
        if config_path is None:
            visit = without_config(out, seconds)
        else:
            visit = with_config(checked(config_path, drives=False), out, seconds)
        for finding in visit:
            findings.append(finding)
            if not as_json:
                show_finding(finding)
    ok = all(finding.state != "bad" for finding in findings)
    if as_json:
        click.echo(json.dumps({"ok": ok, "findings": [finding.as_dict() for finding in findings]}))
    sys.exit(0 if ok else EXIT_FAILED)
