"""The stages of a run: the column ``stage`` names the stage of each row."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

_NUMBERED = re.compile(r"(relay|strokes|hysteretic)-(.*)")
_TRACKING = "track:"


class StageKind(StrEnum):
    """The kind of a stage. ``OTHER``: a stage of a file that rig did not write."""

    REST = "rest"
    JOG = "jog"
    BREAKAWAY = "breakaway"
    SEARCH = "search"
    RELAY = "relay"
    STROKES = "strokes"
    HOMING = "homing"
    HYSTERETIC = "hysteretic"
    SURVEY = "survey"
    TRACK = "track"
    LAW = "law"
    STOPPING = "stopping"
    OTHER = "other"


# kinds that occur once in a run at most; the stage has the name of its kind
_PLAIN = {
    str(kind): kind
    for kind in StageKind
    if kind not in (StageKind.RELAY, StageKind.STROKES, StageKind.HYSTERETIC, StageKind.TRACK, StageKind.OTHER)
}


@dataclass(frozen=True)
class Stage:
    """One stage.

    name    as in the column: ``relay-2``, ``track:sampled-data``
    kind    its kind
    number  of a relay test, a stroke test or a hysteretic run, from 1; None for other kinds, and without a number
    method  the estimator whose model a tracking run uses; empty for other kinds
    """

    name: str
    kind: StageKind
    number: int | None = None
    method: str = ""

    @classmethod
    def parse(cls, name: str) -> Stage:
        """The stage of this name. A name that rig does not write gives the kind ``OTHER``."""
        numbered = _NUMBERED.fullmatch(name)
        if numbered is not None:
            kind, number = numbered.groups()
            return cls(name, StageKind(kind), int(number) if number.isdecimal() else None)
        if name.startswith(_TRACKING):
            return cls(name, StageKind.TRACK, method=name.removeprefix(_TRACKING))
        return cls(name, _PLAIN.get(name, StageKind.OTHER))

    @classmethod
    def test(cls, kind: StageKind, number: int) -> Stage:
        """A test of this kind, numbered from 1."""
        return cls(f"{kind}-{number}", kind, number)

    @classmethod
    def track(cls, method: str) -> Stage:
        """A tracking run on the model of this estimator."""
        return cls(f"{_TRACKING}{method}", StageKind.TRACK, method=method)

    @property
    def is_test(self) -> bool:
        """Whether it was driven to be identified: a test of the dual-channel relay or a hysteretic one, or strokes."""
        return self.kind in (StageKind.RELAY, StageKind.STROKES, StageKind.HYSTERETIC)

    @property
    def tells_motor(self) -> bool:
        """Whether it can be identified: a test, or the gain search before the tests."""
        return self.is_test or self.kind is StageKind.SEARCH

    def __str__(self) -> str:
        return self.name


def kind_of(name: str) -> StageKind:
    """The kind of the stage of this name."""
    return Stage.parse(name).kind
