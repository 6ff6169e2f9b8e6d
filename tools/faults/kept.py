"""What was measured so far, line by line: docs/evidence/fault-lines.json. So a part may be run anew.

A line is a row on a device in a stage. Each has the day and the code that it was measured with.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path

from faults.backends import Backend
from faults.bounds import Times
from faults.case import Found
from faults.rows import Row
from faults.stages import BY_KEY, STAGES, Stage
from rig.run_folder.recording.folder import write_whole

ROOT = Path(__file__).resolve().parents[2]
PLACE = ROOT / "docs" / "evidence" / "fault-lines.json"
CODE = ("rig", "firmware")  # what is measured: with other code a line may be another


@dataclass(frozen=True)
class Line:
    """A row of the matrix on one device in one stage, over all phases; the row as it is there."""

    row: Row
    backend: Backend
    stage: Stage
    times: Times
    found: tuple[Found, ...]

    @property
    def trouble(self) -> list[str]:
        """What should not be."""
        return [
            f"{f.row}, {f.backend}, {f.stage}, phase {f.phase:.2f}: {words}" for f in self.found for words in f.trouble
        ]

    def kept(self, made: str, code: str) -> Kept:
        """What is kept of it; ``made`` and ``code`` as of ``Kept``."""
        found = self.found
        return Kept(
            made,
            code,
            cases=len(found),
            off_s=max(f.off_s for f in found),
            within_s=self.row.bound.seconds(self.times),
            is_broken=not all(f.off_s <= f.bound_s for f in found),
            runs_on=all(f.code == "" and f.status in (0, 1) for f in found),
            beyond_rad=max(f.beyond_rad for f in found),
            shown=tuple(sorted({f"{f.code or '-'}, {f.status}" for f in found})),
            lost=sum(f.lost for f in found),
            wrong=sum(bool(f.trouble) for f in found),
            next_run="; ".join(sorted({f.restart for f in found if f.restart})),
        )


@dataclass(frozen=True)
class Kept:
    """A line as it is kept.

    made        day on which it was measured
    code        first digits of the digest of what measured it (``code_of``); empty: not known
    cases       phases that were tried
    off_s       longest time that the drive was on, s; ``within_s``: its bound
    is_broken   in some case that was longer than the bound
    runs_on     no case ended the run
    beyond_rad  farthest position of the shaft beyond a hard limit, rad
    shown       codes, each with its exit status
    lost        samples; ``wrong``: cases with anything that should not be
    next_run    what the next run does, in words; empty if not tried
    """

    made: str
    code: str
    cases: int
    off_s: float
    within_s: float
    is_broken: bool
    runs_on: bool
    beyond_rad: float
    shown: tuple[str, ...]
    lost: int
    wrong: int
    next_run: str

    @property
    def codes(self) -> tuple[str, ...]:
        """The codes, or what stands for none."""
        pairs = [shown.rsplit(", ", 1) for shown in self.shown]
        names = {code if code != "-" else ("killed" if int(status) < 0 else "runs on") for code, status in pairs}
        return tuple(sorted(names))


Key = tuple[str, str, str]  # a row's name, a device's key, a stage's key


@dataclass(frozen=True)
class Lines:
    """All that the pages are made of.

    lines  by row, device and stage
    times  by device: what its bounds are made of, by name, s
    real   the table of the rows in real time: its cells
    untold by device: wrong cases of a run that kept no lines, so that nobody knows in which; until each of the device's
           lines was measured anew
    """

    lines: Mapping[Key, Kept]
    times: Mapping[str, Mapping[str, float]]
    real: Sequence[Sequence[object]] = ()
    untold: Mapping[str, int] = field(default_factory=dict)

    def of(self, row: Row, backend: Backend) -> list[tuple[Stage, Kept]]:
        """Those of a row on a device, by stage."""
        keys = ((stage, (row.name, backend.key, stage.key)) for stage in STAGES)
        return [(stage, self.lines[key]) for stage, key in keys if key in self.lines]

    def with_measured(self, measured: Iterable[Line], made: str, code: str) -> Lines:
        """These, with what was measured now in place of what was before."""
        new, times = dict(self.lines), {key: dict(value) for key, value in self.times.items()}
        for line in measured:
            new[line.row.name, line.backend.key, line.stage.key] = line.kept(made, code)
            known = {name: s for name, s in line.times._asdict().items() if math.isfinite(s)}
            times[line.backend.key] = times.get(line.backend.key, {}) | known
        of_old_run = {device for (_, device, _), kept in new.items() if kept.code == ""}
        untold = {device: cases for device, cases in self.untold.items() if device in of_old_run}
        return replace(self, lines=new, times=times, untold=untold)

    def with_real(self, cells: Iterable[Sequence[object]], places: Iterable[tuple[str, str]]) -> Lines:
        """These, with rows in real time that were measured now; of all only those of these places, in their order."""
        rows = {tuple(row[:2]): row for row in (*self.real, *cells)}
        return replace(self, real=[rows[place] for place in places if place in rows])

    def only(self, places: Iterable[Key]) -> Lines:
        """Those that are still in the matrix."""
        wanted = set(places)
        return replace(self, lines={key: kept for key, kept in self.lines.items() if key in wanted})


NONE = Lines({}, {})


def read(path: Path = PLACE) -> Lines:
    """What is kept; nothing where there is no file."""
    if not path.exists():
        return NONE
    told = json.loads(path.read_text(encoding="utf-8"))
    lines = {}
    for name, kept in told["lines"].items():
        row, device, stage = name.split(" | ")
        if stage in BY_KEY:
            lines[row, device, stage] = Kept(**kept | {"shown": tuple(kept["shown"])})
    return Lines(lines, told["times"], told["real"], told["untold"])


def write(lines: Lines, path: Path = PLACE) -> None:
    """Keep these, and no others; a line of the file is a line of the matrix."""
    parts = [f"{json.dumps(' | '.join(key))}: {json.dumps(asdict(kept))}" for key, kept in sorted(lines.lines.items())]
    others = {"times": lines.times, "real": lines.real, "untold": lines.untold}
    rest = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in others.items()]
    text = '{"lines": {\n' + ",\n".join(parts) + "},\n" + ",\n".join(rest) + "}\n"
    write_whole(path, text.encode("ascii"))


def code_of(folders: Sequence[str] = CODE) -> str:
    """First digits of the digest of every file of the code that a line depends on."""
    digest = sha256()
    for folder in folders:
        for path in sorted(p for p in (ROOT / folder).rglob("*") if p.is_file()):
            name = path.relative_to(ROOT)
            if path.suffix in (".py", ".c", ".h", ".js", ".yaml", ".mk", ".S") and "node_modules" not in name.parts:
                digest.update(f"{name}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:8]
