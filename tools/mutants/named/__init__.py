"""The named mutants: a data file a room of the table."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from pydantic import Field

from mutants.mutant import Mutant
from shared.data import Entry, load

_ORDER = (
    "control",
    "loop",
    "live",
    "panel",
    "drivers",
    "recording",
    "promise",
    "answer",
    "core",
    "board",
)  # of the table's rooms


class _Defect(Entry):
    """One mutant, as ``mutants.mutant.Mutant`` has it.

    caught_by  tests that it meets first: names in the file's ``tests``, or with their paths; none: all of that file
    """

    name: str
    function: str = Field("", alias="in")
    old: str
    new: str
    caught_by: tuple[str, ...] = ()


class _File(Entry):
    path: str
    tests: str
    mutants: tuple[_Defect, ...]

    def all(self) -> tuple[Mutant, ...]:
        return tuple(
            Mutant(
                one.name,
                self.path,
                one.function,
                one.old,
                one.new,
                tuple(map(self._test, one.caught_by)) or (self.tests,),
            )
            for one in self.mutants
        )

    def _test(self, name: str) -> str:
        return name if "/" in name.partition("[")[0] else f"{self.tests}::{name}"


class Room(Entry):
    """A data file: what the table calls the room, and the mutants of its files."""

    room: str
    files: tuple[_File, ...]


def _mutants(room: Room) -> tuple[Mutant, ...]:
    return tuple(mutant for file in room.files for mutant in file.all())


@cache
def rooms() -> dict[str, tuple[Mutant, ...]]:
    """What the table calls each room, and its mutants. To read the files takes a second."""
    read = (load(Path(__file__).with_name(f"{name}.yaml"), Room) for name in _ORDER)
    return {room.room: _mutants(room) for room in read}


def all_named() -> tuple[Mutant, ...]:
    """The mutants of all rooms."""
    return tuple(mutant for mutants in rooms().values() for mutant in mutants)
