"""`rig config`: the ready configs that come with rig."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from rig.cli.shared import FILE, written


@click.group("config")
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
    "--to", "file", type=FILE, metavar="FILE",
    help="File to write. Default: NAME.yaml here.",
)  # fmt: skip
def copy_config(name: str, file: Path | None) -> None:
    """Copy a ready config, so that you can change it.

    It never replaces a file.
    """
    from rig.config import ready

    text = ready.text(name)
    file = file or Path(f"{name.removesuffix('.yaml')}.yaml")
    with written(file), file.open("x", encoding="utf-8") as new:
        new.write(text)
    click.echo(f"{file}: check it with `rig check {shlex.quote(str(file))}`")
