"""`rig compare`: whether several runs are of one motor, and how it changes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from rig.cli.shared import FILE, JSON, PATH, asks_json, require_new, say_json
from rig.cli.terminal import patience, show_comparison


class Percents(click.ParamType):  # type: ignore[type-arg]
    """``TAU,K,FC``: three numbers, %."""

    name = "percents"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The three numbers."""
        try:
            tau, gain, friction = (float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} must be TAU,K,FC: three numbers in %, such as 1,0.5,2", param, ctx)
        if not all(0.0 <= one <= 100.0 for one in (tau, gain, friction)):
            self.fail(f"{value!r} must be from 0 to 100 %", param, ctx)
        return tau, gain, friction


@click.command()
@click.argument("folders", nargs=-1, required=True, metavar="RUN...", type=PATH)
@click.option(
    "--scatter", "percent", type=Percents(), metavar="TAU,K,FC",
    help="Scatter of tau, K and f_c from run to run of one motor: standard deviations, %. Default: that of the other "
    "runs where there are five or more; else what 2.5 K do to copper and magnet: 2,0.5,1.5.",
)  # fmt: skip
@click.option(
    "--temperature", "temperatures", type=FILE, metavar="FILE",
    help="CSV file with the columns run (name of the folder) and temperature_C, for the trend over temperature.",
)  # fmt: skip
@click.option(
    "--to", "file", type=FILE, metavar="FILE",
    help="Write the report, a page of HTML: cycles, residuals and tracking of the runs laid over each other.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Replace FILE if it is there already.")
@JSON
def compare(
    folders: Sequence[Path],
    percent: tuple[float, float, float] | None,
    temperatures: Path | None,
    file: Path | None,
    force: bool,
) -> None:
    """Tell whether several runs are of one motor.

    Two answers: do the runs differ by more than their noise explains, and by more than one motor does from run to run?
    What is common to them, such as supply and calibration, cancels. Of three runs or more rig names the odd one, and
    says how tau, K and f_c change over time. Each answer is wrong in 5 % of cases if it is one motor. Reads result.json
    and meta.json; nothing is identified anew.
    """
    require_new(file, (".html", ".htm"), force=force)
    with patience("comparing"):
        from rig.output.compare.comparison import Scatter
        from rig.output.compare.comparison import compare as compare_runs
        from rig.output.compare.temperatures import read_temperatures
        from rig.run_folder.recording.path_kind import require_distinct
    require_distinct(folders)
    with patience("comparing"):
        found = compare_runs(
            folders,
            None if percent is None else Scatter(percent, "given by --scatter"),
            None if temperatures is None else read_temperatures(temperatures),
        )
    if file is not None:
        from rig.output.compare.page import write_page

        with patience("drawing the report"):
            write_page(found, file)
    if asks_json():
        report = None if file is None else str(file)
        say_json({"ok": True, **found.result.as_json(), "report": report})
        return
    show_comparison(found.result)
    if file is not None:
        click.echo(f"report: {file}")
