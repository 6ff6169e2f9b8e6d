"""What drives without a run folder, from its begin: alone in its folder of runs, and known to every Stop."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rig.core.errors import CauseError
from rig.run_folder.live.own_folder import START_LOCK, HeldError, OwnFolder
from rig.run_folder.live.running import running
from rig.run_folder.live.stop_flag import StopFlag, command_of, is_recorded

_WAIT_S: Final = 2.0  # for a panel that starts something


class BusyError(CauseError):
    """It cannot begin in this folder of runs."""

    status = 1


@contextmanager
def told(runs: Path, command: str) -> Iterator[StopFlag]:
    """The flag of a command that records nothing, for the block.

    It begins under the lock under which panels start things: so neither begins while the other looks what goes on.
    Raises BusyError if anything goes on in ``runs``, or a panel is starting it; or if there is no room for the flag.
    """
    with StopFlag() as flag:
        try:
            with OwnFolder(runs) as own, own.locked(START_LOCK, _WAIT_S):
                if going := running(runs):
                    last = going[-1].folder
                    what = last.name if is_recorded(last) else command_of(last)
                    raise BusyError(
                        f"{what} goes on in {runs}",
                        "wait for its end, or stop it; for another bench name another folder of runs: --out",
                    )
                flag.open(runs, command)
        except HeldError as error:
            raise BusyError(f"a panel of {runs} starts something", "wait for it, or end that panel") from error
        except OSError as error:
            raise BusyError(
                f"no stop flag in {runs}, so nobody else could stop the drive: {error.strerror}",
                "check the disk and its permissions, or name another folder of runs: --out",
            ) from error
        yield flag
