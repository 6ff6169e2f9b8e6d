"""docs/mutant-table.md from what came of each mutant."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from mutants.mutant import Mutant
from mutants.session import CAUGHT, SURVIVED, Result
from shared.table import markdown

_HEAD = """\
# Defects put in on purpose, and what catches them

Made by `make mutants`, {made}. Each mutant is one defect in a copy of the tree; firmware is built anew. It meets the
tests that are named for it, and every other test (but those that need a real clock) only if it survives them. The
command fails if one survives, if the place that it changes is gone, or if its tests fail without it. An interrupted run
goes on where it was: what is known is in `build/mutants/state.jsonl`, for as long as the changed file and the tests
that caught the mutant are the same; a survivor meets every change of the tree. The tool is
[tools/mutants](../tools/mutants).

{named} named defects, {caught} caught. {drawn} at random, {killed} caught{hung}, {equivalent} equivalent.
"""

_RANDOM_HEAD = """\
## At random

Changes that [cosmic-ray](https://pypi.org/project/cosmic-ray/) knows (operators, comparisons, numbers, conditions,
loops, decorators), at places drawn with a seed from all modules of the room; left out are annotations and what only
makes the words of a message. A place keeps its lot when the code changes elsewhere. Each meets the tests of its room
alone. A mutant that hangs is ended by its bound on processor time, and counts as caught.
"""


def render(
    made: str,
    named: Mapping[str, Sequence[Mutant]],
    drawn: Mapping[str, Sequence[Mutant]],
    results: Mapping[str, Result],
    equivalent: Mapping[str, str],
) -> str:
    """The page; ``named`` and ``drawn`` by room."""
    all_named = [mutant for mutants in named.values() for mutant in mutants]
    all_drawn = [mutant for mutants in drawn.values() for mutant in mutants]
    hung = sum(results[mutant.name].outcome == "hung" for mutant in all_drawn)
    parts = [
        _HEAD.format(
            made=made,
            named=len(all_named),
            caught=_caught(all_named, results),
            drawn=len(all_drawn),
            killed=_caught(all_drawn, results),
            hung=f" ({hung} of them hung)" if hung else "",
            equivalent=sum(mutant.name in equivalent for mutant in all_drawn),
        )
    ]
    for room, mutants in named.items():
        rows = ((_cell(mutant.name), _where(mutant), _by(results[mutant.name])) for mutant in mutants)
        parts.append(f"## {room[0].upper()}{room[1:]}\n\n{markdown(('defect', 'in', 'caught by'), rows)}\n")
    counts = (
        (f"`{room}`", len(mutants), _caught(mutants, results), sum(mutant.name in equivalent for mutant in mutants))
        for room, mutants in drawn.items()
    )
    parts.append(f"{_RANDOM_HEAD}\n{markdown(('room', 'drawn', 'caught', 'equivalent'), counts)}\n")
    survivors = [mutant for mutant in all_drawn if results[mutant.name].outcome == SURVIVED]
    if survivors:
        whys = ((_where(mutant), _change(mutant), equivalent.get(mutant.name, "**unknown**")) for mutant in survivors)
        head = "### What survives, and why nothing can tell it"
        parts.append(f"{head}\n\n{markdown(('in', 'change', 'why'), whys)}\n")
    caught = ((_where(m), _change(m), _by(results[m.name])) for m in all_drawn if m not in survivors)
    parts.append(f"### What is caught\n\n{markdown(('in', 'change', 'caught by'), caught)}\n")
    return "\n".join(parts)


def _caught(mutants: Sequence[Mutant], results: Mapping[str, Result]) -> int:
    return sum(results[mutant.name].outcome in CAUGHT for mutant in mutants)


def _where(mutant: Mutant) -> str:
    place = mutant.path.removeprefix("rig/").removeprefix("firmware/")
    return f"`{place}`" + (f" `{mutant.function}`" if mutant.function else "")


def _change(mutant: Mutant) -> str:
    return f"`{_code(mutant.old)}` &rarr; `{_code(mutant.new)}`"


def _code(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("`", "'")


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _by(result: Result) -> str:
    if result.outcome not in CAUGHT:
        return f"**{result.outcome}**"
    tests = ", ".join(_cell(_short(test)) for test in result.by[:2])
    words = {"hung": f"it hangs: {tests}", "killed by the suite": f"another test than named: {tests}"}
    return words.get(result.outcome, tests)


def _short(test: str) -> str:
    """A test without its folders; of the fault matrix the row and the device."""
    row = re.fullmatch(r".*test_faults_matrix\.py::test_every_fault_\w+\[(.*)-(\w+)\]", test)
    return f"matrix: {row[1]}, {row[2]}" if row else test.rpartition("/")[2]
