"""What may go wrong: how it is done, within what bound the drive must be at 0, what the run says to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from faults import damage
from faults.bounds import Bound, bound
from faults.stand import Stand

Act = Callable[[Stand], None]

RUNS_ON = ""  # no fault

SILENCE = bound("the device's watchdog, and its tick", watchdog=1, tick=2)
HEARD = bound("the loop waits a time-out for its next reply, then says stop", period=1, timeout=1, frame=1, tick=2)


@dataclass(frozen=True)
class Row:
    """One row of the matrix.

    name     what goes wrong
    act      makes it so; ``how`` in words
    bound    for the drive at the device
    codes    that the run may end with; RUNS_ON: it goes on
    lasting  it stays until somebody mends it
    refused  codes that the next run may end with meanwhile, before any relay runs
    early    it is so from before the run: the breakaway check has to find it
    absent   devices to which it does not apply, and why
    remark   what else is to be said
    """

    name: str
    how: str
    act: Act
    bound: Bound
    codes: tuple[str, ...]
    lasting: bool = False
    refused: tuple[str, ...] = ()
    early: bool = False
    absent: Mapping[str, str] = field(default_factory=dict)
    remark: str = ""


def _both(stand: Stand, what: Callable[[], damage.Damage]) -> None:
    stand.up, stand.down = what(), what()


def _cable_out(stand: Stand) -> None:
    stand.up = stand.down = damage.lost


def _port_gone(stand: Stand) -> None:
    stand.is_gone = True


def _down(what: Callable[[], damage.Damage]) -> Act:
    def act(stand: Stand) -> None:
        stand.down = what()

    return act


ROWS = (
    Row(
        "cable out",
        "nothing arrives any more, either way",
        _cable_out,
        SILENCE,
        ("LINK_TIMEOUT",),
        True,
        ("LINK_HELLO",),
    ),
    Row(
        "port gone",
        "reading and writing fail",
        _port_gone,
        SILENCE,
        ("LINK_LOST",),
        True,
        ("LINK_LOST",),
    ),
    Row(
        "bit flips, to the host",
        "one wrong bit in each reply",
        _down(lambda: damage.flipped),
        HEARD,
        ("LINK_TIMEOUT",),
        True,
        ("LINK_HELLO", "LINK_TIMEOUT"),
    ),
    Row("duplicated replies", "each comes twice", _down(lambda: damage.duplicated), HEARD, (RUNS_ON,)),
    Row("device reset", "external", lambda s: s.device.reset(2), bound("the pins", tick=1), ("DEVICE_RESET",)),
)
