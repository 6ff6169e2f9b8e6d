"""The command `rig`. Each command stands in the file of its name; ``rig.terminal`` shows the results.

options  arguments and options that several commands have
failure  how a command that cannot be done ends
driving  what commands share that open a device

Exit status: 0 done, 1 the experiment failed or was refused, 2 bad input.
"""

from __future__ import annotations

from typing import Any

import click

from rig.cli import (
    calibrate,
    campaign,
    check,
    compare,
    config,
    design,
    doctor,
    emulate,
    export,
    flash,
    home,
    identify,
    init,
    jog,
    list,
    panel,
    predict,
    rehearse,
    relay,
    replay,
    report,
    run,
    schema,
    survey,
    track,
    tune,
)
from rig.cli.failure import EXIT_FAILED
from rig.package import VERSION


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


for _command in (
    calibrate.calibrate,
    campaign.campaign,
    check.check,
    compare.compare,
    config.ready_configs,
    design.design,
    doctor.doctor,
    emulate.emulate,
    export.export,
    flash.flash,
    home.home,
    identify.identify,
    init.init,
    jog.jog,
    list.list_runs,
    panel.panel,
    predict.predict,
    rehearse.rehearse,
    relay.relay,
    replay.replay,
    report.report,
    run.run,
    schema.schema,
    survey.survey,
    track.track,
    tune.tune,
):
    main.add_command(_command)
