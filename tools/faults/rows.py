"""What may go wrong, from rows.yaml: how it is done, within what bound the drive must be at 0, what the run says."""

from __future__ import annotations

import signal
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, Field

from faults.acts import ACTS, NUMBERS, PREPARATIONS, Act
from faults.bounds import Bound, Times
from faults.stages import STAGES, START
from shared.data import Entry, load

RUNS_ON = ""  # no fault; in the data file it is RUNS_ON
AT_ZERO = {stage.key for stage in STAGES if stage.at_zero and stage is not START}  # the drive is 0 there


@dataclass(frozen=True)
class Row:
    """One row of the matrix.

    name     what goes wrong; ``how`` it is done
    act      does it
    bound    for the drive at the device; at rest, in the pause and at re-arming STAYS unless ``other`` says otherwise
    codes    that the run may end with, one, or two where ``either`` says when which; RUNS_ON: it goes on
    either   why there are two codes
    lasting  it stays until somebody mends it
    refused  codes that the next run may end with meanwhile, before any relay runs
    early    it is so from before the run: the breakaway check has to find it, no relay may run, unless RUNS_ON
    emulated changes of the config's section, in force from the beginning
    prepare  done before the run, in a process of its own; gets the folder that holds the config and `runs`
    alone    runs in a process of its own
    status   exit status where it is not that of the code: one of these
    same     the recording must equal that of a run in which nothing happens, to the last bit
    only     it is of devices with one of these traits (``backends.Backend``); empty: of all
    absent   traits of devices, or of stages (``stages.Stage.traits``), to which it does not apply, and why
    only_seen  the motor is driven on, whatever the device puts out
    other    what is otherwise on a device: fields by a trait; of several, in the order of the device's traits
    may_lose samples that are lost by chance; the remark says why
    leaves_result   there is a result.json, whatever ended the run
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
    emulated: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    prepare: Callable[[Path], None] | None = None
    alone: bool = False
    status: tuple[int, ...] = ()
    same: bool = False
    only: tuple[str, ...] = ()
    absent: Mapping[str, str] = field(default_factory=dict)
    only_seen: bool = False
    other: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    may_lose: int = 0
    leaves_result: bool = True
    either: str = ""
    remark: str = ""

    def on(self, traits: Sequence[str]) -> Row:
        """The row as it is for one device, or for one in a stage (``stages.Stage.traits``)."""
        changes: dict[str, Any] = {}
        for trait in traits:
            runs_on = changes.get("codes", self.codes) == (RUNS_ON,) and -signal.SIGKILL not in self.status
            if trait in AT_ZERO and not runs_on:
                changes["bound"] = STAYS
            changes |= self.other.get(trait, {})
        return replace(self, **changes)

    def why_absent(self, traits: Sequence[str]) -> str:
        """Why it does not apply to a device; empty where it does, or is of others only."""
        return next((self.absent[trait] for trait in traits if trait in self.absent), "")

    def is_for(self, traits: Sequence[str]) -> bool:
        """Whether it is run on a device."""
        return not self.why_absent(traits) and (not self.only or any(trait in self.only for trait in traits))


# ---------------------------------------------------------------------- the data file

_DATA = Path(__file__).with_suffix(".yaml")
_Known = TypeVar("_Known")


def _one_of(known: Collection[str], what: str) -> AfterValidator:
    def checked(name: str) -> str:
        if name not in known:
            raise ValueError(f"no such {what}: {name!r}")
        return name

    return AfterValidator(checked)


class _Bound(Entry):
    """A bound; ``sum``: how many of each of ``bounds.Times``."""

    why: str
    sum: dict[Annotated[str, _one_of(Times._fields, "time")], float] = Field(default_factory=dict)


class _Change(Entry):
    """What may be otherwise on a device; by name where there is a name."""

    act: Annotated[str, _one_of(ACTS, "act")] = ""
    bound: str | _Bound = ""
    codes: tuple[str, ...] = ()
    lasting: bool = False
    refused: tuple[str, ...] = ()
    status: tuple[int, ...] = ()
    either: str = ""
    may_lose: int = 0


_Changes = dict[str, _Change]  # by a trait of the device


class _Row(_Change):
    """A row. Where it names no act, its own name is the act's.

    changes  names of changes, which ``other`` comes after
    """

    name: str
    how: str
    bound: str | _Bound
    codes: tuple[str, ...]
    early: bool = False
    emulated: dict[str, dict[str, str | float]] = Field(default_factory=dict)
    prepare: Annotated[str, _one_of(PREPARATIONS, "preparation")] | None = None
    alone: bool = False
    same: bool = False
    only: tuple[str, ...] = ()
    absent: dict[str, str] = Field(default_factory=dict)
    only_seen: bool = False
    changes: tuple[str, ...] = ()
    other: _Changes = Field(default_factory=dict)
    leaves_result: bool = True
    remark: str = ""


class Rows(Entry):
    """The data file: rows, and what their names stand for."""

    texts: dict[str, str]
    groups: dict[str, tuple[str, ...]]
    bounds: dict[str, _Bound]
    changes: dict[str, _Changes]
    rows: tuple[_Row, ...]

    def bound(self, given: str | _Bound) -> Bound:
        """A bound by its name, or written out. Raises ValueError for a name that nothing has."""
        told = _named(self.bounds, given, "bound") if isinstance(given, str) else given
        return Bound(self._text(told.why), tuple(told.sum.items()))

    def all(self) -> tuple[Row, ...]:
        """Every row. Raises ValueError, with the row's name, for a name that nothing has."""
        return tuple(map(self._row, self.rows))

    def _row(self, row: _Row) -> Row:
        try:
            told = self._fields(row) | {"other": self._other(row)}
            if "act" not in told:
                told["act"] = _named(ACTS, row.name, "act")
            return Row(**told)
        except ValueError as error:
            raise ValueError(f"{_DATA.name}, row {row.name!r}: {error}") from error

    def _other(self, row: _Row) -> dict[str, dict[str, Any]]:
        changes: _Changes = {}
        for name in row.changes:
            changes |= _named(self.changes, name, "change")
        changes |= row.other
        return {trait: self._fields(change) for trait, change in changes.items()}

    def _fields(self, given: _Change) -> dict[str, Any]:
        """The fields that were given, and what stands for their names."""
        means: dict[str, Callable[[Any], Any]] = {
            "act": ACTS.__getitem__,
            "prepare": PREPARATIONS.__getitem__,
            "bound": self.bound,
            "codes": self._codes,
            "refused": self._codes,
            "absent": lambda why: {trait: self._text(text) for trait, text in why.items()},
            **dict.fromkeys(("how", "either", "remark"), self._text),
        }
        told = {name: getattr(given, name) for name in given.model_fields_set - {"changes", "other"}}
        return {name: means[name](value) if name in means else value for name, value in told.items()}

    def _codes(self, names: Sequence[str]) -> tuple[str, ...]:
        groups = {"RUNS_ON": (RUNS_ON,), **self.groups}
        return tuple(code for name in names for code in groups.get(name, (name,)))

    def _text(self, text: str) -> str:
        try:
            return text.format(**self.texts, **NUMBERS)
        except KeyError as error:
            raise ValueError(f"no such text: {error}") from error


def _named(known: Mapping[str, _Known], name: str, what: str) -> _Known:
    if name not in known:
        raise ValueError(f"no such {what}: {name!r}")
    return known[name]


_FILE = load(_DATA, Rows)
STAYS, SILENCE, SEEN, AT_ONCE, RUNNING = map(_FILE.bound, ("STAYS", "SILENCE", "SEEN", "AT_ONCE", "RUNNING"))
ROWS = _FILE.all()
