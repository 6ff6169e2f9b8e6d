"""A jog by leases: the shaft is driven only while somebody renews a promise of some milliseconds.

Who jogs writes the lease; the loop reads it each tick. If the one who jogs dies, freezes or loses its connection,
nothing has to notice: the lease runs out, and the drive is 0. So does whoever lets another process drive by itself:
the drive goes on only while somebody promises to be there.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from rig.run_folder.live.own_folder import OwnFolder
from rig.run_folder.live.shared_page import MappedPage, OthersPage

NAME: Final = "jog.lease"
LONGEST_NS: Final = 150_000_000
_OVER: Final = -1  # in place of a time: nobody gives leases any more
_LEASE: Final = struct.Struct("=qdqq")  # number, u_V, expires_ns, number again: they differ in a lease half written


class Lease(NamedTuple):
    """A promise to be there until a time.

    number      counts the leases, from 1
    u_V         drive, V
    expires_ns  time of the monotonic clock at which it runs out, ns
    """

    number: int
    u_V: float
    expires_ns: int


class HeldLease:
    """The lease as the loop reads it each tick, for the block. Raises OSError where the folder has no room for it.

    folder  the run folder, or rig's own one; no other lease of this name may be in it
    now_ns  the clock of the leases
    name    of its file

    refused  leases that reached further ahead than LONGEST_NS, or asked for no number of volts: they drive nothing
    """

    def __init__(
        self, folder: Path | OwnFolder, now_ns: Callable[[], int] = time.monotonic_ns, name: str = NAME
    ) -> None:
        path, within = _place(folder, name)
        self._page = MappedPage(path, _LEASE.pack(0, 0.0, 0, 0), within)
        self._now_ns = now_ns
        self._held = Lease(0, 0.0, 0)
        self.refused = 0

    def __enter__(self) -> HeldLease:
        return self

    def __exit__(self, *_: object) -> None:
        self._page.close()

    def u_V(self) -> float | None:
        """The drive that is promised now, V; 0.0: none is; None: nobody gives leases any more."""
        lease = self._look()
        if lease.expires_ns == _OVER:
            return None
        return lease.u_V if self._now_ns() < lease.expires_ns else 0.0

    def holds(self) -> bool:
        """Whether somebody promises now to be there, with a drive or without."""
        lease = self._look()
        return self._now_ns() < lease.expires_ns

    def _look(self) -> Lease:
        """The newest whole lease; none from a file that was cut short."""
        data = self._page.read(0, _LEASE.size)
        if len(data) < _LEASE.size:
            return Lease(self._held.number, 0.0, _OVER)
        number, u_V, expires_ns, number_again = _LEASE.unpack(data)
        if number == number_again and number > self._held.number:
            if expires_ns - self._now_ns() > LONGEST_NS or not math.isfinite(u_V):
                self.refused += 1
                u_V, expires_ns = 0.0, 0
            self._held = Lease(number, u_V, expires_ns)
        return self._held


class Leaser:
    """Gives leases to the jog in ``folder``.

    Raises OSError where no jog waits for leases there, or this user may not give any; ValueError where the file is
    no page of leases.
    """

    def __init__(
        self, folder: Path | OwnFolder, now_ns: Callable[[], int] = time.monotonic_ns, name: str = NAME
    ) -> None:
        path, within = _place(folder, name)
        self._page = OthersPage(path, writes=True, folder=within)
        self._now_ns = now_ns
        self._number = _LEASE.unpack(self._page.read(0, _LEASE.size))[0]
        self._own = 0  # number of the last lease that it gave

    @property
    def is_anothers(self) -> bool:
        """Whether somebody else has given the newest lease, and it has not run out: he holds the jog.

        Raises OSError as a read does.
        """
        data = self._page.read(0, _LEASE.size)
        if len(data) < _LEASE.size:
            return False
        number, _, expires_ns, _ = _LEASE.unpack(data)
        return bool(number != self._own and 0 < expires_ns - self._now_ns() <= LONGEST_NS)

    def drive(self, u_V: float, for_s: float = 0.15) -> Lease:
        """Promise to be there for ``for_s`` from now, at most 0.15 s: the shaft is driven with ``u_V`` until then.

        Raises ValueError for a longer time, or a drive that is no number; OSError as a write does.
        """
        ahead_ns = round(for_s * 1e9)
        if not (0 <= ahead_ns <= LONGEST_NS and math.isfinite(u_V)):
            raise ValueError(f"a lease of {for_s} s at {u_V} V: at most {LONGEST_NS * 1e-9} s, and a number of volts")
        return self._write(u_V, self._now_ns() + ahead_ns)

    def stay(self) -> Lease:
        """Promise to be there for the longest time that there is, without a drive. Raises OSError as a write does."""
        return self.drive(0.0)

    def release(self) -> Lease:
        """Give the lease back: the drive is 0 from the next tick on."""
        return self._write(0.0, 0)

    def end(self) -> Lease:
        """End the jog: its run comes to its end in order."""
        return self._write(0.0, _OVER)

    def close(self) -> None:
        """Let go of the file; a lease that was given runs out by itself."""
        self._page.close()

    def _write(self, u_V: float, expires_ns: int) -> Lease:
        self._number += 1
        self._own = self._number
        lease = Lease(self._number, u_V, expires_ns)
        self._page.write(0, _LEASE.pack(*lease, self._number))
        return lease


def _place(folder: Path | OwnFolder, name: str) -> tuple[Path, int | None]:
    """The path of a file in a folder, and the descriptor that it is relative to; None: the present folder."""
    return (Path(name), folder.descriptor) if isinstance(folder, OwnFolder) else (folder / name, None)
