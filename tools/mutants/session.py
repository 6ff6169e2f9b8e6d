"""One mutant after the other, each once: what came of it is kept, so that an interrupted run goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from resource import RLIM_INFINITY

from mutants.mutant import AnchorError, Mutant
from mutants.workshop import Limits, Workshop

SUITE = Limits(cpu_s=7200.0, wall_s=14400.0, memory_bytes=RLIM_INFINITY)  # some of its tests run sanitizers
_SLOWER = 5.0  # a mutant's tests may take so many times what they take without it, and
_SPARE_S = 60.0
_SPARE_WALL_S = 300.0
_MOST_WALL_S = 1800.0  # of a machine that is busy otherwise

CAUGHT = ("killed", "hung", "killed by the suite")
SURVIVED = "survived"


@dataclass(frozen=True)
class Result:
    """What came of a mutant.

    outcome  one of ``CAUGHT``; ``SURVIVED``; else what is wrong with the mutant itself
    by       tests that failed
    of       what it holds for: see ``Session``
    """

    outcome: str
    by: tuple[str, ...]
    cpu_s: float
    of: str = ""


_NEVER = Result("not run", (), 0.0)


class State:
    """Results in a file, a line each, by what they are of."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[str, Result] = {}
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    told = json.loads(line)
                    self._known[told["key"]] = Result(told["outcome"], tuple(told["by"]), told["cpu_s"], told["of"])
                except (ValueError, KeyError):
                    continue  # torn by an interruption, which leaves no line end

    def get(self, key: str) -> Result | None:
        """What is known of it."""
        return self._known.get(key)

    def put(self, key: str, name: str, result: Result) -> None:
        """Keep it, at once."""
        self._known[key] = result
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write("\n" + json.dumps({"key": key, "name": name, **asdict(result)}))


class Session:
    """Runs mutants in a workshop. A catch holds while the changed file and the tests that failed are the same; a mutant
    that was not caught meets every change of the tree.

    with_suite  a mutant that its killers let pass meets every other test
    say         told of each result
    spare_cpu_s processor time that a mutant's tests may take beyond a multiple of what they take without it
    """

    def __init__(
        self,
        workshop: Workshop,
        state: State,
        *,
        with_suite: bool,
        say: Callable[[str], None] = print,
        spare_cpu_s: float = _SPARE_S,
    ) -> None:
        self._workshop, self._state, self._with_suite, self._say = workshop, state, with_suite, say
        self._spare_s = spare_cpu_s
        self._hashes: dict[str, str] = {}
        self._tree = _hash(
            self._hash_of(str(path.relative_to(workshop.tree)))
            for path in sorted(workshop._files(workshop.tree))
            if path.suffix in (".py", ".c", ".h", ".yaml", ".mk")
        )

    def run(self, mutants: Sequence[Mutant]) -> dict[str, Result]:
        """Results by name, in order."""
        waiting = [mutant for mutant in mutants if self._known(mutant) is None]
        took_s = self._healthy({killer: None for mutant in waiting for killer in mutant.killers})
        for number, mutant in enumerate(waiting, 1):
            result = self._new(mutant, took_s)
            self._keep(mutant, result)
            words = f"{result.outcome} by {result.by[0]}" if result.by else result.outcome
            self._say(f"{number}/{len(waiting)} {mutant.name}: {words} ({result.cpu_s:.0f} s)")
        return {mutant.name: self._known(mutant) or _NEVER for mutant in mutants}

    # ------------------------------------------------------------------ one mutant

    def _new(self, mutant: Mutant, took_s: Mapping[str, float]) -> Result:
        try:
            mutant.applied_in(self._workshop.tree)
            complaint = self._workshop.complaint(mutant) if mutant.is_c else ""
        except AnchorError as error:
            return Result("anchor gone", (str(error),), 0.0)
        if complaint:
            return Result("does not compile", tuple(complaint.splitlines()[:1]), 0.0)
        first = self._meet(mutant, mutant.killers, took_s)
        if first.outcome != SURVIVED or not (mutant.others or self._with_suite):
            return first
        if mutant.others:
            last = self._meet(mutant, mutant.others, self._healthy(mutant.others))
        else:
            with self._workshop.with_defect(mutant):
                met = self._workshop.suite(SUITE)
            last = Result(SURVIVED if met.outcome == "passed" else CAUGHT[2], met.by, met.cpu_s)
        return replace(last, cpu_s=first.cpu_s + last.cpu_s)

    def _meet(self, mutant: Mutant, tests: Sequence[str], took_s: Mapping[str, float]) -> Result:
        """What these tests say to it; ``took_s`` has those that pass without it, and their times."""
        unfit = tuple(test for test in tests if test not in took_s)
        if unfit:
            return Result("its tests fail without it", unfit, 0.0)
        needed_s = sum(took_s[test] for test in tests)
        limits = Limits(_SLOWER * needed_s + self._spare_s, min(_SLOWER * needed_s + _SPARE_WALL_S, _MOST_WALL_S))
        with self._workshop.with_defect(mutant):
            met = self._workshop.meet(tests, limits)
        outcome = {"passed": SURVIVED, "hung": "hung"}.get(met.outcome, "killed")
        return Result(outcome, met.by, met.cpu_s)

    def _healthy(self, killers: Iterable[str]) -> dict[str, float]:
        """Tests that pass without any defect, and their times: what fails then catches nothing. Of this very tree."""
        known = {killer: self._state.get(_hash(["healthy", self._tree, killer])) for killer in killers}
        unknown = [killer for killer, result in known.items() if result is None]
        if unknown:
            self._say(f"{len(unknown)} tests without a defect")
            passing = self._workshop.healthy(unknown, SUITE)
            for killer in unknown:
                result = Result("passed" if killer in passing else "failed", (), passing.get(killer, 0.0))
                known[killer] = result
                self._state.put(_hash(["healthy", self._tree, killer]), f"without a defect: {killer}", result)
        return {killer: result.cpu_s for killer, result in known.items() if result and result.outcome == "passed"}

    # ------------------------------------------------------------------ what a result is of

    def _known(self, mutant: Mutant) -> Result | None:
        result = self._state.get(self._key(mutant))
        return result if result is not None and result.of == self._of(mutant, result) else None

    def _keep(self, mutant: Mutant, result: Result) -> None:
        self._state.put(self._key(mutant), mutant.name, replace(result, of=self._of(mutant, result)))

    def _key(self, mutant: Mutant) -> str:
        what = (mutant.path, mutant.function, mutant.old, mutant.new, str(mutant.occurrence), *mutant.killers)
        return _hash([*what, *mutant.others, self._hash_of(mutant.path)])

    def _of(self, mutant: Mutant, result: Result) -> str:
        if result.outcome not in CAUGHT:
            return f"{self._tree} {self._with_suite}"
        files = sorted({test.partition("::")[0] for test in result.by if ".py" in test or ".c" in test})
        return _hash(self._hash_of(file) for file in files or mutant.killers)

    def _hash_of(self, name: str) -> str:
        """Of a file, or of all in a folder."""
        if name not in self._hashes:
            path = self._workshop.tree / name
            files = sorted(path.rglob("*.py")) if path.is_dir() else [path] if path.is_file() else []
            self._hashes[name] = _hash(file.read_text(encoding="utf-8") for file in files)
        return self._hashes[name]


def _hash(parts: Iterable[str]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() + b"\0")
    return digest.hexdigest()
