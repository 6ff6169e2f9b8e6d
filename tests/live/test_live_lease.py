"""Leases: the drive that is promised, until when, and what is refused."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.run_folder.live.lease import LONGEST_NS, NAME, HeldLease, Leaser
from rig.run_folder.live.shared_page import SIZE, OthersPage


class Clock:
    """A clock that the test sets."""

    ns = 10_000_000_000

    def __call__(self) -> int:
        return self.ns


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def held(tmp_path: Path, clock: Clock) -> Iterator[HeldLease]:
    with HeldLease(tmp_path, clock) as lease:
        yield lease


def test_a_lease_drives_until_it_runs_out_is_renewed_or_given_back(
    tmp_path: Path, held: HeldLease, clock: Clock
) -> None:
    leaser = Leaser(tmp_path, clock)
    assert held.u_V() == 0.0
    leaser.drive(0.8, 0.15)
    clock.ns += LONGEST_NS - 1
    assert held.u_V() == 0.8
    clock.ns += 1
    assert held.u_V() == 0.0
    leaser.drive(-0.5, 0.05)
    assert held.u_V() == -0.5
    leaser.release()
    assert held.u_V() == 0.0
    leaser.drive(0.3)
    leaser.close()
    again = Leaser(tmp_path, clock)  # another process goes on, also after the first has died
    again.drive(0.4)
    assert held.u_V() == 0.4
    again.end()
    assert held.u_V() is None
    assert held.refused == 0


def test_who_gives_leases_sees_that_another_does_until_the_others_run_out(
    tmp_path: Path, held: HeldLease, clock: Clock
) -> None:
    mine, others = Leaser(tmp_path, clock), Leaser(tmp_path, clock)

    def seen() -> tuple[bool, bool]:
        return mine.is_anothers, others.is_anothers

    assert seen() == (False, False)
    mine.drive(0.8)
    assert seen() == (False, True)
    others.drive(-0.8)  # at the same moment: their numbers are the same
    mine.drive(0.8)
    assert seen() == (False, True) and held.u_V() == 0.8
    mine.release()
    assert seen() == (False, False)
    mine.drive(0.8)
    clock.ns += LONGEST_NS
    assert seen() == (False, False)
    mine._write(0.8, clock.ns + 2**61)  # it drives nothing: nobody holds by it
    assert seen() == (False, False)


@pytest.mark.parametrize(
    ("u_V", "ahead_ns"), [(0.8, LONGEST_NS + 1), (0.8, 2**62), (math.nan, 1_000_000), (math.inf, 1_000_000)]
)
def test_a_lease_that_reaches_too_far_or_asks_for_no_volts_drives_nothing_and_is_counted(
    tmp_path: Path, held: HeldLease, clock: Clock, u_V: float, ahead_ns: int
) -> None:
    """Both sides refuse: who gives it, and the loop whoever wrote it."""
    leaser = Leaser(tmp_path, clock)
    leaser.drive(0.2)
    assert held.u_V() == 0.2
    with pytest.raises(ValueError, match="a lease of"):
        leaser.drive(u_V, ahead_ns * 1e-9)
    leaser._write(u_V, clock.ns + ahead_ns)
    assert held.u_V() == 0.0
    assert held.u_V() == 0.0
    assert held.refused == 1


def test_a_lease_that_is_half_written_changes_nothing(tmp_path: Path, held: HeldLease, clock: Clock) -> None:
    leaser = Leaser(tmp_path, clock)
    leaser.drive(0.2)
    assert held.u_V() == 0.2
    with OthersPage(tmp_path / NAME, writes=True) as page:
        page.write(0, struct.pack("=qd", 99, 0.9))  # number and drive, and not yet the number again
        assert held.u_V() == 0.2
        page.write(0, bytes(SIZE))  # an older one
    assert held.u_V() == 0.2
    clock.ns += LONGEST_NS
    assert held.u_V() == 0.0


def test_a_lease_whose_file_is_cut_short_drives_nothing_any_more(tmp_path: Path, held: HeldLease, clock: Clock) -> None:
    Leaser(tmp_path, clock).drive(0.5)
    assert held.u_V() == 0.5
    os.truncate(tmp_path / NAME, 8)
    assert held.u_V() is None and not held.holds()


def test_nobody_gives_leases_where_no_jog_waits(tmp_path: Path, clock: Clock) -> None:
    with pytest.raises(FileNotFoundError):
        Leaser(tmp_path, clock)
    (tmp_path / NAME).write_bytes(b"short")
    with pytest.raises(ValueError, match="is no page of rig"):
        Leaser(tmp_path, clock)
