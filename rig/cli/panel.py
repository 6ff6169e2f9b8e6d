"""`rig panel`: the bench live in a browser."""

from __future__ import annotations

import contextlib
import stat
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli.shared import EXIT_FAILED, OUT, PATH, fail

if TYPE_CHECKING:  # the server's packages may be missing
    from rig.panel.app import Panel

PORT = 8470


@click.command()
@click.argument("path", metavar="[CONFIG|RUN]", required=False, type=PATH)
@OUT
@click.option("--port", type=click.IntRange(0, 65535), default=PORT, show_default=True, help="0: any that is free.")
@click.option("--bind", default="127.0.0.1", show_default=True, help="Address of the interface to serve on.")
@click.option(
    "--name", "names", multiple=True, help="A host name of this machine, as users type it. Repeat for several."
)
@click.option("--tls-cert", type=PATH, help="Certificate with its chain, PEM.")
@click.option("--tls-key", type=PATH, help="Its key, PEM.")
@click.option("--password-file", type=PATH, help="One line: who knows it may drive.")
def panel(
    path: Path | None,
    out: Path,
    port: int,
    bind: str,
    names: tuple[str, ...],
    tls_cert: Path | None,
    tls_key: Path | None,
    password_file: Path | None,
) -> None:
    """Show a bench live in a browser, and drive it from there.

    With a CONFIG the page can start it, jog and stop. With a RUN it shows that run, live if it goes on. It also shows
    what `rig run` does in another terminal with the same --out. The panel is a process of its own: whatever ends it,
    a run goes on.
    """
    from rig.panel.access import Access, Address, require_safe

    config, opened = _sort_out(path)
    try:
        from rig.panel.app import Panel
        from rig.panel.serve import Certificate, address_of, listen, require_certificate, serve
    except ModuleNotFoundError as error:
        fail(
            f"the panel needs the package {error.name}, which is not installed",
            "in rig's clone: make setup; elsewhere: python3 -m pip install starlette uvicorn websockets",
            status=EXIT_FAILED,
        )
    if (tls_cert is None) != (tls_key is None):
        fail("--tls-cert and --tls-key belong together", "give both")
    certificate = None if tls_cert is None or tls_key is None else Certificate(tls_cert, tls_key)
    password = None if password_file is None else _password(password_file)
    if certificate is not None:
        require_certificate(certificate)
    secure = certificate is not None
    require_safe(Address(bind, port or PORT, secure, names), password=password is not None)
    listening = listen(bind, port)
    access = Access(address_of(listening, bind, secure=secure, names=names), password)
    served = Panel.of(access, opened.parent if opened is not None else out, config, opened)
    _announce(served)
    with contextlib.suppress(KeyboardInterrupt):
        serve(served, listening, certificate)
    for run in served.bench.running:
        click.echo(f"the panel has ended; {run.folder} goes on (process {run.runner.pid})", err=True)


def _sort_out(path: Path | None) -> tuple[Path | None, Path | None]:
    """The config, or the run folder, that ``path`` is. A config that must not be run is no reason to show nothing."""
    from rig.run_folder.recording.path_kind import is_run

    if path is None:
        return None, None
    if path.is_dir():
        if not is_run(path):
            fail(f"{path} is no run folder", "give a config, a run folder, or --out FOLDER of runs")
        return None, path
    if not path.is_file():
        fail(f"{path} is not there", "give a config or a run folder; `rig config list` shows configs")
    return path, None


def _password(path: Path) -> str:
    """The password in a file that nobody else may read. Raises AccessError."""
    from rig.panel.access import AccessError, password_of

    try:
        mode = path.stat().st_mode
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AccessError(f"{path} cannot be read: {error}", "check --password-file") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise AccessError(
            f"others on this machine may read {path}",
            "put the password into a file of its own that only you may read: chmod 600 FILE",
        )
    return password_of(text)


def _announce(panel: Panel) -> None:
    access = panel.access
    if access.token is None:
        click.echo(f"rig panel: {access.address.url}  (it asks for the password)")
    else:
        click.echo(f"rig panel: {access.address.url}?token={access.token}")
        click.echo("The first browser that opens this address may drive; others may watch and stop.")
    click.echo("Ctrl-C ends the panel. A run goes on without it, guarded; a jog ends.")
