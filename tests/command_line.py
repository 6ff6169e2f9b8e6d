"""Commands as a user gives them, in this process."""

from __future__ import annotations

from click.testing import CliRunner, Result

from rig.cli import main


def rig(*arguments: object) -> Result:
    """What ``rig`` with these arguments says, and its exit status."""
    return CliRunner().invoke(main, [str(a) for a in arguments])
