"""Who lets a calibration drive has to be there: the panel promises it by leases, and the calibration's loop looks.

The file of the leases is in rig's own folder beside the run folders. If the panel is killed or frozen, nothing has to
notice: the last lease runs out, and the drive is 0.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from rig.control.loop.stop_request import Gone
from rig.run_folder.live.lease import HeldLease, Leaser
from rig.run_folder.live.own_folder import OwnFolder
from rig.running.calibrate.refusal import ALONE

EVERY_S: Final = 0.05  # between two promises, each of 150 ms


@contextmanager
def watched(out: Path) -> Iterator[Gone]:
    """In the calibration's process, for the block: what tells whether the panel is gone. Raises OSError.

    out  folder of the run folders
    """
    with OwnFolder(out) as folder, HeldLease(folder, name=_name(os.getpid())) as held:
        yield lambda: "" if held.holds() else ALONE


class Attendance:
    """The panel's promises to the calibration of process ``pid``. Not for two threads at once."""

    def __init__(self, out: Path, pid: int) -> None:
        self._out, self._name = out, _name(pid)
        self._leaser: Leaser | None = None

    def renew(self) -> None:
        """Promise to be there for 150 ms from now; nothing where there is no calibration that looks."""
        with suppress(OSError, ValueError):
            if self._leaser is None:
                with OwnFolder(self._out, makes=False) as folder:
                    self._leaser = Leaser(folder, name=self._name)
            self._leaser.stay()

    def end(self) -> None:
        """Promise no more; may be called twice."""
        leaser, self._leaser = self._leaser, None
        if leaser is not None:
            leaser.close()


def _name(pid: int) -> str:
    return f"calibration-{pid}.lease"
