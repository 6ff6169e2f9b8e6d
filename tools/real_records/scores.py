"""The figures that issue 34 asks for, over all records and with each motor left out.

A number is given where it is graded exact, good or rough. It holds what is known where the two differ by no more than
the sum of both half widths. Where it does not, the reason may be the model that the known number is of: if rig's motor
leaves at most half as much of blocks that were not fitted, each over what a linear model leaves of the same blocks, the
record itself says which model is nearer. A law is shared where a sibling that names any law names it, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from real_records.known import LESS_BIAS, NUMBERS, PUBLISHED, Known
from real_records.siblings import Next
from rig.identification.identification import Identification
from rig.run_folder.results import Answer
from rig.run_folder.results import known as number

ASKED_CPU_S = 12.0
SAME_RANGE = 0.5  # of the speeds that either answer holds for: at least so many both do
BETTER = 1.05  # times the linear model's error
HALF = 0.5  # of what another model leaves of blocks that were not fitted


@dataclass(frozen=True)
class Seen:
    """One record: its name, its motor, what rig found (None: nothing), CPU seconds."""

    name: str
    motor: str
    found: Identification | None
    cpu_s: float

    @property
    def answer(self) -> Answer | None:
        """The answer, None without one."""
        return None if self.found is None else self.found.answer

    def given(self, name: str) -> tuple[float, float] | None:
        """Value and half width of a usable number; None where rig gives none."""
        one = None if self.answer is None else (self.answer.grade or {}).get(name)
        return None if one is None or one.value is None or one.u95 is None else (one.value, one.u95)


@dataclass(frozen=True)
class Compared:
    """A known number beside rig's.

    known      value and half width
    value      rig's, whether it is given or not; nan without any
    u95        half width; inf without any
    bound      half width that the scatter of the fit alone has at 95 % (the Cramer-Rao bound with the residual's noise)
    is_given   whether rig gives it
    shares     held-out errors over the linear model's: of the motor that is known, nan where nobody says; of rig's
    """

    record: str
    motor: str
    name: str
    known: tuple[float, float]
    value: float
    u95: float
    bound: float
    is_given: bool
    shares: tuple[float, float] = (math.nan, math.nan)

    @property
    def is_nearer(self) -> bool:
        """Whether rig's motor leaves at most half as much of the record as the one whose number is known."""
        known, own = self.shares
        return own <= HALF * known

    @property
    def holds(self) -> bool:
        """Whether both agree within the sum of both half widths."""
        return abs(self.value - self.known[0]) <= self.known[1] + self.u95

    def cells(self) -> list[str]:
        """A row of the table."""
        size = max(abs(self.value), 1e-300)
        return [
            self.record,
            {"tau_s": "tau", "K_rad_s_V": "K", "fc_V": "f_c", LESS_BIAS: "f_c - a"}[self.name],
            f"{self.known[0]:.4g}"
            + (f" ± {100.0 * self.known[1] / abs(self.known[0]):.2g} %" if self.known[1] else ""),
            f"{self.value:.4g}",
            percent(self.u95 / size),
            percent(self.bound / size),
            percent((self.value - self.known[0]) / self.known[0]),
            "yes" if self.is_given else "no",
            self._word if self.is_given else "-",
        ]

    @property
    def _word(self) -> str:
        if self.holds:
            return "yes"
        return "NO: {:.2f} against {:.2f}".format(*self.shares) if self.is_nearer else "NO"


HEAD = ("record", "number", "known", "rig", "±", "± by scatter", "off", "given", "holds")


def compared(seen: Seen, numbers: Mapping[str, tuple[float, float]], share: float = math.nan) -> Iterator[Compared]:
    """Each known number of a record beside rig's; ``share``: held-out error of the motor that they are of."""
    answer = seen.answer
    predicts = None if answer is None else answer.predicts
    own = math.nan if predicts is None else number(predicts.error) / number(predicts.linear_error)
    for name, known in numbers.items():
        plain = "fc_V" if name == LESS_BIAS else name
        value = math.nan if answer is None else answer.value(plain)
        value = math.nan if value is None else value
        bounds = None if answer is None else answer.interval(plain)
        one = None if answer is None else (answer.grade or {}).get(name)
        u95 = math.inf if one is None or one.u95 is None else one.u95
        bound = math.inf if bounds is None else 0.5 * (bounds[1] - bounds[0])
        yield Compared(
            seen.name, seen.motor, name, known, value, u95, bound, seen.given(name) is not None, (share, own)
        )


def by_table(records: Sequence[Seen], known: Mapping[str, Known]) -> list[Compared]:
    """The numbers that the README's table gives."""
    of = [(seen, known[seen.name]) for seen in records if seen.name in known]
    return [one for seen, told in of for one in compared(seen, told.numbers, told.share)]


def by_published(records: Sequence[Seen]) -> list[Compared]:
    """The numbers that others published."""
    return [one for seen in records for one in compared(seen, PUBLISHED.get(seen.motor, {}))]


def laws_shared(records: Sequence[Seen]) -> tuple[int, int]:
    """Each law of a record beside each sibling that names one: how many the sibling names, too; of how many."""
    shared = count = 0
    for one, other in combinations(records, 2):
        if one.motor != other.motor or one.answer is None or other.answer is None:
            continue
        mine, theirs = ({law.name for law in seen.answer.law or ()} for seen in (one, other) if seen.answer is not None)
        if mine and theirs:
            count += len(mine) + len(theirs)
            shared += 2 * len(mine & theirs)
    return shared, count


def agreeing(records: Sequence[Seen], *, alike: bool = False) -> tuple[int, int]:
    """Of the usable numbers of two records of one motor: how many agree within the root sum of squares, of how many.

    alike   only of records with the same range: ``hold_alike``
    """
    agree = count = 0
    for one, other in combinations(records, 2):
        if one.motor != other.motor or (alike and not hold_alike(one, other)):
            continue
        for name in (*NUMBERS, LESS_BIAS):
            mine, theirs = one.given(name), other.given(name)
            if mine is not None and theirs is not None:
                count += 1
                agree += abs(mine[0] - theirs[0]) <= math.hypot(mine[1], theirs[1])
    return agree, count


def hold_alike(one: Seen, other: Seen) -> bool:
    """Whether two answers hold for the same range: the same ways, and of all their speeds at least half for both."""
    held, beside = (None if seen.answer is None else seen.answer.holds for seen in (one, other))
    if held is None or beside is None or held.speed_rad_s is None or beside.speed_rad_s is None:
        return False
    low, high, slow, fast = map(number, (*held.speed_rad_s, *beside.speed_rad_s))
    shared, every = min(high, fast) - max(low, slow), max(high, fast) - min(low, slow)
    return held.ways == beside.ways and shared >= SAME_RANGE * every


def figures(records: Sequence[Seen], known: Mapping[str, Known], following: Sequence[Next]) -> list[str]:
    """One row: what the issue asks for, over these records."""
    names = {seen.name for seen in records}
    table, published = by_table(records, known), by_published(records)
    predicted = [s for s in records if s.name in known and known[s.name].predicts]
    refused = sum(s.answer is None or s.answer.verdict == "refused" for s in predicted)
    pairs = [one for one in following if one.first in names and one.second in names]
    better = sum(one.rig <= BETTER * one.linear for one in pairs)
    useful = sum(any(s.given(n) is not None for n in (*NUMBERS, LESS_BIAS)) for s in records)
    return [
        *(_of(sum(c.is_given for c in some), len(some)) for some in (table, published)),
        *(
            _of(sum(c.is_given and not c.holds for c in some), sum(c.is_given for c in some))
            for some in (table, published)
        ),
        _of(sum(c.is_given and not c.holds and not c.is_nearer for c in table), sum(c.is_given for c in table)),
        _of(refused, len(predicted)),
        _of(useful, len(records)),
        _of(*agreeing(records)),
        _of(*agreeing(records, alike=True)),
        _of(better, len(pairs)),
        _of(*laws_shared(records)),
        _of(sum(s.cpu_s <= ASKED_CPU_S for s in records), len(records)),
    ]


FIGURES = (
    "known by the table: given (3/4 asked)",
    "published: given",
    "by the table: off",
    "published: off",
    "by the table: off without that reason (0 asked)",
    "refused, of those that can be predicted (0 asked)",
    "records with a usable number",
    "numbers of siblings that agree (90 % asked)",
    "the same, of siblings whose answers hold for the same range",
    "next record: at most 1.05 x linear (3/4 asked)",
    "laws shared (60 % asked)",
    "within 12 s of CPU (90 % asked)",
)


def left_out(records: Sequence[Seen], known: Mapping[str, Known], following: Sequence[Next]) -> list[list[str]]:
    """Rows: each figure over all records, then with each motor left out."""
    motors = list(dict.fromkeys(seen.motor for seen in records))
    columns = [figures(records, known, following)]
    columns += [figures([s for s in records if s.motor != motor], known, following) for motor in motors]
    return [[what, *row] for what, *row in zip(FIGURES, *columns, strict=True)]


def left_out_head(records: Sequence[Seen]) -> list[str]:
    """Of ``left_out``."""
    return ["figure", "all", *(f"without {motor}" for motor in dict.fromkeys(seen.motor for seen in records))]


def _of(part: int, whole: int) -> str:
    return f"{part} of {whole}"


def percent(share: float) -> str:
    """In words: ``3.2 %``; ``unknown`` from ten times the number on."""
    return f"{100.0 * share:.2g} %" if math.isfinite(share) and abs(share) < 10.0 else "unknown"
