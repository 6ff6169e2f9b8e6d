"""docs/evidence/mutant-table.md from what came of each mutant."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from mutants.mutant import Mutant
from mutants.session import CAUGHT, SURVIVED, Result
from shared import page

_TEMPLATE = Path(__file__).with_name("page.md.j2")


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
    survivors = [mutant for mutant in all_drawn if results[mutant.name].outcome == SURVIVED]
    return page.render(
        _TEMPLATE,
        made=made,
        named=len(all_named),
        caught=_caught(all_named, results),
        drawn=len(all_drawn),
        killed=_caught(all_drawn, results),
        hung=sum(results[mutant.name].outcome == "hung" for mutant in all_drawn),
        equivalent=sum(mutant.name in equivalent for mutant in all_drawn),
        rooms=[
            (f"{room[0].upper()}{room[1:]}", [(_cell(m.name), _where(m), _by(results[m.name])) for m in mutants])
            for room, mutants in named.items()
        ],
        counts=[
            (f"`{room}`", len(mutants), _caught(mutants, results), sum(mutant.name in equivalent for mutant in mutants))
            for room, mutants in drawn.items()
        ],
        survivors=[(_where(m), _change(m), equivalent.get(m.name, "**unknown**")) for m in survivors],
        found=[(_where(m), _change(m), _by(results[m.name])) for m in all_drawn if m not in survivors],
    )


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
