"""`make mutants`: every place that it changes is there, and the tool notices what it must not let pass."""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from functools import cache
from itertools import chain
from pathlib import Path

import pytest

from faults.backends import BACKENDS
from faults.rows import ROWS
from mutants import named
from mutants.__main__ import wrong
from mutants.functions import name_at, spans
from mutants.mutant import AnchorError, Mutant
from mutants.named import all_named
from mutants.page import render
from mutants.rooms import EQUIVALENT, ROOMS
from mutants.sampled import Room, draw
from mutants.session import Result, Session, State
from mutants.workshop import Limits, Workshop
from rig.config import ConfigError
from shared.data import load

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]


# ---------------------------------------------------------------------- the list


def test_each_named_mutant_changes_its_function_and_no_two_are_called_alike() -> None:
    for mutant in all_named():
        assert mutant.applied_in(ROOT) != (ROOT / mutant.path).read_text(encoding="utf-8")
    assert [name for name, times in Counter(m.name for m in all_named()).items() if times > 1] == []
    assert len(all_named()) >= 40


def test_a_room_has_the_modules_and_the_tests_that_it_names() -> None:
    named_files = [ROOT / room.folder / f"{name}.py" for room in ROOMS for name in room.own]
    tests = [ROOT / test for room in ROOMS for test in (*room.tests, *chain.from_iterable(room.own.values()))]
    assert [path for path in named_files + tests if not path.exists()] == []


def test_a_data_file_is_refused_by_file_and_line_for_a_key_that_nobody_knows_and_a_value_that_is_no_text(
    tmp_path: Path,
) -> None:
    file = tmp_path / "a.yaml"
    good = (
        "room: a\nfiles:\n  - path: a.py\n    tests: b.py\n    mutants:\n"
        "      - name: m\n        old: a\n        new: b\n"
    )
    file.write_text(good, encoding="utf-8")
    (mutant,) = load(file, named.Room).files[0].all()
    assert mutant == Mutant("m", "a.py", "", "a", "b", ("b.py",))
    for old, new, line, key in (
        ("old:", "odl:", 7, "odl"),
        ("new: b", "new: 5", 8, "new"),
        ("    tests", "    test", 4, "test"),
    ):
        file.write_text(good.replace(old, new), encoding="utf-8")
        with pytest.raises(
            ConfigError, match=rf"^{re.escape(str(file))}:{line}:\d+: files\[0\]\.(mutants\[0\]\.)?{key}: "
        ):
            load(file, named.Room)


@pytest.mark.evidence
def test_each_mutant_of_the_firmware_compiles_without_a_warning(tmp_path: Path) -> None:
    workshop = Workshop(ROOT, tmp_path)
    workshop.prepare(only="firmware")
    wrong = {
        mutant.name: complaint for mutant in all_named() if mutant.is_c and (complaint := workshop.complaint(mutant))
    }
    assert wrong == {}


@cache
def functions_of(name: str) -> set[str]:
    tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_each_test_that_is_to_catch_one_is_there() -> None:
    rows, devices = {row.name for row in ROWS}, {backend.key for backend in BACKENDS}
    for killer in {killer for mutant in all_named() for killer in mutant.killers}:
        name, _, test = killer.partition("::")
        assert (ROOT / name).exists(), killer
        if test:
            function, _, example = test.partition("[")
            assert function in functions_of(name), killer
            if example:
                row, _, device = example.removesuffix("]").rpartition("-")
                assert row in rows and device in devices, killer


def test_the_table_in_the_docs_has_each_named_mutant() -> None:
    page = (ROOT / "docs" / "evidence" / "mutant-table.md").read_text(encoding="utf-8")
    assert [mutant.name for mutant in all_named() if f"| {mutant.name} |" not in page] == []
    assert re.search(r"\| \*\*\w", page) is None  # nothing survived that should not, and nothing went wrong
    assert all(why in page for why in EQUIVALENT.values())


# ---------------------------------------------------------------------- where functions are

C_FILE = """\
static const table BOARD = {
    .drive = 1,
};

#if A
static void on(uint8_t n)
{
    x = 1;
}
#else
static void on(uint8_t n)
{
    x = 2;
}
#endif

ISR(ADC_vect)
{
    y = 3;
}
"""


@pytest.mark.parametrize(
    ("name", "text"), [("on", "x = 2;"), ("ADC_vect", "y = 3;"), ("BOARD", ".drive = 1"), ("", "#else")]
)
def test_a_function_of_c_is_found_by_its_name(name: str, text: str) -> None:
    assert any(text in C_FILE[start:end] for start, end in spans(C_FILE, name, is_c=True))
    assert name_at(C_FILE, C_FILE.index(text), is_c=True) == name
    assert Mutant("m", "a.c", name, text, "z", ()).applied(C_FILE).count("z") == C_FILE.count("z") + 1


def test_an_anchor_that_is_gone_doubtful_or_changes_nothing_is_an_error(tmp_path: Path) -> None:
    text = "class A:\n    def f(self):\n        return 1 + 1\n\n    def g(self):\n        return 2\n"
    assert Mutant("m", "a.py", "A.g", "return 2", "return 3", ()).applied(text).endswith("return 3\n")
    for function, old, new in (
        ("A.f", "return 2", "return 3"),  # in another function
        ("A.h", "return 2", "return 3"),
        ("A.f", "1", "2"),  # twice
        ("A.g", "return 2", "return  2"),
        ("A.g", "return 2", "return )"),
    ):
        with pytest.raises(AnchorError):
            Mutant("m", "a.py", function, old, new, ()).applied(text)
    with pytest.raises(AnchorError, match="no such file"):
        Mutant("m", "gone.py", "", "a", "b", ()).applied_in(tmp_path)


# ---------------------------------------------------------------------- the tool

CODE = """\
def larger(a: float, b: float) -> float:
    if a > b:
        return a
    return b


def count(n: int) -> int:
    k = 0
    while k < n:
        k += 1
    return k
"""
TESTS = """\
from code_of_ours import count, larger

def test_larger():
    assert (larger(1, 2), larger(2, 1)) == (2, 2)

def test_count():
    assert count(5) == 5

def test_of_another():
    assert larger(-1, -2) == -1

def test_that_fails_anyway():
    assert False
"""


@pytest.fixture
def workshop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workshop:
    """Of a tree with one module and its tests, which need no plug-in: to load them takes longer than they do."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTEST_PLUGINS", "pytest_timeout")
    source = tmp_path / "source"
    (source / "tests").mkdir(parents=True)
    (source / "code_of_ours.py").write_text(CODE)
    (source / "tests" / "test_code.py").write_text(TESTS)
    (source / "pytest.ini").write_text("[pytest]\nmarkers =\n    realtime\n    alone\n    evidence\n")
    workshop = Workshop(source, tmp_path / "work")
    workshop.prepare()
    return workshop


def of_ours(name: str, old: str, new: str, *tests: str, function: str = "larger") -> Mutant:
    return Mutant(name, "code_of_ours.py", function, old, new, tuple(f"tests/test_code.py::{test}" for test in tests))


@pytest.mark.evidence
def test_what_comes_of_a_mutant(workshop: Workshop, tmp_path: Path) -> None:
    mutants = [
        of_ours("caught", "a > b", "a < b", "test_larger"),
        of_ours("equivalent", "a > b", "a >= b", "test_larger"),
        of_ours("endless", "k < n", "k < n or True", "test_count", function="count"),
        of_ours("no anchor", "a != b", "a < b", "test_larger"),
        of_ours("no test", "a > b", "a < b", "test_of_nothing"),
        of_ours("failing test", "a > b", "a < b", "test_that_fails_anyway"),
    ]
    said: list[str] = []
    state = State(tmp_path / "state.jsonl")
    results = Session(workshop, state, with_suite=False, say=said.append, spare_cpu_s=2.0).run(mutants)
    assert {name: result.outcome for name, result in results.items()} == {
        "caught": "killed",
        "equivalent": "survived",
        "endless": "hung",
        "no anchor": "anchor gone",
        "no test": "its tests fail without it",
        "failing test": "its tests fail without it",
    }
    assert results["caught"].by == ("tests/test_code.py::test_larger",)
    assert (workshop.tree / "code_of_ours.py").read_text() == CODE  # as it was
    trouble = wrong(mutants, [], results, {}, complete=True)
    assert [line.partition(":")[0] for line in trouble] == ["equivalent", "no anchor", "no test", "failing test"]

    # of one drawn at random a survivor may be called equivalent, but only as long as it survives and is drawn
    drawn = mutants[:2]
    reasons = {"equivalent": "of two that are alike either is the larger"}
    assert wrong([], drawn, results, reasons, complete=True) == []
    assert wrong([], drawn, results, reasons | {"caught": "", "another": ""}, complete=True) == [
        "caught: called equivalent, but caught by tests/test_code.py::test_larger",
        "another: called equivalent, but not drawn",
    ]
    page = render("today", {"ours": mutants[:1]}, {"room": drawn}, results, reasons)
    assert "| caught | `code_of_ours.py` `larger` | test_code.py::test_larger |" in page
    assert "of two that are alike" in page and "**" not in page

    # again: nothing is run but what was not caught
    said.clear()
    Session(workshop, State(tmp_path / "state.jsonl"), with_suite=False, say=said.append).run(mutants)
    assert said == []  # the tree is the same
    (workshop.source / "more.py").write_text("x = 1\n")
    workshop.prepare()
    Session(workshop, State(tmp_path / "state.jsonl"), with_suite=False, say=said.append).run(mutants[:3])
    again = " ".join(said)
    assert "caught" not in again and "endless" not in again and "equivalent: survived" in again


def test_one_that_its_tests_let_pass_meets_all_the_others(tmp_path: Path, workshop: Workshop) -> None:
    (workshop.tree / "tests" / "test_code.py").write_text(TESTS.replace("assert False", "assert True"))
    mutant = of_ours("let pass", "return a\n", "return abs(a)\n", "test_larger")
    result = Session(workshop, State(tmp_path / "state.jsonl"), with_suite=True, say=lambda _: None).run([mutant])
    assert result["let pass"].outcome == "killed by the suite"
    assert result["let pass"].by == ("tests/test_code.py::test_of_another",)


def test_a_state_that_is_torn_is_read_to_where_it_tears(tmp_path: Path) -> None:
    path = tmp_path / "state.jsonl"
    result = Result("killed", ("t",), 1.0, "hash")
    State(path).put("a", "first", result)
    path.write_text(path.read_text() + '\n{"key": "b", "na')
    State(path).put("c", "third", result)
    state = State(path)
    assert (state.get("a"), state.get("b"), state.get("c")) == (result, None, result)


def test_random_mutants_are_drawn_by_lot_and_stay_when_the_code_changes_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    module = tmp_path / "room" / "module.py"
    module.write_text(CODE)
    room = Room("room", 4, ("tests/test_code.py",))
    first = draw(tmp_path, room, "seed")
    assert {(mutant.killers, mutant.others) for mutant in first} == {(("tests/test_code.py",),) * 2}
    assert len({mutant.name for mutant in first}) == 4
    assert draw(tmp_path, room, "seed") == first != draw(tmp_path, room, "another")
    module.write_text(f"X: int | None = None\n\n\n{CODE}")
    assert {mutant.name for mutant in draw(tmp_path, room, "seed")} >= {mutant.name for mutant in first} - {
        mutant.name for mutant in first if "X" in mutant.name
    }
    for mutant in draw(tmp_path, Room("room", 50, ()), "seed"):
        assert mutant.applied_in(tmp_path) != module.read_text() and "|" not in mutant.old


def test_limits_hold_for_what_the_tests_start(workshop: Workshop) -> None:
    """Of what a test starts, not of the test alone: the shell goes on, and says how its child ended."""
    met = workshop._limited(
        ["sh", "-c", '"$0" -c "while True: pass"; exit $?', sys.executable], Limits(cpu_s=1.0, wall_s=600.0)
    )
    assert met.outcome == "failed" and 0.5 < met.cpu_s < 20.0
