"""Who answers on a bus, however late: by a ping to each id."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from rig.backends.servo.bus import ServoLink
from rig.core.faults import Fault

_LATE_S: Final = 0.05  # of an answer behind a slow adapter
_LATE_IDS: Final = 12  # that are asked meanwhile


def who_answers(link: ServoLink, ids: Sequence[int], *, surely: bool = False) -> Iterator[tuple[int, int]]:
    """Those of these ids that answer a ping, each once, and the number of its model.

    Behind a slow adapter, or where this machine stands still, an answer may come once nobody waits for it: while a
    later id is asked, or before that. Then the last ones are asked again, patiently.

    surely  an answer whose sender is not found so is a Fault LINK_UNIT, not nobody
    """
    told: set[int] = set()
    for at, asked in enumerate(ids, 1):
        strayed = link.stray_bytes
        there: dict[int, tuple[int, ...] | None] = {}
        late: Fault | None = None
        try:
            there[asked] = link.is_there(asked)
        except Fault as fault:
            if fault.code != "LINK_UNIT":
                raise
            late = fault
        if at == len(ids):
            link.client.wait(_LATE_S)
        if late is not None or link.stray_bytes > strayed:
            link.client.wait(_LATE_S)  # what else is on its way is not of those that are asked now
            there = {one: _patiently(link, one, surely) for one in ids[max(at - 1 - _LATE_IDS, 0) : at]}
            if surely and late is not None and not any(there.values()):
                raise late
        for one, said in there.items():
            if said and one not in told:
                told.add(one)
                yield one, int.from_bytes(said[:2], "little")


def _patiently(link: ServoLink, id: int, surely: bool) -> tuple[int, ...] | None:
    """What it answers; None where it does not, or where the answer of another one came, unless it must be sure."""
    try:
        return link.is_there(id, _LATE_S)
    except Fault as fault:
        if surely or fault.code != "LINK_UNIT":
            raise
        return None
