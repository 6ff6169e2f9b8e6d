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
    newton_metres,
    panel,
    predict,
    predict_run,
    rehearse,
    relay,
    replay,
    report,
    run,
    schema,
    servo,
    survey,
    track,
    tune,
)
from rig.cli.failure import EXIT_FAILED
from rig.package import VERSION


class _Commands(click.Group):
    """Commands in groups. A Ctrl-C ends them with one line, not a traceback, while no run's loop is going."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("rig: interrupted; no drive is on", err=True)
            ctx.exit(EXIT_FAILED)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Each command with the whole first sentence of its help, group by group."""
        widest = max(map(len, self.commands))
        for title, commands in _GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(str(of.name).ljust(widest), (of.help or "").split("\n\n")[0]) for of in commands])


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(VERSION, prog_name="rig")
def main() -> None:
    """Identify and control a friction-impeded DC motor by relay feedback."""


_GROUPS = {
    "Try it, without hardware": (config.ready_configs, emulate.emulate, predict.predict),
    "Measure a motor": (
        run.run,
        identify.identify,
        relay.relay,
        survey.survey,
        design.design,
        track.track,
    ),
    "Use what was measured": (
        report.report,
        predict_run.predict_run,
        list.list_runs,
        compare.compare,
        tune.tune,
        newton_metres.newton_metres_command,
        export.export,
    ),
    "A bench of your own": (
        init.init,
        servo.servo,
        rehearse.rehearse,
        flash.flash,
        doctor.doctor,
        calibrate.calibrate,
        home.home,
        jog.jog,
        check.check,
        panel.panel,
        schema.schema,
    ),
    "Evidence": (replay.replay, campaign.campaign),
}
for _commands in _GROUPS.values():
    for _command in _commands:
        main.add_command(_command)
