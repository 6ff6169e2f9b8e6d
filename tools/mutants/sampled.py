"""Random mutants: one of the changes that cosmic-ray knows, at places drawn from the code."""

from __future__ import annotations

import ast
import hashlib
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import parso
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider

from mutants.functions import name_at
from mutants.mutant import Mutant

# they need arguments of their own
_NOT_DRAWN = ("VariableReplacer", "VariableInserter")

Place = tuple[tuple[int, int], tuple[int, int]]  # line from 1 and column, of begin and end


@dataclass(frozen=True)
class Room:
    """Modules that are changed at random, and the tests that each change meets.

    folder   of the modules
    number   of mutants
    tests    of the room
    own      of a module, by its name: which tests its mutants meet first, where none are called after it
    """

    folder: str
    number: int
    tests: tuple[str, ...]
    own: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def draw(root: Path, room: Room, seed: str) -> list[Mutant]:
    """Mutants of a room: those places, and of each that change, whose hash with the seed is least.

    So a change of the code elsewhere moves nobody; what is drawn stays where it was.
    """
    places: list[tuple[str, Path, str, list[tuple[str, int]]]] = []
    for path in sorted((root / room.folder).glob("*.py")):
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines()
        for place, changes in _places(text).items():
            words = lines[place[0][0] - 1]
            key = f"{seed} {path.name} {words.strip()} {place[0][1] - len(words) + len(words.lstrip())}"
            places.append((_hash(key), path, key, changes))
    drawn: dict[str, Mutant] = {}
    for _, path, key, changes in sorted(places, key=lambda place: place[0]):
        if len(drawn) == room.number:
            break
        text = path.read_text(encoding="utf-8")
        for operator, occurrence in sorted(changes, key=lambda change: _hash(f"{key} {change[0]}")):
            changed = mutate_code(text, OperatorProvider()[operator](), occurrence)
            if changed is not None and _differs(text, changed):
                mutant = _mutant(str(path.relative_to(root)), text, changed)
                own = _own(root, room, path)
                drawn.setdefault(mutant.name, replace(mutant, killers=own or room.tests, others=room.tests))
                break
    return list(drawn.values())


def _places(text: str) -> dict[Place, list[tuple[str, int]]]:
    """Where something can be changed, and the changes there: operator, and which of its occurrences."""
    nodes = list(_walk(parso.parse(text)))  # type: ignore[no-untyped-call]
    left_out = list(_silent(text))
    places: dict[Place, list[tuple[str, int]]] = defaultdict(list)
    for name in OperatorProvider():
        if name in _NOT_DRAWN:
            continue
        occurrence = 0
        operator = OperatorProvider()[name]()
        for node in nodes:
            for place in operator.mutation_positions(node):
                if not any(begin <= place[0] and place[1] <= end for begin, end in left_out):
                    places[place].append((name, occurrence))
                occurrence += 1
    return places


def _walk(node: parso.tree.NodeOrLeaf) -> Iterator[parso.tree.NodeOrLeaf]:
    yield node
    for child in getattr(node, "children", ()):
        yield from _walk(child)


def _silent(text: str) -> Iterator[Place]:
    """What does nothing but speak: annotations, words in f-strings, decorators of types."""
    for node in ast.walk(ast.parse(text)):
        parts: Sequence[ast.expr | None] = ()
        if isinstance(node, ast.FunctionDef):
            every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs, node.args.vararg, node.args.kwarg)
            parts = (node.returns, *(argument.annotation for argument in every if argument))
        elif isinstance(node, ast.AnnAssign):
            parts = (node.annotation,)
        elif isinstance(node, ast.JoinedStr):
            parts = (node,)
        elif (
            isinstance(node, ast.Assign) and isinstance(node.value, ast.BinOp | ast.Subscript) and _is_type(node.value)
        ):
            parts = (node.value,)
        for part in parts:
            if part is not None:
                end = (part.end_lineno or part.lineno, part.end_col_offset or 0)
                yield ((part.lineno, part.col_offset), end)


def _is_type(value: ast.expr) -> bool:
    """Whether it is the alias of a type: names, | and [] alone."""
    allowed = (ast.BinOp, ast.BitOr, ast.Name, ast.Load, ast.Subscript, ast.Constant, ast.Tuple, ast.Attribute)
    return all(isinstance(node, allowed) for node in ast.walk(value)) and not any(
        isinstance(node, ast.Constant) and not isinstance(node.value, str | None.__class__) for node in ast.walk(value)
    )


def _differs(text: str, changed: str) -> bool:
    try:
        return ast.dump(ast.parse(changed)) != ast.dump(ast.parse(text))
    except SyntaxError:
        return False


def _mutant(path: str, text: str, changed: str) -> Mutant:
    """The same change, anchored to the lines of its function."""
    before, after = text.splitlines(keepends=True), changed.splitlines(keepends=True)
    first = next(k for k, (a, b) in enumerate(zip(before, after, strict=False)) if a != b)
    behind = next(k for k, (a, b) in enumerate(zip(reversed(before), reversed(after), strict=False)) if a != b)
    old, new = "".join(before[first : len(before) - behind]), "".join(after[first : len(after) - behind])
    function = name_at(text, sum(map(len, before[:first])), is_c=False)
    mutant = Mutant("", path, function, old, new, (), 0)
    while mutant.applied(text) != changed:
        mutant = replace(mutant, occurrence=(mutant.occurrence or 0) + 1)
    which = f" ({mutant.occurrence + 1})" if mutant.occurrence else ""
    where = f"{path.removeprefix('rig/')} {function}".strip()
    return replace(mutant, name=f"{where}{which}: {' '.join(old.split())} -> {' '.join(new.split())}")


def _own(root: Path, room: Room, path: Path) -> tuple[str, ...]:
    """Tests of a module: those that are called after it, and those that the room names."""
    called = f"test_{Path(room.folder).name}_{path.stem}"
    files = [
        file
        for tests in room.tests
        for file in sorted((root / tests).glob("test_*.py"))
        if not _needs_a_clock(file.read_text(encoding="utf-8"))
    ]
    return (
        *(str(file.relative_to(root)) for file in files if file.stem.startswith(called)),
        *room.own.get(path.stem, ()),
    )


def _needs_a_clock(text: str) -> bool:
    """Whether each test of a file needs a real clock, which no mutant has."""
    marks = re.findall(r"^@pytest\.mark\.(?:realtime|alone)$", text, re.MULTILINE)
    return len(marks) == len(re.findall(r"^def test_", text, re.MULTILINE))


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
